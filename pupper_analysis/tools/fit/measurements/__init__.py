"""Measurements as they are read: stands at rest, and logs of motions."""
