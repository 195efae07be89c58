"""Solve a stance, and verify the stance by simulation."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
