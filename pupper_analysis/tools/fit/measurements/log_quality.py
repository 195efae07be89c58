"""What is odd in a log, before anything is fitted to it: units, columns, clock, joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, diagnose
from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log

Array = NDArray[np.float64]

_GAP = 1.5
"""Median intervals between two samples: beyond, at least one is missing between them."""

_STILL = 2e-3
"""rad, m: a joint whose whole range is less has not moved; the play of a gearbox is more."""

_TWICE = 2.0
"""A joint beyond twice its range's farther end was not there: its unit is another."""

_DEGREES = 180 / np.pi

_SAME_UNIT = (0.2, 5.0)
"""Between these, a ratio of two columns is one of unit 1: 57.3 and 1/57.3 are far outside."""

_BACKWARDS = -0.1
"""Of the correlation between a joint's steps and its servo's error: a servo gives energy to what
rubs and swings, so that is positive (0.1 to 0.9 in simulated and public logs); with the columns
swapped it is as negative."""

_ZERO = 0.1
"""rad, m: by that an encoder's zero may be off, which gives or takes over a motion that ends
elsewhere than it began: three standard deviations of what is known of it."""

_OPPOSED = -0.7
"""Of the correlation between commands and positions: a quarter of a turn late makes 0, and no servo
that follows its command is later."""

_OWN, _OTHERS = 0.5, 0.9
"""Correlation of a position with its own joint's command, below which it may be another's, and with
that other's. A servo that lags by a third of a period still has 0.5; of joints that are commanded
alike both are high."""

_MAX_INTERVAL_DEVIATION = 0.3
"""Standard deviation of the sampling intervals, as a share of their median, above which a log has
uneven intervals. Measured: 0.01 to 0.1 with a scheduler that is late."""

_SLOWEST = 0.1
"""s between samples: servos answer in less, and of a walk of 2 Hz five samples a step are left."""


@check_arguments
def inspect_log(robot: Robot, log: Log) -> tuple[Diagnostic, ...]:
    """Returns what is odd in a log of a robot, before anything is fitted to it.

    Args:
        robot: The robot.
        log: The log.

    Raises:
        MeasurementError: If no fit can make sense of it: degrees for radians, command and position
            swapped, no joint that moves.
        UnknownNameError: If the robot has not one of the joints.
    """
    found = tuple(_remarks(robot, log.order_joints(robot), log.joints))
    for one in found:
        if one.severity is Severity.ERROR:
            raise MeasurementError(log.source, one)
    return found


def _remarks(robot: Robot, log: Log, joints: tuple[str, ...]) -> Iterator[Diagnostic]:
    """Says what is odd in a log whose joints are in a robot's order; what is worst first."""
    named = [robot.joint_names.index(name) for name in joints]
    position, command = log.position[:, named], log.command[:, named]
    if log.interval > _SLOWEST:
        yield diagnose("log-too-slow", interval=Quantity(log.interval, "s"))
    yield from find_degrees(robot, named, log.position, log.command)
    ratio = _ratio(command, position)
    if ratio is not None and not _SAME_UNIT[0] < ratio < _SAME_UNIT[1]:
        yield diagnose("columns-of-two-units", ratio=ratio, header=f"position.{joints[0]} [deg]")
    there = [column[np.isfinite(column)] for column in position.T]
    span = np.array([np.ptp(column) if column.size else 0.0 for column in there])
    moves = span > np.maximum(_STILL, 3 * np.array([find_column_step(one) for one in there]))
    if not moves.any():
        yield diagnose("log-without-motion", most=Quantity(span.max(initial=0.0), "rad"))
    moving = [index for index, one in zip(named, moves, strict=True) if one]
    yield from _of_other_commands(robot, log, moving)
    yield from _swapped(robot, log, moving)
    if (still := [name for name, one in zip(joints, moves, strict=True) if not one]) and moving:
        yield diagnose("joints-do-not-move", joints=still)
    if silent := [name for name in robot.joint_names if name not in joints]:
        yield diagnose("joints-not-in-log", joints=silent)
    yield from _clock(log)


def _clock(log: Log) -> Iterator[Diagnostic]:
    steps, jumps = np.diff(log.time), log.jumps
    interval, longest = Quantity(log.interval, "s"), Quantity(steps.max(), "s")
    if jumps:
        after = Quantity(log.time[jumps[0]], "s")
        yield diagnose("clock-jumps", count=len(jumps), after=after, longest=longest)
    gaps = steps > _GAP * log.interval
    if (count := int(gaps.sum()) - len(jumps)) > 0:
        yield diagnose("log-samples-missing", count=count, interval=interval, longest=longest)
    deviation = float(steps[~gaps].std() / log.interval)
    if deviation > _MAX_INTERVAL_DEVIATION:
        yield diagnose("log-intervals-uneven", deviation=Quantity(deviation, "1"))


