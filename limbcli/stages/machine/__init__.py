"""This machine: libraries, a self test of a solver, kernels compiled ahead of time."""
