"""Simulated measurements with known truth: indentation, hidden effects, and the case that is written."""
