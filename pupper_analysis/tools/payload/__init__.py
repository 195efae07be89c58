"""Find how much a stance carries, and what fails."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
