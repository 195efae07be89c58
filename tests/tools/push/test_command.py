"""The command ``push``: printed text, written files, exit status, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import pupper_analysis as pa
from tests.support.commands import check_refusal, run_command
from tests.support.variants import load

COARSE = ("--directions", "4", "--resolution", "0.3")


@pytest.mark.slow
def test_stand_that_does_not_last_gives_exit_status_1(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tilt that counts as fallen is set to -1 rad."""
    from pupper_analysis.robot import fall
    from pupper_analysis.simulation import monitor

    for module in (fall, monitor):
        monkeypatch.setattr(module, "FALLEN_TILT", -1.0)
    status, out, _ = run_command(capfd, "push", "original", *COARSE)
    assert status == 1
    assert "COLLAPSES in MuJoCo: the robot fell over" in out
    assert "the robot does not stand, so it withstands no push" in out


@pytest.mark.slow
def test_pushes_of_two_files_in_a_stance_equal_the_python_result(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: impulses [N s] of `push_recovery` with the same task and gains."""
    urdf, mjcf = pa.pupper.write_variant("heavy", tmp_path / "robot")
    own = ("--urdf", str(urdf), "--mjcf", str(mjcf))
    feet = [part for foot in ("FL", "FR", "RL", "RR") for part in ("--foot", f"{foot}_foot")]
    stance = (
        *("--swing", "FL_foot=1cm", "--com", "inside", "--com-margin", "1cm", "--height", "0.15"),
    )
    file, figure = tmp_path / "own.json", tmp_path / "own.png"
    servos = ("--kp", "60", "--kd", "1")
    status, out, err = run_command(
        capfd, "push", "-v", *own, *feet, *stance, *servos, *COARSE, "--json", str(file),
        "--figure", str(figure),
    )  # fmt: skip
    assert status == 0, err
    generator, _, found = json.loads(file.read_text()).values()
    assert generator.startswith("pupper-analysis ")
    robot = load("heavy")
    task = pa.StandTask(height=0.15, swing={"FL": 0.01}, com="inside", com_margin=0.01)
    alike = pa.push_recovery(
        robot,
        pa.stance.solve_stand_on_soft_ground(robot, task),
        directions=4,
        resolution=0.3,
        kp=60.0,
        kd=1.0,
    )
    np.testing.assert_allclose(found["recovery"]["impulses"], alike.impulses, atol=1e-9)
    assert "FL_foot lifted 10 mm" in out
    assert imread(figure).std() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("v3", "--directions", "2"), "directions: 2 is not between 3 and 360"),
        (("v3", "--resolution", "0"), "resolution: 0.0 N s is not between"),
        (("v3", "--urdf", "a.urdf"), "a.urdf: there is no such file"),
    ],
)
def test_invalid_input_is_refused_in_one_line(
    arguments: tuple[str, ...], message: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    check_refusal(capfd, tmp_path, ["push", *arguments, "--json", "all.json"], message)
