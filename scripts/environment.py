"""Runs a command of the package for a script, or says how to get the package."""

from __future__ import annotations

import sys


def run(command: str) -> None:
    """Runs ``pupper_analysis.cli``'s command; where a package is missing, one line and status 2.

    Args:
        command: Its name: ``analyze``, ``drop`` or ``view``.
    """
    try:
        from pupper_analysis import cli
    except ModuleNotFoundError as missing:
        print(
            f"error: {sys.executable} has no package {missing.name}. In the repository's folder: "
            "`make setup`, then `source .venv/bin/activate`; or `uv run python scripts/...`.",
            file=sys.stderr,
        )
        sys.exit(2)
    cli.run(getattr(cli, command))
