"""Causes of unreachable postures, against closed forms of an arm and of a quadruped's legs."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance import JointsTask, PositionTask, SelfClearanceTask
from pupper_analysis.stance.posture_conflict import find_conflict
from pupper_analysis.stance.posture_tasks import PostureTask
from tests.support import arm as by_hand
from tests.support.variants import load

UPPER, FORE = 0.3, 0.2
"""Lengths of the planar arm [m]."""


@pytest.fixture(scope="module")
def planar_arm(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """Arm with two joints about y, without limits: at zero it is straight along x."""
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1">'
        '<joint name="shoulder" axis="0 1 0"/>'
        f'<geom size="0.02" mass="1"/><body name="fore" pos="{UPPER} 0 0">'
        '<joint name="elbow" axis="0 1 0" limited="true" range="-3.1 3.1"/>'
        f'<geom size="0.02" mass="1"/><body name="tip" pos="{FORE} 0 0">'
        '<geom size="0.02" mass="1"/></body></body></body></worldbody></mujoco>'
    )
    return pa.load_robot(path)


def fail(robot: pa.Robot, *tasks: PostureTask) -> pa.PostureUnreachableError:
    """Return the error of tasks that no posture satisfies."""
    with pytest.raises(pa.PostureUnreachableError) as caught:
        pa.solve_posture(robot, tasks)
    return caught.value


def test_stretched_arm_is_out_of_reach_without_conflict(planar_arm: pa.Robot) -> None:
    """Closed form: the residual is the distance less both lengths."""
    error = fail(planar_arm, PositionTask("tip", (0.9, 0.0, 1.0)))
    assert error.residual == pytest.approx(0.9 - UPPER - FORE, abs=1e-6)
    assert error.out_of_reach
    assert (error.conflicting, error.blocking) == ((), {})
    assert "no motion of the joints reduces" in str(error)


def test_two_tasks_that_no_posture_satisfies_are_both_named(planar_arm: pa.Robot) -> None:
    """Each target alone is within reach; their distance of 0.6 m exceeds the forearm of 0.2 m."""
    tip, elbow = PositionTask("tip", (0.0, 0.0, 0.6)), PositionTask("fore", (0.0, 0.0, 1.3))
    assert pa.solve_posture(planar_arm, [tip]).residuals.max() < 1e-6
    assert pa.solve_posture(planar_arm, [elbow]).residuals.max() < 1e-6
    error = fail(planar_arm, tip, elbow)
    names = {"PositionTask tip", "PositionTask fore"}
    assert {error.task, *error.conflicting} == names
    assert not error.out_of_reach
    assert all(name in str(error) for name in names)


def test_joint_limit_blocks_only_if_the_target_is_beyond_it() -> None:
    """The slide of the arm misses its target beyond 0.2 m; the elbow is at its limit by a task."""
    robot = by_hand.arm()
    low, _ = by_hand.RANGES["elbow"]
    error = fail(robot, JointsTask({"b_slide": 0.5, "elbow": low}))
    assert error.at_limit == {"b_slide": 0.2, "elbow": low}
    assert error.blocking == {"b_slide": 0.2}
    assert "b_slide (0.2 m)" in str(error)
    assert "elbow (" not in str(error)


def test_raised_base_conflicts_with_the_feet_that_it_must_keep() -> None:
    """The legs of Pupper v3 end below 0.3 m: at 1 m, the feet would leave the ground."""
    error = fail(load("v3"), PositionTask("base_link", (0.0, 0.0, 1.0)))
    assert set(error.conflicting) == {f"contact {foot}" for foot in ("FR", "FL", "RR", "RL")}
    copied = pickle.loads(pickle.dumps(error))
    assert (copied.conflicting, copied.blocking) == (error.conflicting, error.blocking)
    np.testing.assert_array_equal(copied.qpos, error.qpos)


def test_self_clearance_conflicts_with_a_foot_target_at_another_foot() -> None:
    """The base and the hind leg are fixed: the clearance alone balances the position task."""
    robot = load("v3", fixed_base=True)
    front, back = (robot.contact_frames[foot] for foot in ("FR", "RR"))
    goal = pa.Configuration(robot, robot.home).frame_position(back) + np.array([0.03, 0.0, 0.0])
    hind = {
        name: at for name, at in zip(robot.joint_names, robot.home, strict=True) if "back" in name
    }
    error = fail(robot, PositionTask(front, goal), JointsTask(hind), SelfClearanceTask())
    assert error.task == f"PositionTask {front}"
    assert "SelfClearanceTask" in error.conflicting


def test_gradients_of_residuals_that_are_smaller_than_the_step() -> None:
    """Two tasks with equal weighted gradients: the residual of the second is 1e-8 m."""
    robot, weights = load("v3", fixed_base=True), [1.0, 1e4]

    def residuals(qpos: np.ndarray) -> np.ndarray:
        return np.abs(np.array([qpos[0] - 1e-4, qpos[0] + 1e-8]))

    limits = robot.lower_limits, robot.upper_limits
    conflict = find_conflict(robot, np.zeros(robot.nq), limits, residuals, weights, 0)
    assert conflict.tasks == (1,)
    heavier = find_conflict(robot, np.zeros(robot.nq), limits, residuals, [1.0, 0.5e2], 0)
    assert heavier.tasks == ()  # a share of 0.5 %
