"""List changes between two versions of a model, with effects."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
