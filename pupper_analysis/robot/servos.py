"""Position servos of a robot's MuJoCo model: gains, commands, and models with other gains.

A servo exerts tau = clip(kp (ctrl / gear - q) - kd qvel, lower, upper) at its joint.
`model_with_servos` returns a copy of the model with requested gains. `resolve_servo_gains` returns
only the gains. `with_options` returns a robot with other MuJoCo options. If a joint has several
actuators, only the last is considered as its motor or servo (`MujocoConvention.actuator_index`).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.mjcf import TIMESTEP_RANGE
from pupper_analysis.models.transmission import measure_actuator_levers, read_gears
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.robot.joints import get_common_units
from pupper_analysis.robot.robot import Robot

INTEGRATOR_TYPES = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
"""{name of an integrator in an MJCF: MuJoCo's constant}."""

CONE_TYPES = {
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
}
"""{name of a friction cone type in an MJCF: MuJoCo's constant}."""

_CONVERGING_DYNAMICS = (
    mujoco.mjtDyn.mjDYN_NONE.value,
    mujoco.mjtDyn.mjDYN_FILTER.value,
    mujoco.mjtDyn.mjDYN_FILTEREXACT.value,
)
"""Actuator dynamics (``dyntype``) of a position servo: none, or a filter. With a constant command,
the input of the force law equals the command, or converges to the command."""


@dataclass(frozen=True, eq=False)
class Servos:
    """MuJoCo model with position servos of the joints, and their gains.

    Dependent joints of closed loops and couplings count as joints without servo.

    Attributes:
        model: MuJoCo model with the servos, a copy of the robot's model.
        kp: Stiffness of each joint's servo, shape (nu,) [N m/rad, N/m]; 0 for dependent joints.
        kd: Damping of each joint's servo, shape (nu,) [N m s/rad, N s/m]; 0 for dependent joints.
        gear: Actuator length per joint position, shape (nu,); 1 for dependent joints.
        integrator: Name of MuJoCo's integrator.
    """

    model: mujoco.MjModel
    kp: Array
    kd: Array
    gear: Array
    integrator: str

    @property
    def is_implicit(self) -> bool:
        """True for the integrators ``implicit`` and ``implicitfast``.

        With these, the damping of a servo that does not saturate depends on the velocity after the
        time step.
        """
        return self.integrator.startswith("implicit")

    def command(self, robot: Robot, positions: Array, torques: Array | None = None) -> Array:
        """Compute MuJoCo's ctrl that commands joint positions with feed-forward torques.

        The command of a joint servo is gear * (position + torque / kp). Further position servos,
        for example on tendons, are commanded to exert no force.

        Args:
            robot: Robot with n joints (``robot.nu``).
            positions: Joint positions in actuator order, shape (..., n) [rad, m].
            torques: Feed-forward torques, shape (..., n) [N m, N]. Default: 0.

        Returns:
            Commands of all actuators of the model, shape (..., model.nu).
        """
        actuators = robot.mj_convention.actuator_index
        driven, ctrl = actuators >= 0, np.zeros((*positions.shape[:-1], self.model.nu))
        target = (
            positions if torques is None else positions + compute_command_lead(torques, self.kp)
        )
        if _find_other_servos(self.model, actuators[driven]).size:
            data = mujoco.MjData(self.model)
            for row in np.ndindex(positions.shape[:-1]):
                data.qpos[robot.mj_convention.qpos_index[-robot.nu :]] = positions[row]
                ctrl[row] = make_neutral_commands(self.model, data.qpos, actuators[driven])
        places = self.model.actuator_ctrladr[actuators[driven]]
        ctrl[..., places] = (self.gear * target)[..., driven]
        return ctrl


def read_torque_ranges(model: mujoco.MjModel, actuators: NDArray[np.int64]) -> Array:
    """Read the force ranges of actuators at their joints, shape (n, 2) [N m, N].

    The columns are the lower and upper end; infinite for an actuator without ``forcelimited``.

    Args:
        model: MuJoCo model.
        actuators: Actuator ids, each at a single joint, shape (n,).
    """
    gears = read_gears(model, actuators)
    ranges = np.sort(model.actuator_forcerange[actuators] * gears[:, None], axis=1)
    limited = model.actuator_forcelimited[actuators].astype(bool)
    return np.where(limited[:, None], ranges, [-np.inf, np.inf])


def integrate_servo_damping(
    model: mujoco.MjModel, kd: Array, torques: Array, speeds: Array, ranges: Array
) -> Array:
    """Return the servo torques with which MuJoCo integrates n steps, shape (n, nu) [N m, N].

    With the integrators ``implicit`` and ``implicitfast``, the damping of a servo that does not
    saturate acts on the velocity at the end of a step; ``qfrc_actuator`` contains the velocity at
    the start.

    Args:
        model: MuJoCo model, with its integrator.
        kd: Damping at the joints, shape (nu,) [N m s/rad, N s/m].
        torques: Torques with the velocity at the start of each step, shape (n, nu) [N m, N].
        speeds: Speeds of the joints at the start of each step and at the end of the last step,
            shape (n + 1, nu) [rad/s, m/s].
        ranges: Lower and upper torque of each servo, shape (nu, 2) [N m, N]; infinite without a
            limit.
    """
    integrators = mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if model.opt.integrator not in {integrator.value for integrator in integrators}:
        return torques
    low, high = ranges.T * (1 + _SATURATION_RTOL * np.array([[1.0], [-1.0]]) * np.sign(ranges.T))
    saturated = (torques <= low) | (torques >= high)
    integrated: Array = torques - np.where(saturated, 0.0, kd * np.diff(speeds, axis=0))
    return integrated


_SATURATION_RTOL = 1e-12
"""Relative tolerance [1] below a force limit from which a servo counts as saturated (rounding).
Chosen, not tuned."""


def make_position_commands(robot: Robot, positions: Array) -> Array:
    """Compute MuJoCo's ctrl with which the servos of the MJCF hold given joint positions.

    Further position servos, for example on tendons, are commanded to exert no force. Other
    actuators are commanded 0.

    Args:
        robot: Robot.
        positions: Joint positions in actuator order, shape (nu,) [rad, m].

    Returns:
        Commands of all actuators, shape (model.nu,).
    """
    model, actuators = robot.mj_model, robot.mj_convention.actuator_index
    driven = np.flatnonzero(actuators >= 0)
    _, _, gear, servo = _read_actuator_gains(model, actuators[driven])
    data = mujoco.MjData(model)
    data.qpos[robot.mj_convention.qpos_index[robot.nq - robot.nu :]] = positions
    ctrl = make_neutral_commands(model, data.qpos, actuators[driven])
    controls = model.actuator_ctrladr[actuators[driven]]
    ctrl[controls[servo]] = (gear * positions[driven])[servo]
    return ctrl


def make_neutral_commands(model: mujoco.MjModel, qpos: Array, known: NDArray[np.int64]) -> Array:
    """Compute commands at which position servos that the caller does not command exert no force.

    The commands are computed for zero velocity, and are not clipped to ``ctrlrange``. The ctrl of
    all other actuators is 0.

    Args:
        model: MuJoCo model.
        qpos: Configuration, shape (model.nq,).
        known: Ids of the actuators that the caller commands.

    Returns:
        Commands of all actuators, shape (model.nu,).
    """
    other_servos, ctrl = _find_other_servos(model, known), np.zeros(model.nu)
    if other_servos.size:
        lengths, _ = measure_actuator_levers(model, qpos, other_servos.tolist())
        bias = model.actuator_biasprm[other_servos]
        force = bias[:, 0] + bias[:, 1] * lengths
        ctrl[model.actuator_ctrladr[other_servos]] = (
            -force / model.actuator_gainprm[other_servos, 0]
        )
    return ctrl


def _find_other_servos(model: mujoco.MjModel, known: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the ids of the position servos that are not in ``known``, for example on tendons."""
    if len(set(known.tolist())) == model.nactuator:  # of most robots; the search takes 0.1 ms
        return np.zeros(0, np.int64)
    servo = (
        (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED.value)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE.value)
        & np.isin(model.actuator_dyntype, _CONVERGING_DYNAMICS)
        & (model.actuator_gainprm[:, 0] != 0)
        & (model.actuator_biasprm[:, 1] != 0)
    )
    return np.setdiff1d(np.flatnonzero(servo), known)


def compute_command_lead(torques: Array, kp: Array) -> Array:
    """Compute the offset of servo commands that produces feed-forward torques: torque / kp.

    The offset is 0 for joints with kp = 0.

    Args:
        torques: Feed-forward torques, shape (..., nu) [N m, N].
        kp: Stiffness, shape (nu,) [N m/rad, N/m].

    Returns:
        Offset of the commanded joint positions, shape (..., nu) [rad, m].
    """
    ahead: Array = np.divide(torques, kp, out=np.zeros_like(torques), where=kp > 0)
    return ahead


def model_with_servos(
    robot: Robot,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Servos:
    """Create a copy of the robot's MuJoCo model in which position servos drive the joints.

    The force ranges of the servos are narrowed to the robot's effort limits. If kp or kd is given,
    the motor of each joint becomes a position servo with the resulting gains. A motor that was no
    servo then loses its ``ctrlrange``. Other actuators of a joint are not changed.

    Args:
        robot: Robot.
        kp: Stiffness at the joints [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        kd: Damping at the joints [N m s/rad, N s/m], scalar or shape (nu,). Default: the model's.
        integrator: ``Euler``, ``implicitfast``, ``implicit`` or ``RK4``. Default: the model's.

    Raises:
        ConfigurationError: If a gain is not a number, has another shape or is out of range, or the
            integrator is unknown.
        ModelError: If a joint has no motor; or if a motor is no position servo, and kp or kd is
            None. Dependent joints of loops and couplings need no motor.
    """
    model = copy.copy(robot.mj_model)
    wanted = resolve_servo_gains(robot, kp, kd)
    driven = robot.mj_convention.actuator_index >= 0
    actuators = robot.mj_convention.actuator_index[driven]
    if kp is not None or kd is not None:
        write_position_servos(model, actuators, wanted.kp[driven], wanted.kd[driven])
        model.actuator_ctrllimited[model.actuator_ctrladr[actuators[~wanted.servo[driven]]]] = 0
    _narrow_force_ranges(model, actuators, wanted.gear[driven], robot.effort_ranges[driven])
    if integrator is not None:
        model.opt.integrator = _find_option_value("integrator", integrator, INTEGRATOR_TYPES)
    used = next(
        (name for name, kind in INTEGRATOR_TYPES.items() if kind.value == model.opt.integrator),
        mujoco.mjtIntegrator(int(model.opt.integrator)).name,
    )
    return Servos(model, wanted.kp, wanted.kd, wanted.gear, used)


def write_position_servos(
    model: mujoco.MjModel, actuators: NDArray[np.int64], kp: ArrayLike, kd: ArrayLike
) -> None:
    """Convert actuators of a model to position servos without filter, in place.

    Gears and ranges are kept; an actuator with gear 0 exerts no torque and gets no gains. The
    activation states of removed filters remain in the model (``na``), but are no longer assigned to
    an actuator.

    Args:
        model: MuJoCo model.
        actuators: Actuator ids, each at a single joint, shape (n,).
        kp: Stiffness at the joints, scalar or shape (n,) [N m/rad; N/m for a slide].
        kd: Damping at the joints, scalar or shape (n,) [N m s/rad; N s/m for a slide].
    """
    squared = read_gears(model, actuators) ** 2
    squared[squared == 0] = math.inf
    model.actuator_gaintype[actuators] = mujoco.mjtGain.mjGAIN_FIXED.value
    model.actuator_biastype[actuators] = mujoco.mjtBias.mjBIAS_AFFINE.value
    model.actuator_dyntype[actuators] = mujoco.mjtDyn.mjDYN_NONE.value
    model.actuator_actnum[actuators], model.actuator_actadr[actuators] = 0, -1
    model.actuator_gainprm[actuators, 0] = np.asarray(kp) / squared
    model.actuator_biasprm[actuators, 0] = 0.0
    model.actuator_biasprm[actuators, 1] = -np.asarray(kp) / squared
    model.actuator_biasprm[actuators, 2] = -np.asarray(kd) / squared


@dataclass(frozen=True, eq=False)
class Gains:
    """Servo gains of all joints of a robot, checked for shape and range.

    Dependent joints of loops and couplings have gains of 0, and need no motor.

    Attributes:
        kp: Stiffness at the joints, shape (nu,) [N m/rad, N/m].
        kd: Damping at the joints, shape (nu,) [N m s/rad, N s/m].
        gear: Actuator length per joint position, shape (nu,); 1 for dependent joints.
        servo: Mask, shape (nu,): True if the joint's motor is a position servo in the robot's
            model, or if the joint is dependent.
    """

    kp: Array
    kd: Array
    gear: Array
    servo: NDArray[np.bool_]


def _narrow_force_ranges(
    model: mujoco.MjModel, actuators: NDArray[np.int64], gear: Array, ranges: Array
) -> None:
    """Narrow the force ranges of actuators to the effort limits of their joints, in place.

    Reason: MuJoCo does not bound a servo by the effort of a URDF. ``gear`` is joint force /
    actuator force, shape (n,); ``ranges`` are at the joints, shape (n, 2) [N m, N].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.sort(ranges / gear[:, None], axis=1)
    free = ~model.actuator_forcelimited[actuators].astype(bool)
    present = np.where(free[:, None], (-np.inf, np.inf), model.actuator_forcerange[actuators])
    # Ends that are equal up to rounding stay unchanged.
    slack = 1 + 1e-12
    narrower = np.column_stack(
        [wanted[:, 0] > present[:, 0] / slack, wanted[:, 1] < present[:, 1] / slack]
    )
    narrowed = np.where(narrower, wanted, present)
    chosen = narrower.any(axis=1) & (gear != 0) & np.isfinite(narrowed).all(axis=1)
    model.actuator_forcelimited[actuators[chosen]] = 1
    model.actuator_forcerange[actuators[chosen]] = narrowed[chosen]


MAX_GAIN = 1e9
"""Largest kp [N m/rad, N/m] and kd [N m s/rad, N s/m] that a user may request; larger gains are
refused. Chosen, not tuned: far above the gains of real machines."""

MIN_STIFFNESS = 1e-9
"""Smallest kp [N m/rad, N/m] of a motor that a user may request, or that a search tries; smaller
requests are refused. Commands contain the quotient torque / kp, which would overflow for much
smaller values. Chosen, not tuned."""


def resolve_servo_gains(
    robot: Robot, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> Gains:
    """Return the servo gains of the joints: requested gains, or the gains of the MJCF's servos.

    Args:
        robot: Robot.
        kp: Stiffness at the joints [N m/rad, N/m], scalar or shape (nu,). Default: from the MJCF.
        kd: Damping at the joints [N m s/rad, N s/m], scalar or shape (nu,). Default: from the MJCF.

    Returns:
        Gains of each joint; 0 for the dependent joints of loops and couplings.

    Raises:
        ConfigurationError: If a gain is not a number, has another shape or is out of range, or a
            requested stiffness is below 1e-9 (`MIN_STIFFNESS`).
        ModelError: If a joint has no actuator; or if an actuator is no position servo, and kp or kd
            is None. Dependent joints need no actuator.
    """
    actuators = robot.mj_convention.actuator_index
    following = np.zeros(robot.nu, dtype=bool)
    if robot.closure is not None:
        following[robot.closure.dependent_joints] = True
    for name, motor in zip(robot.joint_names, (actuators >= 0) | following, strict=True):
        if not motor:
            problem = diagnose("joint-without-actuator", subject=("joint", name))
            raise ModelError(robot.description.mjcf_source, problem)
    if robot.closure is None:
        gain, damped, gear, servo = _read_actuator_gains(robot.mj_model, actuators)
    else:
        gain, damped, gear = np.zeros(robot.nu), np.zeros(robot.nu), np.ones(robot.nu)
        servo = following.copy()
        gain[~following], damped[~following], gear[~following], servo[~following] = (
            _read_actuator_gains(robot.mj_model, actuators[~following])
        )
    if (kp is None or kd is None) and not servo.all():
        index = int(np.flatnonzero(~servo)[0])
        problem = diagnose("actuator-is-no-servo", subject=("joint", robot.joint_names[index]))
        raise ModelError(robot.description.mjcf_source, problem)
    stiffness = gain if kp is None else _check_gain("kp", kp, robot.nu)
    damping = damped if kd is None else _check_gain("kd", kd, robot.nu)
    if kp is not None and (stiffness[~following] < MIN_STIFFNESS).any():
        problem = diagnose("stiffness-too-small", kp=stiffness.min(), least=MIN_STIFFNESS)
        raise ConfigurationError("kp", problem)
    stiffness[following], damping[following] = 0.0, 0.0
    return Gains(stiffness, damping, gear, servo)


def command_ranges(robot: Robot) -> Array:
    """Return the range to which MuJoCo clips each servo command, shape (nu, 2) [rad, m].

    The range is the ``ctrlrange`` divided by the gear. It is infinite if MuJoCo does not clip the
    command, or the joint has no position servo in the MJCF.
    """
    model, actuators = robot.mj_model, robot.mj_convention.actuator_index
    ranges = np.tile((-math.inf, math.inf), (robot.nu, 1))
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL.value:
        return ranges
    driven = np.flatnonzero(actuators >= 0)
    _, _, gear, servo = _read_actuator_gains(model, actuators[driven])
    controls = model.actuator_ctrladr[actuators[driven]]
    cut = servo & model.actuator_ctrllimited[controls].astype(bool)
    stated = model.actuator_ctrlrange[controls[cut]] / gear[cut, None]
    ranges[driven[cut]] = np.sort(stated, axis=1)
    return ranges


def list_position_servos(robot: Robot) -> dict[str, tuple[float, float]]:
    """Return the joints that a position servo of the robot's MuJoCo model drives, with gains.

    Returns:
        {joint: (kp [N m/rad, N/m], kd [N m s/rad, N s/m])}.
    """
    actuators = robot.mj_convention.actuator_index
    driven = np.flatnonzero(actuators >= 0)
    gain, damping, _, servo = _read_actuator_gains(robot.mj_model, actuators[driven])
    return {
        robot.joint_names[joint]: (float(kp), float(kd))
        for joint, kp, kd, holds in zip(driven, gain, damping, servo, strict=True)
        if holds
    }


def find_servos_used(
    robot: Robot, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> ServosUsed:
    """Summarise the servos of a robot for a report: source, smallest and largest gains.

    The gains are ``kp`` and ``kd`` if passed, else the gains of servos that this package added,
    else the gains of the model. If ``kd`` alone is passed, the stiffness of added servos remains in
    use.

    Args:
        robot: Robot.
        kp: Stiffness at the joints [N m/rad, N/m], scalar or shape (nu,); None if not passed.
        kd: Damping at the joints [N m s/rad, N s/m], scalar or shape (nu,); None if not passed.

    Raises:
        ConfigurationError: If a gain is not a number, has another shape or is out of range.
        ModelError: If a joint has no motor; or if a motor is no position servo, and kp or kd is
            None. Dependent joints of loops and couplings need no motor, unless all joints are
            dependent.
    """
    found, made = resolve_servo_gains(robot, kp, kd), robot.description.made_servos
    joints = {servo.joint for servo in made}
    chosen = np.array([name in joints for name in robot.joint_names])
    if kp is not None or kd is not None:
        source, chosen = ServoSource.GIVEN, found.kp > 0
        made = made if kp is None else ()
    else:
        source = ServoSource.ADDED if made else ServoSource.FILE
        passive = [name in robot.description.passive_joints for name in robot.joint_names]
        chosen = chosen if made else (found.kp > 0) & ~np.array(passive)
    if robot.closure is not None and len(robot.closure.dependent_joints) == robot.nu:
        problem = diagnose("joints-held-by-constraints-alone", bonds=robot.closure.constraint_names)
        raise ModelError(robot.description.mjcf_source, problem)
    stiffness, damping = found.kp[chosen], found.kd[chosen]
    units = get_common_units(robot, [robot.joint_names[index] for index in np.flatnonzero(chosen)])
    return ServosUsed(
        source,
        (float(stiffness.min()), float(stiffness.max())),
        (float(damping.min()), float(damping.max())),
        made,
        units.stiffness,
        units.damping,
    )


def _read_actuator_gains(
    model: mujoco.MjModel, actuators: NDArray[np.int64]
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Read the servo gains and gears of actuators, and find the position servos among them.

    Returns gain and damping at the joint [N m/rad, N m s/rad; N/m, N s/m], the gear, and a mask of
    position servos; shape (n,) each. The force of a position servo is zero if the joint is at rest
    at ctrl / gear, for each constant ctrl.
    """
    gear = read_gears(model, actuators)
    gain = model.actuator_gainprm[actuators, 0] * gear**2
    bias = -model.actuator_biasprm[actuators, 1:3] * gear[:, None] ** 2
    affine = model.actuator_biastype[actuators] == mujoco.mjtBias.mjBIAS_AFFINE.value
    plain = affine & (model.actuator_gaintype[actuators] == mujoco.mjtGain.mjGAIN_FIXED.value)
    plain &= (model.actuator_biasprm[actuators, 0] == 0) & (model.actuator_delay[actuators] == 0)
    kinds = model.actuator_dyntype[actuators].tolist()
    plain &= np.array([kind in _CONVERGING_DYNAMICS for kind in kinds], dtype=bool)
    # Tolerances of np.isclose, which would be slow.
    as_stiff = np.abs(gain - bias[:, 0]) <= 1e-8 + 1e-5 * np.abs(bias[:, 0])
    return gain, bias[:, 1], gear, plain & as_stiff & (gain > 0)


def _check_gain(name: str, value: ArrayLike, size: int) -> Array:
    """Convert a requested servo gain to shape (size,); ConfigurationError if it is not valid."""
    given = real_array(name, value)
    try:
        gain: Array = np.broadcast_to(given, (size,)).copy()
    except ValueError as error:
        raise ConfigurationError(name, diagnose("no-numbers", count=size)) from error
    for number in gain.tolist():
        if not 0 <= number <= MAX_GAIN:
            problem = diagnose("gain-not-valid", gain=number, most=MAX_GAIN)
            raise ConfigurationError(name, problem)
    return gain


def _find_option_value(option: str, name: str, known: Mapping[str, Any]) -> int:
    """Convert the name of an option's value to MuJoCo's number; ConfigurationError if unknown."""
    if name not in known:
        problem = diagnose("option-unknown", option=option, name=name, known=tuple(known))
        raise ConfigurationError(option, problem)
    return int(known[name].value)


MIN_TIMESTEP = 5e-5
"""Smallest time step that `with_options` accepts [s]; smaller values are refused. Chosen, not
tuned: the bound limits the computing time."""

MAX_IMPRATIO = 1e5
"""Largest ``impratio`` [1] that a user may request; larger values are refused. Measured: contacts
of Pupper v3 chatter with 1e6."""


def with_options(
    robot: Robot,
    integrator: str | None = None,
    cone: str | None = None,
    impratio: float | None = None,
    timestep: float | None = None,
) -> Robot:
    """Return a robot with other MuJoCo options; ``robot`` itself if all arguments are None.

    The notes of the result report a requested time step, cone or ``impratio``. Simulations of the
    published file use the requested options as well.

    Args:
        robot: Robot.
        integrator: ``Euler``, ``implicitfast``, ``implicit`` or ``RK4``.
        cone: Form of the friction cones: ``elliptic`` or ``pyramidal``.
        impratio: MuJoCo's ratio between frictional and normal impedance of contacts, positive and
            at most 1e5 (`MAX_IMPRATIO`). With a larger ratio, contacts slip more slowly under
            tangential force.
        timestep: Time step [s], between 5e-5 (`MIN_TIMESTEP`) and 0.1.

    Raises:
        ConfigurationError: If a name is unknown, or ``impratio`` or ``timestep`` is out of range.
    """
    requested: dict[str, Any] = {}
    if integrator is not None:
        requested["integrator"] = _find_option_value("integrator", integrator, INTEGRATOR_TYPES)
    if cone is not None:
        requested["cone"] = _find_option_value("cone", cone, CONE_TYPES)
    if impratio is not None:
        if not 0 < impratio <= MAX_IMPRATIO:
            problem = diagnose("impratio-not-valid", value=impratio, largest=MAX_IMPRATIO)
            raise ConfigurationError("impratio", problem)
        requested["impratio"] = float(impratio)
    if timestep is not None:
        least, most = MIN_TIMESTEP, TIMESTEP_RANGE[1]
        if not least <= timestep <= most:
            low, high = Quantity(least, "s"), Quantity(most, "s")
            problem = diagnose("not-between", given=f"{timestep:g} s", low=low, high=high)
            raise ConfigurationError("timestep", problem)
        requested["timestep"] = float(timestep)
    if not requested:
        return robot
    spec, model = robot.description.mjcf.copy(), copy.copy(robot.mj_model)
    for option in (spec.option, model.opt):
        for name, value in requested.items():
            setattr(option, name, value)
    published = robot.published
    if published is not None:
        loaded = published.loaded
        loaded = (
            None if loaded is None else with_options(loaded, integrator, cone, impratio, timestep)
        )
        options = {**dict(published.options), **requested}
        published = replace(published, options=tuple(options.items()), loaded=loaded)
    messages = robot.notes
    if timestep is not None:
        own = Quantity(float(robot.mj_model.opt.timestep), "s")
        note = diagnose("timestep-as-requested", timestep=Quantity(timestep, "s"), own=own)
        messages = (*messages, note)
    if cone is not None or impratio is not None:
        file = ("pyramidal", "elliptic")[int(robot.mj_model.opt.cone)]
        said = diagnose(
            "contacts-as-asked",
            cone=cone or file,
            impratio=float(model.opt.impratio),
            own_cone=file,
            own_impratio=float(robot.mj_model.opt.impratio),
        )
        messages = (*messages, said)
    return replace(
        robot,
        description=replace(robot.description, mjcf=spec),
        mj_model=model,
        notes=messages,
        published=published,
        bare=None,
    )
