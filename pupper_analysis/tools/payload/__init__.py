"""Find the largest payload of a stance, and the failure beyond this limit."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
