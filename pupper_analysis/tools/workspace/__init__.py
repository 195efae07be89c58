"""Map how far the base goes, feet planted."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
