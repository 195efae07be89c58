"""Rollouts: where they begin, and what they are given; ``monitor`` says what comes of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import build_on_ground, close_welds
from pupper_analysis.stance.stand import Stand, stand_contacts, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]

_SHALLOW, _DEEP = 1e-6, 0.065536  # m: where the feet are looked for that carry the weight

_DROP_RESOLUTION = 1e-12  # m: drops that differ by no more are one

FILTERS = (mujoco.mjtDyn.mjDYN_FILTER.value, mujoco.mjtDyn.mjDYN_FILTEREXACT.value)
"""Of a servo with ``timeconst``: what it commands lags behind, and at rest is its command."""

STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
"""What rollouts return: time, qpos, qvel ..."""

FORCED = int(mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value)
"""What rollouts with forces on bodies are given."""


@dataclass(frozen=True, eq=False)
class Standing:
    """A stand on its servos, where a simulation of it begins.

    Attributes:
        robot: The robot, on the stand's ground.
        stand: How it stands.
        prediction: Torques and contact forces: those that last.
        drive: Its servos.
        start: The state (mjSTATE_FULLPHYSICS) at rest, let down on to the ground.
        ctrl: (model.nu,) what they are commanded.
    """

    robot: Robot
    stand: Stand
    prediction: GravityCompensation
    drive: Servos
    start: Array
    ctrl: Array


def begin_stand(
    robot: Robot,
    stand: Stand,
    *,
    feedforward: bool = True,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    integrator: str | None = None,
) -> Standing:
    """Puts a robot on its ground and on its servos, in a stand.

    Args:
        robot: The robot.
        stand: How it stands.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        integrator: MuJoCo's integrator; the model's own by default.

    Raises:
        ConfigurationError: If an argument is out of its range.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = stand.check(robot)
    prediction = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    robot = build_on_ground(robot, stand.task.ground, stand.rigid_targets)
    drive, torques = model_with_servos(robot, kp, kd, integrator), prediction.joint_torques
    if robot.welds:
        close_welds(robot, drive.model, stand.qpos, weld_pushes(robot, stand, prediction))
    start = place_on_ground(robot, drive, stand, torques)
    ctrl = drive.command(robot, stand.joint_positions(robot), torques if feedforward else None)
    return Standing(robot, stand, prediction, drive, start, ctrl)


def weld_pushes(robot: Robot, stand: Stand, prediction: GravityCompensation) -> dict[str, Array]:
    """Returns {what is welded: (nv,) the generalised force of its weld} in a stand."""
    columns = stand_contacts(robot, stand).weld_columns(Configuration(robot, stand.qpos))
    wrenches = prediction.weld_wrenches
    return {name: own @ wrenches[name][: own.shape[1]] for name, own in columns.items()}


