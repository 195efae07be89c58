"""Printed view and drop of a robot, and the refusal without a display."""

import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.present import display
from pupper_analysis.tools.live import window as viewer
from tests.support import legged
from tests.support.variants import load

GRAVITY = 9.81


@pytest.fixture(scope="module")
def dropped() -> viewer.Drop:
    return viewer.simulate_drop(load("v3"))


# ------------------------------------------------------------------------------------- the drop


def test_a_dropped_robot_falls_lands_and_holds(dropped: viewer.Drop) -> None:
    """Reference: nominal height of v3, 0.120 m, after a drop from 0.28 m."""
    assert dropped.height[0] == 0.28
    assert dropped.time[-1] == pytest.approx(viewer.DROP_SECONDS)
    assert len(dropped.time) == len(dropped.height)
    assert dropped.height[-1] == pytest.approx(0.120, abs=5e-4)
    assert dropped.height_deviation < 5e-6
    assert dropped.stable


def test_drop_report_states_height_deviation_and_contacts(dropped: viewer.Drop) -> None:
    """References: nominal height 0.120 m of v3; bare MuJoCo tilts by 0.03 rad, at rest."""
    assert viewer.format_drop(dropped) == (
        "base height 120 mm, standard deviation in the last second 0.00 mm (limit 5 mm)",
        "tilt 1.7 deg, only the feet touch the ground; servos hold keyframe home, "
        "not the solved stand",
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keyframe", "pose"), [("0 0.6 -1.2", "keyframe home"), ("", "the start pose")]
)
def test_drop_report_names_the_pose_that_the_servos_hold(
    tmp_path: Path, keyframe: str, pose: str
) -> None:
    """Reference: the commands of the drop, compared with the joint positions in the file."""
    pair = legged.quadruped(tmp_path, floor=True, actuators="position", keyframe=keyframe)
    robot = pa.load_robot(pair.mjcf)
    held = viewer.make_home_data(robot).ctrl
    stated = np.tile(np.fromstring(keyframe or "0 0 0", sep=" "), 4)
    assert np.allclose(held, stated, rtol=0, atol=1e-9) is bool(keyframe)
    line = viewer.format_drop(viewer.simulate_drop(robot))[1]
    assert line.endswith(f"; servos hold {pose}, not the solved stand")


