"""Does it hold: MuJoCo's floating-base simulation of a stand, against what Pinocchio predicts."""

from __future__ import annotations

import copy
import math
import os
import time
from collections.abc import Container, Sequence
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis import contact
from pupper_analysis.convention import rotation_from_quaternion
from pupper_analysis.errors import ConfigurationError, ModelError
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot, on_ground
from pupper_analysis.stand import Stand, stand_statics
from pupper_analysis.statics import GravityCompensation, LoadSharing

Array = NDArray[np.float64]

STABLE_DEVIATION = 5e-3
"""A stand is stable if the base's height deviates by less than this in the last second (m)."""

JOINT_TOLERANCE = 1e-3
"""Joint error that a verified stand may have with feed-forward (rad)."""

FORCE_TOLERANCE = 1e-2
"""Relative error that a verified stand's torques and foot forces may have with feed-forward."""

LIGHT = 0.05
"""Share of the weight below which a foot's force is not what its error is measured by."""

SETTLED_DRIFT = 5e-4
"""A base whose height changes faster than this in the last second has not settled (m/s)."""

FALLEN_TILT = 0.5
"""A base that is tilted by more than this against its task has fallen over (rad)."""

KP_GRID = (10.0, 30.0, 60.0, 120.0)
KD_GRID = (0.5, 1.0, 2.0, 5.0)

SOFT = 1e-4
"""Ground into which feet sink deeper than their stand has them by this is soft (m)."""

INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
"""MuJoCo's integrators, as MJCF names them."""

STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
"""What rollouts return: time, qpos, qvel ..."""

_SAMPLE = 0.02  # s between the states that are looked at closely


# ------------------------------------------------------------------------------------- servos


