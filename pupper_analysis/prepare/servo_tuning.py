"""Suggest gains of position servos.

A servo is deflected by tau / kp. The stiffness therefore follows from a torque and from the
permitted deflection. The time step h bounds the stiffness: h sqrt(kp / I), with the inertia I of
the joint, must remain well below 2.

The requirement depends on the base:

* Standing robot (`ServoRequirement.of_stand`): all joints hold one posture against one load, and
  the feet press against each other. Each joint is as stiff as the most loaded joint, and damping is
  proportional to stiffness: then the damping ratio of a mode is proportional to its frequency.
* Robot with a fixed base, such as an arm (`ServoRequirement.of_fixed_base`): any posture may be
  commanded, and each joint moves alone. Each joint is stiff enough for its worst posture, and
  critically damped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]
Gains = tuple[Array, Array]

DEFAULT_SAG = 0.02
"""What the joint of an arm that holds most gives way by default (rad, m for one that slides)."""

_FASTEST = 1.5
"""Greatest frequency of a standing robot's joint by itself on its servo, per time step (rad):
MuJoCo's steps, explicit in the position, diverge at 2."""

_FASTEST_HELD = 0.5
"""The same of a robot that is held: a quarter of the limit, as its poses are not known."""

_LEAST_LEVER = 0.02
"""Stretched legs hold no torque; servos are made for at least the weight at this part of the base's
height."""

_DAMPING_TIME = 0.05
"""kd / kp of a standing robot's servos (s): within the 0.02 to 0.1 s of robots' own controllers."""

_LEAST_SHARE = 0.02
"""Of the greatest gravity torque: what a joint that holds hardly any is given stiffness for."""

_LEAST_RATE = 4 * math.pi
"""Least natural frequency of a servo (rad/s), 2 Hz: what turns about a vertical axis holds no
gravity, and still is to be where it is commanded within some tenths of a second."""

_POSES = 64

TIMESTEP_DIVISORS = (1, 2, 4)
"""Parts into which the model's time step is divided, the first with which the robot comes to rest.
A light foot without armature (G1's: 3e-4 kg m^2 about the ankle) shakes between a stiff servo and
the ground at 2 ms, and is at rest at 0.5 ms."""


