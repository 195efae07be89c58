"""Logs of motions: joint commands and measured positions over time.

A log is read from a CSV file, and contains a row per sample. The times and the completeness of the
columns are checked when a log is read. `inspect_log` checks whether a log fits a robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import (
    MeasurementError,
    UnknownNameError,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.columns import MeasurementColumn, read_columns

_MIN_JUMP = 0.5
"""Lower bound of a clock jump between two samples [s], if ten median intervals are shorter. A jump
ends a run, which is a part of a log without jumps. Chosen, not tuned.
"""

MIN_SAMPLES = 100
"""Smallest number of samples of a log, half a second at 200 Hz. A shorter log is refused. Chosen,
not tuned."""


@dataclass(frozen=True, eq=False)
class Log:
    """Recorded motion of a robot: joint commands and measured positions over time.

    Attributes:
        source: File.
        time: Sample times, strictly increasing, shape (n,) [s].
        joints: Joints of the columns.
        command: Commanded positions, shape (n, joints) [rad, m]; NaN if missing. A command holds
            until the next sample.
        position: Measured positions, shape (n, joints) [rad, m]; NaN if missing.
    """

    source: str
    time: Array
    joints: tuple[str, ...]
    command: Array
    position: Array

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def jumps(self) -> list[int]:
        """Index of the last sample before each clock jump.

        A jump is a time of more than 0.5 s, and of more than ten median intervals, between two
        samples. The clock was set at a jump, or the log was interrupted.
        """
        min_jump = max(_MIN_JUMP, 10 * self.interval)
        return [int(index) for index in np.flatnonzero(np.diff(self.time) > min_jump)]

    def select_rows(self, rows: slice) -> Log:
        """Return a part of the log: the samples of a slice of row indices."""
        return replace(
            self, time=self.time[rows], command=self.command[rows], position=self.position[rows]
        )

    def order_joints(self, robot: Robot) -> Log:
        """Return the log with all joints in actuator order; NaN for joints without columns.

        Raises:
            UnknownNameError: If the robot lacks a joint of the log.
        """
        for name in self.joints:
            if name not in robot.joint_names:
                raise UnknownNameError(self.source, "joint", name, robot.joint_names)

        def place_columns(values: Array) -> Array:
            placed = np.full((len(self.time), robot.nu), np.nan)
            placed[:, [robot.joint_names.index(name) for name in self.joints]] = values
            return placed

        return replace(
            self,
            joints=robot.joint_names,
            command=place_columns(self.command),
            position=place_columns(self.position),
        )


def make_log(
    source: str, time: Array, kinds: Mapping[str, Mapping[str, Array]], lines: Sequence[int]
) -> Log:
    """Create a log of joint commands and measured joint positions from columns.

    Args:
        source: Source of the columns, for error messages.
        time: Sample times, shape (n,) [s]; empty without a column of times.
        kinds: {``position`` or ``command``: {joint: values, shape (n,) [rad, m]}}.
        lines: Line number of each sample in the file, shape (n,).

    Raises:
        MeasurementError: If columns are missing, if a joint lacks positions or commands, if a time
            is missing or does not increase, or if the samples are too few.
    """
    position = kinds["position"]
    if not len(time) or not position:
        missing = "position.<joint>" if len(time) else "time"
        raise MeasurementError(source, diagnose("column-missing", column=missing))
    _check_time(source, time, lines)
    joints = tuple(position)
    for joint in kinds["command"]:
        if joint not in position:
            finding = diagnose("column-without-position", column=f"command.{joint}", joint=joint)
            raise MeasurementError(source, finding)
    missing_values = np.full(len(time), np.nan)
    command = np.column_stack([kinds["command"].get(joint, missing_values) for joint in joints])
    for joint, column in zip(joints, command.T, strict=True):
        if not np.isfinite(column).any():
            raise MeasurementError(source, diagnose("joint-without-command", joint=joint))
    return Log(source, time, joints, command, np.column_stack([*position.values()]))


def _check_time(source: str, time: Array, lines: Sequence[int]) -> None:
    """Check that a log has enough samples, and that the sample times [s], shape (n,), increase.

    ``lines`` are the line numbers of the samples in the file ``source``, for errors.
    """
    if len(time) < MIN_SAMPLES:
        error = diagnose("log-too-short", samples=len(time), least=MIN_SAMPLES)
        raise MeasurementError(source, error)
    if np.isnan(time).any():
        line = lines[int(np.flatnonzero(np.isnan(time))[0])]
        raise MeasurementError(source, diagnose("time-missing", line=line))
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0])
        error = diagnose(
            "time-not-rising",
            line=lines[row + 1],
            back=Quantity(-steps[row], "s") if steps[row] else None,
            count=int((steps <= 0).sum()),
        )
        raise MeasurementError(source, error)


LOG_COLUMNS = (
    MeasurementColumn("time", "time"),
    MeasurementColumn("command.*", "position"),
    MeasurementColumn("position.*", "position"),
    MeasurementColumn("velocity.*", "velocity"),
    MeasurementColumn("torque.*", "torque"),
)
"""Columns that a log may contain."""


_BAG_SUFFIXES = (".mcap", ".bag", ".db3")
"""Suffixes of MCAP files and ROS bags, which are refused with a hint."""


@check_arguments
def read_log(path: str | Path) -> Log:
    """Read a log of a motion from a CSV file.

    Columns are ``time``, ``position.<joint>`` and ``command.<joint>``; ``velocity.<joint>`` and
    ``torque.<joint>`` are accepted and ignored. Units are SI units, or stated in brackets, for
    example ``time [ms]`` and ``position.FL_knee [deg]``. Empty cells are missing values.

    Returns:
        The log. ``inspect_log`` checks the log for a robot.

    Raises:
        MeasurementError: If the file is not a log: for example columns are missing or unknown, a
            joint has no commands, a cell is not a number, time does not increase, or samples are
            too few.
    """
    if Path(path).suffix.lower() in _BAG_SUFFIXES:
        raise MeasurementError(str(path), diagnose("log-is-bag"))
    table = read_columns(path, LOG_COLUMNS)
    kinds = {kind: table.get_columns(kind) for kind in ("position", "command")}
    return make_log(table.source, table.numbers.get("time", np.zeros(0)), kinds, table.lines)
