"""How much a robot's servos hold up: stiffness, sag and what they bring with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.errors import (
    NoEquilibriumError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.results import Result
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import command_lead, command_ranges, model_with_servos, own_servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.robot.tool import Place, Tool, find_place
from pupper_analysis.stance.payload.first_order import SmallPayload
from pupper_analysis.stance.payload.nudge import find_saturating_motors
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.homotopy_path import HomotopyPath
from pupper_analysis.stance.sag.steady_state import (
    SteadyState,
    check_request,
    describe_pose,
    follow_to_end,
    let_creep,
)
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution

Array = NDArray[np.float64]

RESOLUTION = 1e-3
"""To what part of itself a limit is found by bisection; it is rounded down."""

GROWTH = 1.5
"""Factor from one mass tried to the next: a window of failure narrower than this may be missed."""

LEAST = 1e-3
"""The least payload looked at, in parts of the first one tried."""

COLLAPSED = 0.5
"""A robot that sags below this part of its stand's height no longer stands."""

LASTING = 12.0
"""How long a payload must stay up (s). Under a load that comes as a surprise the feet press against
each other, and MuJoCo's friction lets them creep: where they are after this time counts."""

GRIPLESS = 10.0
"""A friction coefficient that no foot has: where more is needed, it is not friction that lacks."""


class Failure(StrEnum):
    """What gives way first when the payload grows."""

    MOTOR = "a motor saturates"
    SLIDING = "a foot slides"
    TIPPING = "the robot tips"
    BUCKLING = "loses static stability: servo stiffness too low"
    JOINT = "a joint comes to its limit"
    GROUND = "another part comes to the ground"
    COMMAND = "a servo cannot be commanded so far"
    NOTHING = "nothing that was looked at"


class PayloadCommand(StrEnum):
    """What position servos are commanded.

    LOADED: the pose, with feed-forward for the torques that the load takes: ctrl = q* + tau / kp.
    UNLOADED: the same as without the load, which comes as a surprise, put down gently.
    """

    LOADED = "loaded"
    UNLOADED = "unloaded"


@dataclass(frozen=True, eq=False)
class Bound(Result):
    """One of the limits of a payload.

    Attributes:
        mass: kg; infinite if nothing gives way.
        failure: What gives way just above.
        where: The motors, joints, feet or bodies concerned.
    """

    mass: float
    failure: Failure
    where: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LoadedPose(Result):
    """A loaded robot under a command, at rest.

    Attributes:
        robot: The loaded robot.
        stand: Its stand: feet sunk under the load, base where the unloaded stand has it.
        target: (nu,) the joint positions that the servos are commanded (rad).
        start: (nq,) where it rests as the load has just been put down: the equilibrium, or, if
            there is none, the stand.
        pose: The equilibrium, after ``LASTING`` of creep under a load that is a surprise; None if
            there is none.
        failure: Why it does not stand so; None if it does.
        where: The motors, joints, feet or bodies concerned.
    """

    robot: Robot
    stand: Stand
    target: Array
    start: Array
    pose: SteadyState | None
    failure: Failure | None
    where: tuple[str, ...]


