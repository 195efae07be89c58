"""One robot, two models, at a state."""
