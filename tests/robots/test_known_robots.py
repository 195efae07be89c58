"""The table of known robots has every robot of the packages, as their files are now."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.repository import ROOT

TABLE = ROOT / "docs/data/robots-of-packages.csv"


@pytest.mark.longest
@pytest.mark.skipif("PUPPER_ROBOTS" not in os.environ, reason="PUPPER_ROBOTS names no folder")
def test_the_table_is_made_by_one_command_from_cached_rows(tmp_path: Path) -> None:
    """A robot whose files are those of its row is not run again; one that is gone is."""
    rows = TABLE.read_text(encoding="utf-8").splitlines(keepends=True)
    copy = tmp_path / "robots.csv"
    shutil.copy(TABLE, copy)
    command = [sys.executable, "benchmarks/robots.py", os.environ["PUPPER_ROBOTS"], "--csv", copy]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"{len(rows) - 1} robots, 0 rows changed" in done.stdout
    gone = next(row for row in rows if row.startswith("a1,"))
    copy.write_text("".join(row for row in rows if row != gone), encoding="utf-8")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert "1 rows changed" in done.stdout
    assert set(copy.read_text(encoding="utf-8").splitlines(keepends=True)) == set(rows)