def servo_limit(
    robot: Robot,
    stand: Stand,
    point: Place,
    *,
    command: PayloadCommand = PayloadCommand.LOADED,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    most: float = math.inf,
) -> Bound:
    """Finds the greatest payload with which a servo-driven robot still stands.

    It stands if the equilibrium under the load exists and is stable (``steady_state``, feet
    pinned), no foot slips or would have to pull, no motor saturates, no joint is at its limit, no
    other part is on the ground, and it keeps half of its height. Masses are tried from a quarter of
    what first order says on (``FirstOrder``), in steps of ``GROWTH``, and the first interval in
    which it stops standing is bisected.

    Args:
        robot: As in ``payload_limit``, like the next four.
        stand: Likewise.
        point: Likewise.
        command: Likewise.
        kp: Likewise.
        kd: Likewise.
        most: What motors and contacts bear (kg): where it still stands with that, on soft ground it
            may stand with a little more.

    Returns:
        The limit, to ``RESOLUTION``, rounded down: with it the robot does stand.

    Raises:
        ConfigurationError: If the robot cannot stand, or kp is out of range.
        ModelError: If the model has no position servos, and no kp is given.
    """

    def judge(mass: float) -> LoadedPose | Bound:
        return find_loaded_pose(robot, stand, mass, point, command=command, kp=kp, kd=kd)

    failed: dict[float, tuple[Failure, tuple[str, ...]]] = {}

    def fails(mass: float) -> bool:
        found = judge(mass)
        if found.failure is not None:
            failed[mass] = found.failure, found.where
        return found.failure is not None

    ceiling = 2 * most if math.isfinite(most) else 1e4 * robot.total_mass
    stiffness = model_with_servos(robot, kp, None if kp is None else 0.0).kp
    start = _guess(robot, stand, find_place(robot, point), stiffness) / 4
    mass = 0.0 if fails(0.0) else find_first_failing(fails, min(start, most), ceiling)
    if mass >= ceiling:
        return Bound(math.inf, Failure.NOTHING, ())
    failure, where = failed[min(tried for tried in failed if tried >= mass)]
    return Bound(mass, failure, where)


def _guess(robot: Robot, stand: Stand, point: Tool, kp: Array) -> float:
    """Returns about what a stand bears (kg), to begin the search at."""
    small = SmallPayload(robot, point, kp)
    try:
        first = small.borne(stand)
    except StaticsInfeasibleError:
        return small.mass
    guess = small.mass if first is None else first.limit(robot.effort_limits)
    return guess if 0 < guess < math.inf else small.mass


def find_first_failing(fails: Callable[[float], bool], start: float, ceiling: float) -> float:
    """Returns the greatest mass (kg) below the first failure, or ``ceiling`` if there is none.

    Args:
        fails: Tells whether a mass (kg) is too much.
        start: The first mass tried (kg); where it fails, smaller ones are.
        ceiling: Nothing above is tried (kg).
    """
    low, high = 0.0, min(start, ceiling)
    while not fails(high):
        if high >= ceiling:
            return ceiling
        low, high = high, min(GROWTH * high, ceiling)
    while high - low > RESOLUTION * high and high > LEAST * start:
        middle = (low + high) / 2
        low, high = (low, middle) if fails(middle) else (middle, high)
    return low


