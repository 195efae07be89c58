"""Move to a stance, in balance all the way."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
