"""Map how far the base goes, feet planted."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
