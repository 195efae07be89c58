"""Fit of motions: what the robot's servos would have done is simulated."""
