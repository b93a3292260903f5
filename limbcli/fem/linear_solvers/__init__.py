"""Linear solvers: direct solvers behind one interface (our own is `multifrontal`), and GMRES."""
