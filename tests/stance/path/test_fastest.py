"""The least time of a path: that it is within the limits, that less is not, and in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import pupper_analysis as pa
from pupper_analysis.pupper.demo import DEMOS, demo_stances
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP
from pupper_analysis.simulation.tracking import track_path
from pupper_analysis.stance.path import fastest
from pupper_analysis.stance.path.fastest import RESERVE, RISE, fastest_path, ground_lag
from pupper_analysis.stance.path.geometry import path_geometry
from pupper_analysis.stance.path.path_limits import PathLimit, PathLimits
from pupper_analysis.stance.path.stance_path import stance_path
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.dynamics import joint_resistance
from tests.stance.path.test_stance_path import Task, stances
from tests.support.cases import some
from tests.support.repository import benchmark
from tests.support.variants import load, stand_of


def down(name: str) -> list[pa.StandTask]:
    return stances(name, "squat")[:2]


def aside(name: str) -> list[pa.StandTask]:
    return stances(name, "sway")[:2]


def beyond(robot: pa.Robot, found: pa.stance.FastestPath) -> tuple[float, float, float, float]:
    """How much of limits a path needs: torque, speed, friction; and what loads lack of theirs.

    By Pinocchio's mass matrix, bias forces and Jacobians alone: the path's own forces must balance
    its own motion, without the programme that found them.
    """
    path, worst = found.path, np.zeros(4)
    still = stance_path(robot, [stand.task for stand in path.stances], 1e3, rate=1e-3)
    rest = still.loads.min(axis=0)
    for index in range(len(path.time)):
        config = pa.Configuration(robot, path.qpos[index], path.qvel[index])
        left = config.mass_matrix() @ path.qacc[index] + config.bias_forces()
        left += joint_resistance(robot, path.qvel[index], path.qacc[index])
        for column, foot in enumerate(robot.contact_points):
            down = -robot.contact_radius[foot] * UP
            wrench = [*path.forces[index, column], *path.moments[index, column]]
            left -= config.frame_jacobian(robot.contact_frames[foot], down).T @ np.array(wrench)
        np.testing.assert_allclose(left[:6], 0, atol=1e-7)
        np.testing.assert_allclose(left[6:], path.torques[index], atol=1e-7)
        pressed = path.forces[index, :, 2]
        sliding = np.linalg.norm(path.forces[index, :, :2], axis=1)
        friction = np.array(
            [robot.contacts[foot].sliding_friction for foot in robot.contact_points]
        )
        shares = (
            np.abs(path.torques[index]) / robot.effort_limits,
            np.abs(path.qvel[index, 6:]) / robot.velocity_limits,
            sliding / (friction * pressed),
            found.reserve * rest - pressed,
        )
        worst = np.maximum(worst, [share.max() for share in shares])
    return tuple(worst)


@pytest.mark.parametrize("name", some(["v3", "original"], 2))
def test_the_fastest_path_is_within_the_limits_and_its_own_derivatives(name: str) -> None:
    robot = load(name)
    found = fastest_path(robot, aside(name))
    torque, speed, friction, lack = beyond(robot, found)
    assert max(torque, speed) <= 1 - RESERVE + 1e-6
    assert friction <= 1 - RESERVE + 1e-6
    assert friction > 0.75  # it is what a sway takes, with its feet's loads
    assert lack < 1e-6 * robot.total_mass
    path = found.path
    assert path.time[-1] == pytest.approx(found.seconds)
    assert found.rise == pytest.approx(RISE * ground_lag(robot))
    for position, rate, change in (
        (path.qpos[:, 7:], path.qvel[:, 6:], path.qacc[:, 6:]),
        (path.qpos[:, :3], path.qvel[:, :3], path.qacc[:, :3]),
    ):
        # Hermite splines of one derivative have the next, at the middles of the intervals.
        for value, first, scale in ((position, rate, 1.0), (rate, change, 1.0)):
            middles = (path.time[1:] + path.time[:-1]) / 2
            spline = CubicHermiteSpline(path.time, value, first)
            given = CubicHermiteSpline(path.time, first, np.gradient(first, path.time, axis=0))
            wrong = np.abs(spline(middles, 1) - given(middles)).max()
            assert wrong < 5e-3 * scale * np.abs(first).max()


@pytest.mark.longest
def test_the_fastest_path_is_faster_than_minimum_jerk_and_slower_than_its_bound() -> None:
    robot, tasks = load("original"), aside("original")
    found = fastest_path(robot, tasks, reserve=0.0)
    assert found.lower_bound < found.seconds
    assert found.seconds == pytest.approx(found.segment_seconds.sum())
    assert found.lower_bound == pytest.approx(found.segment_lower_bounds.sum())
    with pytest.raises(pa.StaticsInfeasibleError):
        stance_path(robot, tasks, found.seconds)
    slow = fastest_path(robot, tasks, reserve=0.0, rise=1.0)
    with pytest.raises(pa.StaticsInfeasibleError):  # that law's own jerk is allowed, at least
        stance_path(robot, tasks, slow.seconds)
    quick = fastest_path(robot, tasks, reserve=0.0, rise=0.005)
    assert found.lower_bound < quick.seconds < found.seconds <= slow.seconds
    # Trapezoids of acceleration, of nearly the same height: T = t + sqrt(t^2 + T0^2).
    closed = quick.rise + math.hypot(quick.rise, found.lower_bound)
    assert quick.seconds == pytest.approx(closed, rel=0.03)


def test_a_squat_falls_no_faster_than_gravity() -> None:
    """Closed form: the ground cannot pull, so that d takes at least sqrt(2 d / g) of falling.

    The legs stay behind: the com moves by less than the base. And what falls must be stopped.
    """
    robot = load("original")
    found = fastest_path(robot, down("original"), reserve=0.0)
    first, last = (
        pa.Configuration(robot, found.path.qpos[index]).center_of_mass()[2] for index in (0, -1)
    )
    assert found.lower_bound > math.sqrt(2 * (first - last) / 9.81)
    loads = found.path.loads
    assert loads.sum(axis=1).min() < 0.2 * loads[0].sum()
    assert found.binding.limit is PathLimit.LIFTING


def test_weak_motors_slow_ones_and_smooth_floors_bind() -> None:
    robot, tasks = load("original"), aside("original")
    free = fastest_path(robot, tasks, reserve=0.0).seconds
    sluggish = replace(robot, pin_model=robot.pin_model.copy())
    sluggish.pin_model.velocityLimit = 0.005 * robot.pin_model.velocityLimit
    found = fastest_path(sluggish, tasks, reserve=0.0)
    assert found.binding.limit is PathLimit.VELOCITY
    assert found.path.peak_speed_utilisation == pytest.approx(1, rel=5e-3)
    joint = robot.joint_names.index(found.binding.names[0])  # one of several alike
    allowed = sluggish.velocity_limits[joint]
    assert np.abs(found.path.qvel[:, 6 + joint]).max() == pytest.approx(allowed, rel=2e-2)
    assert found.seconds > free

    smooth = {
        foot: replace(contact, friction=(0.1, *contact.friction[1:]))
        for foot, contact in robot.contacts.items()
    }
    slippery = replace(robot, contacts=smooth)
    found = fastest_path(slippery, tasks, reserve=0.0)
    assert found.binding.limit is PathLimit.FRICTION
    # Sliding is where the com's horizontal acceleration is mu g: no way is shorter than that.
    places = [pa.Configuration(robot, qpos).center_of_mass() for qpos in found.path.qpos[[0, -1]]]
    way = float(np.linalg.norm((places[1] - places[0])[:2]))
    assert found.lower_bound == pytest.approx(2 * math.sqrt(way / (0.1 * 9.81)), rel=0.03)


@pytest.mark.longest
def test_forces_are_chosen_so_that_motors_bear_them() -> None:
    """Motors that cannot bear the minimum-tangential forces, and can bear others."""
    robot, tasks = load("v3"), aside("v3")
    still = stance_path(robot, tasks, 1e3, rate=1e-3)
    least = max(
        pa.gravity_compensation(
            pa.Configuration(robot, qpos), distribution=pa.statics.ForceDistribution.MIN_MAX_TORQUE
        ).motor_utilisation.max()
        for qpos in still.qpos[::8]
    )
    assert least < 0.9 * still.peak_utilisation
    weak = replace(robot, pin_model=robot.pin_model.copy())
    share = 0.5 * (least + still.peak_utilisation)
    weak.pin_model.effortLimit = share * robot.pin_model.effortLimit
    found = fastest_path(weak, tasks, reserve=0.0)
    assert found.path.peak_utilisation == pytest.approx(1, abs=5e-3)
    assert stance_path(weak, tasks, 100.0).peak_utilisation > 1


def test_fastest_path_refuses_bad_arguments_and_what_no_time_helps() -> None:
    robot = load("original")
    for reserve in (-0.1, 1.0, math.nan, "x", True):
        with pytest.raises(pa.ConfigurationError, match="reserve"):
            fastest_path(robot, down("original"), reserve=reserve)
    for rise in (0.0, math.inf, math.nan, "x", True):
        with pytest.raises(pa.ConfigurationError, match="rise"):
            fastest_path(robot, down("original"), rise=rise)
    with pytest.raises(pa.ConfigurationError, match="rate"):
        fastest_path(robot, down("original"), rate=math.inf)
    with pytest.raises(pa.ConfigurationError, match="at least 2"):
        fastest_path(robot, [Task()])
    with pytest.raises(pa.ConfigurationError, match="nothing moves"):
        fastest_path(robot, [Task(), Task()])
    weak = replace(robot, pin_model=robot.pin_model.copy())
    weak.pin_model.effortLimit = 0.001 * robot.pin_model.effortLimit
    with pytest.raises(pa.StaticsInfeasibleError, match="however slow") as caught:
        fastest_path(weak, down("original"))
    assert caught.value.reason is pa.errors.Infeasibility.MOTOR


@pytest.mark.longest
@pytest.mark.parametrize("name", pa.VARIANTS)
@pytest.mark.parametrize("kind", DEMOS)
def test_mujoco_confirms_the_least_time(name: str, kind: str) -> None:
    robot = load(name)
    tasks = demo_stances(robot, kind, depth=0.2 if name.startswith("v3") else 0.1)
    found = fastest_path(robot, tasks)
    assert found.lower_bound < found.seconds < 2 * found.lower_bound
    tracking = track_path(robot, found.path)
    assert tracking.passed, tracking.failures
    assert tracking.torque_error < 0.05


def test_what_is_stated_by_default_is_what_mujoco_follows() -> None:
    robot, tasks = load("v3"), stances("v3", "squat")
    found = fastest_path(robot, tasks)
    assert found.reserve == RESERVE
    tracking = track_path(robot, found.path)
    assert tracking.passed, tracking.failures
    assert found.seconds < 1.5 * found.lower_bound


@pytest.mark.longest
@pytest.mark.parametrize("name", ["a1", "go1", "anymal"])
def test_mujoco_follows_the_fastest_paths_of_others(name: str) -> None:
    """A1's and Go1's servos are stiff and damped, on knees without rotors."""
    paths = benchmark("paths")
    robot = paths.other(name)
    for demo in ("squat", "sway"):
        found = pa.stance.fastest_path(robot, paths.tasks_of(robot, name, demo))
        tracking = pa.simulation.track_path(robot, found.path)
        assert tracking.passed, tracking.failures
        assert tracking.torque_error < 0.05
        assert found.lower_bound < found.seconds < 1.3 * found.lower_bound


def test_the_ground_lags_under_a_foots_share_of_the_weight() -> None:
    """Under a load that grows by F' a second the depth's rate r' is that of the static law.

    k d r + b r' = R f: with f and r growing alike, the depth is behind by b / (k d) seconds.
    """
    robot = load("v3")
    forces = stand_statics(robot, stand_of("v3")).contact_forces
    share = sum(float(force[2]) for force in forces.values()) / len(forces)
    lags = []
    for foot in robot.contact_points:
        law = GroundLaw.of(robot, foot)
        lags.append(law.damping / (law.stiffness * law.impedance(law.depth(share))))
    assert ground_lag(robot) == pytest.approx(max(lags))


def test_feet_keep_their_loads_in_a_squat_with_reserve_and_lose_them_without() -> None:
    """It keeps 0.95 of its least loads as feet sink and rise; without reserve it lets go."""
    robot, count = load("v3"), 6
    geometry, limits = path_geometry(robot, down("v3"), count), PathLimits(robot, RESERVE)
    for reserve, keeps in ((RESERVE, True), (0.0, False)):
        given = PathLimits(robot, reserve), geometry, 1.0, lambda _: geometry
        path = fastest._find_at(1e-3, *given)[0].path
        assert fastest._keeps_loads(limits, geometry, path) is keeps


@pytest.mark.parametrize(
    ("kept_from", "slowest", "expected"),
    [
        pytest.param(0.0, 2.0, 1.0, id="feet keep their loads at once"),
        pytest.param(2.0, 2.0, 4.0, id="they do with a longer rise"),
        pytest.param(99.0, 2.5, 16.0, id="they never do, and longer takes no more"),
    ],
)
def test_the_acceleration_rises_longer_until_feet_keep_their_loads(
    monkeypatch: pytest.MonkeyPatch, kept_from: float, slowest: float, expected: float
) -> None:
    """Rises are in usual ones: a path takes as long as half its rise more, up to some."""
    robot = load("v3")
    usual = RISE * ground_lag(robot)

    def find(rise: float, *_: object) -> tuple[SimpleNamespace, bool]:
        seconds = min(slowest, 1 + rise / usual / 2)
        return SimpleNamespace(rise=rise, seconds=seconds), rise >= kept_from * usual

    monkeypatch.setattr(fastest, "_find_at", find)
    monkeypatch.setattr(fastest, "path_geometry", lambda *_, **__: None)
    found = fastest_path(robot, down("v3"))
    assert found.rise == pytest.approx(expected * usual)
