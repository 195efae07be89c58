"""Geometry of a path through stances: configurations and derivatives, without dynamics.

`path_geometry` divides a list of stand tasks into segments. Each sample of a segment is a stand.
Its task is interpolated linearly in the path parameter s of the segment, and s follows a
minimum-jerk law in time. dq/ds and d2q/ds2 are computed from the constraints, not by differences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    Infeasibility,
    NoEquilibriumError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_unit, resolve_posture
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.problem import feet_centre, ground_normals
from pupper_analysis.stance.search import MAX_SOLE_ERROR, count_joints_of_short_legs
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.support_polygon import com_margin

_T = TypeVar("_T", float, NDArray[np.float64])
"""Type of a value that is interpolated: a number or an array."""

_PATH_CONSTRAINTS = ("base-height", "base-place", "com-place", "support-margin", "footholds")
"""Names of stance constraints whose task fields `interpolate_task` does not interpolate number by
number. Most follow from the solved stances of a segment.
"""

UNLOADED_HEIGHT = 1e-12
"""Height [m] in a stand task for a foot that is at the ground without load: a positive height marks
a foot as unloaded. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PathStance:
    """A solved stance of the path, in world coordinates.

    Attributes:
        task: Stand task with the height of the solution.
        base: Shape (3,) [m]; position of the base.
        com: Shape (3,) [m]; centre of mass.
        feet: Centre of the sphere of each contact point, shape (3,) [m].
        joints: Shape (nu,) [rad, m]; joint positions.
    """

    task: StandTask
    base: Array
    com: Array
    feet: dict[str, Array]
    joints: Array

    def margin(self, feet: Sequence[str]) -> float:
        """Compute the horizontal distance [m] from the CoM to the edge of a support polygon.

        The distance is positive inside the polygon, which the centres of the contact points
        ``feet`` span.
        """
        return com_margin(self.com, {foot: self.feet[foot] for foot in feet})


@dataclass(frozen=True, eq=False)
class Segment:
    """Part of a path between two successive stances.

    Attributes:
        start: First stance.
        end: Last stance.
        stance_feet: Contact points that carry load during the whole segment.
        before: Contact points that carry load during the previous segment; ``stance_feet`` in the
            first segment.
        after: Contact points that carry load during the next segment; ``stance_feet`` in the last
            segment.
    """

    start: PathStance
    end: PathStance
    stance_feet: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]

    def find_specified_joints(self, robot: Robot) -> list[int]:
        """Return the indices of joints with a position in the task of the first or last stance."""
        tasks = self.start.task, self.end.task
        names = {joint for task in tasks for joint in resolve_posture(robot, task.posture)}
        return sorted(map(robot.joint_names.index, names))


