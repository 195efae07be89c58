"""Make the missing model of a robot with one file: an MJCF from a URDF, or a URDF from an MJCF."""
