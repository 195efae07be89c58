"""Load a robot, and tell what was added."""
