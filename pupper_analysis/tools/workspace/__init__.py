"""Find the range of the base with planted feet."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
