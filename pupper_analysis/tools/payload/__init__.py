"""Find the largest payload of a stance, and what fails beyond it."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
