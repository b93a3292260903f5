"""The report page: reads what the stages left and shows it; computes nothing."""
