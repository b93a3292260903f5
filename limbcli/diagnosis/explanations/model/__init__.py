"""Input of a diagnosis: the data and their noise, the forward model to fit, and its linearised fit."""