@dataclass(frozen=True, eq=False)
class Servos:
    """The position servos of a MuJoCo model: tau = clip(kp (ctrl' - q) - kd qvel, +- limit).

    Attributes:
        model: The model, a copy of the robot's.
        kp: (nu,) at the joints (N m/rad).
        kd: (nu,) at the joints (N m s/rad).
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
        """Returns the ctrl (model.nu,) that asks for joint positions, with a feed-forward torque.

        Args:
            robot: The robot.
            positions: (nu,) joint positions (rad).
            torques: (nu,) torques (N m) to be given at these positions; zero if None.
        """
        target = positions if torques is None else positions + torques / self.kp
        ctrl = np.zeros(self.model.nu)
        ctrl[robot.mj_convention.actuator_index] = self.gear * target
        return ctrl


def servos(
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
    actuators = robot.mj_convention.actuator_index
    for name, actuator in zip(robot.joint_names, actuators, strict=True):
        if actuator < 0:
            raise ModelError(robot.description.mjcf_source, f"joint {name!r} has no actuator")
    gear = model.actuator_gear[actuators, 0].copy()
    gain = model.actuator_gainprm[actuators, 0] * gear**2
    bias = -model.actuator_biasprm[actuators, 1:3] * gear[:, None] ** 2
    affine = model.actuator_biastype[actuators] == mujoco.mjtBias.mjBIAS_AFFINE.value
    servo = affine & np.isclose(gain, bias[:, 0]) & (gain > 0)
    if (kp is None or kd is None) and not servo.all():
        index = int(np.flatnonzero(~servo)[0])
        raise ModelError(
            robot.description.mjcf_source,
            f"the actuator of joint {robot.joint_names[index]!r} is no position servo; "
            "give kp and kd to drive it as one",
        )
    stiffness = gain if kp is None else _gain("kp", kp, robot.nu)
    damping = bias[:, 1] if kd is None else _gain("kd", kd, robot.nu)
    if kp is not None and (stiffness <= 0).any():
        raise ConfigurationError("kp", f"{stiffness.min()} N m/rad is not positive")
    if kp is not None or kd is not None:
        model.actuator_gaintype[actuators] = mujoco.mjtGain.mjGAIN_FIXED.value
        model.actuator_biastype[actuators] = mujoco.mjtBias.mjBIAS_AFFINE.value
        model.actuator_dyntype[actuators] = mujoco.mjtDyn.mjDYN_NONE.value
        model.actuator_gainprm[actuators, 0] = stiffness / gear**2
        model.actuator_biasprm[actuators, 0] = 0.0
        model.actuator_biasprm[actuators, 1] = -stiffness / gear**2
        model.actuator_biasprm[actuators, 2] = -damping / gear**2
        model.actuator_ctrllimited[actuators[~servo]] = 0
    if integrator is not None:
        if integrator not in INTEGRATORS:
            raise ConfigurationError(
                "integrator", f"{integrator!r} is unknown; there are: {', '.join(INTEGRATORS)}"
            )
        model.opt.integrator = INTEGRATORS[integrator].value
    used = next(
        (name for name, kind in INTEGRATORS.items() if kind.value == model.opt.integrator),
        mujoco.mjtIntegrator(int(model.opt.integrator)).name,
    )
    return Servos(model, stiffness, damping, gear, used)


def _gain(name: str, value: ArrayLike, size: int) -> Array:
    try:
        gain: Array = np.broadcast_to(np.asarray(value, dtype=float), (size,)).copy()
    except (TypeError, ValueError) as error:
        raise ConfigurationError(name, f"not a number, nor {size} of them") from error
    if not np.isfinite(gain).all() or (gain < 0).any():
        raise ConfigurationError(name, f"{value!r} is not finite and >= 0")
    return gain


# ------------------------------------------------------------------------------------- rollouts


def place_on_ground(robot: Robot, drive: Servos, stand: Stand, torques: Array) -> Array:
    """Returns MuJoCo's state at a stand, let down until the contacts carry the weight.

    The ground is soft: feet that just touch it carry nothing. The base is lowered into it, with the
    joints as they are, to where MuJoCo finds no acceleration of the base in the direction of the
    ground's normal; so the simulation starts at rest instead of with a fall of some millimetres.

    Args:
        robot: The robot.
        drive: The robot's MuJoCo model, with servos.
        stand: The stand.
        torques: (nu,) motor torques that balance it (N m).

    Returns:
        The state (mjSTATE_FULLPHYSICS).
    """
    model = drive.model
    data = mujoco.MjData(model)
    data.ctrl[:] = drive.command(robot, stand.joint_positions(robot), torques)
    normal = stand.task.ground.normal()

    def acceleration(drop: float) -> float:
        qpos = stand.qpos.copy()
        qpos[:3] -= drop * normal
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(model, data)
        return float(normal @ data.qacc[robot.mj_convention.qvel_index[:3]])

    low, high = 0.0, min(robot.foot_radius.values())
    if acceleration(high) > 0:
        while high - low > 1e-12:
            middle = (low + high) / 2
            low, high = (middle, high) if acceleration(middle) < 0 else (low, middle)
    acceleration(high)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def _heights(robot: Robot, states: Array) -> Array:
    """Returns the base's height in every state of a rollout."""
    heights: Array = states[..., 1 + robot.mj_convention.qpos_index[2]]
    return heights


