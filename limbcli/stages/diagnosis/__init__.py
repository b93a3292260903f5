"""The simulation half of `diagnose`: what it prepares, and what it writes."""
