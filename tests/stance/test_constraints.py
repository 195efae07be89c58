"""Constraints of a stand: Jacobians against finite differences, and the requirements that a refusal
relaxes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.constraints import angle_between, make_constraints
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.programme import StanceProgram
from tests.support.variants import load

TASK = pa.StandTask(
    height=0.14,
    roll=0.2,
    pitch=-0.1,
    yaw=0.3,
    foot_offsets={"FR": (0.02, 0.01)},
    swing={"RL": 0.03},
    ground=pa.Ground(0.1, 0.5),
    com="inside",
    com_margin=0.01,
    joint_margin=0.05,
    ground_clearance=0.01,
    self_clearance=0.001,
)


def integrate_motion(
    robot: pa.Robot, qpos: np.ndarray, velocity: np.ndarray, time: float
) -> np.ndarray:
    """Return qpos after a motion with constant velocity; the base rotates about its own axes."""
    x, y, z, w = (
        pin.Quaternion(qpos[[4, 5, 6, 3]]) * pin.Quaternion(pin.exp3(time * velocity[3:6]))
    ).coeffs()
    after = qpos.copy()
    after[:3] += time * velocity[:3]
    after[3:7] = w, x, y, z
    after[7:] += time * velocity[6:]
    return after


def test_angle_between_rotations_equals_scipy() -> None:
    """Reference: SciPy's angle of the relative rotation; q and -q are equal rotations."""
    turns = Rotation.random(20, random_state=0)
    for one, other in zip(turns[:10], turns[10:], strict=True):
        first, second = (turn.as_quat(scalar_first=True) for turn in (one, other))
        expected = (one.inv() * other).magnitude()
        assert angle_between(first, second) == pytest.approx(expected, abs=1e-12)
        assert angle_between(first, -second) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("com", ["inside", (0.01, 0.0)])
def test_constraint_jacobians_equal_finite_differences(com: str | tuple[float, float]) -> None:
    """Reference: central differences of the residuals along a random velocity."""
    robot, random = load("v3"), np.random.default_rng(3)
    shapes, targets = ClearanceShapes(robot), compute_targets(robot, replace(TASK, com=com), {})
    stand = pa.solve_stand(robot)
    qpos = stand.qpos + 0.0
    qpos[7:] += random.uniform(-0.2, 0.2, 12)
    velocity = random.normal(size=robot.nv)
    seen = set()
    for constraint in make_constraints(shapes, targets):
        if constraint.is_presatisfied:  # fulfilled by each configuration of the search
            continue
        ends = [
            constraint.residual(
                targets, shapes.move_to(integrate_motion(robot, qpos, velocity, time))
            )
            for time in (1e-6, -1e-6)
        ]
        rates = constraint.jacobian(targets, pa.Configuration(robot, qpos)) @ velocity
        np.testing.assert_allclose(
            rates, (ends[0] - ends[1]) / 2e-6, atol=2e-3, err_msg=constraint.name
        )
        seen.add(constraint.name)
    assert len(seen) == (5 if com == "inside" else 6)


def test_elastic_jacobian_equals_the_finite_difference_of_the_residuals() -> None:
    """Reference: central differences along a random direction of the free variables."""
    robot = load("v3")
    requirements = ["height", "roll", "yaw", "foot_offsets", "swing", "ground", "com_margin"]
    elastic = StanceProgram(ClearanceShapes(robot), compute_targets(robot, TASK, {}), requirements)
    random = np.random.default_rng(1)
    x = elastic._make_start(pa.solve_stand(robot).qpos, None)
    free = elastic._high > elastic._low  # variables with equal bounds are fixed
    x += free * random.uniform(0.01, 0.05, len(x))
    way = free * random.normal(size=len(x))
    ends = [elastic._get_used_residuals(x + step * way) for step in (1e-6, -1e-6)]
    np.testing.assert_allclose(
        elastic._get_used_jacobian(x) @ way, (ends[0] - ends[1]) / 2e-6, atol=2e-3
    )


@pytest.mark.slow
def test_refusal_of_nine_requirements_relaxes_at_most_four_of_them() -> None:
    """The stand with the stated limits is solved by the solver, and the other requirements keep
    their values."""
    robot = load("v3")
    task = pa.StandTask(
        height=0.24,
        roll=0.7,
        pitch=0.6,
        yaw=0.9,
        foot_offsets={"FR": (0.06, 0.05)},
        swing={"RL": 0.06},
        com="inside",
        com_margin=0.03,
        joint_margin=0.3,
    )
    with pytest.raises(pa.StanceUnreachableError) as refusal:
        pa.solve_stand(robot, task)
    (limits,) = refusal.value.limits.values()
    assert len(limits) <= 4
    assert {"pitch", "foot_offsets", "swing", "com_margin"}.isdisjoint(limits)
    assert pa.solve_stand(robot, replace(task, **limits), explain=False).solved
    assert refusal.value.nearest.task.pitch == task.pitch
    (message,) = refusal.value.possible.values()
    assert message.code == "reachable-requirements"
    assert len(message.values["requirements"]) == len(limits)
