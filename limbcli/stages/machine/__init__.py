"""Checks and preparation of this machine: system libraries, solver self test, ahead-of-time compilation."""
