"""Prepare and run MuJoCo rollouts of stands; ``monitor`` evaluates the states.

`make_stand_start` computes the initial state and the servo commands of a stand: a robot on feet is
lowered into the soft ground until the contacts carry the weight. `roll_out` and `simulate_commands`
run MuJoCo from a state and return the states after each step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import build_on_ground, close_welds
from pupper_analysis.stance.stand import Stand, stand_contacts, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

_MIN_DROP, _MAX_DROP = 1e-6, 0.065536
"""First and largest distance [m] by which ``place_on_ground`` lowers the base, until the contacts
carry the weight. The distance is doubled in each step. Chosen, not tuned."""

_DROP_RESOLUTION = 1e-12
"""Tolerance [m] of the bisection for the distance by which ``place_on_ground`` lowers the base.
Chosen, not tuned.
"""


FILTER_DYNAMICS = (mujoco.mjtDyn.mjDYN_FILTER.value, mujoco.mjtDyn.mjDYN_FILTEREXACT.value)
"""MuJoCo's types of filter dynamics (first-order lag) of actuators, for example of servos with
``timeconst``.
"""

STATE_SPEC = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
"""MuJoCo's specification of the states that rollouts return: time, qpos, qvel, act and more."""

FORCED_CONTROL_SPEC = int(
    mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
)
"""MuJoCo's specification (mjtState) of the controls of rollouts with forces on bodies: ctrl, then
xfrc_applied."""


@dataclass(frozen=True, eq=False)
class StandStart:
    """Initial state of the simulation of a stand, with servos and command.

    Attributes:
        robot: The robot, on the stand's ground.
        stand: The stand.
        prediction: Static equilibrium of the stand with minimum tangential contact forces.
        drive: Servos and MuJoCo model.
        start: State (mjSTATE_FULLPHYSICS) with zero velocities, from `place_on_ground`.
        ctrl: Actuator commands, shape (model.nu,).
    """

    robot: Robot
    stand: Stand
    prediction: GravityCompensation
    drive: Servos
    start: Array
    ctrl: Array


