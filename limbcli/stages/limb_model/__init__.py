"""What the stage `limb` puts into the model of a whole limb, and what it hands over."""
