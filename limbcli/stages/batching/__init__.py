"""Parts of `batch`: the steps of a site, their outcome, the processes that run them, fits on demand."""
