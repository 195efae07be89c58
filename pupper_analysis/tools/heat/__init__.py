"""Predict the temperature of the motors of a stance."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
