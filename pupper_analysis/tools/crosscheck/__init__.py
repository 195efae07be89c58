"""Find what makes a URDF and an MJCF disagree."""

HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
