"""Take robots from model files to a verified stand."""

HEADING = "Design"
"""Section of ``--help`` that lists this tool."""
