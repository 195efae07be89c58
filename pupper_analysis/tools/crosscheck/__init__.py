"""Find the differences between a URDF and an MJCF, and their causes."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