def place_on_ground(robot: Robot, drive: Servos, stand: Stand, torques: Array) -> Array:
    """Returns MuJoCo's state at a stand, let down until the contacts carry the weight.

    The ground is soft: feet that just touch it carry nothing. The base is lowered into it, with the
    joints as they are, to where the contacts push against the ground's normal with the weight; so
    the simulation starts at rest instead of with a fall of some millimetres. (But for one that is
    welded.)

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
    data.act[:] = settled_activations(model, data.ctrl)
    apart = stand.task.ground.planes
    normal = UP if apart else next(iter(stand.normals.values()), UP)

    def surplus(drop: float) -> float:
        """Returns by how much the contacts carry more than the weight (N)."""
        qpos = stand.qpos.copy()
        qpos[:3] -= drop * normal
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(model, data)
        # Gravity compensation, which is passive, may carry a part of the weight.
        pushing = data.qfrc_constraint + data.qfrc_passive - data.qfrc_bias
        return float(normal @ pushing[robot.mj_convention.qvel_index[:3]])

    # Deep enough, walls hold by friction alone; and what is fixed cannot be let down.
    if robot.bolted or robot.welds or (apart and any(stand.depths.values())):
        return rest_state(robot, drive, stand.qpos, data.ctrl)
    low, high = 0.0, _SHALLOW
    while (over := surplus(high)) <= 0 and high < _DEEP:
        low, high = high, min(2 * high, _DEEP)
    while over > 0 and high - low > _DROP_RESOLUTION:
        middle = (low + high) / 2
        low, high = (middle, high) if surplus(middle) < 0 else (low, middle)
    surplus(high)  # where nothing carries, however deep, it begins there and falls
    return full_state(model, data)


def rest_state(robot: Robot, drive: Servos, qpos: Array, ctrl: Array) -> Array:
    """Returns the state (mjSTATE_FULLPHYSICS) of a robot at rest in a configuration.

    Args:
        robot: The robot, on its ground.
        drive: Its servos.
        qpos: (nq,) where it rests.
        ctrl: (model.nu,) what they are commanded.
    """
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, qpos)
    data.act[:] = settled_activations(drive.model, ctrl)
    return full_state(drive.model, data)


def settled_activations(model: mujoco.MjModel, ctrl: Array, slowest: float = math.inf) -> Array:
    """Returns what motors with a filter have at rest (na,): their command, as far as it goes.

    Those slower than ``slowest`` (s) are still where they begin.
    """
    activations = np.zeros(model.na)
    for motor in range(model.nactuator) if model.na else ():
        filtered = model.actuator_dyntype[motor] in FILTERS
        if filtered and model.actuator_dynprm[motor, 0] <= slowest:
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
    """Returns the state (mjSTATE_FULLPHYSICS) in MuJoCo's data."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def roll_out(
    model: mujoco.MjModel,
    workers: mujoco.MjData | Sequence[mujoco.MjData],
    starts: Array,
    control: Array,
    *,
    control_spec: int = int(mujoco.mjtState.mjSTATE_CTRL.value),
) -> Array:
    """Simulates a model from states on.

    MuJoCo's warnings of simulations that diverge are not printed, and leave no file: ``monitor``
    says what comes of each.

    Args:
        model: The model.
        workers: Its data, one per thread.
        starts: (runs, size) the states (mjSTATE_FULLPHYSICS), or one of them.
        control: (runs, steps, nu) what it is given in each step.
        control_spec: What that is.

    Returns:
        (runs, steps, size) the states after each step.
    """
    with silence_mujoco():
        states, _ = mujoco.rollout.rollout(
            model, workers, starts, control, control_spec=control_spec
        )
    return np.asarray(states)


def simulate(model: mujoco.MjModel, start: Array, ctrl: Array) -> Array:
    """Simulates a model from a state on.

    Args:
        model: The model.
        start: The state (mjSTATE_FULLPHYSICS).
        ctrl: (n, nu) the command in each step.

    Returns:
        (n, size) the states after each step.
    """
    one: Array = roll_out(model, mujoco.MjData(model), start, ctrl[None])[0]
    return one


def forced_commands(
    robot: Robot, model: mujoco.MjModel, ctrl: Array, runs: int, steps: int
) -> tuple[Array, Array]:
    """Returns what rollouts with a force on the base are given, for ``control_spec=FORCED``.

    Args:
        robot: The robot.
        model: Its model.
        ctrl: (nu,) the servos' command, in all steps.
        runs: How many rollouts.
        steps: Their length.

    Returns:
        (runs, steps, size) with forces of zero; and the part of it, (runs, steps, 3), that is the
        force on the base, at its com, in world axes (N).
    """
    control = np.zeros((runs, steps, model.nu + 6 * model.nbody))
    control[:, :, : model.nu] = ctrl
    column = model.nu + 6 * model.body(robot.mj_base).id
    return control, control[:, :, column : column + 3]


def check_stand(robot: Robot, stand: Stand, duration: float) -> Robot:
    """Checks what a simulation of a stand is given; returns the robot with its contacts.

    Raises:
        ConfigurationError: If the base is fixed, the stand is another robot's, or the duration (s)
            is not between 2 and 600.
    """
    robot = check_standing(robot, stand)
    if not math.isfinite(duration) or not 2.0 <= duration <= 600.0:
        problem = diagnose("not-between", given=f"{duration} s", low=2, high=Quantity(600, "s"))
        raise ConfigurationError("duration", problem)
    return robot


def check_standing(robot: Robot, stand: Stand) -> Robot:
    """Checks that a stand is the robot's, its base free if it has feet; returns it with contacts.

    Raises:
        ConfigurationError: If not.
    """
    if stand.stance_feet and not stand.task.contacts:  # a weld frees a base
        robot.check_floating()
    robot = stand.check(robot)
    if stand.stance_feet:
        robot.check_floating()
    return robot
