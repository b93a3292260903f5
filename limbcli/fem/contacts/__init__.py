"""Contact between soft facets and rigid bodies: search, contact pairs, penalty, friction, compiled loops."""
