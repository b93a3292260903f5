"""Measured data of a site: layout as rows, and noise."""
