"""Find what a learnt policy asks of the motors as it walks."""

HEADING = "Real robot"
"""Section of ``--help`` that lists this tool."""
