"""A synthetic subject whose truth is known: anatomy, MRI, measurements."""
