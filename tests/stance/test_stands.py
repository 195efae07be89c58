"""Sequences of stands, compared with single calls, refusals included."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.legged import BIPED_FEET, biped
from tests.support.variants import load

ROUNDING = 1e-12


def wave(robot: pa.Robot, count: int, size: float = 1.0) -> list[pa.StandTask]:
    """Return tasks whose height, orientation, foot offset and slope change smoothly."""
    phases = 2 * np.pi * np.linspace(0, 1, count)
    return [
        pa.StandTask(
            height=robot.stand_height * (0.96 + 0.02 * size * np.cos(phase)),
            roll=0.05 * size * np.sin(phase),
            pitch=0.03 * size * np.sin(2 * phase),
            yaw=0.04 * size * np.cos(phase),
            foot_offsets={robot.contact_points[0]: (0.004 * size * np.sin(phase), 0.0)},
            ground=pa.Ground(slope=0.03 * size * (1 - np.cos(phase))),
        )
        for phase in phases
    ]


def assert_same(found: pa.Stand, expected: pa.Stand) -> None:
    assert found.task == expected.task
    np.testing.assert_allclose(found.qpos, expected.qpos, rtol=0, atol=ROUNDING)
    for foot, target in expected.foot_targets.items():
        np.testing.assert_array_equal(found.foot_targets[foot], target)
    assert found.stance_feet == expected.stance_feet
    assert found.com_margin == pytest.approx(expected.com_margin, abs=ROUNDING)
    near, wanted = found.ground_clearance, expected.ground_clearance
    assert near is not None
    assert wanted is not None
    assert near.distance == pytest.approx(wanted.distance, abs=ROUNDING)
    assert found.solved


LINE = '<geom type="capsule" size="0.01" fromto="-0.06 0 -0.05 0.12 0 -0.05"/>'


@pytest.mark.slow
@pytest.mark.parametrize("foot", [BIPED_FEET["box"], LINE], ids=["box", "line"])
def test_stand_sequence_equals_single_calls_for_flat_and_line_feet(
    foot: str, tmp_path: Path
) -> None:
    """Reference: ``solve_stand`` per task.

    A leg with a line foot may still turn, so its stand depends on the initial guess, which must be
    that of a single call.
    """
    urdf, mjcf = biped(tmp_path, foot)
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
    height = 0.95 * robot.stand_height
    tasks = [pa.StandTask(height=height, pitch=pitch) for pitch in (0.0, 0.02, 0.04)]
    stands = pa.solve_stands(robot, tasks)
    for task, one in zip(tasks, stands, strict=True):
        single = pa.solve_stand(robot, task)
        np.testing.assert_allclose(one.qpos, single.qpos, atol=1e-9)
        if foot is LINE:
            assert one.iterations == single.iterations


def test_sequence_stops_at_an_unreachable_task_and_names_it() -> None:
    """The fourth task, 500 mm high, is refused as `tasks[3]`, also after pickling."""
    robot = load("v3")
    tasks = [*wave(robot, 3), pa.StandTask(height=0.5), *wave(robot, 2)]
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stands(robot, tasks)
    assert pickle.loads(pickle.dumps(caught.value)).where == "tasks[3]"
    assert str(caught.value).startswith("tasks[3]: stance out of reach (height 500.0 mm")


def test_a_wrong_task_is_refused_before_any_is_solved() -> None:
    """An unknown foot in the second task is reported although the first task is out of reach."""
    robot = load("v3")
    wrong = pa.StandTask(swing={"XX": 0.02})
    with pytest.raises(pa.UnknownNameError, match=r"tasks\[1\].*'XX'"):
        pa.solve_stands(robot, [pa.StandTask(height=0.5), wrong])
    with pytest.raises(pa.ConfigurationError, match=r"tasks\[2\]: joint_margin"):
        pa.solve_stands(robot, [pa.StandTask(), pa.StandTask(), pa.StandTask(joint_margin=3.0)])
    with pytest.raises(pa.ConfigurationError, match=r"tasks: .* is not a sequence"):
        pa.solve_stands(robot, pa.StandTask())  # type: ignore[arg-type]
    with pytest.raises(pa.ConfigurationError, match=r"tasks: .* is not a sequence"):
        pa.solve_stands(robot, np.array([0.12]))  # type: ignore[arg-type]
    assert pa.solve_stands(robot, []) == ()


def test_joint_limits_that_change_between_calls_are_obeyed() -> None:
    """A limit below the stand makes the stand unreachable; the stand is equal after the limit is
    restored. PlaCo keeps the limits of the previous solve.
    """
    robot = pa.load_variant("v3")
    stand = pa.solve_stand(robot)
    positions = stand.joint_positions(robot)
    joint = int(np.argmax(positions))
    index, upper = robot.pin_convention.q_index[joint], float(robot.upper_limits[joint])
    robot.pin_model.upperPositionLimit[index] = positions[joint] - 0.1
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stands(robot, [pa.StandTask(), pa.StandTask()])
    robot.pin_model.upperPositionLimit[index] = upper
    again = pa.solve_stands(robot, [pa.StandTask()])[0]
    np.testing.assert_allclose(again.qpos, stand.qpos, atol=ROUNDING)


@pytest.mark.parametrize("name", ["v3", "original"])
def test_stand_sequence_equals_single_calls_in_fewer_iterations(name: str) -> None:
    robot = load(name)
    tasks = wave(robot, 20)
    found, singles = pa.solve_stands(robot, tasks), [pa.solve_stand(robot, task) for task in tasks]
    for first, second in zip(found, singles, strict=True):
        assert_same(first, second)
    assert sum(s.iterations for s in found) < 0.8 * sum(s.iterations for s in singles)


def test_stands_of_tasks_in_random_order_equal_single_calls() -> None:
    """A stand that is far from the previous one does not depend on it."""
    robot = load("v3")
    tasks = wave(robot, 8, 1.5)
    foot = next(iter(robot.contact_points))
    tasks += [replace(tasks[2], swing={foot: 0.02}, com="inside", com_margin=0.004)]
    tasks += [replace(tasks[5], offset=(0.004, -0.006), foot_offsets={})]
    tasks += [replace(tasks[7], self_clearance=0.001)]
    shuffled = [tasks[number] for number in np.random.default_rng(0).permutation(len(tasks))]
    for task, one in zip(shuffled, pa.solve_stands(robot, shuffled), strict=True):
        assert_same(one, pa.solve_stand(robot, task))


@pytest.mark.parametrize(
    "change",
    [
        {"ik_seed": (0.1, 0.8, -0.9, -0.1, -0.8, 0.9) * 2},
        {"com": "inside", "com_margin": 0.004},
        {"self_clearance": 0.001},
    ],
    ids=str,
)
def test_stand_that_depends_on_its_start_is_that_of_a_single_call(change: dict[str, Any]) -> None:
    """Equal to the last bit, with the same number of iterations."""
    robot = load("v3")
    tasks = [replace(task, **change) for task in wave(robot, 4)]
    for task, one in zip(tasks, pa.solve_stands(robot, tasks), strict=True):
        expected = pa.solve_stand(robot, task)
        np.testing.assert_array_equal(one.qpos, expected.qpos)
        assert one.iterations == expected.iterations
