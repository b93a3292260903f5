"""Predictions of the data: the surrogate, its fits, and its corrections by further simulations."""
