"""What is run now and then leaves a line with its date, whether it passes or not."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from tests.support.repository import ROOT, script

record_run = script("scripts/record_run.py")


def test_a_run_replaces_its_line_and_its_status_is_returned(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    file.write_text("command,begun,commit,seconds,passed\nb,,,,\nmake x,2020,,,\n")
    for status, said in ((0, "yes"), (3, "NO")):
        command = [sys.executable, "-c", f"raise SystemExit({status})"]
        assert record_run.main("make x", command, file) == status
        _, other, (name, begun, commit, seconds, passed) = csv.reader(file.read_text().splitlines())
        assert other == ["b", "", "", "", ""]
        assert (name, passed) == ("make x", said)
        assert begun.startswith("20")
        assert begun != "2020"
        assert commit
        assert float(seconds) >= 0


def test_the_targets_that_are_recorded_have_a_line() -> None:
    makefile = (ROOT / "Makefile").read_text()
    names = [row[0] for row in csv.reader(record_run.FILE.read_text().splitlines())][1:]
    assert names == sorted(
        {line.split('"')[1] for line in makefile.splitlines() if "$(RECORDED)" in line}
    )
