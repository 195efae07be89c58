"""Find what a learnt policy demands of the motors during walking."""

HELP_HEADING = "Real robot"
"""Section of ``--help`` that lists this tool."""
