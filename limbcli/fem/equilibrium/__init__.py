"""Equilibrium: the times to be solved for, increments towards them, Newton's method, the tangent."""
