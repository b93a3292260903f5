"""Predictions beside the data: the surrogate, its fits and its repairs."""
