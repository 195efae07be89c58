"""Load a robot, and list what was added."""

HEADING = "Stance"
