"""Suggest gains of position servos: stiffness kp and damping kd of each joint.

Units: kp [N m/rad, N/m], kd [N m s/rad, N s/m]. A servo is deflected by tau / kp. The stiffness
therefore follows from a torque and from the permitted deflection. The time step h bounds the
stiffness: h sqrt(kp / I), with the inertia I of the joint, must remain below 2.

The requirement depends on the base:

- Standing robot (`ServoRequirement.of_stand`): all joints hold a single posture against a single
  load, and the feet press against each other. As far as the time step and closed loops permit, each
  hinge is as stiff as the most loaded joint. Each slide is as stiff as a hinge with the lever of a
  leg, or as its own load requires. Damping is proportional to stiffness: then the damping ratio of
  a mode is proportional to its frequency.
- Robot with a fixed base, such as an arm (`ServoRequirement.of_fixed_base`): any posture may be
  commanded, and each joint moves alone. Each joint is stiff enough for the worst of random
  postures, as far as the time step permits, and critically damped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.units import round_down
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import is_slide
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand

GainArrays = tuple[Array, Array]
"""Servo gains: stiffness kp [N m/rad, N/m] and damping kd [N m s/rad, N s/m], an array each, with a
value per joint."""

DEFAULT_SAG = 0.02
"""Default deflection of a joint of an arm under gravity [rad; m for a slide], from which the
suggested servo stiffness follows. Chosen, not tuned.
"""

_MAX_STANDING_FREQUENCY = 1.5
"""Upper bound of h sqrt(kp / I) for each joint of a standing robot [rad per time step]. The bound
limits the stiffness kp; h is the time step, and I the inertia at the joint. Chosen below 2, at
which MuJoCo's integration, explicit in the position, diverges."""

_MAX_FIXED_BASE_FREQUENCY = 0.5
"""Upper bound of h sqrt(kp / I) for each joint of a robot with a fixed base [rad per time step].
The bound limits the stiffness kp; h is the time step, and I the inertia at the joint. Chosen as a
quarter of the stability limit 2, because the poses in which the robot will be used are unknown."""

_MIN_LEVER_FRACTION = 0.02
"""Lower bound of the design torque of a standing robot's servos, divided by weight * base height
[1]. The bound is needed because straight legs need almost no torque. Chosen, not tuned."""

_LEVER_FRACTION, _MIN_LEVER, _MAX_LEVER = 0.5, 0.1, 1.0
"""Lever of the hinges of a leg, relative to the stand height [1], and its bounds [m]. The lever
converts the stiffness of a hinge to the stiffness of a slide. Chosen, not tuned. Measured: a robot
with telescopic legs that is 0.42 m high falls with 800 N m/rad at its hinges and up to 5,000 N/m at
its slides, and stands with 8,000 and 20,000 N/m.
"""

_DAMPING_TIME = 0.05
"""Default ratio kd / kp [s] between damping and stiffness of servos added to a standing robot.
Chosen, not tuned.
"""

_MIN_TORQUE_FRACTION = 0.02
"""Lower bound of a joint's design torque, divided by the largest gravity torque of all joints [1].
The stiffness of a servo is derived from the design torque. Chosen, not tuned.
"""

_MIN_FREQUENCY = 4 * math.pi
"""Lower bound of a servo's natural frequency [rad/s], 2 Hz, for a robot with a fixed base. The
bound that follows from the time step has priority. Chosen: a joint with a vertical axis
holds no gravity torque, but must reach the command within some tenths of a second."""

_NUM_POSES = 64
"""Number of random poses of a robot with a fixed base. The servo gains are derived from the gravity
torques and inertias in these poses. Chosen, not tuned."""

TIMESTEP_DIVISORS = (1, 2, 4, 8)
"""Divisors of the model's time step [1] that are tried for a robot with added servos, and for
MuJoCo's import of a URDF. Measured: a light foot without armature oscillates between a stiff servo
and the ground at 2 ms. With an inertia of 3e-4 kg m^2 about the ankle (G1) the foot is at rest at
0.5 ms; with 2e-4 kg m^2 (the biped HECTOR) at 0.25 ms.
"""


