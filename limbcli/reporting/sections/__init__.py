"""The reportlets: one file per question, each a function of the page's data."""
