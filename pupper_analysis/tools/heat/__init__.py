"""Predict how hot the motors of a stance become, and the current of the battery."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
