"""Find what changed between two versions."""

HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
