"""What a log is: looked at before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Severity,
    diagnose,
)
from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log

Array = NDArray[np.float64]

_GAP = 1.5
"""Median intervals between two samples: beyond, at least one is missing between them."""

_JUMP = 0.5
"""s: a longer gap is a clock that was set, or a log that was stopped: another run begins."""

_STILL = 2e-3
"""rad, m: a joint whose whole range is less has not moved; the play of a gearbox is more."""

_TWICE = 2.0
"""A joint beyond twice its range's farther end was not there: its unit is another."""

_DEGREES = 180 / np.pi

_SAME_UNIT = (0.2, 5.0)
"""Between these, a ratio of two columns is one of unit 1: 57.3 and 1/57.3 are far outside."""

_BACKWARDS = -0.1
"""Of the correlation between a joint's velocity and its servo's error: a servo gives energy to what
rubs and swings, so that is positive (0.1 to 0.9 in simulated and public logs); with the columns
swapped it is as negative."""

_OPPOSED = -0.7
"""Of the correlation between commands and positions: a quarter of a turn late makes 0, and no servo
that follows its command is later."""

_OWN, _OTHERS = 0.5, 0.9
"""Correlation of a position with its own joint's command, below which it may be another's, and with
that other's. A servo that lags by a third of a period still has 0.5; of joints that are commanded
alike both are high."""

_SLOWEST = 0.1
"""s between samples: servos answer in less, and of a walk of 2 Hz five samples a step are left."""

_UNEVEN = 0.3
"""Of the median interval: of a scheduler that is late it is 0.01 to 0.1."""

_WHOLE = 0.05
"""By so much of a quantum may differences of positions be off whole numbers of it."""

_FINEST = 1e-6
"""rad, m: below, a quantum is that of digits in a file, and no encoder's."""

_COUNTED = 50
"""Steps that tell a quantum: were they any numbers, so many whole ones are 1e-50 probable."""

_SATURATED = 0.999
"""A motor at this share of its limit gives all it can."""


@dataclass(frozen=True, eq=False)
class LogQuality:
    """What a log is.

    Attributes:
        source: The file.
        samples: How many.
        duration: From the first to the last (s).
        interval: Median between two (s).
        jitter: Standard deviation of intervals that are no gaps / their median.
        gaps: Intervals in which samples are missing.
        longest_gap: The longest interval (s).
        jumps: Samples after which the clock has jumped.
        missing: (joints,) share of positions that are missing.
        joints: Those it is of.
        quantum: (joints,) of encoders (rad, m); 0 where positions are no multiples of one.
        range: (joints,) of positions (rad, m).
        moves: (joints,) whether the joint moves at all.
        saturated: (joints,) share of samples in which its motor gives all it can; NaN if not known.
        diagnostics: What is to be said of it.
    """

    source: str
    samples: int
    duration: float
    interval: float
    jitter: float
    gaps: int
    longest_gap: float
    jumps: tuple[int, ...]
    missing: Array
    joints: tuple[str, ...]
    quantum: Array
    range: Array
    moves: NDArray[np.bool_]
    saturated: Array
    diagnostics: tuple[Diagnostic, ...]


@check_arguments
def inspect_log(robot: Robot, log: Log, kp: Array | None = None) -> LogQuality:
    """Looks at a log of a robot, before anything is fitted to it.

    Args:
        robot: The robot.
        log: The log.
        kp: (nu,) of the robot's servos (N m/rad), by which a command is a torque; None: nothing is
            said of motors at their limits unless torques were measured.

    Raises:
        MeasurementError: If no fit can make sense of it: degrees for radians, command and position
            swapped, a velocity in another unit, no joint that moves.
        UnknownNameError: If the robot has not one of the joints.
    """
    placed = log.of(robot)
    steps, interval = np.diff(log.time), log.interval
    gaps = steps > _GAP * interval
    jumps = tuple(np.flatnonzero(steps > max(_JUMP, 10 * interval)).tolist())
    named = [robot.joint_names.index(name) for name in log.joints]
    position = placed.position[:, named]
    with np.errstate(invalid="ignore"):
        finding = np.isfinite(position).any(axis=0)
        filled = np.where(finding, position, 0.0)
        span = np.nanmax(filled, axis=0) - np.nanmin(filled, axis=0)
    quantum = np.array([find_quantum(column) for column in position.T])
    moves = span > np.maximum(_STILL, 3 * quantum)
    found = LogQuality(
        source=log.source,
        samples=len(log.time),
        duration=log.duration,
        interval=interval,
        jitter=float(steps[~gaps].std() / interval),
        gaps=int(gaps.sum()),
        longest_gap=float(steps.max()),
        jumps=jumps,
        missing=np.isnan(position).mean(axis=0),
        joints=log.joints,
        quantum=quantum,
        range=span,
        moves=moves,
        saturated=_saturation(robot, placed, kp)[named],
        diagnostics=(),
    )
    diagnostics = tuple(_remarks(robot, placed, named, found))
    for one in diagnostics:
        if one.severity is Severity.ERROR:
            raise MeasurementError(log.source, one)
    object.__setattr__(found, "diagnostics", diagnostics)
    return found