@dataclass(frozen=True, eq=False)
class ServoRequirement:
    """What the servos of some joints are to hold, each (n,).

    Attributes:
        torques: What a joint is given stiffness for (N m, N of a slide).
        own_torques: The part of it that it holds itself, for which it is stiff in any case.
        inertia: What it feels with everything else free (kg m^2, kg).
        min_stiffness: The least stiffness (N m/rad, N/m).
        soft_limit: The stiffness beyond which it is no stiffer than ``own`` asks.
        max_stiffness: The greatest.
    """

    torques: Array
    own_torques: Array
    inertia: Array
    min_stiffness: Array
    soft_limit: Array
    max_stiffness: Array

    def stiffness(self, sag: float) -> Array:
        """Returns the stiffness (n,) with which each gives way by no more than a sag (rad, m)."""
        wanted = np.maximum(np.minimum(self.torques / sag, self.soft_limit), self.own_torques / sag)
        return np.asarray(np.minimum(np.maximum(wanted, self.min_stiffness), self.max_stiffness))

    @classmethod
    def of_stand(
        cls, robot: Robot, qpos: Array, torques: Array, *, parts: int = 1
    ) -> ServoRequirement:
        """Returns what the servos of a robot that stands are to hold.

        Args:
            robot: The robot.
            qpos: (nq,) its stand.
            torques: (nu,) what holds it (N m).
            parts: Into which the model's time step is divided.
        """
        inertia = compute_joint_inertia(robot, qpos)
        timestep = float(robot.mj_model.opt.timestep) / parts
        weight = robot.weight
        most = max(float(np.abs(torques).max()), _LEAST_LEVER * weight * robot.stand_height)
        calm = np.full(robot.nu, np.inf)
        if robot.closure is not None:
            # The solver shares a servo's damping out before the implicit step makes it less: what
            # it would stop in less than a step throws what follows (a finger's end by 33 mrad, at a
            # nudge of 1e-3 rad/s). It acts on the joint's own inertia first, without what follows:
            # of a hand that leads 11 fingers' joints a twelfth. A joint that leads is no stiffer,
            # unless its load asks for it.
            leading = robot.closure.leading
            alone = 1 / np.diag(np.linalg.inv(Configuration(robot, qpos).mass_matrix()))
            calm[leading] = alone[robot.nv - robot.nu :][leading] / (_DAMPING_TIME * timestep)
        return cls(
            torques=np.full(robot.nu, most),
            own_torques=np.abs(torques),
            inertia=inertia,
            min_stiffness=np.zeros(robot.nu),
            soft_limit=calm,
            max_stiffness=inertia * (_FASTEST / timestep) ** 2,
        )

    @classmethod
    def of_fixed_base(cls, model: mujoco.MjModel) -> ServoRequirement:
        """Returns what the servos of a robot that is held are to hold: an arm, say.

        Each joint's stiffness is for the greatest gravity torque that it holds in random poses, or
        for the greatest inertia that it moves there with the others locked, if that asks for more.

        Args:
            model: The model, its base fixed or held.
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
        return cls(
            torques=np.maximum(torque, _LEAST_SHARE * float(torque.max())),
            own_torques=torque,
            inertia=inertia,
            min_stiffness=heaviest * _LEAST_RATE**2,
            soft_limit=np.full(len(hinges), np.inf),
            max_stiffness=inertia * (_FASTEST_HELD / float(model.opt.timestep)) ** 2,
        )


def suggest_standing_gains(
    robot: Robot, stand: Stand, torques: Array, sag: float, parts: int = 1, damping: float = 1.0
) -> Gains:
    """Returns gains to try on a robot that stands: to two digits, as they are typed.

    Args:
        robot: The robot.
        stand: How it stands.
        torques: (nu,) what holds it (N m).
        sag: What the joint that holds most gives way (rad).
        parts: Into which the model's time step is divided.
        damping: Part of the usual damping.

    Returns:
        kp (nu,) (N m/rad), kd (nu,) (N m s/rad).
    """
    required = ServoRequirement.of_stand(robot, stand.qpos, torques, parts=parts)
    kp = np.array([_two_digits(value) for value in required.stiffness(sag)])
    return kp, np.array([_two_digits(value) for value in damping * _DAMPING_TIME * kp])


def suggest_fixed_base_gains(model: mujoco.MjModel, sag: float = DEFAULT_SAG) -> Gains:
    """Computes the gains of a robot that is held: an arm, or one that cannot stand.

    A joint's damping is for the inertia that it moves with the others free, and the least without
    overshoot: kd = 2 sqrt(kp I).

    Args:
        model: The model, its base fixed or held.
        sag: What a joint gives way under gravity (rad).

    Returns:
        kp and kd, one for each joint that is not free, in the model's order.
    """
    required = ServoRequirement.of_fixed_base(model)
    kp = required.stiffness(sag)
    kd = 2 * np.sqrt(kp * required.inertia)
    return np.array([round_to_three_digits(v) for v in kp]), np.array(
        [round_to_three_digits(v) for v in kd]
    )


def compute_joint_inertia(robot: Robot, qpos: Array) -> Array:
    """Returns what each joint feels (nu,) with everything else free, and loops closed (kg m^2)."""
    mass, first = Configuration(robot, qpos).mass_matrix(), robot.nv - robot.nu
    if robot.closure is None:
        inverse = np.linalg.inv(mass)
    else:
        basis = linalg.block_diag(np.eye(first), robot.closure.null_space(qpos))
        inverse = basis @ np.linalg.solve(basis.T @ mass @ basis, basis.T)
    with np.errstate(divide="ignore"):
        felt: Array = 1 / np.diag(inverse)[first:]
    return felt


def _two_digits(value: float) -> float:
    """Rounds a positive number down to two digits, to be typed."""
    digits = 1 - math.floor(math.log10(value))
    return math.floor(value * 10.0**digits + 1e-9) / 10.0**digits


def round_to_three_digits(value: float) -> float:
    """Rounds to three digits, to be read in a file."""
    return float(f"{value:.3g}")
