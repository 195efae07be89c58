"""Solve a stance, and verify it by simulation."""

HEADING = "Stance"
