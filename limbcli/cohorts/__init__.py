"""Parts of `cohort`: the family of models, the estimate, compliance of left-out people, the page."""
