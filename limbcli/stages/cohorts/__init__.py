"""What `cohort` is made of: the family of models, the estimate, compliance of people left out, the page."""
