"""Find what changed between two versions."""

HEADING = "Files"
