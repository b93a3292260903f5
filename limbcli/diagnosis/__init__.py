"""The simulation part of the stage `diagnose`: preparation of sites, forward model, and results."""
