"""Find what is wrong in one URDF, MJCF or USD."""

HEADING = "Files"
