"""Find what changed between two versions."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
