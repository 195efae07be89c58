"""Runs a command that nobody runs every day, and records when that was: docs/data/last-runs.csv.

    python scripts/record_run.py "make benchmark" COMMAND ...

The line of that name gets the time, the commit (``+``: with changes), the seconds, and whether the
command passed, whose exit status is returned.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "data" / "last-runs.csv"


def commit() -> str:
    """Returns the commit that is checked out, with a ``+`` if files are changed; else "unknown"."""
    try:
        return subprocess.run(
            ["git", "describe", "--always", "--abbrev=8", "--exclude=*", "--dirty=+"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def record(file: Path, name: str, when: datetime, of: str, seconds: float, passed: bool) -> None:
    """Writes the line of a name anew; the others stay.

    Args:
        file: The table.
        name: What was run.
        when: When it began.
        of: The commit.
        seconds: How long it took (s).
        passed: Whether it passed.
    """
    with file.open(encoding="utf-8", newline="") as opened:
        header, *rows = csv.reader(opened)
    line = [name, f"{when:%Y-%m-%d %H:%M} UTC", of, f"{seconds:.0f}", "yes" if passed else "NO"]
    rows = sorted([*(row for row in rows if row[0] != name), line])
    with file.open("w", encoding="utf-8", newline="") as opened:
        csv.writer(opened, lineterminator="\n").writerows([header, *rows])


def main(name: str, command: Sequence[str], file: Path = FILE) -> int:
    """Runs a command, and records it; returns its exit status."""
    when, of, begin = datetime.now(UTC), commit(), time.monotonic()
    status = subprocess.run(command, cwd=ROOT, check=False).returncode
    record(file, name, when, of, time.monotonic() - begin, status == 0)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