def _of_other_commands(robot: Robot, log: Log, moving: list[int]) -> Iterator[Diagnostic]:
    """Finds joints whose position follows another's command, or their own the other way."""
    asked, done = log.command[:, moving], log.position[:, moving]
    rows = (np.isfinite(asked) & np.isfinite(done)).all(axis=1)
    if rows.sum() < 10:
        return
    asked, done = (one[rows] - one[rows].mean(axis=0) for one in (asked, done))
    size = np.outer(np.linalg.norm(asked, axis=0), np.linalg.norm(done, axis=0))
    alike = np.divide(asked.T @ done, size, out=np.zeros_like(size), where=size > 0)
    names = [robot.joint_names[index] for index in moving]
    whose = {
        names[at]: names[int(np.argmax(column))]
        for at, column in enumerate(alike.T)
        if column[at] < _OWN and column.max() > _OTHERS
    }
    if whose:
        yield diagnose("positions-of-other-joints", joints=list(whose), whose=list(whose.values()))
    if turned := [name for name, own in zip(names, np.diag(alike), strict=True) if own < _OPPOSED]:
        yield diagnose("command-sign-differs", joints=turned)


def _swapped(robot: Robot, log: Log, moving: list[int]) -> Iterator[Diagnostic]:
    """Finds joints whose command follows their position.

    A servo's spring gives its joint what friction takes: over a motion the integral of
    (command - position) d position is positive. With the columns swapped it is negative, and so is
    that of (command - position) d command, which is larger by 1/2 [(command - position)^2]: where a
    motion ends with its load on the servo, or the load fell, one is negative without the other.
    """
    backwards = []
    for index in moving:
        asked, done = log.command[:, index], log.position[:, index]
        both = np.isfinite(asked) & np.isfinite(done)
        if both.sum() < 10:
            continue
        steps = np.diff([asked[both], done[both]])
        error = (asked - done)[both]
        error = (error[1:] + error[:-1]) / 2
        size = np.linalg.norm(error - error.mean()) * np.linalg.norm(steps, axis=1)
        given = steps @ error + _ZERO * np.abs(steps.sum(axis=1))
        if (given < _BACKWARDS * size).all():
            backwards.append(robot.joint_names[index])
    if len(backwards) > len(moving) / 2:
        yield diagnose("command-and-position-swapped", joints=backwards)
    elif backwards:
        yield diagnose("position-leads-command", joints=backwards)


def find_degrees(
    robot: Robot, joints: Iterable[int], position: Array, command: Array
) -> Iterator[Diagnostic]:
    """Finds columns that are not in the unit that they are said to be in.

    Args:
        robot: The robot.
        joints: Those to look at.
        position: (n, nu) of them (rad, m); NaN are passed over.
        command: (n, nu) likewise.
    """
    farthest = np.maximum(np.abs(robot.lower_limits), np.abs(robot.upper_limits))
    farthest = np.where(np.isfinite(farthest) & (farthest > 0), farthest, 2 * np.pi)
    for index in joints:
        for kind, values in (("position", position), ("command", command)):
            there = values[np.isfinite(values[:, index]), index]
            # Its median: servos may be asked for what is far beyond a limit, for a moment.
            reach = np.median(np.abs(there)) if there.size else 0.0
            if reach > _TWICE * farthest[index]:
                column = f"{kind}.{robot.joint_names[index]}"
                yield diagnose(
                    "column-in-degrees",
                    column=column,
                    header=f"{column} [deg]",
                    value=Quantity(reach, "rad"),
                    limit=Quantity(farthest[index], "rad"),
                    degrees=bool(reach / _DEGREES <= _TWICE * farthest[index]),
                )


def _ratio(one: Array, other: Array) -> float | None:
    """Returns how much more a column varies than another, in the median of columns."""
    both = np.isfinite(one) & np.isfinite(other)
    pairs = [(one[rows, at], other[rows, at]) for at, rows in enumerate(both.T) if rows.any()]
    ratios = [a.std() / b.std() for a, b in pairs if b.std() > _STILL and a.std() > 0]
    return float(np.median(ratios)) if ratios else None


def find_column_step(column: Array) -> float:
    """Returns the step whose whole multiples a joint's positions (n,) are apart; 0 of none."""
    steps = np.diff(np.sort(column))
    steps = np.sort(steps[steps > _FINEST])[:_COUNTED]
    if len(steps) < _LEAST_STEPS:
        return 0.0
    parts = np.arange(1, 1 + min(_MOST_PARTS, int(steps.min() / _FINEST)))
    ratios = steps / (steps.min() / parts[:, None])
    whole = np.abs(ratios - np.round(ratios)).max(axis=1) < _WHOLE
    return float(steps.min() / parts[whole.argmax()]) if whole.any() else 0.0


_FINEST = 1e-5
"""rad: a file's rounding is finer, and an encoder of 18 bits is not."""

_LEAST_STEPS = 7
"""That many whole multiples are no chance, of all the parts that are tried: 1e-7 each."""

_MOST_PARTS = 400
"""Of the least difference of two stands: those of ten, 0.1 rad apart, are 300 steps of 14 bits."""

_WHOLE = 0.05
"""Of a step: rounding in the file."""

_COUNTED = 50
"""The smallest ones, in which rounding in a file adds up least: were they any numbers, so many
whole ones are 1e-50 probable."""
