"""Parts of `cohort`: the table, the estimate, compliance of left-out people, the page."""
