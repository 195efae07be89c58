"""Move to a stance, in balance all the way."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
