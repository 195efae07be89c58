"""Command ``workspace``: refusal of a fixed base."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import arm
from tests.support.commands import run_command


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
