"""Take robots from their model files to a verified stand."""

HEADING = "Design"
"""Section of ``--help`` that lists this tool."""