@dataclass(frozen=True, eq=False)
class ServoRequirement:
    """Torques, inertias and stiffness bounds from which the servo gains of n joints are derived.

    Each array has the shape (n,). The first unit is that of a hinge, the second that of a slide.

    Attributes:
        torques: Design torque that may deflect the joint by the permitted deflection [N m, N]. For
            a slide of a standing robot, the design torque of a hinge divided by the square of a
            lever [N/m].
        own_torques: Torque that the joint itself must hold [N m, N]. To hold this torque, the
            stiffness may exceed ``soft_limit``, but not ``max_stiffness``.
        inertia: Inertia at the joint with all other joints free, in closed loops as far as the
            loops permit [kg m^2, kg].
        min_stiffness: Lower bound of the stiffness [N m/rad, N/m].
        soft_limit: Upper bound of the stiffness that follows from ``torques``; no bound of the
            stiffness that follows from ``own_torques`` [N m/rad, N/m].
        max_stiffness: Upper bound of the stiffness in all cases [N m/rad, N/m].
    """

    torques: Array
    own_torques: Array
    inertia: Array
    min_stiffness: Array
    soft_limit: Array
    max_stiffness: Array

    def stiffness(self, sag: float) -> Array:
        """Compute the stiffness kp of n servos for a permitted deflection.

        kp = min(max_stiffness, max(min_stiffness, own_torques / sag, min(torques / sag,
        soft_limit))), with the attributes of this class.

        Args:
            sag: Permitted deflection of a joint under the design torque [rad, m].

        Returns:
            Stiffness, shape (n,) [N m/rad, N/m].
        """
        wanted = np.maximum(np.minimum(self.torques / sag, self.soft_limit), self.own_torques / sag)
        return np.asarray(np.minimum(np.maximum(wanted, self.min_stiffness), self.max_stiffness))

    @classmethod
    def of_stand(
        cls, robot: Robot, qpos: Array, torques: Array, *, parts: int = 1
    ) -> ServoRequirement:
        """Compute the requirements on the servos of a standing robot: torques, inertia, bounds.

        All hinges have the same design torque: the largest static torque of all joints, or a lower
        bound (`_MIN_LEVER_FRACTION`).

        Args:
            robot: Robot.
            qpos: Configuration of the stand, shape (nq,).
            torques: Static torques of the stand, shape (nu,) [N m, N].
            parts: Divisor of the model's time step; the bounds are those for this shorter step.
        """
        inertia = compute_joint_inertia(robot, qpos)
        timestep = float(robot.mj_model.opt.timestep) / parts
        weight = robot.weight
        design_torque = max(
            float(np.abs(torques).max()), _MIN_LEVER_FRACTION * weight * robot.stand_height
        )
        design_torques = np.full(robot.nu, design_torque)
        slides = [is_slide(robot, joint) for joint in robot.joint_names]
        lever = min(max(_LEVER_FRACTION * robot.stand_height, _MIN_LEVER), _MAX_LEVER)
        design_torques[slides] /= lever**2
        soft_limit = np.full(robot.nu, np.inf)
        if robot.closure is not None:
            # MuJoCo's solver distributes damping over coupled joints before the implicit step
            # reduces it. Damping that would stop the joint within a step accelerates the dependent
            # joints (a fingertip by 33 mrad after a nudge of 1e-3 rad/s). It acts on the inertia of
            # the leading joint alone: a twelfth of the total for a hand that drives 11 finger
            # joints. The stiffness of a leading joint is therefore limited, unless its own load
            # requires more.
            leading = robot.closure.driving_joints
            own_inertia = 1 / np.diag(np.linalg.inv(Configuration(robot, qpos).mass_matrix()))
            soft_limit[leading] = own_inertia[robot.nv - robot.nu :][leading] / (
                _DAMPING_TIME * timestep
            )
        return cls(
            torques=design_torques,
            own_torques=np.abs(torques),
            inertia=inertia,
            min_stiffness=np.zeros(robot.nu),
            soft_limit=soft_limit,
            max_stiffness=inertia * (_MAX_STANDING_FREQUENCY / timestep) ** 2,
        )

    @classmethod
    def of_fixed_base(cls, model: mujoco.MjModel) -> ServoRequirement:
        """Compute the requirements on the servos of a robot with a fixed base, such as an arm.

        The design torque of a joint is the largest gravity torque in random poses, or a lower bound
        (`_MIN_TORQUE_FRACTION`).

        Args:
            model: Model with a fixed base, or with a free base that is held. All other joints must
                be hinges or slides.
        """
        data, random = mujoco.MjData(model), np.random.default_rng(0)
        hinges = np.flatnonzero(model.jnt_type != JointKind.FREE)
        dofs, addresses = model.jnt_dofadr[hinges], model.jnt_qposadr[hinges]
        limited = model.jnt_limited[hinges] == 1
        low = np.where(limited, model.jnt_range[hinges, 0], -math.pi)
        high = np.where(limited, model.jnt_range[hinges, 1], math.pi)
        torque, inertia = np.zeros(len(hinges)), np.full(len(hinges), np.inf)
        locked_inertia = np.zeros(len(hinges))
        mass = np.zeros((model.nv, model.nv))
        for _ in range(_NUM_POSES):
            data.qpos[addresses] = random.uniform(low, high)
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            inverse = np.linalg.inv(mass[np.ix_(dofs, dofs)])
            torque = np.maximum(torque, np.abs(data.qfrc_bias[dofs]))
            inertia = np.minimum(inertia, 1 / np.diag(inverse))
            locked_inertia = np.maximum(locked_inertia, mass[dofs, dofs])
        return cls(
            torques=np.maximum(torque, _MIN_TORQUE_FRACTION * float(torque.max())),
            own_torques=torque,
            inertia=inertia,
            min_stiffness=locked_inertia * _MIN_FREQUENCY**2,
            soft_limit=np.full(len(hinges), np.inf),
            max_stiffness=inertia * (_MAX_FIXED_BASE_FREQUENCY / float(model.opt.timestep)) ** 2,
        )


