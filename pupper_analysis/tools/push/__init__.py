"""Find how hard a push it withstands, and where."""

HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
