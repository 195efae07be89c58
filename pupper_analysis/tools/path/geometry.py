"""Where a path goes: segments from stance to stance, configurations and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    Infeasibility,
    NoEquilibriumError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import placed_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.problem import feet_centre, ground_normals
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]

_T = TypeVar("_T", float, NDArray[np.float64])

_PLACES = ("base-height", "base-place", "com-place", "support-margin", "footholds")
"""Constraints whose numbers a path works out itself; all others' are between its stances'."""

TOUCHING = 1e-12
"""The height of a foot that does not carry, but is on the ground (m)."""


@dataclass(frozen=True, eq=False)
class Key:
    """A stance in world coordinates.

    Attributes:
        task: The task, with its height filled in.
        base: (3,) place of the base (m).
        com: (3,) centre of mass (m).
        feet: {foot: (3,) centre of its sphere (m)}.
        joints: (nu,) joint positions (rad, m).
    """

    task: StandTask
    base: Array
    com: Array
    feet: dict[str, Array]
    joints: Array

    def margin(self, feet: Sequence[str]) -> float:
        """Returns how far inside these feet the com's projection is (m)."""
        return com_margin(self.com, {foot: self.feet[foot] for foot in feet})


@dataclass(frozen=True, eq=False)
class Segment:
    """From one stance to the next.

    Attributes:
        start: Where it begins.
        end: Where it ends.
        stance_feet: The feet that carry all along it.
        before: Those that carry on the segment before.
        after: Those that carry on the segment after.
    """

    start: Key
    end: Key
    stance_feet: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]

    def placed(self, robot: Robot) -> list[int]:
        """Returns the numbers of the joints that one of the stances puts in their places."""
        tasks = self.start.task, self.end.task
        names = {joint for task in tasks for joint in placed_joints(robot, task.posture)}
        return sorted(map(robot.joint_names.index, names))


def segments_of(
    robot: Robot, stances: Sequence[StandTask]
) -> tuple[list[Segment], tuple[Stand, ...]]:
    """Solves the stances, and checks that they can follow each other.

    Raises:
        ConfigurationError: If they cannot; says which.
        StanceUnreachableError: If one is out of reach; says which.
        UnknownNameError: If a task names a foot that the robot does not have.
    """
    if any(task.ground != stances[0].ground for task in stances):
        raise ConfigurationError("stances", diagnose("grounds-differ"))
    fixed = any(not isinstance(task.com, str | None) for task in stances)
    if fixed and any(task.com == "inside" for task in stances):
        raise ConfigurationError("stances", diagnose("com-inside-mixed"))
    solved: list[Stand] = []
    keys = []
    for number, task in enumerate(stances, 1):
        if solved:
            task = replace(task, ik_seed=tuple(solved[-1].joint_positions(robot)))
        try:
            solved.append(solve_stand(robot, task))
        except StanceUnreachableError as error:
            raise error.at(diagnose("of-stance", number=number)) from None
        com = Configuration(robot, solved[-1].qpos).center_of_mass()
        base, joints = solved[-1].qpos[:3], solved[-1].joint_positions(robot)
        keys.append(Key(solved[-1].task, base, com, solved[-1].foot_targets, joints))
    sets = []
    for number, (one, two) in enumerate(pairwise(keys), 1):
        swinging = one.task.swing.keys() | two.task.swing.keys()
        idle = {point for foot in swinging for point in robot.feet[foot]}
        sets.append(tuple(foot for foot in robot.contact_points if foot not in idle))
        where = diagnose("between-stances", one=number, two=number + 1)
        if len(sets[-1]) < 3:
            problem = diagnose("too-few-feet-carry", count=len(sets[-1]), where=where)
            raise ConfigurationError("stances", problem)
        for foot in sets[-1]:
            if np.abs(one.feet[foot] - two.feet[foot]).max() > 1e-9:
                problem = diagnose("carrying-foot-moves", subject=("foot", foot), where=where)
                raise ConfigurationError("stances", problem)
        if number > 1 and not (set(sets[-1]) <= set(sets[-2]) or set(sets[-1]) >= set(sets[-2])):
            problem = diagnose("lands-as-another-lifts", number=number)
            raise ConfigurationError("stances", problem)
    sets = [sets[0], *sets, sets[-1]]
    segments = [
        Segment(one, two, sets[number], sets[number - 1], sets[number + 1])
        for number, (one, two) in enumerate(pairwise(keys), 1)
    ]
    return segments, tuple(solved)


