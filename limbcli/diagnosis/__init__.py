"""Which effect a site's model lacks: its simulations, data, surrogate and errors; `explanations/` decides."""