def find_quantum(values: Array) -> float:
    """Returns of which least difference a column's values are whole multiples apart; 0 of none.

    Args:
        values: (n,) of an encoder; NaN are passed over.
    """
    finding = values[np.isfinite(values)]
    steps = np.abs(np.diff(finding))
    steps = steps[steps > _FINEST]
    if len(steps) < 10:
        return 0.0
    steps = np.sort(steps)[:_COUNTED]  # of longer ones, rounding in the file adds up
    quantum = float(np.median(steps[steps < 1.5 * steps[0]]))
    off = np.abs(steps / quantum - np.round(steps / quantum))
    return quantum if off.max() < _WHOLE else 0.0


def _saturation(robot: Robot, log: Log, kp: Array | None) -> Array:
    """Returns in which share of samples (nu,) motors give all they can."""
    torque = log.torque
    if torque is None and kp is not None:
        torque = kp * (log.command - log.position)
    if torque is None:
        return np.full(robot.nu, np.nan)
    limits = robot.effort_limits
    with np.errstate(invalid="ignore"):
        full = np.abs(torque) >= _SATURATED * limits
    counted = np.isfinite(torque).sum(axis=0)
    share = np.divide(full.sum(axis=0), counted, out=np.full(robot.nu, np.nan), where=counted > 0)
    return np.where(np.isfinite(limits), share, np.nan)


def _remarks(robot: Robot, log: Log, named: list[int], found: LogQuality) -> Iterator[Diagnostic]:
    """Says what is odd in a log whose joints are in a robot's order; what is worst first."""
    if found.interval > _SLOWEST:
        yield diagnose("log-too-slow", interval=Quantity(found.interval, "s"))
    yield from _units(robot, log, named)
    if not found.moves.any():
        yield diagnose("log-without-motion", most=Quantity(found.range.max(initial=0.0), "rad"))
    yield from _exchanged(robot, log, named, found.moves)
    yield from _reversed(robot, log, named, found.moves)
    yield from _swapped(robot, log, named, found.moves)
    still = [name for name, moves in zip(found.joints, found.moves, strict=True) if not moves]
    if still and found.moves.any():
        yield diagnose("joints-do-not-move", joints=still)
    silent = [name for name in robot.joint_names if name not in found.joints]
    if silent:
        yield diagnose("joints-not-in-log", joints=silent)
    if found.jumps:
        after = Quantity(log.time[found.jumps[0]], "s")
        longest = Quantity(found.longest_gap, "s")
        yield diagnose("clock-jumps", count=len(found.jumps), after=after, longest=longest)
    if found.gaps > len(found.jumps):
        median, longest = Quantity(found.interval, "s"), Quantity(found.longest_gap, "s")
        count = found.gaps - len(found.jumps)
        yield diagnose("log-samples-missing", count=count, interval=median, longest=longest)
    if found.jitter > _UNEVEN:
        yield diagnose("log-intervals-uneven", jitter=Quantity(found.jitter, "1"))
    lost = {
        name: share for name, share in zip(found.joints, found.missing, strict=True) if share > 0
    }
    if lost:
        worst = max(lost, key=lambda name: lost[name])
        yield diagnose("cells-missing", joints=list(lost), most=Quantity(lost[worst], "1"))
    full = {
        name: share for name, share in zip(found.joints, found.saturated, strict=True) if share > 0
    }
    if full:
        worst = max(full, key=lambda name: full[name])
        most = Quantity(full[worst], "1")
        yield diagnose("motors-saturated", joints=list(full), worst=worst, most=most)


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
        name = robot.joint_names[index]
        for kind, values in (("position", position), ("command", command)):
            column = values[:, index]
            column = column[np.isfinite(column)]
            # Its median: servos may be asked for what is far beyond a limit, for a moment.
            reach = np.median(np.abs(column)) if column.size else 0.0
            if reach > _TWICE * farthest[index]:
                seen = reach / _DEGREES <= _TWICE * farthest[index]
                yield diagnose(
                    "column-in-degrees",
                    column=f"{kind}.{name}",
                    header=f"{kind}.{name} [deg]",
                    value=Quantity(reach, "rad"),
                    limit=Quantity(farthest[index], "rad"),
                    degrees=bool(seen),
                )