def task_between(
    robot: Robot,
    segment: Segment,
    stance_feet: Sequence[str],
    share: float,
    ik_seed: Array,
    away: Mapping[str, Array],
) -> StandTask:
    """Returns the task of a moment, in world coordinates.

    Args:
        robot: The robot.
        segment: The segment of the path.
        stance_feet: The feet that carry.
        share: Of the segment's way, from 0 to 1.
        ik_seed: (nu,) joint positions to start from (rad).
        away: {foot: (3,) how far it has rolled from its place (m)}.

    Raises:
        StaticsInfeasibleError: If the com is less inside the feet than the tasks demand.
    """
    one, two = segment.start.task, segment.end.task

    def between(start: _T, end: _T) -> _T:
        return start + share * (end - start)

    ground, out = one.ground, ground_normals(robot, one.ground)
    places = {foot: segment.start.feet[foot] for foot in robot.contact_points}
    places |= {foot: p + share * (segment.end.feet[foot] - p) for foot, p in places.items()}
    points = {point: place + away[point] for point, place in places.items()}
    feet = {}
    for foot, own in robot.feet.items():
        x, y, _ = np.mean([points[point] for point in own], axis=0).tolist()
        feet[foot] = x, y
    contacts = {
        point: ground.centre(robot.foot_of(point), points[point], robot.contact_radius[point])
        - robot.contact_radius[point] * out[point]
        for point in stance_feet
    }
    centre = feet_centre(robot, ground, contacts, points)
    height = between(float(segment.start.base[2]), float(segment.end.base[2]))
    com = segment.start.com + share * (segment.end.com - segment.start.com)
    needed = max(1e-6, between(one.com_margin, two.com_margin) - 1e-9)
    margin = com_margin(com, contacts)
    if margin < needed:
        raise StaticsInfeasibleError(
            Infeasibility.COM_OUTSIDE,
            diagnose(
                "com-off-the-feet",
                margin=Quantity(margin, "m"),
                feet=contacts,
                needed=Quantity(needed, "m"),
            ),
            margin=margin,
            feet=contacts,
        )
    last = two.values()
    others: dict[str, Any] = {
        name: None if None in (first, last[name]) else between(first, last[name])
        for name, first in one.values().items()
        if FIELDS[name].constraint not in _PLACES and not FIELDS[name].per
    }
    joints = between(segment.start.joints, segment.end.joints).tolist()
    posture = {robot.joint_names[index]: joints[index] for index in segment.placed(robot)}
    heights = {
        foot: between(one.swing.get(foot, 0.0), two.swing.get(foot, 0.0)) for foot in robot.feet
    }
    carrying = robot.feet_with(stance_feet)
    return StandTask(
        height=height - float(centre[2]),
        feet=feet,
        swing={f: max(TOUCHING, h) for f, h in heights.items() if f not in carrying},
        ground=replace(ground, heights={f: h for f, h in ground.heights.items() if f in feet}),
        com=(float(com[0]), float(com[1])),
        posture=posture,
        ik_seed=tuple(ik_seed),
        **others,
    )


MAX_JUMP = 0.5
"""A joint that moves by more than this from one sample to the next has jumped (rad)."""

_ROLLED = 1e-8  # m: two iterations of how far a foot rolls that agree
_MAX_ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class PathPlace:
    """A sample of a path's geometry.

    Attributes:
        segment: The segment of the path.
        number: Which one, from 0.
        progress: Of the segment's time by the minimum-jerk law, from 0 to 1.
        share: Of the way, from 0 to 1: the minimum-jerk law of ``progress``.
        stand: The configuration, and which feet carry.
        tangent: (nv,) dq/ds, with s the share: qvel = tangent ds/dt.
        curvature: (nv,) its derivative: qacc = curvature (ds/dt)^2 + tangent d2s/dt2.
    """

    segment: Segment
    number: int
    progress: float
    share: float
    stand: Stand
    tangent: Array
    curvature: Array

    @property
    def qpos(self) -> Array:
        """(nq,) the configuration."""
        return self.stand.qpos

    def motion(self, rate: float, acceleration: float) -> tuple[Array, Array]:
        """Returns qvel and qacc (nv,) where the share has this rate and acceleration (1/s^2)."""
        tangent = self.tangent
        return rate * tangent, rate**2 * self.curvature + acceleration * tangent


