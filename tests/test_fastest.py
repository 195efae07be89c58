"""The least time of a path: that it is feasible, that less is not, what binds, and in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import load
from test_path import Task, stances

import pupper_analysis as pa
from pupper_analysis.simulation.tracking import track_path
from pupper_analysis.stance.path.fastest import RESERVE, Limit, fastest_path
from pupper_analysis.stance.path.stance_path import stance_path


def test_a_squat_falls_no_faster_than_gravity() -> None:
    """Closed form: d share of the height in T takes 10/sqrt(3) d/T^2, and the ground cannot pull.

    The legs stay behind: the com moves by less than the base, whence the margin.
    """
    robot, tasks = load("original"), stances("original", "squat")
    found = fastest_path(robot, tasks, reserve=0.0)
    drop = 0.1 * robot.stand_height
    closed = math.sqrt(10 / math.sqrt(3) * drop / 9.81)
    assert found.binding.limit in (Limit.TIPPING, Limit.LIFTING)
    assert found.leg_seconds[0] == pytest.approx(closed, rel=0.12)
    # What is left of the weight is little: with the com off the middle, two feet lift first.
    loads = found.path.loads
    assert loads[:, :].min() == pytest.approx(0, abs=0.02 * loads[0].sum())
    assert loads.sum(axis=1).min() < 0.2 * loads[0].sum()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("v3", "squat"), ("original", "sway")])
def test_the_least_time_is_feasible_and_less_is_not(name: str, kind: str) -> None:
    robot, tasks = load(name), stances(name, kind)
    found = fastest_path(robot, tasks, reserve=0.0)
    assert found.seconds == pytest.approx(len(found.leg_seconds) * found.leg_seconds.max())
    assert not found.path.infeasible.any()
    assert found.path.peak_utilisation <= 1
    assert found.path.peak_speed_utilisation <= 1
    rate = 32 * len(found.leg_seconds) / found.seconds
    for factor in (1.01, 1.5, 4.0):
        stance_path(robot, tasks, factor * found.seconds, rate=rate / factor)
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        stance_path(robot, tasks, 0.99 * found.seconds, rate=rate / 0.99)
    number = f"between stances {found.binding.leg} and {found.binding.leg + 1}"
    assert number in str(caught.value)
    assert found.to_dict()["binding"]["limit"] == found.binding.limit.value


@pytest.mark.slow
def test_weak_motors_slow_ones_and_smooth_floors_bind() -> None:
    robot, tasks = load("original"), stances("original", "sway")
    free = fastest_path(robot, tasks, reserve=0.0).seconds
    sluggish = replace(robot, pin_model=robot.pin_model.copy())
    sluggish.pin_model.velocityLimit = 0.01 * robot.pin_model.velocityLimit
    found = fastest_path(sluggish, tasks, reserve=0.0)
    assert found.binding.limit is Limit.VELOCITY
    assert found.path.peak_speed_utilisation == pytest.approx(1, rel=2e-3)
    assert found.path.fastest_joint == found.binding.names[0]
    assert found.seconds > free

    weak = replace(robot, pin_model=robot.pin_model.copy())
    at_rest = stance_path(robot, tasks, 100.0, rate=1.0).peak_utilisation
    weak.pin_model.effortLimit = 1.1 * at_rest * robot.pin_model.effortLimit
    found = fastest_path(weak, tasks, reserve=0.0)
    assert found.binding.limit is Limit.TORQUE
    assert found.path.peak_utilisation == pytest.approx(1, rel=3e-3)
    assert found.path.peak_joint == found.binding.names[0]
    assert found.seconds > free

    smooth = {
        foot: replace(contact, friction=(0.1, *contact.friction[1:]))
        for foot, contact in robot.contacts.items()
    }
    found = fastest_path(replace(robot, contacts=smooth), tasks, reserve=0.0)
    assert found.binding.limit is Limit.FRICTION
    # Sliding is where the com's horizontal acceleration is mu g.
    path = found.path
    rates = [
        pa.Configuration(robot, *row).com_acceleration(qacc)
        for *row, qacc in zip(path.qpos, path.qvel, path.qacc, strict=True)
    ]
    assert max(abs(rate[1]) for rate in rates) == pytest.approx(0.1 * 9.81, rel=0.03)


@pytest.mark.slow
def test_a_reserve_is_left() -> None:
    robot, tasks = load("original"), stances("original", "sway")
    found, bare = fastest_path(robot, tasks, reserve=0.3), fastest_path(robot, tasks, reserve=0.0)
    assert found.seconds > bare.seconds
    path = found.path
    assert path.friction_utilisation.max() <= 0.7 + 1e-9
    still = stance_path(robot, tasks, 1e3, rate=32 * 3 / 1e3)
    share = path.loads / still.loads
    assert share.min() == pytest.approx(0.3, abs=0.01)
    assert bare.path.loads.min() == pytest.approx(0, abs=0.05)


def test_bad_arguments_and_what_no_time_helps() -> None:
    robot = load("original")
    for reserve in (-0.1, 1.0, math.nan, "x", True):
        with pytest.raises(pa.ConfigurationError, match="reserve"):
            fastest_path(robot, stances("original", "squat"), reserve=reserve)
    with pytest.raises(pa.ConfigurationError, match="at least 2"):
        fastest_path(robot, [Task()])
    with pytest.raises(pa.ConfigurationError, match="nothing moves"):
        fastest_path(robot, [Task(), Task()])
    weak = replace(robot, pin_model=robot.pin_model.copy())
    weak.pin_model.effortLimit = 0.001 * robot.pin_model.effortLimit
    with pytest.raises(pa.StaticsInfeasibleError, match="however slow") as caught:
        fastest_path(weak, stances("original", "squat"))
    assert caught.value.reason is pa.Infeasibility.MOTOR


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    [("v3", "squat"), ("original", "sway"), ("v3", "lift"), ("original", "lift")],
)
def test_mujoco_confirms_the_least_time_and_not_less(name: str, kind: str) -> None:
    robot, tasks = load(name), stances(name, kind)
    found = fastest_path(robot, tasks, reserve=0.2)
    tracking = track_path(robot, found.path)
    assert tracking.passed, tracking.failures
    assert tracking.torque_error < 0.05
    rate = len(found.path.time) / found.seconds
    faster = track_path(
        robot, stance_path(robot, tasks, 0.8 * found.seconds, rate=rate, beyond=True)
    )
    assert any("carries nothing" in failure for failure in faster.failures), faster.failures
    assert np.isfinite(faster.torque_error)


@pytest.mark.slow
def test_a_reserve_is_the_default() -> None:
    """What is stated without further ado is what MuJoCo follows."""
    robot, tasks = load("v3"), stances("v3", "squat")
    found = fastest_path(robot, tasks)
    assert found.reserve == RESERVE
    assert found.path.friction_utilisation.max() <= 1 - RESERVE + 1e-9
    assert track_path(robot, found.path).passed