def find_loaded_pose(
    robot: Robot,
    stand: Stand,
    mass: float,
    point: Place,
    *,
    command: PayloadCommand = PayloadCommand.LOADED,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> LoadedPose | Bound:
    """Finds where a loaded robot comes to rest under a command, and whether it stands so.

    Args:
        robot: The robot.
        stand: How it stands, without payload.
        mass: Of the payload (kg).
        point: Where the mass is, as in ``with_payload``.
        command: What the servos are commanded.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default, none where its
            motors are no servos.

    Returns:
        The pose; or, where there is no balance to begin with, why, as a bound of that mass.

    Raises:
        ConfigurationError: If the robot cannot stand, or kp is out of range.
        ModelError: If the model has no position servos, and no kp is given.
    """
    loaded = with_payload(robot, mass, point)
    try:
        sunk = solve_loaded_stand(loaded, stand)
        balance = stand_statics(loaded, sunk, distribution=ForceDistribution.MIN_TANGENTIAL)
    except StanceUnreachableError as error:
        return Bound(mass, Failure.GROUND, tuple(map(str, error.blocked)))
    except StaticsInfeasibleError as error:
        needed = error.friction_needed
        failure = Failure.TIPPING if needed is None or needed > GRIPLESS else Failure.SLIDING
        return Bound(mass, failure, error.feet)
    except NoEquilibriumError:
        return Bound(mass, Failure.BUCKLING, ())
    drive = model_with_servos(loaded, kp, _damping(loaded, kp, kd))
    damping = drive.kd
    target = sunk.joint_positions(loaded) + command_lead(balance.joint_torques, drive.kp)
    if command is PayloadCommand.UNLOADED:
        empty = solve_loaded_stand(robot, stand)
        torques = stand_statics(
            robot, empty, distribution=ForceDistribution.MIN_TANGENTIAL
        ).joint_torques
        target = empty.joint_positions(robot) + command_lead(torques, drive.kp)
    try:
        if command is PayloadCommand.LOADED:
            way = _way(loaded, sunk, kp)
            pose = follow_to_end(way, feedforward=True)
            start = pose.qpos
        else:
            way = _way(loaded, sunk, kp, target)
            start, pose = _crept(way)
    except NoEquilibriumError:
        # With feed-forward for the load the only thing that can be missing is torque.
        if command is PayloadCommand.LOADED:
            over = np.abs(balance.joint_torques) >= loaded.effort_limits
            names = tuple(loaded.joint_names[index] for index in np.flatnonzero(over))
            if names:
                return LoadedPose(loaded, sunk, target, sunk.qpos, None, Failure.MOTOR, names)
        return LoadedPose(loaded, sunk, target, sunk.qpos, None, Failure.BUCKLING, ())
    why, where = _judge(loaded, sunk, pose, target)
    if why is None and (weak := find_saturating_motors(way, damping)):
        why, where = Failure.MOTOR, weak
    # Feet that are pressed against each other, as soles that are twisted are, creep from there.
    if why is None and command is PayloadCommand.LOADED and math.isfinite(let_creep(way, pose)):
        why, where = Failure.SLIDING, _creeping(pose)
    return LoadedPose(loaded, sunk, target, start, pose, why, where)


def _creeping(pose: SteadyState) -> tuple[str, ...]:
    """Returns the feet that creep at half the speed of the fastest, or more."""
    fastest = max(pose.foot_creep.values())
    return tuple(foot for foot, speed in pose.foot_creep.items() if speed >= fastest / 2)


def _way(
    robot: Robot, stand: Stand, kp: ArrayLike | None, target: Array | None = None
) -> HomotopyPath:
    """Begins the way from a stand, which full feed-forward holds, to another command (nu,)."""
    check_request(robot, stand, "pinned", 0.0)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    return HomotopyPath(SagEquilibrium(robot, stand, kp, "pinned"), target)


def _crept(way: HomotopyPath) -> tuple[Array, SteadyState]:
    """Returns the qpos (nq,) at a way's end, and the equilibrium after ``LASTING`` of creep."""
    way.follow(1.0)
    start = way.solution.qpos
    way.creep(LASTING)
    return start, describe_pose(way, math.nan)


_FAILURES = {
    "joint-beyond-limit": Failure.JOINT,
    "foot-idle": Failure.TIPPING,
    "foot-slides": Failure.SLIDING,
    "lifted-foot-presses": Failure.GROUND,
    "body-touches-ground": Failure.GROUND,
}
"""{what an equilibrium is told to fail by: what gives way}, what is told before the rest first."""


def _judge(
    robot: Robot, stand: Stand, pose: SteadyState, target: Array
) -> tuple[Failure | None, tuple[str, ...]]:
    """Returns why a robot does not stand in an equilibrium, and where; None if it does."""
    if pose.saturated:
        return Failure.MOTOR, pose.saturated
    low, high = command_ranges(robot).T
    if (beyond := (target < low) | (target > high)).any():
        return Failure.COMMAND, tuple(np.array(robot.joint_names)[beyond].tolist())
    for failure in dict.fromkeys(_FAILURES.values()):
        told = [one.subject for one in pose.failures if _FAILURES.get(one.code) is failure]
        if where := tuple(subject.name for subject in told if subject is not None):
            return failure, where
    if not pose.stable or pose.base_height < COLLAPSED * stand.qpos[2]:
        return Failure.BUCKLING, ()
    return None, ()


def _damping(robot: Robot, kp: ArrayLike | None, kd: ArrayLike | None) -> ArrayLike | None:
    """Returns a kd to go with a kp: the model's own, or none where that is of no servo."""
    if kd is not None or kp is None:
        return kd
    own = own_servos(robot)
    return np.array([own.get(name, (0.0, 0.0))[1] for name in robot.joint_names])
