"""Search for the best stance."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
