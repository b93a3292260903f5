"""Equilibrium solution: solve times, load increments, Newton's method, tangent."""
