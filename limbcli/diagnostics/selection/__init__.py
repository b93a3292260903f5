"""Which explanations are kept: candidates, their refits, the confidence set, and when the gap is closed."""
