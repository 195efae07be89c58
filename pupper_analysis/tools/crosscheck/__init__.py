"""Find differences of a URDF and an MJCF, and the causes."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
