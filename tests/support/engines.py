"""Evaluations and modified models of a robot by MuJoCo, and Pinocchio models of parameter trees."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin

import pupper_analysis as pa
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.coordinates import PinocchioConvention


def with_efforts(robot: pa.Robot, efforts: float | Sequence[float] | np.ndarray) -> pa.Robot:
    """Return the robot with other effort limits in both models.

    Args:
        robot: Robot.
        efforts: Limits (nu,) [N m], or one for all joints.
    """
    urdf, mjcf = robot.pin_model.copy(), copy.copy(robot.mj_model)
    limits = np.array(urdf.effortLimit)
    limits[robot.pin_convention.v_index] = efforts
    urdf.effortLimit = limits
    spec = robot.description.mjcf.copy()  # which a payload is welded to
    for name, limit in zip(robot.joint_names, limits[robot.pin_convention.v_index], strict=True):
        for actuator in spec.actuators:
            if actuator.target == name and limit > 0:  # of zero the URDF's counts alone
                actuator.forcelimited = mujoco.mjtLimited(int(np.isfinite(limit)))
                actuator.forcerange = (-limit, limit) if np.isfinite(limit) else (0.0, 0.0)
        drives = mjcf.actuator_trnid[:, 0] == mjcf.joint(name).id
        mjcf.actuator_forcelimited[drives] = np.isfinite(limit)
        mjcf.actuator_forcerange[drives] = (-limit, limit) if np.isfinite(limit) else 0.0
    description = replace(robot.description, mjcf=spec)
    return replace(robot, pin_model=urdf, mj_model=mjcf, description=description)


def change_model(robot: pa.Robot, change: Callable[[mujoco.MjModel], None]) -> pa.Robot:
    """Return the robot with a changed copy of its MuJoCo model."""
    model = copy.copy(robot.mj_model)
    change(model)
    return replace(robot, mj_model=model)


def addresses(robot: pa.Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the public qpos and qvel in MuJoCo's vectors, by joint names."""
    model = robot.mj_model
    base_q = list(range(7)) if robot.floating else []
    base_v = list(range(6)) if robot.floating else []
    joints = [model.joint(name) for name in robot.joint_names]
    q = base_q + [int(joint.qposadr[0]) for joint in joints]
    v = base_v + [int(joint.dofadr[0]) for joint in joints]
    return np.array(q), np.array(v)


def evaluate_mujoco(
    robot: pa.Robot,
    qpos: np.ndarray,
    qvel: np.ndarray | None = None,
    model: mujoco.MjModel | None = None,
) -> mujoco.MjData:
    """Return MuJoCo's data of the MJCF at a public state, after ``mj_forward``."""
    model = model or robot.mj_model
    data = mujoco.MjData(model)
    q, v = addresses(robot)
    data.qpos[q] = qpos
    data.qvel[v] = 0.0 if qvel is None else qvel
    mujoco.mj_forward(model, data)
    return data


def load_by_mujoco(robot: pa.Robot, qpos: np.ndarray) -> np.ndarray:
    """Return the generalised forces (nv,) of ``Configuration.load``, by MuJoCo from the MJCF."""
    data = evaluate_mujoco(robot, qpos)
    return (data.qfrc_bias - data.qfrc_passive)[addresses(robot)[1]]


def integrate(robot: pa.Robot, qpos: np.ndarray, qvel: np.ndarray, dt: float) -> np.ndarray:
    """Return qpos after a time ``dt`` [s] at a constant velocity qvel, by MuJoCo."""
    q, v = addresses(robot)
    moved, rate = np.empty(robot.mj_model.nq), np.empty(robot.mj_model.nv)
    moved[q], rate[v] = qpos, qvel
    mujoco.mj_integratePos(robot.mj_model, moved, rate, dt)
    return moved[q]


def differentiate_along(
    robot: pa.Robot,
    function: Callable[[np.ndarray], np.ndarray],
    qpos: np.ndarray,
    qvel: np.ndarray,
    dt: float = 1e-5,
) -> np.ndarray:
    """Return the time derivative of function(qpos) at a velocity qvel, by a central difference."""
    ahead, behind = (integrate(robot, qpos, qvel, sign * dt) for sign in (1, -1))
    return (np.asarray(function(ahead)) - np.asarray(function(behind))) / (2 * dt)


def make_free_mechanism(robot: pa.Robot, timestep: float = 1e-3) -> mujoco.MjModel:
    """Return MuJoCo's model without contacts, limits, motors, damping and friction; RK4."""
    model = robot.description.mjcf.copy().compile()
    off = mujoco.mjtDisableBit
    for bit in (off.mjDSBL_CONTACT, off.mjDSBL_LIMIT, off.mjDSBL_ACTUATION):
        model.opt.disableflags |= bit.value
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.timestep = timestep
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4.value
    return model


def velocity_map(convention: PinocchioConvention, qpos: np.ndarray) -> np.ndarray:
    """Return the matrix T (nv, nv) with v_pin = T qvel: R^T, identity and a permutation."""
    n = convention.base_nv
    matrix = np.zeros((convention.nv, convention.nv))
    matrix[convention.v_index, n + np.arange(len(convention.v_index))] = 1.0
    if convention.floating:
        matrix[:3, :3] = rotation_from_quaternion(qpos[3:7]).T
        matrix[3:6, 3:6] = np.eye(3)
    return matrix


def velocity_map_rate(
    convention: PinocchioConvention, qpos: np.ndarray, qvel: np.ndarray
) -> np.ndarray:
    """Return dT/dt qvel (nv,): the base frame rotates at a constant world velocity."""
    rate = np.zeros(convention.nv)
    if convention.floating:
        rate[:3] = -np.cross(qvel[3:6], rotation_from_quaternion(qpos[3:7]).T @ qvel[:3])
    return rate


def to_pinocchio(parameters: MultibodyTree) -> pin.Model:
    """Return the Pinocchio model of a parameter tree; frames have the type BODY."""
    model = pin.Model()
    model.gravity = pin.Motion(parameters.gravity, np.zeros(3))
    index, still = {parameters.base: 0}, pin.SE3.Identity()
    if parameters.floating:
        flyer = pin.JointModelFreeFlyer()
        index[parameters.base] = model.addJoint(0, flyer, still, "__free__")
    model.appendBodyToJoint(
        index[parameters.base], parameters.bodies[parameters.base].spatial_inertia, still
    )
    order = parameters.parents_first()
    for name in order:
        joint = parameters.joints[name]
        motion = (
            pin.JointModelPrismaticUnaligned(joint.axis)
            if joint.slides
            else pin.JointModelRevoluteUnaligned(joint.axis)
        )
        index[name] = model.addJoint(
            index[joint.parent],
            motion,
            joint.placement,
            name,
            np.array([joint.effort]),
            np.array([joint.velocity]),
            np.array([joint.lower]),
            np.array([joint.upper]),
        )
        model.appendBodyToJoint(index[name], parameters.bodies[name].spatial_inertia, still)
    offset = 6 if parameters.floating else 0
    joints = [parameters.joints[name] for name in order]
    for attribute in (parameter for parameter in JOINT_ATTRIBUTES if parameter.pinocchio):
        getattr(model, attribute.pinocchio)[offset:] = [
            getattr(joint, attribute.field) for joint in joints
        ]
    model.damping[:offset] = parameters.base_damping
    model.armature[:offset] = parameters.base_armature
    for name, (body, position) in parameters.frames.items():
        placement = pin.SE3(np.eye(3), position)
        frame = pin.Frame(name, index[body], 0, placement, pin.FrameType.BODY)
        model.addFrame(frame, False)
    return model
