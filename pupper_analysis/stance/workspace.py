"""Workspace of the base with planted feet: reachable intervals of height [m], angles [rad], x, y.

`base_workspace` searches each coordinate separately from the stand of a task, outward in both
directions. A step is halved if no stand is found after the step (bisection). The IK of each step
starts at the last stand; other initial guesses are tried as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import HINGE_UNITS, POSITION_UNIT, SLIDE_UNITS
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.stance.problem import can_move_com, compute_targets
from pupper_analysis.stance.search import search_near_stand, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask

BISECTION_RTOL = 1e-3
"""Step length, relative to the first step of the search (`_FIRST_STEPS`), down to which the search
for the end of a reachable interval continues. Also the relative distance to `_MAX_VALUES` within
which an interval counts as ending there. Chosen, not tuned."""

_FULL_SEARCH_RATIO = 0.4
"""Step length of the outward search, relative to the first step (`_FIRST_STEPS`), above which a
full search (`search_stand`) follows if IK from the last stand fails. After a gap
(`_RESTART_RATIO`), a full search follows at each step length. Chosen, not tuned."""

_RESTART_RATIO = 0.2
"""Step length after the outward search has crossed a gap, relative to the first step
(`_FIRST_STEPS`). A gap is a part of the interval in which IK from the last stand fails, but beyond
the gap a full search finds a stand. Chosen, not tuned."""

_GAP_RATIO = 8e-3
"""Distance beyond the last reachable value at which one more stand is tried before the search ends,
relative to the first step of the search. Another IK branch may begin there. For pitch the distance
is 3.2 mrad. Chosen larger than a gap of 1.3 mrad in the pitch of Pupper v3."""

DIRECTIONS = ("height", "roll", "pitch", "yaw", "x", "y")
"""Base coordinates whose reachable intervals `base_workspace` determines."""

ANGLE_COORDINATES = ("roll", "pitch", "yaw")
"""Coordinates of the base that are angles [rad]; the others are lengths [m]."""

_FIRST_STEPS = {"height": 0.1, "roll": 0.4, "pitch": 0.4, "yaw": 0.4, "x": 0.05, "y": 0.05}
"""{base coordinate: first step of the outward search from the initial stand [m or rad]}. Chosen,
not tuned."""
_MAX_VALUES = {"roll": math.pi, "pitch": math.pi / 2, "yaw": math.pi}
"""{angle: largest absolute value [rad] that is searched}. Roll, pitch and yaw within these bounds
describe all rotations."""


@dataclass(frozen=True)
class Interval(Result):
    """Reachable interval of one base coordinate, with the feet planted.

    Attributes:
        low: Lower end (rad or m).
        high: Upper end (rad or m).
    """

    low: float = field(metadata={"unit": POSITION_UNIT})
    high: float = field(metadata={"unit": POSITION_UNIT})


def get_coordinate_unit(coordinate: str) -> str:
    """Return the unit of a coordinate of base or feet: rad for roll, pitch and yaw, otherwise m."""
    units = HINGE_UNITS if coordinate in ANGLE_COORDINATES else SLIDE_UNITS
    return units.position


@dataclass(frozen=True, eq=False)
class BaseWorkspace(Tabular):
    """Reachable intervals of the base with planted feet, for each direction separately.

    Attributes:
        name: Name of the robot.
        start: Stand at which the search starts.
        intervals: {``height`` (m, of the base above the centre of the feet), ``roll``, ``pitch``,
            ``yaw`` (rad, absolute), ``x``, ``y`` (m, of the base from the centre of the feet)}.
        limits: {direction: (reason for the lower end, reason for the upper end)}. Examples are
            joints at their limits and the reach of the legs.
        mismatch: Message that the CoM of the MJCF is beside the CoM of the URDF, from which the
            intervals are computed; None if both agree horizontally.
        missing_masses: Message about links with assumed masses, on which the CoM depends; None if
            the files state all.
    """

    _warnings: ClassVar[tuple[str, ...]] = ("mismatch", "missing_masses")

    name: str
    start: Stand
    intervals: dict[str, Interval] = field(metadata={"unit": "m or rad"})
    limits: dict[str, tuple[Diagnostic, Diagnostic]]
    mismatch: Diagnostic | None = None
    missing_masses: Diagnostic | None = None

    @property
    def passed(self) -> bool:
        """Whether the files state all masses."""
        return self.missing_masses is None

    def _field_units(self) -> dict[str, dict[str, str]]:
        """Return the unit of each direction in ``intervals``."""
        return {"intervals": {name: get_coordinate_unit(name) for name in self.intervals}}

    def _columns(self) -> dict[str, list[object]]:
        """Return {column: values} of a table with a row per direction, and the unit of the row."""
        return {
            "direction": [*self.intervals],
            "low": [interval.low for interval in self.intervals.values()],
            "high": [interval.high for interval in self.intervals.values()],
            "unit": [get_coordinate_unit(name) for name in self.intervals],
            "lower_limit": [str(self.limits[name][0]) for name in self.intervals],
            "upper_limit": [str(self.limits[name][1]) for name in self.intervals],
        }


@check_arguments
def reachable_heights(robot: Robot, task: StandTask | None = None) -> Interval:
    """Find the interval of base heights [m] that satisfy all other requirements of a task.

    The interval ends at the first height without a stand that the search finds. `base_workspace`
    describes the position of the CoM.

    Args:
        robot: Robot.
        task: Task whose height is the start of the search. Default: the nominal stand,
            ``StandTask()``.

    Raises:
        StanceUnreachableError: If the task is unreachable.
        ConfigurationError: If the robot cannot stand, the task is invalid, or the task welds the
            base.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
    """
    start = solve_stand(robot, task)
    _check_base_moves(start.check(robot))
    return find_interval(start.check(robot), start, "height")


def _check_base_moves(robot: Robot) -> None:
    """Raise a ConfigurationError if a task welds the base of the robot to the world."""
    if robot.is_base_fixed:
        raise ConfigurationError("contacts", diagnose("base-is-welded", robot=robot.name))


@check_arguments
def base_workspace(robot: Robot, task: StandTask | None = None) -> BaseWorkspace:
    """Find the reachable intervals of the base in height [m], roll, pitch, yaw [rad], x and y [m].

    Each coordinate is varied separately, outward from its value in the task's stand to the first
    value without a stand that the search finds; short gaps in an interval may be missed. Feet stay
    planted.

    The CoM keeps the horizontal position that the task requires. If the task permits any position
    inside the support polygon, the CoM keeps its position in the task's stand, or stays free if the
    legs cannot move it in two directions (`can_move_com`). With an ``offset`` in the task, the base
    keeps this offset instead. For shifts in x and y, the CoM follows the base and must keep the
    task's margin. Roll and yaw are searched up to pi, pitch up to pi / 2: within these bounds the
    three angles describe all rotations.

    Args:
        robot: Robot.
        task: Task at which the search starts. Default: the nominal stand, ``StandTask()``.

    Raises:
        StanceUnreachableError: If the task is unreachable.
        ConfigurationError: If the robot cannot stand, the task is invalid, or the task welds the
            base.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
    """
    start = solve_stand(robot, task)
    robot = start.check(robot)
    _check_base_moves(robot)
    intervals, limits, ends = {}, {}, [start]
    for count, direction in enumerate(DIRECTIONS):
        report_progress("directions", count, len(DIRECTIONS))
        (low, lowest), (high, highest) = (
            _find_limit(robot, start, direction, sign, math.inf, default_guesses_only=False)
            for sign in (-1.0, 1.0)
        )
        intervals[direction] = Interval(low, high)
        ends += [lowest, highest]
        limits[direction] = (
            _describe_base_limit(robot, start, lowest, direction, low),
            _describe_base_limit(robot, start, highest, direction, high),
        )
    return BaseWorkspace(
        name=robot.name,
        start=start,
        intervals=intervals,
        limits=limits,
        mismatch=_describe_com_mismatch(robot, ends),
        missing_masses=describe_missing_masses(robot),
    )


_MAX_COM_DISTANCE = 5e-5
"""Largest horizontal distance [m] between the CoMs of both files that is not reported: the accuracy
of the ends in x and y, `BISECTION_RTOL` times the first step."""


def _describe_com_mismatch(robot: Robot, stands: Iterable[Stand]) -> Diagnostic | None:
    """Create the message that the CoMs of MuJoCo's and Pinocchio's models differ in a stand.

    The distance is horizontal, as the support polygon: equal factors on all masses have no effect.
    """
    base = robot.mj_model.body(robot.mj_base).id
    distance = max(
        math.dist(
            robot.compute_kinematics(stand.qpos).subtree_com[base, :2],
            Configuration(robot, stand.qpos).center_of_mass()[:2],
        )
        for stand in stands
    )
    if not distance > _MAX_COM_DISTANCE:
        return None
    urdf, mjcf = robot.describe_masses()
    moved = Quantity(distance, "m")
    return diagnose("range-of-two-robots", urdf=urdf, mjcf=mjcf, distance=moved)


_LIMIT_DISTANCE = 0.01
"""Distance [rad, m] between a moved joint and the joint limit (with margin) below which the limit
is reported as the reason for the end of an interval. Also the displacement above which a joint
counts as moved. Chosen, not tuned."""

_EDGE_DISTANCE = 1e-3
"""Excess [m] of a margin or clearance over its required value, below which this requirement is
reported as the reason for the end of an interval. Chosen: ten times the accuracy of the ends in
height."""


def _describe_base_limit(
    robot: Robot, start: Stand, end: Stand, direction: str, value: float
) -> Diagnostic:
    """Create the message why the interval of a base coordinate ends at the stand ``end``."""
    task = start.task
    if abs(value) >= _MAX_VALUES.get(direction, math.inf) * (1 - BISECTION_RTOL):
        return diagnose("workspace-ends-at-full-turn")
    positions = end.joint_positions(robot)
    distances = np.minimum(positions - robot.lower_limits, robot.upper_limits - positions)
    at_limit = distances - task.joint_margin < _LIMIT_DISTANCE
    moved = np.abs(positions - start.joint_positions(robot)) > _LIMIT_DISTANCE
    joints = [name for name, at in zip(robot.joint_names, at_limit & moved, strict=True) if at]
    if joints:
        return diagnose("workspace-ends-at-joint-limits", joints=joints)
    clearance = end.ground_clearance
    if clearance is not None and clearance.distance - task.ground_clearance < _EDGE_DISTANCE:
        return diagnose("workspace-ends-at-ground", links=clearance.links)
    between, least = end.self_clearance, task.self_clearance or 0.0
    if between is not None and between.distance - least < _EDGE_DISTANCE:
        return diagnose("workspace-ends-at-links", links=between.links)
    if direction in ("x", "y") and end.com_margin - task.com_margin < _EDGE_DISTANCE:
        return diagnose("workspace-ends-at-support")
    return diagnose("workspace-ends-at-reach")


def find_interval(
    robot: Robot,
    start: Stand,
    direction: str,
    enough: float = math.inf,
    *,
    default_guesses_only: bool = False,
) -> Interval:
    """Find the reachable interval of one base coordinate [m or rad], with the feet planted.

    The search moves outward from the stand in both directions, to the first unreachable stand that
    is found. `base_workspace` describes which other quantities stay constant.

    Args:
        robot: Robot.
        start: Stand at which the search starts.
        direction: An element of ``DIRECTIONS``.
        enough: Distance [m or rad] from the start. Each direction of the search ends as soon as
            this distance is reached or exceeded.
        default_guesses_only: Whether full searches start from `default_initial_guesses` only.
    """
    (low, _), (high, _) = (
        _find_limit(robot, start, direction, sign, enough, default_guesses_only)
        for sign in (-1.0, 1.0)
    )
    return Interval(low, high)


def _find_limit(
    robot: Robot,
    start: Stand,
    direction: str,
    sign: float,
    enough: float,
    default_guesses_only: bool,
) -> tuple[float, Stand]:
    """Find an end of the reachable interval of a base coordinate; return value and stand there.

    The search moves outward from ``start``, towards larger (``sign`` 1) or smaller values (-1), at
    most until it has reached the distance ``enough`` [m or rad]. IK starts at the last stand, but
    the end must also be reachable from the initial guesses of `search_stand`.
    """
    first, most = _FIRST_STEPS[direction], _MAX_VALUES.get(direction, math.inf)
    first_value = value = _get_coordinate(robot, start, direction)
    step, least, last = first, BISECTION_RTOL * first, start
    shortest = _FULL_SEARCH_RATIO * first  # step with a full search

    def try_value(further: float, near: Stand | None = None) -> bool:
        """Return True if a stand exists at ``further`` [m or rad]; store value and stand.

        ``near`` is the initial guess; None for all guesses of `search_stand`.
        """
        nonlocal value, last
        if abs(further) > most:
            return False
        stand = _solve_at(robot, start, direction, further, near, default_guesses_only)
        if stand is not None:
            value, last = further, stand
        return stand is not None

    while step > least and abs(value - first_value) < enough:
        further, gap = value + sign * step, value + sign * _GAP_RATIO * first
        if try_value(further, last) or (step > shortest and try_value(further)):
            continue
        if step <= 2 * least < shortest and (try_value(further) or try_value(gap)):
            step, shortest = _RESTART_RATIO * first, 0.0  # beyond a gap
        else:
            step /= 2
    while value != first_value and not try_value(value):  # must be reachable without a nearby stand
        value = first_value + sign * max(0.0, abs(value - first_value) - least)
        least *= 2
    return value, start if value == first_value else last


def _get_coordinate(robot: Robot, start: Stand, direction: str) -> float:
    """Return the value [m or rad] of a base coordinate, one of ``DIRECTIONS``, in a stand."""
    if direction in ("x", "y"):
        return float(_base_offset(robot, start)["xy".index(direction)])
    return float(getattr(start.task, direction))


def _base_offset(robot: Robot, start: Stand) -> Array:
    """Return the base position relative to the centre of the feet, world x and y, (2,) [m]."""
    offset: Array = start.qpos[:2] - start.centre(robot)[:2]
    return offset


def _solve_at(
    robot: Robot,
    start: Stand,
    direction: str,
    value: float,
    near: Stand | None,
    default_guesses_only: bool,
) -> Stand | None:
    """Search for a stand with a base coordinate ``value`` [m or rad], from ``near`` if given."""
    try:
        targets = compute_targets(robot, _make_task(robot, start, direction, value), {})
    except ConfigurationError:
        return None
    with borrow(robot, SearchContext) as context:
        if near is None:
            stand: Stand | None = search_stand(
                context, targets, default_guesses_only=default_guesses_only
            )
        else:
            stand = search_near_stand(context, targets, near)
    if stand is None or not stand.solved:
        return None
    if direction in ("x", "y") and stand.com_margin < start.task.com_margin:
        return None
    return stand


def _make_task(robot: Robot, start: Stand, direction: str, value: float) -> StandTask:
    """Return a stand's task with another value [m or rad] of a single base coordinate.

    `base_workspace` describes which CoM position or base offset the task then requires. x and y are
    relative to the centre of the feet.
    """
    changes: dict[str, Any] = {direction: value}
    if start.task.com == "inside" and can_move_com(robot):
        x, y, _ = Configuration(robot, start.qpos).center_of_mass().tolist()
        changes |= {"com": (x, y), "com_margin": 0.0}
    if direction in ("x", "y"):
        x, y = _base_offset(robot, start).tolist()
        place = (value, y) if direction == "x" else (x, value)
        changes = {"com": "centre", "offset": place}
    return replace(start.task, **changes)
