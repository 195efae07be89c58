"""Take robots from model files to a verified stand."""

HELP_HEADING = "Design"
"""Section of ``--help`` that lists this tool."""
