"""Find the stiffness and damping with which a robot stands stably."""

HELP_HEADING = "Stance"
"""Section of ``--help`` that lists this tool."""
