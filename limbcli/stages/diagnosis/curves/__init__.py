"""Force and wave speed over depth, of models solved and kept."""