def make_stand_start(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> StandStart:
    """Compute the initial state and servo commands for the simulation of a stand.

    Args:
        robot: The robot.
        stand: The stand.
        feedforward: Whether ctrl = q* + tau / kp (joint positions plus static torques); otherwise
            ctrl = q*.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of range, or the stand belongs to another robot,
            for example.
        UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
        ModelError: If the servo gains of a joint are unknown, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = stand.check(robot)
    prediction = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    robot = build_on_ground(robot, stand.task.ground, stand.rigid_targets)
    drive, torques = model_with_servos(robot, kp, kd, integrator), prediction.joint_torques
    if robot.fixed_parts:
        close_welds(
            robot, drive.model, stand.qpos, weld_generalized_forces(robot, stand, prediction)
        )
    start = place_on_ground(robot, drive, stand, torques)
    ctrl = drive.command(robot, stand.joint_positions(robot), torques if feedforward else None)
    return StandStart(robot, stand, prediction, drive, start, ctrl)


def weld_generalized_forces(
    robot: Robot, stand: Stand, prediction: GravityCompensation
) -> dict[str, Array]:
    """Compute the generalised force of each weld or grip in a stand: {part: (nv,)} [N, N m].

    The order is that of qvel. The wrenches are taken from ``prediction``, the statics of the stand.
    """
    columns = stand_contacts(robot, stand).weld_columns(Configuration(robot, stand.qpos))
    wrenches = prediction.weld_wrenches
    return {name: own @ wrenches[name][: own.shape[1]] for name, own in columns.items()}


def place_on_ground(robot: Robot, drive: Servos, stand: Stand, torques: Array) -> Array:
    """Compute the state (mjSTATE_FULLPHYSICS) of a stand, lowered until contacts carry the weight.

    The base is lowered along the ground normal, with constant joint positions, until the forces
    along this direction balance, by at most `_MAX_DROP`. A stand that is held otherwise, for
    example by a fixed base, is not lowered. Velocities are zero. ``torques`` of the motors, shape
    (nu,) [N m, N], balance the stand.
    """
    model = drive.model
    data = mujoco.MjData(model)
    data.ctrl[:] = drive.command(robot, stand.joint_positions(robot), torques)
    data.act[:] = settled_activations(model, data.ctrl)
    on_planes = stand.task.ground.planes
    normal = UP if on_planes else next(iter(stand.normals.values()), UP)

    def compute_surplus_force(drop: float) -> float:
        """Return the supporting force minus the weight [N], along the ground normal.

        The base is lowered by ``drop`` [m].
        """
        qpos = stand.qpos.copy()
        qpos[:3] -= drop * normal
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(model, data)
        # Gravity compensation, which is passive, may carry a part of the weight.
        generalized_force = data.qfrc_constraint + data.qfrc_passive - data.qfrc_bias
        return float(normal @ generalized_force[robot.mj_convention.qvel_index[:3]])

    # Deep feet on walls hold the robot by friction alone; a fixed robot cannot be lowered.
    if robot.is_base_fixed or robot.fixed_parts or (on_planes and any(stand.depths.values())):
        return rest_state(robot, drive, stand.qpos, data.ctrl)
    low, high = 0.0, _MIN_DROP
    while (over := compute_surplus_force(high)) <= 0 and high < _MAX_DROP:
        low, high = high, min(2 * high, _MAX_DROP)
    while over > 0 and high - low > _DROP_RESOLUTION:
        middle = (low + high) / 2
        low, high = (middle, high) if compute_surplus_force(middle) < 0 else (low, middle)
    # The state at the end of the bracket; if no depth carries the robot, the robot falls.
    compute_surplus_force(high)
    return full_state(model, data)


def rest_state(robot: Robot, drive: Servos, qpos: Array, ctrl: Array) -> Array:
    """Return the state (mjSTATE_FULLPHYSICS) of a robot in a configuration, with zero velocities.

    Args:
        robot: The robot, on the ground.
        drive: Servos and MuJoCo model.
        qpos: Configuration, shape (nq,).
        ctrl: Actuator commands, shape (model.nu,).
    """
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, qpos)
    data.act[:] = settled_activations(drive.model, ctrl)
    return full_state(drive.model, data)


def settled_activations(
    model: mujoco.MjModel, ctrl: Array, max_time_constant: float = math.inf
) -> Array:
    """Compute the activations (model.na,) of actuators with filter dynamics at a constant command.

    The activation is the command in ``ctrl``, shape (model.nu,), clipped to ``ctrlrange`` if this
    range is a limit. The activation is zero for time constants above ``max_time_constant`` [s], and
    for other dynamics.
    """
    activations = np.zeros(model.na)
    for motor in range(model.nactuator) if model.na else ():
        filtered = model.actuator_dyntype[motor] in FILTER_DYNAMICS
        if filtered and model.actuator_dynprm[motor, 0] <= max_time_constant:
            control = int(model.actuator_ctrladr[motor])
            low, high = (
                model.actuator_ctrlrange[control]
                if model.actuator_ctrllimited[control]
                else (-np.inf, np.inf)
            )
            last = int(model.actuator_actadr[motor] + model.actuator_actnum[motor] - 1)
            activations[last] = min(max(float(ctrl[control]), low), high)
    return activations


def full_state(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Copy the state from MuJoCo's data, shape (size,): time, qpos, qvel, act and more.

    The order is that of mjSTATE_FULLPHYSICS.
    """
    state = np.empty(mujoco.mj_stateSize(model, STATE_SPEC))
    mujoco.mj_getState(model, data, state, STATE_SPEC)
    return state


def roll_out(
    model: mujoco.MjModel,
    workers: mujoco.MjData | Sequence[mujoco.MjData],
    starts: Array,
    control: Array,
    *,
    control_spec: int = int(mujoco.mjtState.mjSTATE_CTRL.value),
    warmstarts: Array | None = None,
) -> Array:
    """Simulate a model from several initial states, in one thread per element of ``workers``.

    MuJoCo's warnings about diverging simulations are suppressed; ``monitor`` detects divergence.

    Args:
        model: MuJoCo model.
        workers: MuJoCo data, one or one per thread. The data are changed.
        starts: Initial states (mjSTATE_FULLPHYSICS), shape (runs, size) or (size,).
        control: Controls in each step, shape (runs, steps, n), or (1, steps, n) if equal in all
            runs.
        control_spec: Bit mask (mjtState) of the columns of ``control``; actuator commands by
            default.
        warmstarts: Accelerations with which MuJoCo's solver starts, shape (runs, model.nv)
            [rad/s^2, m/s^2]; zero by default.

    Returns:
        States after each step, shape (runs, steps, size).
    """
    with silence_mujoco():
        states, _ = mujoco.rollout.rollout(
            model,
            workers,
            starts,
            control,
            control_spec=control_spec,
            initial_warmstart=warmstarts,
        )
    return np.asarray(states)


def simulate_commands(
    model: mujoco.MjModel, start: Array, ctrl: Array, data: mujoco.MjData | None = None
) -> Array:
    """Simulate a model from an initial state, with given actuator commands.

    Args:
        model: MuJoCo model.
        start: Initial state (mjSTATE_FULLPHYSICS).
        ctrl: Actuator commands in each step, shape (n, model.nu).
        data: MuJoCo data for the simulation. The data are changed, and do not change the result.
            Default: new data.

    Returns:
        States after each step, shape (n, size).
    """
    worker = mujoco.MjData(model) if data is None else data
    states: Array = roll_out(model, worker, start, ctrl[None])[0]
    return states


def simulate_in_intervals(
    model: mujoco.MjModel, start: Array, ctrl: Array, steps: int, interval: int
) -> Iterator[Array]:
    """Simulate a model with a constant command, and yield the states of each interval.

    The states equal those of a single simulation (`simulate_commands`), since each interval starts
    with the solver's result of the interval before.

    Args:
        model: MuJoCo model.
        start: Initial state (mjSTATE_FULLPHYSICS).
        ctrl: Actuator commands, shape (model.nu,).
        steps: Number of steps.
        interval: Number of steps of an interval; the last interval may be shorter.

    Yields:
        States after each step of an interval, shape (n, size).
    """
    data, state, warmstart = mujoco.MjData(model), start, None
    for begin in range(0, steps, interval):
        control = np.tile(ctrl, (1, min(interval, steps - begin), 1))
        states = roll_out(model, data, state, control, warmstarts=warmstart)[0]
        state, warmstart = states[-1], data.qacc_warmstart[None].copy()
        yield states


def make_forced_controls(
    robot: Robot, model: mujoco.MjModel, ctrl: Array, runs: int, steps: int
) -> tuple[Array, Array]:
    """Create the controls of rollouts with a force on the base, and a view to set this force.

    The layout is ``FORCED_CONTROL_SPEC``.

    Args:
        robot: The robot.
        model: MuJoCo model that is simulated.
        ctrl: Actuator commands, the same in every step, shape (model.nu,).
        runs: Number of rollouts.
        steps: Number of steps of each rollout.

    Returns:
        Two arrays. The controls have the shape (runs, steps, model.nu + 6 model.nbody), with all
        forces zero. The second array is a view into the controls, shape (runs, steps, 3) [N]: the
        force on the base at the CoM of the base body, in world axes. The caller sets this force.
    """
    control = np.zeros((runs, steps, model.nu + 6 * model.nbody))
    control[:, :, : model.nu] = ctrl
    column = model.nu + 6 * model.body(robot.mj_base).id
    return control, control[:, :, column : column + 3]


def check_duration(duration: float) -> None:
    """Raise ``ConfigurationError`` if a simulated time [s] is not between 2 and 600."""
    if not math.isfinite(duration) or not 2.0 <= duration <= 600.0:
        problem = diagnose("not-between", given=f"{duration} s", low=2, high=Quantity(600, "s"))
        raise ConfigurationError("duration", problem)


def with_stand_contacts(robot: Robot, stand: Stand) -> Robot:
    """Return a robot with the contacts of a stand (friction, hands, welds), for simulation.

    Raises:
        ConfigurationError: If the stand belongs to another robot, or the base is fixed and the
            stand has stance feet, or the robot cannot make the contacts of the task.
        UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
        ModelError: If the model with the contacts cannot be built.
    """
    if stand.stance_feet and not stand.task.contacts:  # a weld frees the base
        robot.check_floating()
    robot = stand.check(robot)
    if stand.stance_feet:
        robot.check_floating()
    return robot
