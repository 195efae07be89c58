"""Find the largest pushes from which a stand recovers."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
