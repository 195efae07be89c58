"""Plan a path to a stance in balance, and simulate the path."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
