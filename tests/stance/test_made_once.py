"""What is made once and used again gives what a new one gives."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.problem import make_goal
from pupper_analysis.stance.solver import Context
from pupper_analysis.statics.equilibrium import balance_load
from tests.support.variants import NAMES, load, stand_of


def tasks(robot: pa.Robot) -> list[pa.StandTask]:
    """Goals that differ in all that PlaCo's tasks are aimed at."""
    return [
        pa.StandTask(),
        pa.StandTask(height=0.93 * robot.stand_height, roll=0.05, pitch=-0.04, yaw=0.1),
        pa.StandTask(offset=(0.01, -0.005), joint_margin=0.05),
        pa.StandTask(ground=pa.Ground(slope=0.1, uphill=0.7), com=(0.005, 0.004)),
        pa.StandTask(foot_offsets={robot.contact_points[0]: (0.01, 0.0)}),
    ]


@pytest.mark.parametrize("name", NAMES)
def test_tasks_that_were_aimed_elsewhere_solve_as_new_ones(name: str) -> None:
    robot = load(name)
    goals = [make_goal(robot, task, {}) for task in tasks(robot)]
    start = stand_of(name).joint_positions(robot)
    expected = [Context(robot).solver.run(goal, start) for goal in goals]
    solver = Context(robot).solver
    for index in np.random.default_rng(0).permutation(3 * len(goals)) % len(goals):
        found = solver.run(goals[index], start)
        np.testing.assert_array_equal(found.qpos, expected[index].qpos)
        assert found.iterations == expected[index].iterations


def test_a_robots_files_are_its_own() -> None:
    """A variant is derived once; what is done to one robot's spec does not reach the next."""
    first = pa.load_variant("v3-long-leg")
    mass = first.mj_model.body_mass.copy()
    for body in first.description.mjcf.bodies[1:]:
        body.pos = 2 * body.pos
    second = pa.load_variant("v3-long-leg")
    assert second.fingerprint == first.fingerprint
    np.testing.assert_array_equal(second.mj_model.body_mass, mass)
    np.testing.assert_array_equal(second.mj_model.body_pos, first.mj_model.body_pos)


def test_what_the_motors_hold_is_found_once_for_a_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, found = load("v3"), []

    def counted(*given: object, **named: object) -> pa.statics.GravityCompensation:
        found.append(named["distribution"])
        return balance_load(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("pupper_analysis.stance.stand.balance_load", counted)
    stand = pa.solve_stand(robot, pa.StandTask(height=0.11))
    held = pa.stance.stand_statics(robot, stand)
    assert pa.stance.stand_statics(robot, stand) is held
    pa.steady_state(robot, stand)
    assert len(found) == 1
    loaded = pa.stance.stand_statics(pa.robot.with_payload(robot, 1.0), stand)
    assert loaded.joint_torques.tolist() != held.joint_torques.tolist()
    peak = pa.stance.stand_statics(robot, stand, distribution="min-max torque")
    assert peak.joint_torques.tolist() != held.joint_torques.tolist()
    again = pickle.loads(pickle.dumps(stand))
    np.testing.assert_array_equal(
        pa.stance.stand_statics(robot, again).joint_torques, held.joint_torques
    )
    assert len(found) == 4
