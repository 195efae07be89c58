"""Find the largest pushes from which a stand recovers."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
