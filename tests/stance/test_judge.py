"""Kinematics and constraint slack by which stands are judged, compared with a new
`Configuration`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.structure import Kinematics
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.judge import evaluate_stand
from pupper_analysis.stance.problem import compute_targets
from tests.support.variants import NAMES, load, stand_of


def random_states(robot: pa.Robot, count: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(3)
    for _ in range(count):
        qpos = rng.uniform(-1.0, 1.0, robot.nq)
        if robot.floating:
            qpos[3:7] /= np.linalg.norm(qpos[3:7])
        yield qpos


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("fixed", [False, True], ids=["free", "fixed"])
def test_kinematics_equal_those_of_a_configuration(name: str, fixed: bool) -> None:
    """Reference: `Configuration`, which creates its own data; equal to the last bit."""
    robot = load(name, fixed_base=fixed)
    there = Kinematics(robot.structure)
    for qpos in random_states(robot, 5):
        config = pa.Configuration(robot, qpos)
        there.update(config.qpos)
        np.testing.assert_array_equal(there.com, config.center_of_mass())
        for foot, place in config.foot_positions().items():
            np.testing.assert_array_equal(there.feet[foot], place)
        for link in robot.structure.links:
            turn, origin = there.links[link]
            np.testing.assert_array_equal(turn, config.frame_rotation(link))
            np.testing.assert_array_equal(origin, config.frame_position(link))


def test_constraint_slack_is_the_smallest_of_all_margins() -> None:
    """By hand: distances to the ground and between links, minus the required clearances."""
    stand = stand_of("v3")
    ground = stand.ground_clearance
    assert ground is not None
    near = replace(ground, distance=0.03)

    def slack(**changes: object) -> float:
        required = {"ground_clearance": 0.04, "self_clearance": 0.05}
        return replace(stand, task=replace(stand.task, **required), **changes).constraint_slack  # type: ignore[arg-type]

    assert slack(ground_clearance=near, self_clearance=None) == pytest.approx(0.03 - 0.04)
    assert slack(ground_clearance=ground, self_clearance=near) == pytest.approx(0.03 - 0.05)
    assert slack(ground_clearance=near, self_clearance=ground) == pytest.approx(0.03 - 0.04)
    assert slack(ground_clearance=None, self_clearance=None) == 0.0


def test_configuration_with_a_nan_is_refused_by_its_element() -> None:
    robot = load("v3")
    spoilt = stand_of("v3").qpos.copy()
    spoilt[9] = np.nan
    with pytest.raises(pa.ConfigurationError, match="element 9 is nan"):
        evaluate_stand(ClearanceShapes(robot), compute_targets(robot, None, {}), spoilt, 0)


def test_stand_is_evaluated_alike_if_pinocchio_returns_copies() -> None:
    """Reference: the evaluations with shared memory, Pinocchio's default.

    A base raised by 10 mm raises the ground clearance and the foot error by as much.
    """
    robot, qpos = load("v3"), stand_of("v3").qpos
    all_targets = [compute_targets(robot, pa.StandTask(height=z), {}) for z in (0.11, 0.12, 0.13)]
    expected = [evaluate_stand(ClearanceShapes(robot), targets, qpos, 0) for targets in all_targets]
    raised = qpos.copy()
    raised[2] += 0.01
    pin.sharedMemory(False)
    try:
        shapes = ClearanceShapes(robot)
        found = [evaluate_stand(shapes, targets, qpos, 0) for targets in all_targets]
        higher = evaluate_stand(shapes, all_targets[0], raised, 0)
    finally:
        pin.sharedMemory(True)
    for first, second in zip(found, expected, strict=True):
        assert first.to_dict() == second.to_dict()
    assert higher.ground_clearance is not None
    assert expected[0].ground_clearance is not None
    lifted = higher.ground_clearance.distance - expected[0].ground_clearance.distance
    assert lifted == pytest.approx(0.01, abs=1e-12)
    assert higher.foot_error == pytest.approx(expected[0].foot_error + 0.01, abs=1e-12)


def test_both_links_are_named_if_their_clearance_is_too_small() -> None:
    """Reference: the two links of the self-clearance, which is 10 mm below the required value."""
    stand = pa.solve_stand(load("v3"), pa.StandTask(self_clearance=1e-3))
    assert stand.self_clearance is not None
    near = replace(stand, task=pa.StandTask(self_clearance=stand.self_clearance.distance + 0.01))
    (message,) = near.blocked
    assert message.code == "links-too-near"
    named = [message.subject.name, message.values["other"]]
    assert named == list(stand.self_clearance.links)
    assert len(set(named)) == 2
