"""What was measured, how it is laid out, and by what it errs."""
