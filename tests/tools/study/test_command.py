"""Command ``study``: exit status and answer of a study without results."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import arm
from tests.support.commands import run_command


@pytest.mark.slow
def test_study_whose_designs_all_fail_has_status_1_and_a_reason(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """No stance of v3 has its base 2 or 3 m above the ground. The exit status was 0."""
    file = tmp_path / "high.toml"
    file.write_text('robot = "v3"\nmeasure = ["peak_utilisation"]\n[vary]\nheight = [2.0, 3.0]\n')
    status, out, _ = run_command(capfd, "study", str(file), "-o", str(tmp_path / "out"))
    assert status == 1
    verdict, reason, *_ = out.splitlines()
    assert verdict.startswith("NONE MEASURED v3: 2 designs, 2 failed")
    assert "first failed design: stance out of reach" in reason
    assert "--minimise" not in out


@pytest.mark.slow
def test_next_command_minimises_the_first_metric_that_varies(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The static torques do not depend on kp; the sag does."""
    file = tmp_path / "gains.toml"
    file.write_text(
        'robot = "v3"\nmeasure = ["peak_utilisation", "servo_sag"]\n[vary]\nkp = [5.0, 10.0]\n'
    )
    status, out, err = run_command(capfd, "study", str(file), "-o", str(tmp_path / "out"))
    assert status == 0, err
    verdict, answer, step, *_ = out.splitlines()
    assert verdict.startswith("MEASURED v3: 2 designs")
    assert answer.split()[0] == "servo_sag"
    assert step.endswith("--minimise servo_sag")


def test_fixed_base_names_the_command_that_holds_it(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The refusal stated that the robot has no feet, without a next command."""
    path, file = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    path.write_text(arm.URDF)
    file.write_text('robot = "arm.urdf"\nmeasure = ["stands"]\n[vary]\nleg_scale = [1.0, 1.1]\n')
    status, _, err = run_command(capfd, "study", str(file), "-o", str(tmp_path / "out"))
    fault, step = err.splitlines()
    assert status == 2
    assert fault == (
        f"error: {file}: {path.name} has a fixed base, so study does not apply; "
        "hold computes torques"
    )
    assert step == f"  next: pupper-analysis hold {path}"
