"""Conversion of a URDF into an MJCF that agrees and stands, and back."""
