"""Make the missing model of a robot: an MJCF from a URDF, or a URDF from an MJCF."""
