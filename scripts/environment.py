"""Finds the package for the scripts of this folder, whether it is installed or not."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))


def run(command: str, *arguments: str) -> None:
    """Runs a command; where the environment is not activated, says what to do instead.

    Args:
        command: Its name.
        *arguments: What comes before those that are typed.
    """
    from pupper_analysis.__main__ import main

    main(command, *arguments)
