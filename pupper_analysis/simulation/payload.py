"""Does a payload really stay up: MuJoCo with the mass on the robot, nudged from all sides."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.diagnostics import Term, diagnose
from pupper_analysis.errors import NoEquilibriumError
from pupper_analysis.results import Result
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.robot.tool import Place, Tool, find_place
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import (
    check_stand,
    check_standing,
    full_state,
    roll_out,
    settled_activations,
)
from pupper_analysis.simulation.stability import evaluate_stability
from pupper_analysis.stance.payload.nudge import nudge_velocities
from pupper_analysis.stance.payload.servo_limit import (
    LASTING,
    Bound,
    Failure,
    LoadedPose,
    PayloadCommand,
    find_first_failing,
    find_loaded_pose,
)
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

LEFT = 0.1
"""A joint that is further from where it began has left it (rad): robots that buckle go on to 0.3
and more; creep under a surprise moves those that stay by 0.05."""

SLIPPED = 5e-3
"""A foot that is further from its place has slid (m); in 12 s creep and rolling give 1 mm."""

LIFTED = 2e-3
"""A foot that is off the ground and this much higher than it began has lifted (m); one that carries
little hops by less when it is nudged."""

_SAMPLE_TIME = 0.05  # s between the states that are looked at closely
_SLIDING_CONDIM = 3  # of a contact without torsional and rolling friction


@dataclass(frozen=True, eq=False)
class PayloadTrial(Result):
    """A simulation of a loaded stand.

    Attributes:
        mass: Of the payload (kg).
        held: Whether it stood to the end, whichever way it was nudged.
        failure: What happened first if it did not.
        where: The motors, joints, feet or bodies concerned.
        time: When (s).
        fell: How many of the nudges ended in a failure.
        nudges: How many there were.
        joint_error: The largest distance of a joint from the equilibrium at the end (rad).
        duration: s.
        dry_friction: Whether joints and rolling feet had the dry friction of the model.
    """

    mass: float
    held: bool
    failure: Failure | None
    where: tuple[str, ...]
    time: float | None
    fell: int
    nudges: int
    joint_error: float
    duration: float
    dry_friction: bool


@dataclass(frozen=True, eq=False)
class Buckling(Result):
    """How fast a loaded stand leaves its equilibrium, by the spectrum of a step of MuJoCo's.

    Friction in MuJoCo is viscous near standstill, so that what it carries buckles slowly, without a
    sharp edge: feet that creep, and joints' dry friction above all.

    Attributes:
        mass: Of the payload (kg).
        doubling_time: In which a deviation doubles (s), with the model's dry friction; infinite if
            none grows.
        free_doubling_time: The same without it: as fast as once something moves.
    """

    mass: float
    doubling_time: float
    free_doubling_time: float


@check_arguments
def payload_buckling(
    robot: Robot,
    stand: Stand,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
    *,
    command: PayloadCommand = PayloadCommand.LOADED,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Buckling:
    """Tells how fast a stand buckles with a mass on the robot.

    Args:
        robot: As for ``simulate_payload``, which begins in the same state, like all that follow.
        stand: Likewise.
        mass: Likewise.
        point: Likewise.
        command: Likewise.
        kp: Likewise.
        kd: Likewise.

    Raises:
        ConfigurationError: As ``simulate_payload``, like the next two.
        ModelError: Likewise.
        NoEquilibriumError: Likewise.
    """
    robot.check_tree("a payload")
    check_standing(robot, stand)
    place = find_place(robot, point)
    laid = _laid(robot, stand, mass, place, command, kp, kd)
    data = mujoco.MjData(laid.drive.model)
    laid.robot.mj_convention.set_state(data, laid.qpos)
    data.act[:] = settled_activations(laid.drive.model, laid.ctrl)
    start = full_state(laid.drive.model, data)
    rubbing = evaluate_stability(laid.drive, start, laid.ctrl).doubling_time or math.inf
    laid.free()
    free = evaluate_stability(laid.drive, start, laid.ctrl).doubling_time or math.inf
    return Buckling(float(mass), rubbing, free)


@check_arguments
def simulate_payload(
    robot: Robot,
    stand: Stand,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
    *,
    command: PayloadCommand = PayloadCommand.LOADED,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = LASTING,
    dry_friction: bool = False,
) -> PayloadTrial:
    """Simulates a stand with a mass on the robot.

    It begins at rest in the equilibrium of that mass (where there is none: in the stand), with the
    base moving at ``NUDGE`` in one of eight directions: both ways along x, y and z, and about z.

    By default the joints have no friction loss, and the feet no torsional and rolling friction:
    dry friction holds up what is not stable, for as long as nothing moves it, and so proves
    nothing. v3 stays up with 15 kg so, and falls at the first touch.

    Args:
        robot: The robot.
        stand: How it stands, without payload.
        mass: Of the payload (kg).
        point: Where it is, as in ``with_payload``.
        command: What the servos are commanded.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        duration: Simulated time (s), at least 2.
        dry_friction: Keep the model's dry friction.

    Returns:
        What happened.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        NoEquilibriumError: If the stand cannot be held without payload.
    """
    robot.check_tree("a payload")
    check_stand(robot, stand, duration)
    place = find_place(robot, point)
    laid = _laid(robot, stand, mass, place, command, kp, kd)
    if not dry_friction:
        laid.free()
    loaded, model, qpos, ctrl = laid.robot, laid.drive.model, laid.qpos, laid.ctrl
    states = _rollouts(loaded, model, qpos, ctrl, duration)
    events = [_first_event(loaded, model, laid.stand, qpos, rows, ctrl) for rows in states]
    failed = [event for event in events if event is not None]
    time, failure, where = min(failed, key=lambda event: event[0]) if failed else (None, None, ())
    joints = states[:, -1, 1 + loaded.mj_convention.qpos_index[7:]]
    return PayloadTrial(
        mass=float(mass),
        held=not failed,
        failure=failure,
        where=where,
        time=time,
        fell=len(failed),
        nudges=len(states),
        joint_error=float(np.abs(joints - qpos[7:]).max()),
        duration=duration,
        dry_friction=dry_friction,
    )


@dataclass(frozen=True, eq=False)
class _Laid:
    """A payload on a robot, at rest: the loaded robot on its ground, its servos and command."""

    robot: Robot
    stand: Stand
    drive: Servos
    qpos: Array
    ctrl: Array

    def free(self) -> None:
        """Takes the dry friction of joints and of rolling feet away."""
        model = self.drive.model
        model.dof_frictionloss[:] = 0.0
        model.geom_condim[:] = np.minimum(model.geom_condim, _SLIDING_CONDIM)


def _laid(
    robot: Robot,
    stand: Stand,
    mass: float,
    point: Tool,
    command: PayloadCommand,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> _Laid:
    """Puts a payload on a robot."""
    loaded = with_payload(robot, mass, point)
    start = _start(robot, stand, mass, point, command, kp)
    loaded = on_ground(loaded, start.stand.task.ground, start.stand.foot_targets)
    drive = model_with_servos(loaded, kp, kd)
    return _Laid(loaded, start.stand, drive, start.start, drive.command(loaded, start.target))


def _start(
    robot: Robot,
    stand: Stand,
    mass: float,
    point: Tool,
    command: PayloadCommand,
    kp: ArrayLike | None,
) -> LoadedPose:
    """Returns where the simulation begins, and with what command.

    A mass for which there is no balance has neither pose nor command: those of the greatest that
    has. Where only the servos' equilibrium is missing under a load that comes as a surprise, it is
    the pose of the greatest mass that has one: put down gently, and then a little more.
    """

    def pose(tried: float) -> LoadedPose | Bound:
        return find_loaded_pose(robot, stand, tried, point, command=command, kp=kp)

    def none(tried: LoadedPose | Bound) -> bool:
        missing = isinstance(tried, LoadedPose) and tried.pose is None
        return isinstance(tried, Bound) or (missing and command is PayloadCommand.UNLOADED)

    found = pose(mass)
    if none(found):
        found = pose(find_first_failing(lambda tried: none(pose(tried)), mass / 8, mass))
    if isinstance(found, Bound):
        failure = Term(found.failure.value)
        raise NoEquilibriumError(None, diagnose("no-equilibrium-unloaded", failure=failure))
    return found


def _rollouts(
    robot: Robot, model: mujoco.MjModel, qpos: Array, ctrl: Array, duration: float
) -> Array:
    """Returns the states (8, n, size) of the simulations, one per nudge."""
    data = mujoco.MjData(model)
    starts = []
    for qvel in nudge_velocities(robot, float(qpos[2])):
        robot.mj_convention.set_state(data, qpos, qvel)
        starts.append(full_state(model, data))
    steps = max(2, round(duration / float(model.opt.timestep)))
    control = np.tile(ctrl, (1, steps, 1))
    datas = [mujoco.MjData(model) for _ in range(2)]
    return roll_out(model, datas, np.array(starts), control)


def _first_event(
    robot: Robot, model: mujoco.MjModel, stand: Stand, qpos: Array, states: Array, ctrl: Array
) -> tuple[float, Failure, tuple[str, ...]] | None:
    """Returns when, what and where something happened that shall not, if it did.

    A motor may saturate for a moment, in the swing of a nudge, if the robot then stands.
    """
    timestep = float(model.opt.timestep)
    if monitor.has_diverged(states, timestep):
        return 0.0, Failure.BUCKLING, ()
    watcher = monitor.Watcher(robot, model)
    data = watcher.data
    most, names = robot.effort_ranges * (1 - 1e-9), np.array(robot.joint_names)
    saturated: tuple[float, Failure, tuple[str, ...]] | None = None
    recovered = True
    lower, upper = robot.lower_limits, robot.upper_limits
    places: dict[str, Array] = {}
    carrying = set(robot.feet_with(stand.stance_feet))
    for state in states[:: max(1, round(_SAMPLE_TIME / timestep))]:
        seen = watcher.look(state, ctrl)
        angles = data.qpos[robot.mj_convention.qpos_index[7:]]
        torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        weak = names[(torques < most[:, 0]) | (torques > most[:, 1])].tolist()
        recovered = not weak
        if weak and saturated is None:
            saturated = seen.time, Failure.MOTOR, tuple(weak)
        feet = watcher.foot_centres()
        places = places or feet
        moved = {
            foot: np.linalg.norm((feet[foot] - places[foot])[:2]) for foot in stand.stance_feet
        }
        found = {
            Failure.GROUND: sorted(seen.bodies | (set(seen.forces) - carrying)),
            Failure.JOINT: names[(angles < lower) | (angles > upper)].tolist(),
            Failure.TIPPING: [
                foot
                for foot in stand.stance_feet
                if robot.foot_of(foot) not in seen.forces
                and (feet[foot] - places[foot])[2] > LIFTED
            ],
            Failure.SLIDING: [foot for foot, way in moved.items() if way > SLIPPED],
            Failure.BUCKLING: names[np.abs(angles - qpos[7:]) > LEFT].tolist(),
        }
        for failure, where in found.items():
            if where:
                return saturated or (seen.time, failure, tuple(where))
    return None if recovered else saturated
