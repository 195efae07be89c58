"""Compare what commands say of edited files with bare MuJoCo, for random pairs of edit and command.

    python -m tests.explore 20 --seed 1       # as many pairs (make explore)

``tests/cli/test_every_command.py`` has one edit of each kind for each command; this draws from all
edits (some 140) and all commands. See ``tests.support.every_command``.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

from tests.support import every_command


def main() -> int:
    """Check random pairs of edit and command; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    options = parser.parse_args()
    edits = dict(every_command.edits())
    pairs = [(name, command) for name in edits for command in every_command.COMMANDS]
    drawn = random.Random(options.seed).sample(pairs, min(options.count, len(pairs)))
    failures = 0
    for name, command in drawn:
        with tempfile.TemporaryDirectory() as folder:
            row = every_command.row_of(name, edits[name], Path(folder), (command,))
        for wrong in row.wrong.values():
            failures += 1
            print(f"{name}, {command}: {wrong} ({row.cells[command].word})")
    print(f"seed {options.seed}: {len(drawn)} pairs of edit and command, {failures} failed")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