def test_stable_drop_on_unstable_damping_states_ideal_servos(
    dropped: viewer.Drop, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """v3 is stable on an explicit PD controller up to 26 times its damping."""
    assert dropped.largest_kd_factor is not None
    assert 20 < dropped.largest_kd_factor < 30
    for factor, word in (
        (dropped.largest_kd_factor, "STABLE v3: "),
        (0.56, "STABLE (ideal servos)"),
    ):
        drop = replace(dropped, largest_kd_factor=factor)
        monkeypatch.setattr(viewer, "simulate_drop", lambda _, drop=drop: drop)
        assert viewer.drop_and_report(load("v3"), headless=True)
        assert capsys.readouterr().out.startswith(word)


def test_a_dropped_robot_falls_freely_until_it_lands(dropped: viewer.Drop) -> None:
    """Closed form g t (t + h) / 2 of the semi-implicit Euler method with the step h."""
    time = dropped.time[dropped.time < 0.17]  # it lands after 0.18 s
    fallen = dropped.height[0] - dropped.height[: len(time)]
    np.testing.assert_allclose(fallen, GRAVITY / 2 * time * (time + dropped.time[1]), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "tilt", "touching"),
    [
        ("v3", 0.03, ()),
        ("long-leg", math.pi, ("base_link",)),
        ("v3-long-leg", 0.28, ("leg_back_l_2", "leg_back_r_2")),
    ],
)
def test_only_a_robot_upright_on_its_feet_is_stable_after_a_drop(
    variant: str, tilt: float, touching: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Reference: tilt and contacts of bare MuJoCo's last state.

    All three robots are at rest after 6 s.
    """
    robot = load(variant)
    model, data = robot.mj_model, viewer.make_home_data(robot)
    mujoco.mj_step(model, data, round(viewer.DROP_SECONDS / model.opt.timestep))
    base = model.body(robot.mj_base).id
    bodies = model.geom_bodyid[data.contact.geom]
    found = {model.body(int(body)).name for body in bodies[(bodies == 0).any(axis=1)].ravel()}
    assert math.acos(data.xmat[base][8]) == pytest.approx(tilt, abs=0.01)
    result = viewer.simulate_drop(robot)
    assert result.height_deviation < 1e-4
    assert result.end.tilt == pytest.approx(math.acos(data.xmat[base][8]), abs=1e-6)
    assert result.end.touching == touching
    assert set(touching) <= found
    assert result.stable == (not touching)
    assert viewer.drop_and_report(robot, headless=True) == result.stable
    line = capsys.readouterr().out
    assert f"tilt {math.degrees(result.end.tilt):.1f} deg" in line
    assert all(body in line for body in touching)
    assert ("NOT stable" in line) is bool(touching)


# ------------------------------------------------------------------------------------- the view


@pytest.mark.parametrize(
    ("fixed", "sizes", "acceleration"),
    [(True, "nq=12, nv=12, nu=12", GRAVITY), (False, "nq=19, nv=18, nu=12", 0.0)],
)
def test_headless_view_prints_sizes_and_sensor_values(
    capsys: pytest.CaptureFixture[str], fixed: bool, sizes: str, acceleration: float
) -> None:
    """At rest an accelerometer measures gravity on a fixed base, and nothing in free fall."""
    viewer.view_robot(pa.load_variant("v3", fixed_base=fixed), headless=True)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"READY v3: MuJoCo model with {sizes}, ")
    assert ("fixed" if fixed else "base height 280.0 mm, lowest foot 148.5 mm") in lines[1]
    assert lines[2] == ""
    readings = [re.match(r'data\.sensor\("(\w+)"\)\.data +(.*)', line) for line in lines]
    sensors = {found[1]: list(map(float, found[2].split())) for found in readings if found}
    assert len(sensors) == len(lines) - 3 == 6
    assert sensors["body_quat"] == [1, 0, 0, 0]
    assert sensors["body_acc"] == pytest.approx([0.0, 0.0, acceleration], abs=1e-3)


# ------------------------------------------------------------------------------------- no window


@pytest.fixture
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="X11 is Linux's display")
def test_display_that_does_not_exist_raises_an_error() -> None:
    """In a process of its own, which MuJoCo's viewer would end without a traceback."""
    code = "from pupper_analysis.present import display; display.check_display()"
    environment = {**os.environ, "DISPLAY": ":4711"}
    environment.pop("WAYLAND_DISPLAY", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "DisplayError: MuJoCo's viewer is not available" in done.stderr.splitlines()[-1]


@pytest.mark.usefixtures("no_screen")
def test_missing_display_is_refused_with_headless(capsys: pytest.CaptureFixture[str]) -> None:
    for show in (
        lambda: viewer.view_robot(load("v3"), headless=False),
        lambda: viewer.drop_and_report(load("v3"), headless=False),
    ):
        with pytest.raises(display.DisplayError, match=r"no display.*--headless") as caught:
            show()
        assert isinstance(caught.value, PupperAnalysisError)
        assert "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""


def test_window_starts_from_home_and_reports_the_headless_result(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], dropped: viewer.Drop
) -> None:
    from mujoco import viewer as mujoco_viewer

    heights: list[float] = []

    def launch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        heights.append(float(data.qpos[2]))
        for _ in range(100):
            mujoco.mj_step(model, data)

    monkeypatch.setattr(display, "check_display", lambda: None)
    monkeypatch.setattr(mujoco_viewer, "launch", launch)
    assert viewer.drop_and_report(load("v3"), headless=False)
    assert heights == [dropped.height[0]]
    assert f"base height {1e3 * dropped.height[-1]:.0f} mm, " in capsys.readouterr().out


def test_fixed_robot_stays_at_its_slider_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    """No joint moves without a command; a command of 0.1 rad moves its joint by 0.1 rad."""
    from mujoco import viewer as mujoco_viewer

    moved: list[float] = []

    def launch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        start = data.qpos.copy()
        for _ in range(500):
            mujoco.mj_step(model, data)
        moved.append(float(np.abs(data.qpos - start).max()))
        data.ctrl[0] += 0.1
        for _ in range(2000):
            mujoco.mj_step(model, data)
        moved.append(float(data.qpos[0] - start[0]))

    monkeypatch.setattr(display, "check_display", lambda: None)
    monkeypatch.setattr(mujoco_viewer, "launch", launch)
    viewer.view_robot(pa.load_variant("v3", fixed_base=True), headless=False)
    assert moved == pytest.approx([0.0, 0.1], abs=1e-3)


def test_home_commands_of_the_view_are_those_of_geared_servos_and_coupled_joints() -> None:
    """A gear of 2 doubles the ctrl; joint "b" has no motor, and motor "m" is no position servo."""
    rod = '<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>'
    robot = pa.load_robot(
        f"""<mujoco><worldbody><body name="base" pos="0 0 1">{rod}
        <body pos="0 0 -.3"><joint name="a" axis="0 1 0" range="-2 2"/>{rod}
        <body pos="0 0 -.3"><joint name="c" axis="0 1 0" range="-2 2"/>{rod}
        <body pos="0 0 -.3"><joint name="b" axis="0 1 0" range="-2 2"/>{rod}</body></body></body>
        </body></worldbody>
        <equality><joint joint1="b" joint2="a" polycoef="0 1 0 0 0"/></equality>
        <actuator><position name="s" joint="a" kp="5" gear="2"/>
        <motor name="m" joint="c" gear="1" ctrlrange="-3 3"/></actuator>
        <keyframe><key name="home" qpos=".5 .3 .5"/></keyframe></mujoco>""",
        as_is=True,
    )
    data = viewer.make_home_data(robot)
    np.testing.assert_allclose(data.qpos, [0.5, 0.3, 0.5])
    forces = dict(zip(("s", "m"), data.actuator_force.tolist(), strict=True))
    assert forces["s"] == pytest.approx(0.0, abs=1e-9)  # MuJoCo: kp (ctrl - 2 q)
    assert forces["m"] == 0.0