def suggest_standing_gains(
    robot: Robot, stand: Stand, torques: Array, sag: float, parts: int = 1, damping: float = 1.0
) -> GainArrays:
    """Compute servo gains that hold a stand; round the gains down to two significant digits.

    Args:
        robot: Robot.
        stand: Stand that the servos hold.
        torques: Static torques of the stand, shape (nu,) [N m, N].
        sag: Permitted deflection of the most loaded joint [rad, m].
        parts: Divisor of the model's time step; the gains are those for this shorter step.
        damping: Factor [1] of the default damping, kd = 0.05 s * kp.

    Returns:
        kp, shape (nu,) [N m/rad, N/m]; kd, shape (nu,) [N m s/rad, N s/m].
    """
    required = ServoRequirement.of_stand(robot, stand.qpos, torques, parts=parts)
    kp = np.array([round_down(value, 2) for value in required.stiffness(sag)])
    return kp, np.array([round_down(value, 2) for value in damping * _DAMPING_TIME * kp])


def suggest_fixed_base_gains(model: mujoco.MjModel, sag: float = DEFAULT_SAG) -> GainArrays:
    """Compute servo gains for a robot with a fixed base, such as an arm, with critical damping.

    The damping is kd = 2 sqrt(kp I). I is the smallest inertia at the joint in random poses, with
    the other joints free. The gains are rounded to three significant digits.

    Args:
        model: Model with a fixed base, or with a free base that is held.
        sag: Permitted deflection of a joint under gravity [rad, m].

    Returns:
        kp [N m/rad, N/m] and kd [N m s/rad, N s/m], each with a value per joint that is not free,
        in the order of the model's joints.
    """
    required = ServoRequirement.of_fixed_base(model)
    kp = required.stiffness(sag)
    kd = 2 * np.sqrt(kp * required.inertia)
    return np.array([round_to_three_digits(gain) for gain in kp]), np.array(
        [round_to_three_digits(gain) for gain in kd]
    )


def compute_joint_inertia(robot: Robot, qpos: Array) -> Array:
    """Compute the effective inertia at each joint: joint torque divided by joint acceleration.

    All other joints and a free base move without torque; loops stay closed.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,).

    Returns:
        Inertia, shape (nu,) [kg m^2 for a hinge, kg for a slide]; huge or infinite if closed loops
        lock the joint.
    """
    mass, first = Configuration(robot, qpos).mass_matrix(), robot.nv - robot.nu
    if robot.closure is None:
        inverse = np.linalg.inv(mass)
    else:
        null_space = robot.closure.null_space(qpos)
        basis = np.zeros((first + len(null_space), first + null_space.shape[1]))
        basis[:first, :first] = np.eye(first)
        basis[first:, first:] = null_space
        inverse = basis @ np.linalg.solve(basis.T @ mass @ basis, basis.T)
    with np.errstate(divide="ignore"):
        joint_inertia: Array = 1 / np.diag(inverse)[first:]
    return joint_inertia


def round_to_three_digits(value: float) -> float:
    """Round ``value`` to three significant digits."""
    return float(f"{value:.3g}")
