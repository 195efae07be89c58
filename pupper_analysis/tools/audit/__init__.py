"""Find physical and practical errors in a URDF, MJCF or USD."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
