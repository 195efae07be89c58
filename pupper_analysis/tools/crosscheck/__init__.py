"""Find what makes a URDF and an MJCF disagree."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
