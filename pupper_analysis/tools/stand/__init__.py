"""Solve a stance, and verify it by simulation."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
