"""Find the largest payload of a stance, and its limiting failure."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