def _units(robot: Robot, log: Log, named: list[int]) -> Iterator[Diagnostic]:
    """Finds columns in another unit than they are said to be in."""
    yield from find_degrees(robot, named, log.position, log.command)
    combination = _ratio(log.command[:, named], log.position[:, named])
    if combination is not None and not _SAME_UNIT[0] < combination < _SAME_UNIT[1]:
        header = f"position.{log.joints[named[0]]} [deg]"
        yield diagnose("columns-of-two-units", ratio=combination, header=header)
    if log.velocity is not None:
        rate = np.gradient(log.position[:, named], log.time, axis=0)
        ratio = _ratio(log.velocity[:, named], rate)
        if ratio is not None and not _SAME_UNIT[0] < ratio < _SAME_UNIT[1]:
            yield diagnose("velocity-in-another-unit", ratio=ratio)


def _ratio(one: Array, other: Array) -> float | None:
    """Returns how much more a column varies than another, in the median of columns."""
    with np.errstate(invalid="ignore"):
        both = np.isfinite(one) & np.isfinite(other)
        spread = [
            (one[rows, column].std(), other[rows, column].std())
            for column, rows in enumerate(both.T)
            if rows.sum() > 1
        ]
    ratios = [above / below for above, below in spread if below > _STILL and above > 0]
    return float(np.median(ratios)) if ratios else None


def _reversed(
    robot: Robot, log: Log, named: list[int], moves: NDArray[np.bool_]
) -> Iterator[Diagnostic]:
    """Finds joints that go the other way than they are commanded to."""
    found = []
    for index, moving in zip(named, moves, strict=True):
        asked, done = log.command[:, index], log.position[:, index]
        both = np.isfinite(asked) & np.isfinite(done)
        if not moving or both.sum() < 10:
            continue
        asked, done = asked[both] - asked[both].mean(), done[both] - done[both].mean()
        if asked @ done < _OPPOSED * np.linalg.norm(asked) * np.linalg.norm(done):
            found.append(robot.joint_names[index])
    if found:
        yield diagnose("command-sign-differs", joints=found)


def _exchanged(
    robot: Robot, log: Log, named: list[int], moves: NDArray[np.bool_]
) -> Iterator[Diagnostic]:
    """Finds joints whose position follows another's command, and not their own."""
    commanded = np.flatnonzero(np.isfinite(log.command).any(axis=0))
    moving = [index for index, one in zip(named, moves, strict=True) if one and index in commanded]
    asked, done = log.command[:, moving], log.position[:, moving]
    finding = np.isfinite(asked).all(axis=1) & np.isfinite(done).all(axis=1)
    if finding.sum() < 10:
        return
    asked, done = (
        asked[finding] - asked[finding].mean(axis=0),
        done[finding] - done[finding].mean(axis=0),
    )
    size = np.outer(np.linalg.norm(asked, axis=0), np.linalg.norm(done, axis=0))
    alike = np.divide(asked.T @ done, size, out=np.zeros_like(size), where=size > 0)
    whose = {
        robot.joint_names[moving[at]]: robot.joint_names[moving[int(np.argmax(column))]]
        for at, column in enumerate(alike.T)
        if column[at] < _OWN and column.max() > _OTHERS
    }
    if whose:
        yield diagnose("positions-of-other-joints", joints=list(whose), whose=list(whose.values()))


def _swapped(
    robot: Robot, log: Log, named: list[int], moves: NDArray[np.bool_]
) -> Iterator[Diagnostic]:
    """Finds joints whose command follows their position.

    A servo's spring gives its joint what friction takes: over a motion the integral of
    (command - position) d position is positive. With the columns swapped it is the integral of
    (position - command) d command, which is as negative: both together are
    -1/2 [(command - position)^2], nothing for a motion that ends as it began.
    """
    backwards, error_of = [], log.command - log.position
    rate = np.gradient(log.position, log.time, axis=0)
    for index, moving in zip(named, moves, strict=True):
        error, speed = error_of[:, index], rate[:, index]
        both = np.isfinite(error) & np.isfinite(speed)
        if not moving or both.sum() < 10:
            continue
        error, speed = error[both] - error[both].mean(), speed[both] - speed[both].mean()
        size = np.linalg.norm(error) * np.linalg.norm(speed)
        if size > 0 and error @ speed < _BACKWARDS * size:
            backwards.append(robot.joint_names[index])
    if len(backwards) > moves.sum() / 2:
        yield diagnose("command-and-position-swapped", joints=backwards)
    elif backwards:
        yield diagnose("position-leads-command", joints=backwards)
