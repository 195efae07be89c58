"""Stiffness under a load: finite differences, and the other route, through settled poses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.payload.buckling import _geometric, _jacobian, find_buckling_modes
from pupper_analysis.stance.sag.solution import integrate_step
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from tests.support.variants import NAMES, load, stand_of

EVEN = pa.statics.ForceDistribution.MIN_TANGENTIAL


@pytest.mark.parametrize(
    ("name", "slope"), [("original", 0.0), ("v3", 0.0), ("v3", 0.2), ("heavy", 0.2)]
)
def test_stiffness_is_the_slope_of_the_balance(name: str, slope: float) -> None:
    """Of gravity less forces that keep their direction, by central differences."""
    robot = load(name)
    stand = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(slope, 0.5)))
    forces = pa.stance.stand_statics(robot, stand, distribution=EVEN).contact_forces

    def balance(qpos: np.ndarray) -> np.ndarray:
        config = pa.Configuration(robot, qpos)
        left = config.gravity()
        for foot, force in forces.items():
            arm = -robot.foot_radius[foot] * stand.normals[foot]
            left = left - config.frame_jacobian(robot.foot_frames[foot], arm)[:3].T @ force
        return left

    steps = 1e-6 * np.eye(robot.nv)
    expected = [
        (balance(integrate_step(stand.qpos, s)) - balance(integrate_step(stand.qpos, -s))) / 2e-6
        for s in steps
    ]
    data = robot.pin_model.createData()
    pin.computeJointJacobians(robot.pin_model, data, robot.pin_convention.q(stand.qpos))
    pin.updateFramePlacements(robot.pin_model, data)
    jacobians = {foot: _jacobian(robot, data, foot) for foot in forces}
    turn = robot.pin_convention.velocity_map(stand.qpos)
    found = turn.T @ _geometric(robot, stand, forces, data, jacobians) @ turn
    # Joints: elsewhere the map between the velocities turns too, which the balance of the base
    # (zero in sum) hides only in the rows of the joints.
    np.testing.assert_allclose(found[6:], np.array(expected).T[6:], atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_where_it_buckles_the_settled_pose_is_not_stable_any_more(name: str) -> None:
    """Substituted twice, as the depths under the load change the configuration."""
    robot, stand = load(name), stand_of(name)
    kp, mass, sunk = model_with_servos(robot).kp, 0.3, stand
    for _ in range(4):
        loaded = with_payload(robot, mass)
        sunk = solve_loaded_stand(loaded, stand)
        empty, laden = (
            pa.stance.stand_statics(one, sunk, distribution=EVEN) for one in (robot, loaded)
        )
        modes = find_buckling_modes(robot, loaded, sunk, kp, empty, laden)
        assert modes is not None
        mass = float(1 / modes[0])
    signs = []
    for share in (0.98, 1.02):
        heavy = with_payload(robot, share * mass)
        pose = pa.steady_state(heavy, solve_loaded_stand(heavy, stand), feedforward=True)
        signs.append(np.sign(pose.stiffness))
    assert signs == [1, -1]


def test_servos_too_soft_without_any_payload() -> None:
    robot, stand = load("v3"), stand_of("v3")
    loaded = with_payload(robot, 0.3)
    empty, laden = (
        pa.stance.stand_statics(one, stand, distribution=EVEN) for one in (robot, loaded)
    )
    assert find_buckling_modes(robot, loaded, stand, np.full(12, 0.5), empty, laden) is None
