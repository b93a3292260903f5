"""Drawings: each takes plain arrays and returns a matplotlib figure with units on its axes."""
