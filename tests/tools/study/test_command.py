"""Command ``study``: exit status and answer of a study without results."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

from pupper_analysis.tools.study.study import Study
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


def test_missing_study_file_names_a_similar_file_or_the_example(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The printed next commands are complete."""
    (tmp_path / "legs.toml").write_text('robot = "v3"\n')
    status, _, err = run_command(capfd, "study", str(tmp_path / "leg.toml"), "-o", "legs")
    fault, step = err.splitlines()
    assert status == 2
    assert fault.endswith(f"there is no such file; did you mean {tmp_path / 'legs.toml'}?")
    assert step == f"  next: pupper-analysis study {tmp_path / 'legs.toml'} -o legs"
    status, _, err = run_command(capfd, "study", str(tmp_path / "other.toml"), "-o", "legs")
    fault, step = err.splitlines()
    assert status == 2
    assert fault.endswith("there is no such file; study --help contains an example")
    assert step == "  next: pupper-analysis study --help"


def test_example_of_the_help_is_a_complete_study_file(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The error about a missing file refers to this example."""
    status, out, _ = run_command(capfd, "study", "--help")
    assert status == 0
    example = out.split("Example of a file:\n")[1].split("\n\n")[0]
    file = tmp_path / "example.toml"
    file.write_text(textwrap.dedent(example))
    assert len(Study.read(file)) == 9 * 9 * 3
