"""Find what makes a URDF and an MJCF disagree."""

HEADING = "Files"
