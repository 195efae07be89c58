"""Solve a stance: what it costs, and if it holds."""

HEADING = "Stance"
