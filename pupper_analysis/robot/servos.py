"""The position servos of a robot's MuJoCo model."""

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
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

INTEGRATOR_TYPES = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
"""MuJoCo's integrators, as MJCF names them."""

CONE_TYPES = {
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
}
"""Forms of MuJoCo's friction cones, likewise."""

_HOLDING = (
    mujoco.mjtDyn.mjDYN_NONE.value,
    mujoco.mjtDyn.mjDYN_FILTER.value,
    mujoco.mjtDyn.mjDYN_FILTEREXACT.value,
)
"""Dynamics after which a command that stays is at last what is commanded."""


@dataclass(frozen=True, eq=False)
class Servos:
    """The position servos of a MuJoCo model: tau = clip(kp (ctrl' - q) - kd qvel, +- limit).

    Attributes:
        model: The model, a copy of the robot's.
        kp: (nu,) at the joints (N m/rad); 0 at those that follow others, without a motor.
        kd: (nu,) at the joints (N m s/rad); likewise.
        gear: (nu,) actuator length per joint angle; ctrl' = ctrl / gear.
        integrator: Name of MuJoCo's integrator.
    """

    model: mujoco.MjModel
    kp: Array
    kd: Array
    gear: Array
    integrator: str

    @property
    def implicit(self) -> bool:
        """Whether the servos' damping acts on the velocity at the end of a time step."""
        return self.integrator.startswith("implicit")

    def command(self, robot: Robot, positions: Array, torques: Array | None = None) -> Array:
        """Returns the ctrl (..., model.nu) for joint positions, with a feed-forward torque.

        Servos at tendons and sites are asked for the length that they have there, as a joint's are:
        they exert nothing then. All other motors are commanded 0.

        Args:
            robot: The robot.
            positions: (..., nu) joint positions (rad).
            torques: (..., nu) torques (N m) to be given at these positions; zero if None.
        """
        actuators = robot.mj_convention.actuator_index
        driven, ctrl = actuators >= 0, np.zeros((*positions.shape[:-1], self.model.nu))
        target = (
            positions if torques is None else positions + compute_command_lead(torques, self.kp)
        )
        if _servos_elsewhere(self.model, actuators[driven]).size:
            data = mujoco.MjData(self.model)
            for row in np.ndindex(positions.shape[:-1]):
                data.qpos[robot.mj_convention.qpos_index[-robot.nu :]] = positions[row]
                ctrl[row] = make_neutral_commands(self.model, data.qpos, actuators[driven])
        places = self.model.actuator_ctrladr[actuators[driven]]
        ctrl[..., places] = (self.gear * target)[..., driven]
        return ctrl


def make_neutral_commands(model: mujoco.MjModel, qpos: Array, known: NDArray[np.int64]) -> Array:
    """Returns the ctrl (model.nu,) with which servos at tendons and sites exert nothing.

    Args:
        model: The model.
        qpos: (model.nq,) where it is.
        known: The actuators that are commanded otherwise; theirs is 0.
    """
    others, ctrl = _servos_elsewhere(model, known), np.zeros(model.nu)
    if others.size:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        for step in (
            mujoco.mj_kinematics,
            mujoco.mj_comPos,
            mujoco.mj_tendon,
            mujoco.mj_transmission,
        ):
            step(model, data)
        bias = model.actuator_biasprm[others]
        force = bias[:, 0] + bias[:, 1] * data.actuator_length[others]
        ctrl[model.actuator_ctrladr[others]] = -force / model.actuator_gainprm[others, 0]
    return ctrl


