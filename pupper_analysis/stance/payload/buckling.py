"""At which payload a stand buckles on servos of finite stiffness: a linear eigenvalue problem."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]


def find_buckling_modes(
    robot: Robot,
    loaded: Robot,
    stand: Stand,
    kp: Array,
    empty: GravityCompensation,
    laden: GravityCompensation,
) -> Array | None:
    """Finds at which payloads a stand held with feed-forward for the load loses its stability.

    In the stand, gravity and the contact forces that last are linear in the payload's mass m, and
    so is the stiffness: K(m) = K_0 + m G, with K_0 that of servos, ground, and the robot's own
    weight, on all motions for which the material contact points do not slip. The stand buckles in
    a mode v where K(m) v = 0, that is, -G v = mu K_0 v with mu = 1 / m.

    The ground's stiffness is that under ``laden``: it is greater under more, which matters little.
    On level ground all else is exact for the configuration; on a slope K is made symmetric.

    Args:
        robot: The robot.
        loaded: The same with some payload.
        stand: How it stands.
        kp: (nu,) servo stiffness at the joints (N m/rad).
        empty: What holds ``robot`` in the stand.
        laden: What holds ``loaded`` there.

    Returns:
        The mu of all modes, the greatest first (1/kg): none buckles below a mass of 1 / mu[0] if
        that is positive, and none at all if not. None if the stand is not stable without payload.
    """
    mass = loaded.total_mass - robot.total_mass
    data = robot.pin_model.createData()
    pin.computeJointJacobians(robot.pin_model, data, robot.pin_convention.q(stand.qpos))
    pin.updateFramePlacements(robot.pin_model, data)
    jacobians = {foot: _jacobian(robot, data, foot) for foot in stand.stance_feet}
    held, normal, rates = _contacts(loaded, stand, laden, jacobians)
    stiff = normal.T @ (rates[:, None] * normal)
    joints = robot.pin_convention.v_index
    stiff[joints, joints] += kp
    free = linalg.null_space(held)
    one, two = (
        free.T @ (_geometric(on, stand, balance.contact_forces, data, jacobians) + stiff) @ free
        for on, balance in ((robot, empty), (loaded, laden))
    )
    softer = (one - two) / mass
    try:
        modes: Array = linalg.eigh((softer + softer.T) / 2, (one + one.T) / 2, eigvals_only=True)
    except np.linalg.LinAlgError:
        return None
    return modes[::-1]


def _contacts(
    robot: Robot, stand: Stand, held: GravityCompensation, jacobians: Mapping[str, Array]
) -> tuple[Array, Array, Array]:
    """Returns what keeps the contact points (2 n, nv), their rise (n, nv), and N/m per foot (n,).

    Columns are those of Pinocchio's velocity.
    """
    tangential, normals, rates = [], [], []
    for foot in stand.stance_feet:
        normal, law, jacobian = stand.normals[foot], GroundLaw.of(robot, foot), jacobians[foot]
        depth = law.depth(max(float(held.contact_forces[foot] @ normal), 0.0))
        arm = contact_offset(robot.foot_radius[foot], normal, depth)
        point = jacobian[:3] - pin.skew(arm) @ jacobian[3:]
        across = pin.Quaternion.FromTwoVectors(normal, UP).matrix()[:2]
        tangential.append(across @ point)
        normals.append(normal @ jacobian[:3])
        rates.append(law.rate(depth))
    return np.concatenate(tangential), np.array(normals), np.array(rates)


def _jacobian(robot: Robot, data: pin.Data, foot: str) -> Array:
    """Returns the Jacobian (6, nv) of a foot's centre, in world axes and Pinocchio's velocity."""
    frame = robot.pin_model.getFrameId(robot.foot_frames[foot], pin.FrameType.BODY)
    jacobian: Array = pin.getFrameJacobian(
        robot.pin_model, data, frame, pin.LOCAL_WORLD_ALIGNED
    ).reshape(6, -1)
    return jacobian


def _geometric(
    robot: Robot,
    stand: Stand,
    forces: Mapping[str, Array],
    at: pin.Data,
    jacobians: Mapping[str, Array],
) -> Array:
    """Returns the derivative (nv, nv) of gravity less contact forces that keep their direction.

    Pinocchio's static torque derivatives are for forces that turn with their link. One that keeps
    its direction in the world, f at the foot's centre, turns by -omega x f against the link, which
    takes J_c^T [f]x J_omega away; likewise the moment about the centre of what acts at the contact.
    """
    model = robot.pin_model
    external = pin.StdVec_Force()
    external.extend([pin.Force.Zero() for _ in range(model.njoints)])
    turning = np.zeros((model.nv, model.nv))
    for foot, force in forces.items():
        frame = model.getFrameId(robot.foot_frames[foot], pin.FrameType.BODY)
        joint, centre = model.frames[frame].parentJoint, at.oMf[frame].translation
        arm = contact_offset(robot.foot_radius[foot], stand.normals[foot], stand.depths[foot])
        moment = pin.skew(arm) @ force
        about_origin = pin.Force(force, moment + pin.skew(centre) @ force)
        external[joint] = external[joint] + at.oMi[joint].actInv(about_origin)
        jacobian = jacobians[foot]
        turning += jacobian[:3].T @ pin.skew(force) @ jacobian[3:]
        turning += jacobian[3:].T @ pin.skew(moment) @ jacobian[3:]
    q = robot.pin_convention.q(stand.qpos)
    turned: Array = pin.computeStaticTorqueDerivatives(model, model.createData(), q, external)
    return turned - turning
