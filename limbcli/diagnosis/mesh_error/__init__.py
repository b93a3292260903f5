"""Numerical effects on a site's curves: mesh, truncation of the limb, and contact."""
