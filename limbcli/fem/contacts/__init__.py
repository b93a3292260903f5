"""Contact of soft facets with rigid bodies and with each other: search, contact pairs, penalty, friction, compiled loops."""
