"""Units, limits, interpolation, and numbers as text."""
