"""A synthetic subject with known truth: anatomy, MRI, measurements."""
