"""Prepare a robot from its published files: matching, feet, servos, start pose and verdict."""
