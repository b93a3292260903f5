"""The report page: reads and displays the results of the stages, without computing anything."""