def _servos_elsewhere(model: mujoco.MjModel, known: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the position servos that are none of the known actuators."""
    servo = (
        (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED.value)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE.value)
        & np.isin(model.actuator_dyntype, _HOLDING)
        & (model.actuator_gainprm[:, 0] != 0)
        & (model.actuator_biasprm[:, 1] != 0)
    )
    return np.setdiff1d(np.flatnonzero(servo), known)


def compute_command_lead(torques: Array, kp: Array) -> Array:
    """Returns by how much (..., nu) a command is beyond a pose for torques (..., nu) to be given.

    Nothing where there is no servo, at joints that follow others.
    """
    ahead: Array = np.divide(torques, kp, out=np.zeros_like(torques), where=kp > 0)
    return ahead


def model_with_servos(
    robot: Robot,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Servos:
    """Returns a copy of the robot's MuJoCo model with position servos.

    Args:
        robot: The robot.
        kp: Stiffness at the joints (N m/rad), one or (nu,); the model's own by default.
        kd: Damping at the joints (N m s/rad), one or (nu,); the model's own by default.
        integrator: ``Euler``, ``implicitfast``, ``implicit`` or ``RK4``; the model's by default.

    Raises:
        ConfigurationError: If a gain is not positive (kd: negative), or the integrator is unknown.
        ModelError: If a joint has no motor, or its motor is no position servo and kp, kd are not
            both given.
    """
    model = copy.copy(robot.mj_model)
    wanted = resolve_servo_gains(robot, kp, kd)
    driven = robot.mj_convention.actuator_index >= 0
    actuators = robot.mj_convention.actuator_index[driven]
    if kp is not None or kd is not None:
        write_position_servos(model, actuators, wanted.kp[driven], wanted.kd[driven])
        model.actuator_ctrllimited[model.actuator_ctrladr[actuators[~wanted.servo[driven]]]] = 0
    _limit(model, actuators, wanted.gear[driven], robot.effort_ranges[driven])
    if integrator is not None:
        model.opt.integrator = _value_of("integrator", integrator, INTEGRATOR_TYPES)
    used = next(
        (name for name, kind in INTEGRATOR_TYPES.items() if kind.value == model.opt.integrator),
        mujoco.mjtIntegrator(int(model.opt.integrator)).name,
    )
    return Servos(model, wanted.kp, wanted.kd, wanted.gear, used)


def write_position_servos(
    model: mujoco.MjModel, actuators: NDArray[np.int64], kp: ArrayLike, kd: ArrayLike
) -> None:
    """Make actuators position servos, in place; gears, ranges and filters' states are kept.

    Args:
        model: MuJoCo model.
        actuators: Actuator ids, each at one joint, shape (n,).
        kp: Stiffness at the joints, one or shape (n,) [N m/rad].
        kd: Damping at the joints, one or shape (n,) [N m s/rad].
    """
    squared = model.actuator_gear[actuators, 0] ** 2
    model.actuator_gaintype[actuators] = mujoco.mjtGain.mjGAIN_FIXED.value
    model.actuator_biastype[actuators] = mujoco.mjtBias.mjBIAS_AFFINE.value
    model.actuator_dyntype[actuators] = mujoco.mjtDyn.mjDYN_NONE.value
    model.actuator_gainprm[actuators, 0] = np.asarray(kp) / squared
    model.actuator_biasprm[actuators, 0] = 0.0
    model.actuator_biasprm[actuators, 1] = -np.asarray(kp) / squared
    model.actuator_biasprm[actuators, 2] = -np.asarray(kd) / squared


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of a robot's motors, checked, and what they are used with.

    Joints that follow others have gains of 0, and need no motor.

    Attributes:
        kp: (nu,) at the joints (N m/rad).
        kd: (nu,) at the joints (N m s/rad).
        gear: (nu,) actuator length per joint angle.
        servo: (nu,) whether the motor is a servo in the robot's model.
    """

    kp: Array
    kd: Array
    gear: Array
    servo: NDArray[np.bool_]


def _limit(model: mujoco.MjModel, actuators: NDArray[np.int64], gear: Array, ranges: Array) -> None:
    """Writes what motors can give (n, 2), at their joints, into a model as their force ranges.

    A URDF's effort, and the command of a motor that is driven as a servo, bound no force there. A
    range that MuJoCo has bounded already is written only where it is wider.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.sort(ranges / gear[:, None], axis=1)
    free = ~model.actuator_forcelimited[actuators].astype(bool)
    now = np.where(free[:, None], (-np.inf, np.inf), model.actuator_forcerange[actuators])
    # To rounding: what is stated there already stays to the last digit.
    slack = 1 + 1e-12
    narrower = (wanted[:, 0] > now[:, 0] / slack) | (wanted[:, 1] < now[:, 1] / slack)
    chosen = narrower & (gear != 0) & np.isfinite(wanted).all(axis=1)
    model.actuator_forcelimited[actuators[chosen]] = 1
    model.actuator_forcerange[actuators[chosen]] = wanted[chosen]


MAX_GAIN = 1e9
"""N m/rad (kd: N m s/rad): more than any machine's; what overflows is far beyond."""

MIN_STIFFNESS = 1e-9
"""N m/rad: commands are the torque divided by kp, and overflow far below."""


def resolve_servo_gains(
    robot: Robot, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> Gains:
    """Returns what ``model_with_servos`` works out, without a model that has it.

    Raises:
        ConfigurationError: As ``model_with_servos``.
        ModelError: Likewise.
    """
    actuators = robot.mj_convention.actuator_index
    following = np.zeros(robot.nu, dtype=bool)
    if robot.closure is not None:
        following[robot.closure.following] = True
    for name, motor in zip(robot.joint_names, (actuators >= 0) | following, strict=True):
        if not motor:
            problem = diagnose("joint-without-actuator", subject=("joint", name))
            raise ModelError(robot.description.mjcf_source, problem)
    if robot.closure is None:
        gain, damped, gear, servo = _of_model(robot.mj_model, actuators)
    else:
        gain, damped, gear = np.zeros(robot.nu), np.zeros(robot.nu), np.ones(robot.nu)
        servo = following.copy()
        gain[~following], damped[~following], gear[~following], servo[~following] = _of_model(
            robot.mj_model, actuators[~following]
        )
    if (kp is None or kd is None) and not servo.all():
        index = int(np.flatnonzero(~servo)[0])
        problem = diagnose("actuator-is-no-servo", subject=("joint", robot.joint_names[index]))
        raise ModelError(robot.description.mjcf_source, problem)
    stiffness = gain if kp is None else _gain("kp", kp, robot.nu)
    damping = damped if kd is None else _gain("kd", kd, robot.nu)
    if kp is not None and (stiffness[~following] < MIN_STIFFNESS).any():
        problem = diagnose("stiffness-too-small", kp=stiffness.min(), least=MIN_STIFFNESS)
        raise ConfigurationError("kp", problem)
    stiffness[following], damping[following] = 0.0, 0.0
    return Gains(stiffness, damping, gear, servo)


def command_ranges(robot: Robot) -> Array:
    """Returns between which joint positions (nu, 2) servos can be commanded (rad, m).

    MuJoCo cuts the command of a servo off at its ``ctrlrange``. A motor that is driven as a servo
    has none, nor has a joint without a motor: infinite.
    """
    model, actuators = robot.mj_model, robot.mj_convention.actuator_index
    ranges = np.tile((-math.inf, math.inf), (robot.nu, 1))
    driven = np.flatnonzero(actuators >= 0)
    _, _, gear, servo = _of_model(model, actuators[driven])
    controls = model.actuator_ctrladr[actuators[driven]]
    cut = servo & model.actuator_ctrllimited[controls].astype(bool)
    stated = model.actuator_ctrlrange[controls[cut]] / gear[cut, None]
    ranges[driven[cut]] = np.sort(stated, axis=1)
    return ranges


def list_position_servos(robot: Robot) -> dict[str, tuple[float, float]]:
    """Returns the joints whose motor is a position servo in the robot's model.

    Returns:
        {joint: its kp (N m/rad) and kd (N m s/rad)}.
    """
    actuators = robot.mj_convention.actuator_index
    driven = np.flatnonzero(actuators >= 0)
    gain, damping, _, servo = _of_model(robot.mj_model, actuators[driven])
    return {
        robot.joint_names[joint]: (float(kp), float(kd))
        for joint, kp, kd, holds in zip(driven, gain, damping, servo, strict=True)
        if holds
    }


def find_servos_used(
    robot: Robot, kp: ArrayLike | None = None, kd: ArrayLike | None = None
) -> ServosUsed:
    """Tells where the gains of a robot's servos are from.

    Args:
        robot: The robot.
        kp: As for ``model_with_servos``.
        kd: As for ``model_with_servos``.

    Raises:
        ConfigurationError: As ``model_with_servos``.
        ModelError: Likewise.
    """
    found, made = resolve_servo_gains(robot, kp, kd), robot.description.made_servos
    joints = {servo.joint for servo in made}
    chosen = np.array([name in joints for name in robot.joint_names])
    if kp is not None or kd is not None:
        source, made, chosen = ServoSource.GIVEN, (), found.kp > 0
    else:
        source = ServoSource.ADDED if made else ServoSource.FILE
        chosen = chosen if made else found.kp > 0
    stiffness, damping = found.kp[chosen], found.kd[chosen]
    return ServosUsed(
        source,
        (float(stiffness.min()), float(stiffness.max())),
        (float(damping.min()), float(damping.max())),
        made,
    )


def _of_model(
    model: mujoco.MjModel, actuators: NDArray[np.int64]
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Returns gain, damping and gear (n,) of actuators, and which of them are position servos.

    One with a force of its own, or whose command is integrated or delayed, is none: its ctrl is not
    where it holds a joint.
    """
    gear = model.actuator_gear[actuators, 0].copy()
    gain = model.actuator_gainprm[actuators, 0] * gear**2
    bias = -model.actuator_biasprm[actuators, 1:3] * gear[:, None] ** 2
    affine = model.actuator_biastype[actuators] == mujoco.mjtBias.mjBIAS_AFFINE.value
    plain = affine & (model.actuator_gaintype[actuators] == mujoco.mjtGain.mjGAIN_FIXED.value)
    plain &= (model.actuator_biasprm[actuators, 0] == 0) & (model.actuator_delay[actuators] == 0)
    kinds = model.actuator_dyntype[actuators].tolist()
    plain &= np.array([kind in _HOLDING for kind in kinds], dtype=bool)
    # The bounds of np.isclose, which takes as long as all else here.
    as_stiff = np.abs(gain - bias[:, 0]) <= 1e-8 + 1e-5 * np.abs(bias[:, 0])
    return gain, bias[:, 1], gear, plain & as_stiff & (gain > 0)


def _gain(name: str, value: ArrayLike, size: int) -> Array:
    given = real_array(name, value)
    try:
        gain: Array = np.broadcast_to(given, (size,)).copy()
    except ValueError as error:
        raise ConfigurationError(name, diagnose("no-numbers", count=size)) from error
    for one in gain.tolist():
        if not 0 <= one <= MAX_GAIN:
            raise ConfigurationError(name, diagnose("gain-not-valid", gain=one, most=MAX_GAIN))
    return gain


def _value_of(option: str, name: str, known: Mapping[str, Any]) -> int:
    """Returns MuJoCo's number of a name."""
    if name not in known:
        problem = diagnose("option-unknown", option=option, name=name, known=tuple(known))
        raise ConfigurationError(option, problem)
    return int(known[name].value)


def with_options(
    robot: Robot,
    integrator: str | None = None,
    cone: str | None = None,
    impratio: float | None = None,
) -> Robot:
    """Returns the robot with other options of MuJoCo's, said in its notes; as it is without any.

    Its file is then simulated with these, too: it is they that are asked about.

    Args:
        robot: The robot.
        integrator: ``Euler``, ``implicitfast``, ``implicit`` or ``RK4``.
        cone: ``elliptic`` or ``pyramidal``: the friction cones' form.
        impratio: How much stiffer friction is than the ground; more of it creeps less.

    Raises:
        ConfigurationError: If one is unknown, or no positive number.
    """
    asked: dict[str, Any] = {}
    if integrator is not None:
        asked["integrator"] = _value_of("integrator", integrator, INTEGRATOR_TYPES)
    if cone is not None:
        asked["cone"] = _value_of("cone", cone, CONE_TYPES)
    if impratio is not None:
        if not 0 < impratio < math.inf:
            raise ConfigurationError("impratio", diagnose("impratio-not-valid", value=impratio))
        asked["impratio"] = float(impratio)
    if not asked:
        return robot
    spec, model = robot.description.mjcf.copy(), copy.copy(robot.mj_model)
    for option in (spec.option, model.opt):
        for name, value in asked.items():
            setattr(option, name, value)
    published = robot.published
    if published is not None:
        loaded = published.loaded
        loaded = None if loaded is None else with_options(loaded, integrator, cone, impratio)
        options = {**dict(published.options), **asked}
        published = replace(published, options=tuple(options.items()), loaded=loaded)
    messages = robot.notes
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
