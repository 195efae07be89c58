"""Logs: what a robot's joints were commanded, and what they did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    MeasurementError,
    UnknownNameError,
)
from pupper_analysis.base.files import describe_os_error
from pupper_analysis.base.inputs import check_input
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.bags import MAX_BAG_BYTES, is_bag, read_bag
from pupper_analysis.tools.fit.measurements.columns import Column, read_columns

Array = NDArray[np.float64]

_JUMP = 0.5
"""s between two samples, at least, if the clock was set."""

MIN_SAMPLES = 100
"""Half a second at 200 Hz: less tells nothing of a motion."""


@dataclass(frozen=True, eq=False)
class Log:
    """What a robot's joints were commanded, and what they did.

    Attributes:
        source: The file.
        time: (n,) of the samples, rising (s).
        joints: Whose columns follow.
        command: (n, joints) positions that servos were asked for, each from its sample to the next
            (rad, m); NaN where there is none.
        position: (n, joints) that encoders tell (rad, m); NaN where a sample is missing.
    """

    source: str
    time: Array
    joints: tuple[str, ...]
    command: Array
    position: Array

    @property
    def duration(self) -> float:
        """From the first sample to the last (s)."""
        return float(self.time[-1] - self.time[0])

    @property
    def interval(self) -> float:
        """Median of the times between samples (s)."""
        return float(np.median(np.diff(self.time)))

    @property
    def jumps(self) -> list[int]:
        """After which samples the clock was set, or the log was stopped: another run begins."""
        least = max(_JUMP, 10 * self.interval)
        return [int(at) for at in np.flatnonzero(np.diff(self.time) > least)]

    def select_rows(self, rows: slice) -> Log:
        """Returns some of its samples."""
        return replace(
            self, time=self.time[rows], command=self.command[rows], position=self.position[rows]
        )

    def order_joints(self, robot: Robot) -> Log:
        """Returns the same with a robot's joints in its order; of those it lacks all is NaN.

        Raises:
            UnknownNameError: If the robot has not one of the joints.
        """
        for name in self.joints:
            if name not in robot.joint_names:
                raise UnknownNameError(self.source, "joint", name, robot.joint_names)

        def put(values: Array) -> Array:
            placed = np.full((len(self.time), robot.nu), np.nan)
            placed[:, [robot.joint_names.index(name) for name in self.joints]] = values
            return placed

        return replace(
            self, joints=robot.joint_names, command=put(self.command), position=put(self.position)
        )


def make_log(
    source: str, time: Array, kinds: Mapping[str, Mapping[str, Array]], lines: Sequence[int]
) -> Log:
    """Makes a log of columns.

    Args:
        source: Where they are from.
        time: (n,) s; empty if there is none.
        kinds: {``position`` or ``command``: {joint: (n,)}}.
        lines: (n,) of the file.

    Raises:
        MeasurementError: If it is no log: columns are missing, a joint has no commands, time does
            not rise, samples are too few.
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
    blank = np.full(len(time), np.nan)
    command = np.column_stack([kinds["command"].get(joint, blank) for joint in joints])
    for joint, column in zip(joints, command.T, strict=True):
        if not np.isfinite(column).any():
            raise MeasurementError(source, diagnose("joint-without-command", joint=joint))
    return Log(source, time, joints, command, np.column_stack([*position.values()]))


def _check_time(source: str, time: Array, lines: Sequence[int]) -> None:
    """Checks that time is stated in all rows, and rises.

    Raises:
        MeasurementError: If not.
    """
    if len(time) < MIN_SAMPLES:
        finding = diagnose("log-too-short", samples=len(time), least=MIN_SAMPLES)
        raise MeasurementError(source, finding)
    if np.isnan(time).any():
        line = lines[int(np.flatnonzero(np.isnan(time))[0])]
        raise MeasurementError(source, diagnose("time-missing", line=line))
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0])
        finding = diagnose(
            "time-not-rising",
            line=lines[row + 1],
            back=Quantity(-steps[row], "s") if steps[row] else None,
            count=int((steps <= 0).sum()),
        )
        raise MeasurementError(source, finding)


# Files of logs: CSV, npz, MCAP and ROS bags.

LOG_COLUMNS = (
    Column("time", "time"),
    Column("command.*", "position"),
    Column("position.*", "position"),
    Column("velocity.*", "velocity"),
    Column("torque.*", "torque"),
)
"""What may stand in a log."""


@check_arguments
def read_log(
    path: str | Path, *, topics: Mapping[str, str] | None = None, joints: Sequence[str] = ()
) -> Log:
    """Reads a log from a CSV file, an ``.mcap`` or a ROS bag.

    Columns are ``time``, ``position.<joint>``, ``command.<joint>``; ``velocity.<joint>`` and
    ``torque.<joint>`` may be there, and nothing is made of them. Units are SI unless they are said
    in brackets: ``time [ms]``, ``position.FL_knee [deg]``. A cell that is empty is missing.

    Of a bag, states are ``sensor_msgs/JointState``, commands ``std_msgs/Float64MultiArray`` (or a
    second ``JointState`` that is named).
    Moments are those of the messages' headers, or if one topic has none, those at which all were
    recorded. They are those of the joint whose position is there most often: numbers of others are
    put between theirs, but not where one of these is missing, and a command holds until the next.

    Args:
        path: The file; of a ROS 2 bag also its folder.
        topics: Of a bag: {``"state"`` or ``"command"``: the topic}, where there are several.
        joints: Of a bag: names of joints in messages that have none, in their order.

    Returns:
        The log. What is odd in it, ``inspect_log`` says, for a robot.

    Raises:
        ConfigurationError: If topics or joints are given of what is no bag.
        MeasurementError: If it cannot be read or is no log: columns are missing or not known, a
            joint has no commands, a cell is no number, time does not rise, samples are too few.
        MissingPackageError: If it is a bag, and rosbags is not installed.
    """
    if is_bag(Path(path)):
        _check_files(Path(path))
        time, kinds = read_bag(Path(path), topics or {}, joints)
        return make_log(str(path), time, kinds, range(len(time)))
    for name, given in (("topics", topics), ("joints", joints)):
        if given:
            raise ConfigurationError(name, diagnose("no-bag-has-no-topics", file=str(path)))
    table = read_columns(path, LOG_COLUMNS)
    kinds = {kind: table.get_columns(kind) for kind in ("position", "command")}
    return make_log(table.source, table.numbers.get("time", np.zeros(0)), kinds, table.lines)


def _check_files(bag: Path) -> None:
    """Refuses a bag with what is no regular file, as its reader would wait for that.

    Raises:
        MeasurementError: If there is one, or it is too large.
    """
    try:
        for file in bag.iterdir() if bag.is_dir() else (bag,):
            check_input(file, MAX_BAG_BYTES)
    except InputError as error:
        raise MeasurementError(error.path, error.cause) from error
    except OSError as error:
        raise MeasurementError(str(bag), str(describe_os_error(error))) from error
