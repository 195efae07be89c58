"""Solve a stance, and verify the stance by simulation."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
