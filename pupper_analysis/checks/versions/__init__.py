"""Compares two versions of a model: what has changed in the robot, and what that does."""
