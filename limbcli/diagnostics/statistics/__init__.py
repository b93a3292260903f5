"""Descriptions of residuals: scatter about smooth curves, prediction of held-out data."""
