"""Gains of position servos: from a sag and a damping ratio."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space

from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import contact_offset
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos
from pupper_analysis.stance.stand import Stand, stand_statics

Array = NDArray[np.float64]

SAG = 0.02
"""What the joint of an arm that holds most gives way by default (rad, m for one that slides)."""

_STEP_SHARE = 0.5
"""Greatest time step of a servo's own motion, h sqrt(kp / I): a quarter of the limit of stability,
which is 2 for a step that is explicit in the position."""

_LEAST_SHARE = 0.02
"""Of the greatest gravity torque: what a joint that holds hardly any is given stiffness for."""

_LEAST_RATE = 4 * math.pi
"""Least natural frequency of a servo (rad/s), 2 Hz: what turns about a vertical axis holds no
gravity, and still is to be where it is commanded within some tenths of a second."""

_POSES = 64


def stand_gains(
    robot: Robot, stand: Stand, sag: float | None, damping_ratio: float | None
) -> tuple[Array, Array]:
    """Computes the gains of a robot that stands.

    The joint that holds the greatest torque gives way by the sag: kp = max |tau| / sag, for all
    joints. With damping in proportion to stiffness, each mode of the robot on its servos has the
    damping ratio z = (kd / kp) w / 2 (Rayleigh); w is that of the mode in which it bounces.

    Args:
        robot: The robot, with servos.
        stand: How it stands.
        sag: What the joint gives way (rad); None: as its servos let it.
        damping_ratio: Of the bounce; None: kd keeps its ratio to kp.

    Returns:
        kp (nu,) (N m/rad), kd (nu,) (N m s/rad).
    """
    drive = servos(robot)
    kp, kd = drive.kp.copy(), drive.kd.copy()
    torques = stand_statics(robot, stand).joint_torques
    if sag is not None:
        new = np.full(robot.nu, _digits(float(np.abs(torques).max()) / sag))
        kd *= new / kp
        kp = new
    if damping_ratio is not None:
        kd = kp * 2 * damping_ratio / bounce_frequency(robot, stand, kp)
    return kp, np.array([_digits(value) for value in kd])


def bounce_frequency(robot: Robot, stand: Stand, kp: Array) -> float:
    """Returns the angular frequency (rad/s) with which a robot bounces on its servos, undamped.

    Feet are pinned, and the ground is hard: the modes are those of K x = w^2 M x in the motions
    that leave the contact points in place. Of them the one is meant that a vertical jolt excites
    most, by its participation factor x^T M e_z (x of unit modal mass).
    """
    config = Configuration(robot, stand.qpos)
    offsets = [
        contact_offset(robot.foot_radius[foot], stand.normals[foot], stand.depths[foot])
        for foot in stand.stance_feet
    ]
    points = config.point_jacobians(stand.stance_feet, np.array(offsets))
    free = null_space(points.reshape(-1, robot.nv))
    mass = config.mass_matrix()
    stiffness = np.concatenate([np.zeros(robot.nv - robot.nu), kp])
    squares, modes = eigh(free.T @ (stiffness[:, None] * free), free.T @ mass @ free)
    up = int(np.argmax(np.abs(modes.T @ free.T @ mass[:, 2])))
    return math.sqrt(float(squares[up]))


def held_gains(
    model: mujoco.MjModel, sag: float | None, damping_ratio: float | None
) -> tuple[Array, Array]:
    """Computes the gains of a robot that is held: an arm, or one that cannot stand.

    Each joint's stiffness is for the greatest gravity torque that it holds in random poses, or for
    the greatest inertia that it moves there with the others locked, if that asks for more; and its
    damping for the inertia that it moves there with the other joints free: kd = 2 z sqrt(kp I).

    Args:
        model: The model, its base fixed or held.
        sag: What a joint gives way under gravity (rad); None: ``SAG``.
        damping_ratio: Of each joint; None: 1, the least without overshoot.

    Returns:
        kp and kd, one for each joint that is not free, in the model's order.
    """
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    hinges = np.flatnonzero(model.jnt_type != JointKind.FREE)
    dofs, places = model.jnt_dofadr[hinges], model.jnt_qposadr[hinges]
    limited = model.jnt_limited[hinges] == 1
    low = np.where(limited, model.jnt_range[hinges, 0], -math.pi)
    high = np.where(limited, model.jnt_range[hinges, 1], math.pi)
    torque, inertia = np.zeros(len(hinges)), np.full(len(hinges), np.inf)
    heaviest = np.zeros(len(hinges))
    mass = np.zeros((model.nv, model.nv))
    for _ in range(_POSES):
        data.qpos[places] = random.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        inverse = np.linalg.inv(mass[np.ix_(dofs, dofs)])
        torque = np.maximum(torque, np.abs(data.qfrc_bias[dofs]))
        inertia = np.minimum(inertia, 1 / np.diag(inverse))
        heaviest = np.maximum(heaviest, mass[dofs, dofs])
    torque = np.maximum(torque, _LEAST_SHARE * float(torque.max()))
    stable = inertia * (_STEP_SHARE / float(model.opt.timestep)) ** 2
    kp = np.minimum(np.maximum(torque / (sag or SAG), heaviest * _LEAST_RATE**2), stable)
    kd = 2 * (damping_ratio or 1.0) * np.sqrt(kp * inertia)
    return np.array([_digits(v) for v in kp]), np.array([_digits(v) for v in kd])


def _digits(value: float) -> float:
    """Rounds to three digits, to be read."""
    return float(f"{value:.3g}")