@dataclass(frozen=True, eq=False)
class Geometry:
    """Where a path through stances goes.

    Attributes:
        stances: The stances, solved.
        segments: From each to the next.
        places: Samples, evenly spaced in each segment's ``progress``; each stance is one.
        per_segment: Samples from a stance to the next.
        seconds: Time for all (s).
    """

    stances: tuple[Stand, ...]
    segments: list[Segment]
    places: list[PathPlace]
    per_segment: int
    seconds: float

    def where(self, index: int) -> Diagnostic:
        """Says where a sample is, and when."""
        return _where(index, self.per_segment, self.seconds / len(self.segments))


def minimum_jerk(progress: float) -> tuple[float, float, float]:
    """Returns the minimum-jerk law from 0 to 1, and its first two derivatives.

    x^3 (10 - 15 x + 6 x^2): neither velocity nor acceleration at the ends. Source: Flash and Hogan,
    "The coordination of arm movements" (1985).
    """
    x = progress
    return (
        x**3 * (10 - 15 * x + 6 * x**2),
        30 * x**2 * (1 - x) ** 2,
        60 * x * (1 - x) * (1 - 2 * x),
    )


def path_geometry(
    robot: Robot,
    stances: Sequence[StandTask],
    per_segment: int,
    seconds: float,
    *,
    rolling: bool = True,
) -> Geometry:
    """Solves a path's samples on the whole body; ``stance_path`` tells what a path is.

    Args:
        robot: A robot with a floating base.
        stances: The tasks.
        per_segment: Samples from a stance to the next, at least 2.
        seconds: Time for all (s), so that errors say when.
        rolling: Whether the feet roll; otherwise their centres stay.

    Raises:
        ConfigurationError: If the stances cannot follow each other, or a joint jumps.
        NoEquilibriumError: If feet roll away.
        UnknownNameError: If a task names a foot that the robot does not have.
        StanceUnreachableError: If a sample is out of reach; says when.
        StaticsInfeasibleError: If the com leaves the feet; says when.
    """
    segments, solved = segments_of(robot, stances)
    places: list[PathPlace] = []
    ik_seed = np.array(solved[0].joint_positions(robot))
    roll = _Roll(robot, solved[0])
    for index in range(per_segment * len(segments) + 1):
        number = max(0, (index - 1) // per_segment)
        segment, progress = segments[number], index / per_segment - number
        share = minimum_jerk(progress)[0]
        feet = segment.stance_feet
        if index == per_segment * (number + 1):  # in a stance only what carries on both sides
            feet = tuple(foot for foot in feet if foot in segment.after)
        where = _where(index, per_segment, seconds / len(segments))
        try:
            stand = roll.solve(segment, feet, share, ik_seed, rolling=rolling)
        except (StanceUnreachableError, StaticsInfeasibleError, NoEquilibriumError) as error:
            raise error.at(where) from None
        if places and stand.qpos[3:7] @ places[-1].qpos[3:7] < 0:
            stand.qpos[3:7] *= -1  # the same rotation, without a jump
        jumps = np.abs(stand.joint_positions(robot) - ik_seed)
        if jumps.max() > MAX_JUMP:
            message = diagnose(
                "joint-jumps",
                subject=("joint", robot.joint_names[int(jumps.argmax())]),
                jump=Quantity(jumps.max(), "rad"),
                where=where,
            )
            raise ConfigurationError("stances", message)
        ik_seed = stand.joint_positions(robot)
        tangent, curvature = _derivatives(robot, segment, share, stand.qpos, rolling=rolling)
        places.append(PathPlace(segment, number, progress, share, stand, tangent, curvature))
    return Geometry(solved, segments, places, per_segment, seconds)


def _where(index: int, per_segment: int, duration: float) -> Diagnostic:
    number = max(0, (index - 1) // per_segment)
    moment = duration * index / per_segment
    return diagnose("at-the-time", time=moment, one=number + 1, two=number + 2)


class _Roll:
    """Feet that roll without slipping, from sample to sample."""

    def __init__(self, robot: Robot, start: Stand) -> None:
        self.robot = robot
        self.away = {foot: np.zeros(3) for foot in robot.contact_points}  # from their places (m)
        self.step = dict(self.away)  # of the last sample
        self.turned = self._rotations(start)

    def _rotations(self, stand: Stand) -> dict[str, Array]:
        config = Configuration(self.robot, stand.qpos)
        return {foot: config.frame_rotation(self.robot.contact_frames[foot]) for foot in self.away}

    def solve(
        self,
        segment: Segment,
        stance_feet: Sequence[str],
        share: float,
        ik_seed: Array,
        *,
        rolling: bool,
    ) -> Stand:
        """Solves a sample; how far the feet roll and the legs' angles determine each other."""
        robot, out = self.robot, ground_normals(self.robot, segment.start.task.ground)
        away = {foot: place + self.step[foot] for foot, place in self.away.items()}
        for _ in range(_MAX_ITERATIONS):
            task = task_between(robot, segment, stance_feet, share, ik_seed, away)
            stand = solve_stand(robot, task, explain=False)
            if not rolling:
                return stand
            rotations = self._rotations(stand)
            last, away = away, dict(self.away)
            for foot in stance_feet:
                turn = pin.log3(rotations[foot] @ self.turned[foot].T)
                rolled = pin.skew(turn) @ (robot.contact_radius[foot] * out[foot])
                away[foot] = away[foot] + rolled
            if max(np.abs(away[foot] - last[foot]).max() for foot in away) < _ROLLED:
                self.step = {foot: away[foot] - self.away[foot] for foot in away}
                self.away, self.turned = away, rotations
                return stand
        change = max(np.abs(away[foot] - last[foot]).max() for foot in away)
        raise NoEquilibriumError(
            0.0,
            diagnose("feet-roll-without-end", change=Quantity(change, "m")),
        )


def _derivatives(
    robot: Robot, segment: Segment, share: float, qpos: Array, *, rolling: bool
) -> tuple[Array, Array]:
    """Returns dq/ds and its derivative (nv,), in coordinates of qvel, of what the legs hold.

    A path is where constraints hold: c(q) = w(s), with J = dc/dq square. So J dq/ds = dw/ds, and
    J d2q/ds2 = d2w/ds2 - dJ/ds dq/ds; the last is the constraints' acceleration at dq/ds without
    d2q/ds2. (With more joints than constraints, the least motion.)

    The constraints: points of carrying feet that touch the ground stay (rolling), or their centres;
    swing feet, the base's height, and the com move evenly; the base turns as roll, pitch and yaw
    change evenly, and so do joints in a posture.
    """
    one, two = segment.start, segment.end
    angles = np.array([[key.task.roll, key.task.pitch, key.task.yaw] for key in (one, two)])
    rpy, change = angles[0] + share * (angles[1] - angles[0]), angles[1] - angles[0]
    turn = pin.rpy.computeRpyJacobian(rpy, pin.LOCAL)
    turn_rate = pin.rpy.computeRpyJacobianTimeDerivative(rpy, change, pin.LOCAL)
    out = ground_normals(robot, one.task.ground)

    still = Configuration(robot, qpos)
    rows, wanted = [np.eye(robot.nv)[2:6]], [[two.base[2] - one.base[2]], turn @ change]
    rows.append(still.com_jacobian()[:2])
    wanted.append((two.com - one.com)[:2])
    offsets = {
        foot: -robot.contact_radius[foot] * out[foot]
        if rolling and foot in segment.stance_feet
        else np.zeros(3)
        for foot in robot.contact_points
    }
    for foot, offset in offsets.items():
        rows.append(still.frame_jacobian(robot.contact_frames[foot], offset)[:3])
        moves = np.zeros(3) if foot in segment.stance_feet else two.feet[foot] - one.feet[foot]
        wanted.append(moves)
    placed = segment.placed(robot)
    rows.append(np.eye(robot.nv)[robot.nv - robot.nu :][placed])
    wanted.append((two.joints - one.joints)[placed])
    jacobian = np.concatenate(rows)
    tangent: Array = np.linalg.lstsq(jacobian, np.concatenate(wanted))[0]

    moving = Configuration(robot, qpos, tangent)
    nothing = np.zeros(robot.nv)
    drift = [np.zeros(1), -turn_rate @ change]
    drift.append(moving.com_acceleration(nothing)[:2])
    accelerations = moving.foot_accelerations(nothing)
    for foot, offset in offsets.items():
        point = accelerations[foot]
        # The offset is the ground's and does not turn with the foot.
        drift.append(point[:3] + np.cross(point[3:], offset))
    drift.append(np.zeros(len(placed)))
    curvature: Array = np.linalg.lstsq(jacobian, -np.concatenate(drift))[0]
    return tangent, curvature


def clearance(place: PathPlace, foot: str) -> float:
    """Returns a foot's height above the ground (m); zero where it is on it."""
    low = place.stand.task.swing.get(foot, 0.0)
    return 0.0 if low <= TOUCHING else low