def _tilt(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns the angle of the base's rotation against the given one (rad)."""
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return float(np.linalg.norm(pin.log3(rotation.T @ rotation_from_quaternion(quaternion))))


def lean(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns how far the base of a state leans off a rotation's vertical (rad); yaw is no lean."""
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    cosine = float(rotation_from_quaternion(quaternion)[2] @ rotation[2])
    return math.acos(min(1.0, max(-1.0, cosine)))


def diverged(states: Array, timestep: float) -> bool:
    """Tells whether a rollout broke down: MuJoCo resets the state, and so the time, if it does."""
    times = states[..., 0]
    return not bool(np.isfinite(states).all() and (np.diff(times) > timestep / 2).all())


# ------------------------------------------------------------------------------------- verification


@dataclass(frozen=True, eq=False)
class StandVerification(Result):
    """What a simulation made of a stand, against the prediction.

    Settled values are means over the last second. Predictions are Pinocchio's, from the URDF.

    Attributes:
        passed: Whether the stand is verified.
        failures: If not, why.
        feedforward: Whether ctrl = q* + tau / kp (otherwise ctrl = q*).
        integrator: MuJoCo's integrator.
        timestep: s.
        duration: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
        base_height: Settled (m).
        height_deviation: Standard deviation of the base's height in the last second (m).
        height_drift: Rate of the base's height in the last second (m/s): still sinking if negative.
        height_loss: Task's height less the settled one (m); the sum of the next two.
        servo_sag: The part lost in the joints (m).
        contact_sag: The part lost in the softness of feet and ground (m).
        tilt: Angle of the base's settled orientation against the task's (rad).
        foot_slip: {foot: horizontal distance from its target} at the end (m).
        joint_error: The largest deviation of a joint from the stand in the last second (rad).
        joint_torques: (nu,) of the motors, settled (N m).
        predicted_torques: (nu,) (N m).
        torque_error: Largest deviation / largest predicted torque.
        foot_forces: {foot: (3,)} of the ground on the foot, settled, in world axes (N).
        predicted_forces: {foot: (3,)} (N).
        force_error: Largest deviation of a vertical foot force / its prediction (or / ``LIGHT`` of
            the weight, where a foot is predicted to carry less than that).
        mujoco_foot_error: Largest distance of a foot from its target at ``stand.qpos`` by MuJoCo's
            kinematics of the MJCF (m).
        mujoco_residual: Largest element of g - J^T f - S^T tau with MuJoCo's g and J and the
            predicted f and tau (N, N m).
        time: (n,) samples (s).
        height: (n,) the base's height at these (m).
    """

    passed: bool
    failures: tuple[str, ...]
    feedforward: bool
    integrator: str
    timestep: float
    duration: float
    kp: Array
    kd: Array
    base_height: float
    height_deviation: float
    height_drift: float
    height_loss: float
    servo_sag: float
    contact_sag: float
    tilt: float
    foot_slip: dict[str, float]
    joint_error: float
    joint_torques: Array
    predicted_torques: Array
    torque_error: float
    foot_forces: dict[str, Array]
    predicted_forces: dict[str, Array]
    force_error: float
    mujoco_foot_error: float
    mujoco_residual: float
    time: Array
    height: Array


def verify_stand(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
    duration: float = 5.0,
) -> StandVerification:
    """Simulates a stand on the floating base, and compares it with Pinocchio's prediction.

    The prediction is ``gravity_compensation`` with even load sharing: the equilibrium that lasts in
    a simulator whose friction creeps. MuJoCo's ground is soft: where the feet bear unequal loads a
    stand for rigid ground tilts by milliradians, and the loads change by percents; ``sunk_stand``
    is the stand that does hold as predicted.

    Args:
        robot: The robot.
        stand: How it shall stand.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.
        duration: Simulated time (s), at least 2.

    Returns:
        The comparison; ``failures`` says why a stand is not verified.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    check_stand(robot, stand, duration)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    prediction = stand_statics(robot, stand, sharing=LoadSharing.EVEN)
    drive = servos(robot, kp, kd, integrator)
    positions = stand.joint_positions(robot)
    torques = prediction.joint_torques if feedforward else None
    ctrl = drive.command(robot, positions, torques)
    start = place_on_ground(robot, drive, stand, prediction.joint_torques)
    timestep = float(drive.model.opt.timestep)
    states, _ = mujoco.rollout.rollout(
        drive.model,
        mujoco.MjData(drive.model),
        start,
        np.tile(ctrl, (1, max(2, round(duration / timestep)), 1)),
    )
    states = states[0]
    last_second = round(1.0 / timestep)
    settled = states[-last_second:]
    heights = _heights(robot, states)

    light = LIGHT * sum(force[2] for force in prediction.contact_forces.values())
    loaded = {
        foot
        for foot, force in prediction.contact_forces.items()
        if force[2] >= FORCE_TOLERANCE * light
    }
    watch = _watch(robot, drive.model, stand, states, ctrl, last_second, loaded)
    drops = {foot: stand.foot_targets[foot] - watch.feet_settled[foot] for foot in stand.carrying}
    base_height = float(_heights(robot, settled).mean())
    height_loss = float(stand.qpos[2]) - base_height
    contact_sag = drop_at(
        stand.qpos[:2],
        np.array([stand.foot_targets[foot] for foot in drops]),
        np.array([drop[2] for drop in drops.values()]),
    )
    joints = settled[:, 1 + robot.mj_convention.qpos_index[7:]]
    joint_error = float(np.abs(joints - positions).max())
    largest = np.abs(prediction.joint_torques).max()
    torque_error = float(np.abs(watch.torques - prediction.joint_torques).max() / largest)
    force_error = max(
        abs(watch.forces[foot][2] - force[2]) / max(force[2], light)
        for foot, force in prediction.contact_forces.items()
    )
    tilt = _tilt(robot, stand.task.rotation(), states[-1])
    leaning = lean(robot, stand.task.rotation(), states[-1])
    deviation = float(_heights(robot, settled).std())
    drift = float(heights[-1] - heights[-last_second]) / (timestep * (last_second - 1))

    failures = list(watch.failures)
    if diverged(states, timestep):
        failures.insert(0, f"the simulation diverged ({drive.integrator}, {1e3 * timestep:g} ms)")
    if leaning > FALLEN_TILT or base_height < 0.5 * stand.qpos[2]:
        failures.insert(
            0, f"it fell over: tilt {math.degrees(leaning):.0f} deg, height {base_height:.3f} m"
        )
    if not deviation < STABLE_DEVIATION:
        failures.append(f"the height deviates by {1e3 * deviation:.2f} mm in the last second")
    if not abs(drift) < SETTLED_DRIFT:
        failures.append(f"it has not settled: the height changes by {1e3 * drift:+.2f} mm/s")
    if feedforward:
        off = []
        if not joint_error < JOINT_TOLERANCE:
            off.append(f"a joint is off by {joint_error:.1e} rad")
        if not torque_error < FORCE_TOLERANCE:
            off.append(f"a motor torque is off by {torque_error:.1%} of the largest")
        if not force_error < FORCE_TOLERANCE:
            off.append(f"a vertical foot force is off by {force_error:.1%}")
        deepest = max(float(drop @ stand.normals[foot]) for foot, drop in drops.items())
        if off and not failures and deepest > SOFT:
            off.append(f"the feet sink by up to {1e3 * deepest:.1f} mm: sunk_stand allows for that")
        failures += off
    step = max(1, round(_SAMPLE / timestep))
    foot_error, residual = _mujoco_opinion(robot, stand, prediction)
    return StandVerification(
        passed=not failures,
        failures=tuple(failures),
        feedforward=feedforward,
        integrator=drive.integrator,
        timestep=timestep,
        duration=len(states) * timestep,
        kp=drive.kp,
        kd=drive.kd,
        base_height=base_height,
        height_deviation=deviation,
        height_drift=drift,
        height_loss=height_loss,
        servo_sag=height_loss - contact_sag,
        contact_sag=contact_sag,
        tilt=tilt,
        foot_slip={foot: float(np.linalg.norm(drop[:2])) for foot, drop in drops.items()},
        joint_error=joint_error,
        joint_torques=watch.torques,
        predicted_torques=prediction.joint_torques,
        torque_error=torque_error,
        foot_forces=watch.forces,
        predicted_forces=prediction.contact_forces,
        force_error=float(force_error),
        mujoco_foot_error=foot_error,
        mujoco_residual=residual,
        time=states[::step, 0].copy(),
        height=heights[::step].copy(),
    )


def check_stand(robot: Robot, stand: Stand, duration: float) -> None:
    """Checks what a simulation of a stand is given.

    Raises:
        ConfigurationError: If the base is fixed, the stand is another robot's, or the duration (s)
            is not between 2 and 600.
    """
    if not robot.floating:
        raise ConfigurationError("robot", f"{robot.name} has a fixed base and cannot stand")
    stand.check(robot)
    if not math.isfinite(duration) or not 2.0 <= duration <= 600.0:
        raise ConfigurationError("duration", f"{duration} s is not between 2 and 600 s")


@dataclass(frozen=True, eq=False)
class _Watch:
    """What a close look at some states of a rollout shows."""

    failures: tuple[str, ...]
    torques: Array
    forces: dict[str, Array]
    feet_settled: dict[str, Array]


def _watch(
    robot: Robot,
    model: mujoco.MjModel,
    stand: Stand,
    states: Array,
    ctrl: Array,
    last_second: int,
    loaded: Container[str],
) -> _Watch:
    """Looks at contacts all along, and at torques and forces in the last second.

    The feet in ``loaded`` must not let go; others are hardly predicted to touch.
    """
    data = mujoco.MjData(model)
    step = max(1, round(_SAMPLE / model.opt.timestep))
    touched: dict[str, float] = {}
    lost: dict[str, float] = {}
    torques = np.zeros(robot.nu)
    total = {foot: np.zeros(3) for foot in robot.feet}
    feet = {foot: np.zeros(3) for foot in robot.feet}
    count = 0
    for index in range(len(states) - 1, -1, -step):  # backwards: the first moment stays
        mujoco.mj_setState(model, data, states[index], STATE)
        data.ctrl[:] = ctrl
        mujoco.mj_forward(model, data)
        forces, others = contact.ground_forces(model, data, robot.soles)
        touched |= dict.fromkeys(others, float(data.time))
        touched |= {foot: float(data.time) for foot in forces if foot not in stand.carrying}
        idle = [foot for foot in stand.carrying if foot not in forces or forces[foot][2] <= 0]
        lost |= {foot: float(data.time) for foot in idle if foot in loaded}
        if index >= len(states) - last_second:
            count += 1
            torques += data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
            for foot, (body, position) in robot.foot_places.items():
                total[foot] += forces.get(foot, np.zeros(3))
                feet[foot] += data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
    failures = [
        f"{body} touches the ground at {moment:.2f} s" for body, moment in sorted(touched.items())
    ]
    failures += [
        f"foot {foot} carries nothing at {moment:.2f} s" for foot, moment in sorted(lost.items())
    ]
    return _Watch(
        failures=tuple(failures),
        torques=torques / count,
        forces={foot: force / count for foot, force in total.items()},
        feet_settled={foot: position / count for foot, position in feet.items()},
    )


def drop_at(place: Array, feet: Array, drops: Array) -> float:
    """Returns how much a plane through the feet has sunk at a place.

    Args:
        place: (2,) where (m).
        feet: (n, 3) the feet (m); their heights do not matter.
        drops: (n,) how much each has sunk (m).
    """
    plane = np.linalg.lstsq(np.column_stack([np.ones(len(feet)), feet[:, :2]]), drops)[0]
    return float(plane @ (1.0, place[0], place[1]))


def _mujoco_opinion(
    robot: Robot, stand: Stand, prediction: GravityCompensation
) -> tuple[float, float]:
    """Checks stand and statics with MuJoCo's kinematics and dynamics of the MJCF."""
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    remainder = np.array(data.qfrc_bias)
    remainder[robot.mj_convention.qvel_index[6:]] -= prediction.joint_torques
    foot_error = 0.0
    jacobian = np.zeros((3, model.nv))
    for foot, (body, position) in robot.foot_places.items():
        centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        foot_error = max(foot_error, float(np.linalg.norm(centre - stand.foot_targets[foot])))
        if foot in stand.carrying:
            reach = robot.foot_radius[foot] - stand.depths[foot] / 2
            point = centre - reach * stand.normals[foot]
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            remainder -= jacobian.T @ prediction.contact_forces[foot]
    return foot_error, float(np.abs(remainder).max())


# ------------------------------------------------------------------------------------- gain sweep


@dataclass(frozen=True, eq=False)
class GainSweep(Result):
    """How steady a stand is under a vertical disturbance, for a grid of servo gains.

    Attributes:
        kp: (n,) N m/rad.
        kd: (m,) N m s/rad.
        height_deviation: (n, m) standard deviation of the base's height in the last second (m);
            infinite where the robot fell or the simulation diverged.
        fell: (n, m) whether it did.
        best_kp: Of the cell with the least deviation; None if the robot fell in all.
        best_kd: Likewise.
        best_deviation: Likewise (m).
        amplitude: Of the disturbance on the base (N).
        frequency: Of the disturbance (Hz).
        duration: s.
        integrator: MuJoCo's integrator.
    """

    kp: Array
    kd: Array
    height_deviation: Array
    fell: NDArray[np.bool_]
    best_kp: float | None
    best_kd: float | None
    best_deviation: float | None
    amplitude: float
    frequency: float
    duration: float
    integrator: str


def sweep_gains(
    robot: Robot,
    stand: Stand,
    *,
    kp: Sequence[float] = KP_GRID,
    kd: Sequence[float] = KD_GRID,
    amplitude: float = 2.0,
    frequency: float = 1.2,
    duration: float = 4.0,
    integrator: str = "implicitfast",
    progress: bool = False,
) -> GainSweep:
    """Simulates a stand under a vertical force on its base, for each kp and kd.

    The servos are commanded the stand's joint positions, without feed-forward; the force is
    amplitude sin(2 pi frequency t), from the first step. All cells run in parallel, on all cores.
    The default integrator takes kd implicitly: with Euler, high kd jitters.

    Args:
        robot: The robot.
        stand: How it stands.
        kp: Stiffnesses (N m/rad).
        kd: Dampings (N m s/rad).
        amplitude: N.
        frequency: Hz.
        duration: Simulated time (s), at least 2.
        integrator: MuJoCo's integrator.
        progress: Show a progress bar if it takes longer than a second.

    Returns:
        The grid of last-second height deviations.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
    """
    check_stand(robot, stand, duration)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    if not (math.isfinite(amplitude) and math.isfinite(frequency)):
        raise ConfigurationError("amplitude, frequency", "they must be finite")
    if not len(kp) or not len(kd):
        raise ConfigurationError("kp, kd", "give at least one value of each")
    cells = [(stiffness, damping) for stiffness in kp for damping in kd]
    drives = [servos(robot, *cell, integrator) for cell in cells]
    timestep = float(robot.mj_model.opt.timestep)
    steps = round(duration / timestep)
    model = drives[0].model
    base = model.body(robot.mj_base).id
    ctrl = drives[0].command(robot, stand.joint_positions(robot))
    control = np.zeros((1, steps, model.nu + 6 * model.nbody))
    control[0, :, : model.nu] = ctrl
    force = amplitude * np.sin(2 * math.pi * frequency * timestep * np.arange(steps))
    control[0, :, model.nu + 6 * base + 2] = force
    balance = stand_statics(robot, stand, sharing=LoadSharing.EVEN)
    starts = np.array(
        [place_on_ground(robot, drive, stand, balance.joint_torques) for drive in drives]
    )
    states = _rollout_in_chunks([drive.model for drive in drives], starts, control, progress)

    deviations = _heights(robot, states)[:, -round(1.0 / timestep) :].std(axis=1)
    for index, (drive, rows) in enumerate(zip(drives, states, strict=True)):
        if diverged(rows, timestep) or _lies(robot, drive.model, stand, rows[-1], ctrl):
            deviations[index] = np.inf
    grid = deviations.reshape(len(kp), len(kd))
    row, column = divmod(int(np.argmin(grid)), len(kd))
    stands = bool(np.isfinite(grid).any())
    return GainSweep(
        kp=np.array(kp, dtype=float),
        kd=np.array(kd, dtype=float),
        height_deviation=grid,
        fell=~np.isfinite(grid),
        best_kp=float(kp[row]) if stands else None,
        best_kd=float(kd[column]) if stands else None,
        best_deviation=float(grid[row, column]) if stands else None,
        amplitude=amplitude,
        frequency=frequency,
        duration=steps * timestep,
        integrator=drives[0].integrator,
    )


def _lies(robot: Robot, model: mujoco.MjModel, stand: Stand, state: Array, ctrl: Array) -> bool:
    """Tells whether a robot has fallen over, or rests on something else than its feet."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, STATE)
    data.ctrl[:] = ctrl
    mujoco.mj_forward(model, data)
    _, others = contact.ground_forces(model, data, robot.soles)
    return bool(others) or lean(robot, stand.task.rotation(), state) > FALLEN_TILT


def _rollout_in_chunks(
    models: list[mujoco.MjModel], starts: Array, control: Array, progress: bool
) -> Array:
    """Runs one rollout per model, on all cores; a bar appears after the first second."""
    from rich.progress import Progress

    workers = min(len(models), os.cpu_count() or 1)
    datas = [mujoco.MjData(models[0]) for _ in range(workers)]
    spec = int(mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value)
    chunk = 2 * workers
    states = []
    began = time.monotonic()
    with (
        mujoco.rollout.Rollout(nthread=workers) as pool,
        Progress(transient=True, disable=not progress, auto_refresh=False) as bar,
    ):
        task = bar.add_task("gain sweep", total=len(models), visible=False)
        for first in range(0, len(models), chunk):
            batch = models[first : first + chunk]
            rows, _ = pool.rollout(
                batch, datas, starts[first : first + chunk], control, control_spec=spec
            )
            states.append(rows)
            bar.update(task, advance=len(batch), visible=time.monotonic() - began > 1.0)
            bar.refresh()
    return np.concatenate(states)
