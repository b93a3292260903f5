"""Contact of soft facets with rigid bodies and each other: search, pairs, penalty, friction, loops."""
