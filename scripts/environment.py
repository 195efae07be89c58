"""Find the package for the scripts of this folder, whether it is installed or not."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))


def run_command(command: str, *arguments: str) -> None:
    """Run a command of the package; print instructions if a required package is missing.

    Args:
        command: Name of the command.
        *arguments: Arguments before the typed ones.
    """
    from pupper_analysis.__main__ import main

    main(command, *arguments)
