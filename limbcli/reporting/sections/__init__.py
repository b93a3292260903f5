"""The reportlets: one file a question, each a function of the page's material."""
