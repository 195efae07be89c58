"""Foot targets of a task, compared with the closed forms of plane and steps."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.problem import make_goal
from tests.support.variants import NAMES, load


@pytest.mark.parametrize("name", NAMES)
def test_foot_targets_touch_the_plane_and_the_steps(name: str) -> None:
    """Reference: distances of the centres along the normal, in closed form."""
    robot, ground = load(name), pa.Ground(0.2, 0.7, {"FL": 0.02})
    goal = make_goal(robot, pa.StandTask(ground=ground, swing={"RR": 0.03}), {"FR": 0.002})
    normal = np.array([-np.sin(0.2) * np.cos(0.7), -np.sin(0.2) * np.sin(0.7), np.cos(0.2)])
    above = {foot: float(normal @ centre) for foot, centre in goal.targets.items()}
    radius = robot.contact_radius
    assert above["FR"] == pytest.approx(radius["FR"] - 0.002)  # sunk along the normal
    assert above["FL"] == pytest.approx(radius["FL"] + 0.02 * np.cos(0.2))
    assert above["RR"] == pytest.approx(radius["RR"] + 0.03 * np.cos(0.2))
    assert above["RL"] == pytest.approx(radius["RL"])
    assert set(goal.stance_feet) == {"FR", "FL", "RL"}
    heights = dict(zip(goal.stance_feet, goal.contacts @ normal, strict=True))
    assert heights["FR"] == pytest.approx(0, abs=1e-12)  # the ground itself does not sink
    assert goal.height == pytest.approx(goal.contacts[:, 2].mean() + robot.stand_height)
    np.testing.assert_allclose(goal.place, goal.contacts[:, :2].mean(axis=0))


def test_goal_place_is_that_of_the_com_or_of_the_base() -> None:
    robot = load("v3")
    centre = make_goal(robot, pa.StandTask(), {}).place
    com = make_goal(robot, pa.StandTask(com=(0.01, 0.02)), {})
    assert not com.by_base
    np.testing.assert_array_equal(com.place, (0.01, 0.02))
    base = make_goal(robot, pa.StandTask(offset=(0.01, 0.02)), {})
    assert base.by_base
    np.testing.assert_allclose(base.place - centre, (0.01, 0.02))
