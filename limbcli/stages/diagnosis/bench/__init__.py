"""Predictions beside the data: the stand-in, its fits and its repairs."""
