"""Simulated measurements with known truth: indentation, hidden effects, the case that they are written as."""
