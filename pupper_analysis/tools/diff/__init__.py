"""List the changes between two versions of a model, with the effects of each change."""

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""
