"""Fits, profiles and intervals of a few parameters of any model; knows no site and no file."""