def solve_segments(
    robot: Robot, stances: Sequence[StandTask]
) -> tuple[list[Segment], tuple[Stand, ...]]:
    """Solve the stances of a path, and check that each can follow the previous stance.

    Args:
        robot: Robot with a floating base.
        stances: Two or more stand tasks.

    Returns:
        A segment between each two successive stances; the solved stands.

    Raises:
        ConfigurationError: If a stance cannot follow the previous stance, for example.
        StanceUnreachableError: If a stance is out of reach. The error contains the number of the
            stance.
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
            raise error.with_location(diagnose("of-stance", number=number)) from None
        com = Configuration(robot, solved[-1].qpos).center_of_mass()
        base, joints = solved[-1].qpos[:3], solved[-1].joint_positions(robot)
        keys.append(PathStance(solved[-1].task, base, com, solved[-1].foot_targets, joints))
    sets = []
    for number, (start, end) in enumerate(pairwise(keys), 1):
        swinging = start.task.swing.keys() | end.task.swing.keys()
        idle = {point for foot in swinging for point in robot.feet[foot]}
        sets.append(tuple(foot for foot in robot.contact_points if foot not in idle))
        where = diagnose("between-stances", one=number, two=number + 1)
        if len(sets[-1]) < 3:
            problem = diagnose("too-few-feet-carry", count=len(sets[-1]), where=where)
            raise ConfigurationError("stances", problem)
        for point in sets[-1]:
            if np.abs(start.feet[point] - end.feet[point]).max() > _MAX_FOOT_MOTION:
                problem = _describe_moved_foot(robot, start, end, point, where)
                raise ConfigurationError("stances", problem)
        if number > 1 and not (set(sets[-1]) <= set(sets[-2]) or set(sets[-1]) >= set(sets[-2])):
            problem = diagnose("lands-as-another-lifts", number=number)
            raise ConfigurationError("stances", problem)
    sets = [sets[0], *sets, sets[-1]]
    segments = [
        Segment(start, end, sets[number], sets[number - 1], sets[number + 1])
        for number, (start, end) in enumerate(pairwise(keys), 1)
    ]
    return segments, tuple(solved)


_MAX_FOOT_MOTION = 1e-9
"""Difference [m] of a coordinate of a loaded foot between two successive stances, above which the
foot counts as moved. Smaller differences are errors of solved stands. Chosen, not tuned."""


def _describe_moved_foot(
    robot: Robot, start: PathStance, end: PathStance, point: str, where: Diagnostic
) -> Diagnostic:
    """Return the message that a loaded contact point has different positions in two stances."""
    foot = robot.foot_of(point)
    moved = float(np.linalg.norm(end.feet[point] - start.feet[point]))
    joints = count_joints_of_short_legs(robot).get(foot)
    if joints is None or moved > 2 * MAX_SOLE_ERROR:
        return diagnose("carrying-foot-moves", subject=("foot", point), where=where)
    return diagnose(
        "short-leg-moves-sole",
        subject=("foot", foot),
        joints=joints,
        moved=Quantity(moved, "m"),
        limit=Quantity(_MAX_FOOT_MOTION, "m"),
        where=where,
    )


def interpolate_task(
    robot: Robot,
    segment: Segment,
    stance_feet: Sequence[str],
    share: float,
    ik_seed: Array,
    away: Mapping[str, Array],
) -> StandTask:
    """Create the stand task of a path sample by interpolation between two stances.

    Args:
        robot: Robot.
        segment: Segment of the path.
        stance_feet: Contact points that carry load.
        share: Path parameter s of the segment, from 0 to 1.
        ik_seed: Shape (nu,) [rad, m]; initial guess of the joint positions.
        away: {contact point: displacement by rolling in the world frame, shape (3,) [m]}.

    Raises:
        StaticsInfeasibleError: If the CoM margin in the support polygon is too small.
    """
    first, last = segment.start.task, segment.end.task

    def between(start: _T, end: _T) -> _T:
        """Interpolate linearly between two values; 0 <= ``share`` <= 1 is the path parameter."""
        return start + share * (end - start)

    ground, normals = first.ground, ground_normals(robot, first.ground)
    places = {foot: segment.start.feet[foot] for foot in robot.contact_points}
    places |= {foot: p + share * (segment.end.feet[foot] - p) for foot, p in places.items()}
    points = {point: place + away[point] for point, place in places.items()}
    feet = {}
    for foot, names in robot.feet.items():
        x, y, _ = np.mean([points[point] for point in names], axis=0).tolist()
        feet[foot] = x, y
    contacts = {
        point: ground.centre(robot.foot_of(point), points[point], robot.contact_radius[point])
        - robot.contact_radius[point] * normals[point]
        for point in stance_feet
    }
    centre = feet_centre(robot, ground, contacts, points)
    height = between(float(segment.start.base[2]), float(segment.end.base[2]))
    com = segment.start.com + share * (segment.end.com - segment.start.com)
    _check_com_margin(com, contacts, max(1e-6, between(first.com_margin, last.com_margin) - 1e-9))
    final = last.values()
    others: dict[str, Any] = {
        name: None if None in (value, final[name]) else between(value, final[name])
        for name, value in first.values().items()
        if FIELDS[name].constraint not in _PATH_CONSTRAINTS and not FIELDS[name].per
    }
    joints = between(segment.start.joints, segment.end.joints).tolist()
    posture = {
        robot.joint_names[index]: joints[index] for index in segment.find_specified_joints(robot)
    }
    heights = {
        foot: between(first.swing.get(foot, 0.0), last.swing.get(foot, 0.0)) for foot in robot.feet
    }
    carrying = robot.feet_with(stance_feet)
    return StandTask(
        height=height - float(centre[2]),
        feet=feet,
        swing={f: max(UNLOADED_HEIGHT, h) for f, h in heights.items() if f not in carrying},
        ground=replace(ground, heights={f: h for f, h in ground.heights.items() if f in feet}),
        com=(float(com[0]), float(com[1])),
        posture=posture,
        ik_seed=tuple(ik_seed),
        **others,
    )


def _check_com_margin(com: Array, contacts: Mapping[str, Array], needed: float) -> None:
    """Raise an error if the margin of the CoM in the support polygon is less than ``needed`` [m].

    ``com`` and ``contacts`` {contact point: position} are in the world frame, shape (3,) [m] each.
    """
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


MAX_JUMP = 0.5
"""Upper bound of the motion of a joint between two samples [rad, m]. A path with a larger motion is
refused, since the inverse-kinematics branch has probably changed. Chosen, not tuned."""

_ROLL_TOLERANCE = 1e-8
"""Difference [m] between the foot displacements of two fixed-point iterations below which the
rolling of the feet has converged. Chosen, not tuned: far below the error of a foot in MuJoCo.
"""

_MAX_ROLL_ITERATIONS = 50
"""Maximum number of fixed-point iterations between the rolling displacement of the feet and the leg
angles, which depend on each other. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PathPlace:
    """Sample of the geometry of a path: stand, and derivatives by the path parameter.

    Attributes:
        segment: Segment of the path.
        number: Index of the segment, from 0.
        progress: Time since the start of the segment / duration of the segment.
        share: Path parameter s from 0 to 1: the minimum-jerk law of ``progress``.
        stand: Stand with the configuration and the feet that carry load.
        tangent: Shape (nv,); dq/ds in the coordinates of ``qvel``: qvel = tangent ds/dt.
        curvature: Shape (nv,); d2q/ds2: qacc = curvature (ds/dt)^2 + tangent d2s/dt2.
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
        """Configuration of the sample, shape (nq,) [m, quaternion, rad]."""
        return self.stand.qpos

    def compute_motion(self, rate: float, acceleration: float) -> tuple[Array, Array]:
        """Compute the robot's velocity and acceleration from the rates of the path parameter.

        Args:
            rate: ds/dt of the path parameter s [1/s].
            acceleration: d2s/dt2 [1/s^2].

        Returns:
            ``qvel`` [m/s, rad/s] and ``qacc`` [m/s^2, rad/s^2], shape (nv,) each.
        """
        tangent = self.tangent
        return rate * tangent, rate**2 * self.curvature + acceleration * tangent


@dataclass(frozen=True, eq=False)
class Geometry:
    """Stands of all samples of a path, with derivatives along the path, without dynamics.

    Attributes:
        stances: Solved stances.
        segments: Segments between successive stances.
        places: Samples, evenly spaced in time in each segment; each stance is a sample.
        per_segment: Number of samples per segment.
        seconds: Duration of the path [s].
    """

    stances: tuple[Stand, ...]
    segments: list[Segment]
    places: list[PathPlace]
    per_segment: int
    seconds: float

    def describe_sample(self, index: int) -> Diagnostic:
        """Return the part of an error message with the time [s] and the two stances of a sample.

        ``index`` is the index of the sample in ``places``.
        """
        return _describe_sample(index, self.per_segment, self.seconds / len(self.segments))


def minimum_jerk(progress: float) -> tuple[float, float, float]:
    """Evaluate the minimum-jerk law s = x^3 (10 - 15 x + 6 x^2), ds/dx and d2s/dx2.

    Both derivatives are zero at x = 0 and x = 1. (Flash and Hogan 1985, "The coordination of arm
    movements".)

    Args:
        progress: Fraction x of the duration, from 0 to 1.

    Returns:
        s, ds/dx and d2s/dx2 [1].
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
    """Solve the stands of all samples of a path, and differentiate them along the path.

    Args:
        robot: Robot with a floating base.
        stances: Stand tasks.
        per_segment: Number of samples per segment, at least 2.
        seconds: Duration of the path [s], for the times in error messages.
        rolling: Feet roll without slipping. If False, the centres of the foot spheres stay.

    Raises:
        ConfigurationError: If a stance cannot follow the previous stance, or a joint jumps, for
            example.
        StanceUnreachableError: If a stance or sample is out of reach. The error contains the number
            of the stance, or the time of the sample.
    """
    segments, solved = solve_segments(robot, stances)
    places: list[PathPlace] = []
    ik_seed = np.array(solved[0].joint_positions(robot))
    roll = _RollingFeet(robot, solved[0])
    for index in range(per_segment * len(segments) + 1):
        number = max(0, (index - 1) // per_segment)
        segment, progress = segments[number], index / per_segment - number
        share = minimum_jerk(progress)[0]
        feet = segment.stance_feet
        if index == per_segment * (number + 1):  # at a stance: feet that carry in both segments
            feet = tuple(foot for foot in feet if foot in segment.after)
        where = _describe_sample(index, per_segment, seconds / len(segments))
        try:
            stand = roll.solve(segment, feet, share, ik_seed, rolling=rolling)
        except (StanceUnreachableError, StaticsInfeasibleError, NoEquilibriumError) as error:
            raise error.with_location(where) from None
        if places and stand.qpos[3:7] @ places[-1].qpos[3:7] < 0:
            stand.qpos[3:7] *= -1  # the same rotation, without a jump
        jumps = np.abs(stand.joint_positions(robot) - ik_seed)
        if jumps.max() > MAX_JUMP:
            name = robot.joint_names[int(jumps.argmax())]
            message = diagnose(
                "joint-jumps",
                subject=("joint", name),
                jump=Quantity(jumps.max(), joint_unit(robot, name)),
                where=where,
            )
            raise ConfigurationError("stances", message)
        ik_seed = stand.joint_positions(robot)
        tangent, curvature = _differentiate_path(robot, segment, share, stand.qpos, rolling=rolling)
        places.append(PathPlace(segment, number, progress, share, stand, tangent, curvature))
    return Geometry(solved, segments, places, per_segment, seconds)


def _describe_sample(index: int, per_segment: int, duration: float) -> Diagnostic:
    """Return the part of an error message with the time [s] of a sample and the stances around it.

    ``index`` is the index of the sample in the path; a segment has the duration ``duration`` [s].
    """
    number = max(0, (index - 1) // per_segment)
    moment = duration * index / per_segment
    return diagnose("at-the-time", time=moment, one=number + 1, two=number + 2)


class _RollingFeet:
    """Displacements of spherical feet that roll without slipping, from path sample to path sample.

    Attributes:
        away: Displacement of each contact point from its position in the stance, shape (3,) [m].
        step: Change of ``away`` at the last sample, used as initial guess.
        turned: Orientation of each contact point in the world at the last sample, shape (3, 3).
    """

    def __init__(self, robot: Robot, start: Stand) -> None:
        self.robot = robot
        self.away = {foot: np.zeros(3) for foot in robot.contact_points}
        self.step = dict(self.away)
        self.turned = self._compute_rotations(start)

    def _compute_rotations(self, stand: Stand) -> dict[str, Array]:
        """Return {contact point: rotation of its frame in the world, shape (3, 3)}."""
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
        """Solve the stand of a sample by iteration between leg angles and rolling of the feet.

        The displacements of the feet are stored for the next sample.

        Args:
            segment: Segment of the path.
            stance_feet: Contact points that carry load.
            share: Path parameter s of the segment, from 0 to 1.
            ik_seed: Initial guess of the joint positions, shape (nu,) [rad, m].
            rolling: Whether feet roll; otherwise the stand is solved once, and nothing is stored.

        Raises:
            NoEquilibriumError: If the rolling displacement does not converge.
            StanceUnreachableError: If the sample is out of reach.
        """
        robot, normals = self.robot, ground_normals(self.robot, segment.start.task.ground)
        away = {foot: place + self.step[foot] for foot, place in self.away.items()}
        for _ in range(_MAX_ROLL_ITERATIONS):
            task = interpolate_task(robot, segment, stance_feet, share, ik_seed, away)
            stand = solve_stand(robot, task, explain=False)
            if not rolling:
                return stand
            rotations = self._compute_rotations(stand)
            last, away = away, dict(self.away)
            for foot in stance_feet:
                turn = pin.log3(rotations[foot] @ self.turned[foot].T)
                rolled = pin.skew(turn) @ (robot.contact_radius[foot] * normals[foot])
                away[foot] = away[foot] + rolled
            if max(np.abs(away[foot] - last[foot]).max() for foot in away) < _ROLL_TOLERANCE:
                self.step = {foot: away[foot] - self.away[foot] for foot in away}
                self.away, self.turned = away, rotations
                return stand
        change = max(np.abs(away[foot] - last[foot]).max() for foot in away)
        problem = diagnose("feet-roll-without-end", change=Quantity(change, "m"))
        raise NoEquilibriumError(None, problem)


def _differentiate_path(
    robot: Robot, segment: Segment, share: float, qpos: Array, *, rolling: bool
) -> tuple[Array, Array]:
    """Compute the derivatives dq/ds and d2q/ds2 of a path's configuration, shape (nv,) each.

    The coordinates are those of ``qvel``; s is the path parameter ``share``. On a path the
    constraints c(q) = w(s) hold, with J = dc/dq. Therefore

        J dq/ds = dw/ds and J d2q/ds2 = d2w/ds2 - (dJ/ds) dq/ds.

    The last term is the acceleration of the constraints for the velocity dq/ds and zero
    acceleration. If the constraints leave motions free, the minimum-norm solution is returned (m
    and rad mixed).
    """
    start, end = segment.start, segment.end
    angles = np.array([[key.task.roll, key.task.pitch, key.task.yaw] for key in (start, end)])
    rpy, change = angles[0] + share * (angles[1] - angles[0]), angles[1] - angles[0]
    turn = pin.rpy.computeRpyJacobian(rpy, pin.LOCAL)
    turn_rate = pin.rpy.computeRpyJacobianTimeDerivative(rpy, change, pin.LOCAL)
    normals = ground_normals(robot, start.task.ground)

    still = Configuration(robot, qpos)
    rows, rates = [np.eye(robot.nv)[2:6]], [[end.base[2] - start.base[2]], turn @ change]
    rows.append(still.com_jacobian()[:2])
    rates.append((end.com - start.com)[:2])
    offsets = {
        foot: -robot.contact_radius[foot] * normals[foot]
        if rolling and foot in segment.stance_feet
        else np.zeros(3)
        for foot in robot.contact_points
    }
    for foot, offset in offsets.items():
        rows.append(still.frame_jacobian(robot.contact_frames[foot], offset)[:3])
        moves = np.zeros(3) if foot in segment.stance_feet else end.feet[foot] - start.feet[foot]
        rates.append(moves)
    placed = segment.find_specified_joints(robot)
    rows.append(np.eye(robot.nv)[robot.nv - robot.nu :][placed])
    rates.append((end.joints - start.joints)[placed])
    jacobian = np.concatenate(rows)
    tangent: Array = np.linalg.lstsq(jacobian, np.concatenate(rates))[0]

    moving = Configuration(robot, qpos, tangent)
    no_acceleration = np.zeros(robot.nv)
    drift = [np.zeros(1), -turn_rate @ change]
    drift.append(moving.com_acceleration(no_acceleration)[:2])
    accelerations = moving.foot_accelerations(no_acceleration)
    for foot, offset in offsets.items():
        point = accelerations[foot]
        # The offset is fixed to the ground and does not rotate with the foot.
        drift.append(point[:3] + np.cross(point[3:], offset))
    drift.append(np.zeros(len(placed)))
    curvature: Array = np.linalg.lstsq(jacobian, -np.concatenate(drift))[0]
    return tangent, curvature


def clearance(place: PathPlace, foot: str) -> float:
    """Return the planned height [m] of a foot above the ground at a path sample; 0 in contact.

    ``foot`` is the name of the foot, not of one of its contact points.
    """
    height = place.stand.task.swing.get(foot, 0.0)
    return 0.0 if height <= UNLOADED_HEIGHT else height
