"""Foot targets of a task, compared with the closed forms of plane and steps."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.problem import compute_targets
from tests.support.variants import NAMES, load


@pytest.mark.parametrize("name", NAMES)
def test_foot_targets_touch_the_plane_and_the_steps(name: str) -> None:
    """Reference: distances of the centres along the normal, in closed form."""
    robot, ground = load(name), pa.Ground(0.2, 0.7, {"FL": 0.02})
    targets = compute_targets(robot, pa.StandTask(ground=ground, swing={"RR": 0.03}), {"FR": 0.002})
    normal = np.array([-np.sin(0.2) * np.cos(0.7), -np.sin(0.2) * np.sin(0.7), np.cos(0.2)])
    above = {foot: float(normal @ centre) for foot, centre in targets.foot_targets.items()}
    radius = robot.contact_radius
    assert above["FR"] == pytest.approx(radius["FR"] - 0.002)  # sunk along the normal
    assert above["FL"] == pytest.approx(radius["FL"] + 0.02 * np.cos(0.2))
    assert above["RR"] == pytest.approx(radius["RR"] + 0.03 * np.cos(0.2))
    assert above["RL"] == pytest.approx(radius["RL"])
    assert set(targets.stance_feet) == {"FR", "FL", "RL"}
    heights = dict(zip(targets.stance_feet, targets.contacts @ normal, strict=True))
    assert heights["FR"] == pytest.approx(0, abs=1e-12)  # the ground itself does not sink
    assert targets.height == pytest.approx(targets.contacts[:, 2].mean() + robot.stand_height)
    np.testing.assert_allclose(targets.place, targets.contacts[:, :2].mean(axis=0))


def test_target_place_is_that_of_the_com_or_of_the_base() -> None:
    robot = load("v3")
    centre = compute_targets(robot, pa.StandTask(), {}).place
    com = compute_targets(robot, pa.StandTask(com=(0.01, 0.02)), {})
    assert not com.by_base
    np.testing.assert_array_equal(com.place, (0.01, 0.02))
    base = compute_targets(robot, pa.StandTask(offset=(0.01, 0.02)), {})
    assert base.by_base
    np.testing.assert_allclose(base.place - centre, (0.01, 0.02))


def test_joint_margin_narrows_the_limits() -> None:
    robot = load("v3")
    targets = compute_targets(robot, pa.StandTask(joint_margin=0.1), {})
    np.testing.assert_allclose(targets.lower, robot.lower_limits + 0.1)
    np.testing.assert_allclose(targets.upper, robot.upper_limits - 0.1)
    with pytest.raises(pa.ConfigurationError, match="leaves no range for leg_"):
        compute_targets(robot, pa.StandTask(joint_margin=2.0), {})
    with pytest.raises(pa.ConfigurationError, match="com_margin"):
        compute_targets(robot, pa.StandTask(com_margin=0.2), {})


def test_three_feet_on_one_line_are_refused_as_support() -> None:
    """The front foot is between the rear feet; 4 mm ahead of the line it forms a triangle."""
    robot = load("original")
    places = compute_targets(robot, pa.StandTask(), {}).foot_targets
    middle = (places["RL"] + places["RR"]) / 2 - places["FR"]

    def corners(ahead: float) -> np.ndarray:
        offsets = {"FR": (float(middle[0]) + ahead, float(middle[1]))}
        task = pa.StandTask(swing={"FL": 0.02}, foot_offsets=offsets)
        return np.array(compute_targets(robot, task, {}).corners)

    with pytest.raises(pa.ConfigurationError, match="along a single line"):
        corners(0.0)
    assert np.ptp(corners(0.004)[:, 0]) == pytest.approx(0.004)


@pytest.mark.parametrize(
    "task", [pa.StandTask(), pa.StandTask(height=0.11), pa.StandTask(offset=(0.01, 0.0))]
)
def test_task_of_targets_is_complete_and_valid(task: pa.StandTask) -> None:
    """Height and position of the CoM are those of the robot if the task does not state them."""
    filled = compute_targets(load("v3"), task, {}).task
    assert filled == pa.StandTask(**vars(filled))
    assert None not in (filled.height, filled.com)
