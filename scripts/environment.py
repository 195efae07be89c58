"""Finds the package for the scripts of this folder, whether it is installed or not."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))


def run(command: str) -> None:
    """Runs a command; where the environment is not activated, says what to do instead.

    Args:
        command: Its name in ``pupper_analysis.cli``: ``analyze``, ``drop`` or ``view``.
    """
    from pupper_analysis.__main__ import main

    main(command)
