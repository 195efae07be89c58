"""The demos: what they do, that MuJoCo follows, and ``stand --demo`` on the command line."""

from __future__ import annotations

import csv
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import viewer

from pupper_analysis import Configuration
from pupper_analysis.tools.live import demo, window
from pupper_analysis.tools.path.path_commands import path_commands
from pupper_analysis.tools.path.tracking import track_path
from tests.support.commands import run_command
from tests.support.variants import load


def test_demos_move_as_they_are_named() -> None:
    robot = load("v3")
    squat, sway, lift = (demo.demo_path(robot, name) for name in demo.DEMOS)
    height = robot.stand_height
    assert squat.qpos[:, 2].min() == pytest.approx(0.8 * height)
    assert np.ptp(squat.qpos[:, :2], axis=0).max() < 5e-3
    assert np.ptp(sway.qpos[:, 1]) == pytest.approx(0.04)
    np.testing.assert_allclose(sway.qpos[:, 2], height, atol=1e-9)
    foot = lift.feet.index("FL")
    assert lift.clearance[:, foot].max() == pytest.approx(0.02)
    assert lift.loads[:, foot].min() == 0.0
    highest = lift.qpos[int(lift.clearance[:, foot].argmax())]
    raised = Configuration(robot, highest).foot_positions()["FL"][2]
    assert raised == pytest.approx(robot.contact_radius["FL"] + 0.02)


@pytest.mark.parametrize("name", demo.DEMOS)
def test_mujoco_follows_the_demos(
    name: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "path.csv"
    status, out, err = run_command(capfd, "live", "--headless", "--demo", name, "--csv", str(path))
    assert status == 0, err
    assert out.startswith(f"{name}: {demo.DEMOS[name]}")
    assert "TRACKED" in out
    with path.open() as file:
        header, *rows = csv.reader(file)
    assert header[0] == "time (s)"
    assert len(header) == 1 + 2 * 12
    assert ["samples", str(len(rows))] in [line.split() for line in out.splitlines()]


def test_the_window_shows_what_is_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[np.ndarray] = []

    monkeypatch.setattr(window, "check_display", lambda: None)
    robot = load("v3")
    steps = len(path_commands(robot, demo.demo_path(robot, "sway")).ctrl)

    def launch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for _ in range(steps):
            mujoco.mj_step(model, data)
        shown.append(data.qpos.copy())

    monkeypatch.setattr(viewer, "launch", launch)
    assert demo.demo("sway", headless=False)
    tracking = track_path(robot, demo.demo_path(robot, "sway"))
    np.testing.assert_allclose(shown[0][7:], tracking.joints[-1], atol=1e-9)
    assert shown[0][2] == pytest.approx(tracking.height[-1], abs=1e-9)


def test_a_path_that_is_not_tracked_is_exit_status_1(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from pupper_analysis.tools.path import tracking

    monkeypatch.setattr(tracking, "TRACKING_TOLERANCE", 1e-6)
    status, out, _ = run_command(capfd, "live", "--headless", "--demo", "squat")
    assert status == 1
    assert "FAILED squat: a joint is off by" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--demo", "dance"], "'dance' is not one of 'squat', 'sway', 'lift'"),
        (["--demo", "squat", "--seconds", "4"], "--seconds: it does nothing with --demo"),
        (["--drop", "--csv", "path.csv"], "--csv: it does nothing with --drop, it is of --demo"),
        (["--demo", "squat", "--csv", "."], "it is a folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_2(
    arguments: list[str],
    message: str,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run_command(capfd, "live", "--headless", *arguments)
    assert status == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""
    assert list(tmp_path.iterdir()) == []
