"""Run checks of the test suite with random inputs: edited files, and random robots.

    python -m tests.explore 20 --seed 1       # number of pairs (make explore)
    python -m tests.explore 0 --robots 10     # number of random robots

``tests/cli/test_every_command.py`` has one edit of each kind for each command; this draws from all
edits (some 140) and all commands. See ``tests.support.every_command``. Random robots must stand or
have a cause (``tests/robots/test_random_robots.py``), and their payload limits must be exact
(``tests/tools/payload/test_limit.py``).
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from tests.robots.test_random_robots import check_robot
from tests.support import every_command
from tests.tools.payload.test_limit import check_random_robot


def main() -> int:
    """Check random pairs of edit and command, and random robots; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--robots", type=int, default=0, help="number of random robots")
    options = parser.parse_args()
    edits = dict(every_command.list_edits())
    pairs = [(name, command) for name in edits for command in every_command.COMMANDS]
    drawn = random.Random(options.seed).sample(pairs, min(options.count, len(pairs)))
    failures = 0
    for name, command in drawn:
        with tempfile.TemporaryDirectory() as folder:
            row = every_command.make_row(name, edits[name], Path(folder), (command,))
        for wrong in row.wrong.values():
            failures += 1
            print(f"{name}, {command}: {wrong} ({row.cells[command].word})")
    print(f"seed {options.seed}: {len(drawn)} pairs of edit and command, {failures} failed")
    for seed in random.Random(options.seed).sample(range(1000, 100_000), options.robots):
        for check in (check_robot, check_payload):
            failures += run_check(check, seed)
    print(f"seed {options.seed}: {options.robots} random robots")
    return int(failures > 0)


def check_payload(seed: int, folder: Path) -> None:
    """Check the payload limit of a random robot."""
    check_random_robot(seed, 0, folder)


def run_check(check: Callable[[int, Path], None], seed: int) -> bool:
    """Run a check with a seed; print and return whether it fails."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            check(seed, Path(folder))
        except Exception:
            print(f"{check.__name__}({seed}) failed:")
            traceback.print_exc()
            return True
    return False


if __name__ == "__main__":
    sys.exit(main())
