"""What moves and what is given: rigid bodies and their loads, load curves, the state of a model."""
