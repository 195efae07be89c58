"""Prepare a robot from the published files: matching, feet, servos, start pose and verdict."""
