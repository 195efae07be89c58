"""The other model of a robot of which there is one file: an MJCF of a URDF, or back."""
