"""How far a robot may change, and which order of joints a policy is of: repeated, the same."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from pupper_analysis.tools.walk.intervals import changed_case, tracked_intervals
from pupper_analysis.tools.walk.orders import limbs_of
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import stage_of
from tests.support.variants import load
from tests.tools.walk import made


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return Policy.load(made.still(tmp_path_factory.mktemp("walk") / "still.json"))


def test_a_stand_falls_from_weak_motors_whatever_the_workers(still: Policy) -> None:
    robot = load("v3")
    found = [
        tracked_intervals(
            robot, still, (0, 0, 0), seeds=1, quantities=("strength",), workers=workers
        )
        for workers in (1, 2)
    ]
    one = found[0].intervals[0]
    assert 0.05 < one.least[0] < 1 < one.most[0]
    assert one.below[0] < one.least[0] < 1.2 * one.below[0]
    assert math.isnan(one.above[0])
    assert (found[1].intervals[0].least == one.least).all()


def test_what_is_changed(still: Policy) -> None:
    stage = stage_of(load("v3"), still)
    base = stage.model.body("base_link").id
    heavy = changed_case(stage, "mass", 2.0, np.zeros(3), 0).model
    assert heavy.body_mass[base] == 2 * stage.model.body_mass[base]
    assert heavy.body_subtreemass[0] > stage.model.body_subtreemass[0]  # constants follow
    long = changed_case(stage, "legs", 1.2, np.zeros(3), 0)
    data = mujoco.MjData(long.model)
    stage.robot.mj_convention.set_state(data, stage.default)
    mujoco.mj_kinematics(long.model, data)
    low = data.geom_xpos[list(stage.robot.foot_geoms), 2].min()
    assert long.lift > 0.01
    assert low + long.lift == pytest.approx(0.01995, abs=1e-9)
    assert changed_case(stage, "delay", 0.02, np.zeros(3), 0).delay == 0.02


def test_limbs() -> None:
    robot = load("v3")
    assert limbs_of(robot, robot.joint_names) == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    mixed = robot.joint_names[::3] + robot.joint_names[1::3] + robot.joint_names[2::3]
    assert limbs_of(robot, mixed)[0] == [0, 4, 8]
