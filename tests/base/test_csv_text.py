"""CSV tables: texts that spreadsheets would execute are escaped, and are read back unchanged."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from pupper_analysis.base.csv_text import cell_text, csv_text
from pupper_analysis.pupper.variant_files import write_variant
from tests.support.commands import answer
from tests.support.layers import PACKAGE

FORMULAS = [
    "=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(1)", "\t=1", "\r=1", "\n=1", "\uff1d1+1", "-", "-a",
]  # fmt: skip
"""First characters by OWASP's page on CSV injection."""


@pytest.mark.parametrize("formula", FORMULAS)
def test_texts_that_spreadsheets_execute_are_written_as_text(formula: str) -> None:
    (row,) = csv.reader(io.StringIO(csv_text([[formula, "FL_hip"]]), newline=""))
    assert row == [f"'{formula}", "FL_hip"]
    assert cell_text(row[0]) == formula


@pytest.mark.parametrize("cell", ["-0.1", "+2", "-1e-3", "-inf", -0.1, "'quoted", "a=b", ""])
def test_numbers_and_other_texts_are_written_as_they_are(cell: object) -> None:
    assert csv_text([[cell, 0]]) == f"{cell},0\n"
    assert cell_text(str(cell)) == str(cell)


@pytest.mark.slow
def test_stand_writes_a_joint_whose_name_is_a_formula_as_text(tmp_path: Path) -> None:
    urdf, mjcf = write_variant("v3", tmp_path)
    for path in (urdf, mjcf):
        path.write_text(path.read_text().replace("leg_front_r_1", "=leg|calc!A0"))
    done = answer("stand", str(urdf), str(mjcf), "--csv", str(tmp_path / "stand.csv"))
    assert done.returncode == 0, done.stderr
    names = [row[0] for row in csv.reader(io.StringIO((tmp_path / "stand.csv").read_text()))]
    assert names[1] == "'=leg|calc!A0"
    assert not [name for name in names if name.startswith("=")]


def test_csv_writer_is_used_in_one_module() -> None:
    """Reference: the source files of the package."""
    users = [path for path in PACKAGE.rglob("*.py") if "csv.writer" in path.read_text("utf-8")]
    assert users == [PACKAGE / "base/csv_text.py"]
