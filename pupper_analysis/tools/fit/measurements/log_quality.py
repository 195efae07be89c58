"""Checks of a log before a fit: units, exchanged columns, clock and resting joints.

`inspect_log` returns the findings for a robot. Units are checked with the joint limits, and with
the ratio of commands to positions. Exchanged columns are found by correlations, and by the sign of
the work of the servos. `find_column_step` determines the encoder step from the differences of the
positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, diagnose
from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log

_MAX_GAP_RATIO = 1.5
"""Largest time between two successive samples, in units of the median interval. A longer time means
that samples are missing. Chosen, not tuned.
"""

_MIN_JOINT_RANGE = 2e-3
"""Largest range of positions [rad, m] with which a joint counts as at rest, unless the encoder is
coarse. Also the largest standard deviation of positions with which units are not compared. Chosen,
not tuned.
"""

_MAX_REACH_RATIO = 2.0
"""Largest plausible ratio of a median absolute position or command to the larger absolute joint
limit. If the ratio is larger, the unit is considered wrong. Chosen, not tuned.
"""

_DEGREES_PER_RADIAN = 180 / np.pi
"""Degrees per radian."""

_SAME_UNIT_RATIOS = (0.2, 5.0)
"""Bounds of the median ratio, over the joints, between the standard deviations of commands and
positions in equal units. With degrees and radians the ratio is about 57.3 or 1/57.3. Chosen, not
tuned.
"""

_MAX_SWAPPED_CORRELATION = -0.1
"""Upper bound of two correlations if commands and positions are swapped: of the servo error
(command - position) with the changes of the position between samples, and with the changes of the
command. A servo supplies the energy that friction dissipates. Measured in simulated and public
logs: 0.1 to 0.9, and -0.9 to -0.1 if the columns are swapped.
"""

_OFFSET_ALLOWANCE = 0.1
"""Encoder offset [rad, m] that the check for swapped columns allows for. The offset changes the
energy balance of a motion if start and end positions differ. About three standard deviations of the
default prior of offsets (2 deg).
"""

_MAX_OPPOSED_CORRELATION = -0.7
"""Correlation of the commands and positions of a joint below which one of the signs is considered
wrong. A delay of a quarter period gives 0. Chosen, not tuned.
"""

_MIN_OWN_CORRELATION = 0.5
"""Correlation of the positions and commands of a joint below which the column of positions may
belong to another joint (`_MIN_OTHER_CORRELATION`). Chosen, not tuned.
"""

_MIN_OTHER_CORRELATION = 0.9
"""Correlation of the positions of a joint with the commands of another joint above which the column
may belong to the other joint. The correlation with the own commands must also be low
(`_MIN_OWN_CORRELATION`), since both are high for similar commands. Chosen, not tuned.
"""

_MIN_EXCHANGE_RATIO = 4.0
"""Ratio of two unexplained shares of the variance of positions, above which two joints are
exchanged: with the own commands, and with the commands of the other joint. The ratio must be
exceeded at both joints, since a load may disturb one of them. Chosen, not tuned.
"""

_MAX_INTERVAL_DEVIATION = 0.3
"""Upper bound of the standard deviation of the sampling intervals, without gaps, divided by the
median interval. Above the bound, the intervals are uneven. Measured with a late scheduler: 0.01 to
0.1.
"""

_MAX_INTERVAL = 0.1
"""Largest median sampling interval [s] of a log. A slower log is refused, since servos respond
faster; a motion at 2 Hz would have five samples per period. Chosen, not tuned.
"""

_MIN_INTERVAL = 1e-4
"""Median sampling interval [s] at or below which a log is refused. Derived: `_MAX_INTERVAL` divided
by 1000. The times of any acceptable log are therefore refused if they are 1000 times too small.
Logs of robots are sampled at up to 5 kHz.
"""


@check_arguments
def inspect_log(robot: Robot, log: Log) -> tuple[Diagnostic, ...]:
    """Check whether a log suits a robot and a fit; return warnings and notes.

    Raises:
        MeasurementError: If a fit cannot use the log, for example because of degrees instead of
            radians, swapped columns of commands and positions, or no moving joint.
        UnknownNameError: If the robot lacks a joint of the log.
    """
    remarks = tuple(_list_remarks(robot, log.order_joints(robot), log.joints))
    for remark in remarks:
        if remark.severity is Severity.ERROR:
            raise MeasurementError(log.source, remark)
    return remarks


def _list_remarks(robot: Robot, log: Log, joints: tuple[str, ...]) -> Iterator[Diagnostic]:
    """Yield remarks on a log: errors, warnings and notes.

    ``joints`` are the joints that the file contains; the columns of ``log`` are in actuator order.
    """
    indices = [robot.joint_names.index(name) for name in joints]
    position, command = log.position[:, indices], log.command[:, indices]
    if log.interval > _MAX_INTERVAL:
        yield diagnose("log-too-slow", interval=Quantity(log.interval, "s"))
    if log.interval <= _MIN_INTERVAL:
        yield diagnose("log-too-fast", interval=Quantity(log.interval, "s"))
    yield from find_degrees(robot, indices, log.position, log.command)
    ratio = _compute_column_ratio(command, position)
    if ratio is not None and not _SAME_UNIT_RATIOS[0] < ratio < _SAME_UNIT_RATIOS[1]:
        yield diagnose("columns-of-two-units", ratio=ratio, header=f"position.{joints[0]} [deg]")
    finite_columns = [column[np.isfinite(column)] for column in position.T]
    ranges = np.array([np.ptp(column) if column.size else 0.0 for column in finite_columns])
    has_moved = ranges > np.maximum(
        _MIN_JOINT_RANGE, 3 * np.array([find_column_step(column) for column in finite_columns])
    )
    if not has_moved.any():
        yield diagnose("log-without-motion", most=Quantity(ranges.max(initial=0.0), "rad"))
    moving = [index for index, moved in zip(indices, has_moved, strict=True) if moved]
    yield from _find_exchanged_joints(robot, log, moving)
    yield from _find_swapped_columns(robot, log, moving)
    if (
        resting := [name for name, moved in zip(joints, has_moved, strict=True) if not moved]
    ) and moving:
        yield diagnose("joints-do-not-move", joints=resting)
    if missing := [name for name in robot.joint_names if name not in joints]:
        yield diagnose("joints-not-in-log", joints=missing)
    yield from _check_clock(log)


def _check_clock(log: Log) -> Iterator[Diagnostic]:
    """Yield remarks on the sample times [s] of a log: clock jumps, gaps, uneven intervals."""
    steps, jumps = np.diff(log.time), log.jumps
    interval, longest = Quantity(log.interval, "s"), Quantity(steps.max(), "s")
    if jumps:
        after = Quantity(log.time[jumps[0]], "s")
        yield diagnose("clock-jumps", count=len(jumps), after=after, longest=longest)
    gaps = steps > _MAX_GAP_RATIO * log.interval
    missing = np.delete(steps, jumps)
    missing = missing[missing > _MAX_GAP_RATIO * log.interval]
    if missing.size:
        longest = Quantity(missing.max(), "s")
        yield diagnose(
            "log-samples-missing", count=missing.size, interval=interval, longest=longest
        )
    deviation = float(steps[~gaps].std() / log.interval)
    if deviation > _MAX_INTERVAL_DEVIATION:
        yield diagnose("log-intervals-uneven", deviation=Quantity(deviation, "1"))


def _find_exchanged_joints(robot: Robot, log: Log, moving: list[int]) -> Iterator[Diagnostic]:
    """Yield diagnostics on joints whose measured position follows the wrong command.

    Examples are the command of another joint, and the own command with the opposite sign.
    ``moving`` are the indices of the compared joints.
    """
    command, position = log.command[:, moving], log.position[:, moving]
    rows = (np.isfinite(command) & np.isfinite(position)).all(axis=1)
    if rows.sum() < 10 or not moving:
        return
    command, position = (series[rows] - series[rows].mean(axis=0) for series in (command, position))
    norms = np.outer(np.linalg.norm(command, axis=0), np.linalg.norm(position, axis=0))
    correlations = np.divide(command.T @ position, norms, out=np.zeros_like(norms), where=norms > 0)
    names = [robot.joint_names[index] for index in moving]
    own, best = np.diag(correlations), correlations.argmax(axis=0)
    # The command of a joint that follows its own command belongs to no other joint.
    is_opposed = (own < _MAX_OPPOSED_CORRELATION) & (
        (-own >= correlations.max(axis=0)) | (own[best] > _MIN_OWN_CORRELATION)
    )
    source_joints = {
        names[index]: names[best[index]]
        for index, column in enumerate(correlations.T)
        if column.max() > _MIN_OTHER_CORRELATION
        and not is_opposed[index]
        and (
            column[index] < _MIN_OWN_CORRELATION
            or _is_exchanged(correlations, index, int(best[index]))
        )
    }
    if source_joints:
        yield diagnose(
            "positions-of-other-joints",
            joints=list(source_joints),
            whose=list(source_joints.values()),
        )
    if opposed := [name for name, turned in zip(names, is_opposed, strict=True) if turned]:
        yield diagnose("command-sign-differs", joints=opposed)


def _is_exchanged(correlations: Array, joint: int, other: int) -> bool:
    """Whether the commands of each of two joints explain the positions of the other joint better.

    ``correlations`` of commands (rows) and positions (columns) have the shape (n, n). The shares of
    the variance that the commands do not explain are compared (`_MIN_EXCHANGE_RATIO`).
    """
    unexplained = 1 - np.square(correlations)
    own = unexplained[[joint, other], [joint, other]]
    exchanged = unexplained[[other, joint], [joint, other]]
    return bool((own > _MIN_EXCHANGE_RATIO * exchanged).all())


def _find_swapped_columns(robot: Robot, log: Log, moving: list[int]) -> Iterator[Diagnostic]:
    """Yield a diagnostic that lists the joints whose command follows the position.

    A servo supplies the energy that friction dissipates. Therefore the integral of (command -
    position) d position over a motion is usually positive. With swapped columns this integral is
    usually negative, and also the integral of (command - position) d command. Both are tested,
    because a single integral may be negative if the load of the servo differs between start and
    end.
    """
    backwards = []
    for index in moving:
        command, position = log.command[:, index], log.position[:, index]
        is_finite = np.isfinite(command) & np.isfinite(position)
        if is_finite.sum() < 10:
            continue
        steps = np.diff([command[is_finite], position[is_finite]])
        error = (command - position)[is_finite]
        error = (error[1:] + error[:-1]) / 2
        norms = np.linalg.norm(error - error.mean()) * np.linalg.norm(steps, axis=1)
        work = steps @ error + _OFFSET_ALLOWANCE * np.abs(steps.sum(axis=1))
        if (work < _MAX_SWAPPED_CORRELATION * norms).all():
            backwards.append(robot.joint_names[index])
    if len(backwards) > len(moving) / 2:
        yield diagnose("command-and-position-swapped", joints=backwards)
    elif backwards:
        yield diagnose("position-leads-command", joints=backwards)


def find_degrees(
    robot: Robot, joints: Iterable[int], position: Array, command: Array
) -> Iterator[Diagnostic]:
    """Find position and command columns that exceed the joint limits, probably because of degrees.

    A diagnostic is yielded for each column whose median magnitude is more than twice the larger
    absolute limit of the joint, or more than 4 pi if this limit is infinite or 0.

    Args:
        robot: Robot.
        joints: Indices of the joints that are checked.
        position: Measured positions, shape (n, nu) [rad, m]; NaN is ignored.
        command: Commands, shape (n, nu) [rad, m]; NaN is ignored.
    """
    max_positions = np.maximum(np.abs(robot.lower_limits), np.abs(robot.upper_limits))
    max_positions = np.where(
        np.isfinite(max_positions) & (max_positions > 0), max_positions, 2 * np.pi
    )
    for index in joints:
        for kind, values in (("position", position), ("command", command)):
            finite_values = values[np.isfinite(values[:, index]), index]
            # The median ignores momentary commands far beyond a limit.
            reach = np.median(np.abs(finite_values)) if finite_values.size else 0.0
            if reach > _MAX_REACH_RATIO * max_positions[index]:
                name = robot.joint_names[index]
                column, unit = f"{kind}.{name}", joint_unit(robot, name)
                yield diagnose(
                    "column-in-degrees",
                    column=column,
                    header=f"{column} [deg]",
                    value=Quantity(reach, unit),
                    limit=Quantity(max_positions[index], unit),
                    degrees=bool(
                        reach / _DEGREES_PER_RADIAN <= _MAX_REACH_RATIO * max_positions[index]
                    ),
                )


def _compute_column_ratio(first: Array, second: Array) -> float | None:
    """Compare the units of two column groups: median over joints of std(first) / std(second) [1].

    Both arrays have the shape (n, joints); NaN is ignored. None if no joint moves in both.
    """
    is_finite = np.isfinite(first) & np.isfinite(second)
    pairs = [
        (first[rows, column], second[rows, column])
        for column, rows in enumerate(is_finite.T)
        if rows.any()
    ]
    ratios = [x.std() / y.std() for x, y in pairs if y.std() > _MIN_JOINT_RANGE and x.std() > 0]
    return float(np.median(ratios)) if ratios else None


def find_column_step(column: Array) -> float:
    """Estimate the step (resolution) of a joint's encoder from positions, shape (n,) [rad, m].

    The step is about the largest number of which all small differences between sorted positions are
    multiples; 0 if there is none, or if the differences are too few.
    """
    steps = np.diff(np.sort(column))
    steps = np.sort(steps[steps > _MIN_ENCODER_STEP])[:_MAX_TESTED_STEPS]
    if len(steps) < _MIN_STEPS:
        return 0.0
    divisors = np.arange(1, 1 + min(_MAX_PARTS, int(steps.min() / _MIN_ENCODER_STEP)))
    ratios = steps / (steps.min() / divisors[:, None])
    is_multiple = np.abs(ratios - np.round(ratios)).max(axis=1) < _MULTIPLE_TOLERANCE
    return float(steps.min() / divisors[is_multiple.argmax()]) if is_multiple.any() else 0.0


_MIN_ENCODER_STEP = 1e-5
"""Lower bound of an encoder step [rad, m]: above the rounding of files, below the step of 18
bits."""

_MIN_STEPS = 7
"""Smallest number of differences between readings from which an encoder step is determined.
Derived: a random difference is within `_MULTIPLE_TOLERANCE` of a multiple of a candidate step with
probability 0.1. The smallest difference is a multiple by construction. The six other differences
are multiples by chance with probability 1e-6.
"""

_MAX_PARTS = 400
"""Largest number of encoder steps in the smallest difference between readings that
`find_column_step` tries. Chosen larger than 260, the number of steps of a 14-bit encoder within 0.1
rad.
"""

_MULTIPLE_TOLERANCE = 0.05
"""Tolerance with which (difference of two readings) / (encoder step) counts as a whole number:
covers rounding in the file. Chosen, not tuned.
"""

_MAX_TESTED_STEPS = 50
"""Maximum number of differences between readings that are tested as multiples of an encoder step. A
candidate step has the rounding error of the smallest difference, whose effect on the ratio grows
with the tested difference. Fifty random differences are multiples of a candidate step with a
probability of 1e-49. Chosen, not tuned.
"""
