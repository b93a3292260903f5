"""What `batch` is made of: the steps of a site, their outcome, who works on them, fits on demand."""
