"""The view and the drop, in words; and that a missing screen is said in one line."""

import math
import os
import re
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.pupper.variants import model_folder
from pupper_analysis.tools.live import window as viewer

GRAVITY = 9.81


@pytest.fixture(scope="module")
def dropped() -> viewer.Drop:
    return viewer.drop()


def home(file: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(str(model_folder("mjcf") / file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data


# ------------------------------------------------------------------------------------- the drop


def test_a_dropped_robot_falls_lands_and_holds(dropped: viewer.Drop) -> None:
    assert dropped.height[0] == 0.28
    assert dropped.time[-1] == pytest.approx(viewer.DEFAULT_SECONDS)
    assert len(dropped.time) == len(dropped.height)
    assert dropped.height[-1] == pytest.approx(0.120, abs=5e-4)
    assert dropped.height_deviation < 5e-6
    assert dropped.stable


def test_a_dropped_robot_falls_freely_until_it_lands(dropped: viewer.Drop) -> None:
    touchdown = dropped.readings[1].time
    falling = dropped.time < touchdown - 0.01
    expected = 0.28 - GRAVITY / 2 * dropped.time[falling] ** 2
    # The semi-implicit Euler method runs ahead by half a step.
    np.testing.assert_allclose(dropped.height[falling], expected, atol=2e-3)


def test_the_imu_feels_the_fall_the_impact_and_gravity(dropped: viewer.Drop) -> None:
    release, touchdown, impact, rest = dropped.readings
    moments = [reading.moment for reading in dropped.readings]
    assert moments == ["release", "touchdown", "impact", "rest"]
    np.testing.assert_allclose(release.acceleration, 0, atol=1e-9)
    assert 0.1 < touchdown.time <= impact.time < 0.5
    assert np.linalg.norm(impact.acceleration) > 2 * GRAVITY
    assert rest.acceleration[2] == pytest.approx(GRAVITY, abs=0.01)
    assert np.linalg.norm(rest.acceleration) == pytest.approx(GRAVITY, abs=0.001)
    np.testing.assert_allclose(rest.angular_velocity, 0, atol=1e-3)


def test_stand_prints_its_result(capsys: pytest.CaptureFixture[str]) -> None:
    assert viewer.drop_and_report(headless=True)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "final z=0.120 m, last-1s std=0.00 mm (< 5 mm = stable)"
    rest = next(line.split() for line in lines if line.strip().startswith("rest"))
    assert rest[1] == "6.000"
    assert float(rest[5]) == pytest.approx(GRAVITY, abs=0.01)


@pytest.mark.parametrize("seconds", [math.nan, math.inf, -math.inf, -1.0, 0.0, 1.999, 600.1])
def test_bad_seconds_are_refused(seconds: float) -> None:
    with pytest.raises(ConfigurationError, match="from 2 to 600 s") as caught:
        viewer.drop_and_report(headless=True, seconds=seconds)
    assert caught.value.field == "seconds"


@pytest.mark.parametrize("name", ["original", "v3-heavy"])
def test_other_variants_fall_and_stand(name: str) -> None:
    result = viewer.drop(4.0, robot=name)
    assert result.stable
    assert result.readings[1].time > 0.1  # it has fallen
    expected = (
        math.sqrt(2 * viewer.FALL / GRAVITY) if name == "original" else result.readings[1].time
    )
    assert result.readings[1].time == pytest.approx(expected, abs=0.01)
    assert result.readings[-1].acceleration[2] == pytest.approx(GRAVITY, abs=0.02)


# ------------------------------------------------------------------------------------- the view


@pytest.mark.parametrize(
    ("fixed", "sizes", "acceleration"),
    [(True, "nq=12, nv=12, nu=12", GRAVITY), (False, "nq=19, nv=18, nu=12", 0.0)],
)
def test_view_tells_sizes_joints_and_imu(
    capsys: pytest.CaptureFixture[str], fixed: bool, sizes: str, acceleration: float
) -> None:
    viewer.view_robot(fixed=fixed, headless=True)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == sizes
    joints = [line.split() for line in lines if re.match(r"  leg_", line)]
    assert len(joints) == 12
    readings = [re.match(r'  data\.sensor\("(\w+)"\)\.data +(.*)', line) for line in lines]
    sensors = {found[1]: found[2].split() for found in readings if found}
    assert set(sensors) == set(viewer.IMU_SENSORS)
    assert [float(value) for value in sensors["body_quat"][:4]] == [1, 0, 0, 0]
    assert float(sensors["body_acc"][2]) == pytest.approx(acceleration, abs=1e-3)
    assert sensors["body_acc"][3] == "m/s^2"


def test_the_snippet_reads_the_imu() -> None:
    model, data = home("pupper_v3_fixed.xml")
    names = {"data": data}
    exec(viewer.IMU_SNIPPET, names)
    imu = names["imu"]
    assert set(imu) == {model.sensor(index).name for index in range(model.nsensor)}
    np.testing.assert_allclose(imu["body_acc"], [0, 0, GRAVITY], atol=1e-9)


def test_what_the_joints_really_do() -> None:
    robot, data = viewer.at_home("v3", fixed=True)
    model = robot.mj_model
    actions = {action.name: action for action in viewer.joint_actions(robot, data)}
    assert list(actions) == [model.actuator(index).name for index in range(model.nu)]
    for name, action in actions.items():
        side = 1.0 if "_l_" in name else -1.0
        expected = ("roll", [-1, 0, 0]) if name[-1] == "2" else ("pitch", [0, side, 0])
        assert action.motion == expected[0]
        np.testing.assert_allclose(action.axis, expected[1], atol=1e-9)


@pytest.mark.parametrize("fixed", [True, False])
def test_feet_move_as_told(fixed: bool) -> None:
    robot, data = viewer.at_home("v3", fixed=fixed)
    model = robot.mj_model
    if not fixed:  # another attitude of the base must make no difference
        data.qpos[3:7] = [0.5, -0.5, 0.5, 0.5]
        mujoco.mj_forward(model, data)
    base = model.body("base_link").id
    for action in viewer.joint_actions(robot, data):
        site = model.site(f"{action.name[:-1]}3_foot_site").id
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        column = jacobian[:, model.joint(action.name).dofadr[0]]
        expected = data.xmat[base].reshape(3, 3).T @ column
        np.testing.assert_allclose(action.foot_motion, expected, atol=1e-12)


# ------------------------------------------------------------------------------------- no window


@pytest.fixture
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("no_screen")
def test_no_screen_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    for show in (
        lambda: viewer.view_robot(fixed=True, headless=False),
        lambda: viewer.drop_and_report(headless=False),
    ):
        with pytest.raises(viewer.DisplayError, match=r"no display.*--headless") as caught:
            show()
        assert isinstance(caught.value, PupperAnalysisError)
        assert "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="X11 is how Linux says so")
def test_a_screen_that_is_not_there_ends_no_interpreter() -> None:
    code = "from pupper_analysis.tools.live import window as viewer; viewer.check_display()"
    environment = {**os.environ, "DISPLAY": ":4711"}
    environment.pop("WAYLAND_DISPLAY", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "DisplayError: MuJoCo's viewer is not available" in done.stderr.splitlines()[-1]


def test_the_window_simulates_from_home_and_the_result_is_that_without(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], dropped: viewer.Drop
) -> None:
    from mujoco import viewer as mujoco_viewer

    begun: list[float] = []

    def launch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        begun.append(float(data.qpos[2]))
        for _ in range(100):
            mujoco.mj_step(model, data)

    monkeypatch.setattr(viewer, "check_display", lambda: None)
    monkeypatch.setattr(mujoco_viewer, "launch", launch)
    assert viewer.drop_and_report(headless=False)
    assert begun == [dropped.height[0]]
    assert f"final z={dropped.height[-1]:.3f} m" in capsys.readouterr().out


def test_a_fixed_robot_moves_only_by_its_sliders(monkeypatch: pytest.MonkeyPatch) -> None:
    from mujoco import viewer as mujoco_viewer

    moved: list[float] = []

    def launch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        begun = data.qpos.copy()
        for _ in range(500):
            mujoco.mj_step(model, data)
        moved.append(float(np.abs(data.qpos - begun).max()))
        data.ctrl[0] += 0.1
        for _ in range(2000):
            mujoco.mj_step(model, data)
        moved.append(float(data.qpos[0] - begun[0]))

    monkeypatch.setattr(viewer, "check_display", lambda: None)
    monkeypatch.setattr(mujoco_viewer, "launch", launch)
    viewer.view_robot(fixed=True, headless=False)
    assert moved == pytest.approx([0.0, 0.1], abs=1e-3)
