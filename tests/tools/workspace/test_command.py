"""Command ``workspace``: refusal of a fixed base, and ranges without all masses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.support import arm
from tests.support.commands import run_command
from tests.support.conversions import write_standing_urdf


@pytest.mark.parametrize("typed", ["", "--height 12cm"])
def test_fixed_base_has_a_range_of_zero(
    typed: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A base that the file fixes to the world cannot move."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF)
    status, _, err = run_command(capfd, "workspace", str(path), *typed.split())
    fault, step = err.splitlines()
    assert status == 2
    assert fault.startswith("error: arm.urdf has a fixed base: the range of the base is zero")
    assert step.startswith(f"  next: pupper-analysis hold {path}")


@pytest.mark.slow
def test_range_without_all_masses_is_unknown(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The CoM depends on the mass of a thigh, which moves an end of the range by 1 cm and more.

    The answer was RANGE with exit status 0, without the missing mass.
    """
    path = write_standing_urdf(tmp_path)
    ends = {}
    for name, expected in (("stated", 0), ("missing", 1)):
        status, out, _ = run_command(
            capfd, "workspace", str(path), "--json", str(tmp_path / f"{name}.json")
        )
        assert status == expected
        assert out.startswith("UNKNOWN" if expected else "RANGE")
        assert ("no mass stated for 1 moving link (FL_thigh)" in out) is bool(expected)
        result = json.loads((tmp_path / f"{name}.json").read_text())
        assert (result["missing_masses"] is None) is not bool(expected)
        ends[name] = result["intervals"]["x"]["low"]
        head, link, rest = path.read_text().partition('<link name="FL_thigh">')
        path.write_text(head + link + re.sub(r"(?s)<inertial>.*?</inertial>", "", rest, count=1))
    assert abs(ends["stated"] - ends["missing"]) > 0.01
