"""Contact of soft facets with rigid bodies: search, pairs, penalty, friction, and their compiled loops."""
