"""Search for the best stance."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
