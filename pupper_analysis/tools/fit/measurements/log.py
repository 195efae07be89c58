"""Logs: what a robot's joints were commanded, and what they did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import MeasurementError, UnknownNameError
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

LEAST_SAMPLES = 100
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
        velocity: (n, joints) likewise (rad/s, m/s); None if there are none.
        torque: (n, joints) of the motors (N m, N), which say whether they are at their limits; None
            if there are none.
    """

    source: str
    time: Array
    joints: tuple[str, ...]
    command: Array
    position: Array
    velocity: Array | None = None
    torque: Array | None = None

    def __repr__(self) -> str:
        return f"<Log {self.source!r}: {len(self.joints)} joints, {self.duration:.4g} s>"

    @property
    def duration(self) -> float:
        """From the first sample to the last (s)."""
        return float(self.time[-1] - self.time[0])

    @property
    def interval(self) -> float:
        """Median of the times between samples (s)."""
        return float(np.median(np.diff(self.time)))

    def part(self, rows: slice) -> Log:
        """Returns some of its samples."""
        return replace(
            self,
            time=self.time[rows],
            command=self.command[rows],
            position=self.position[rows],
            velocity=None if self.velocity is None else self.velocity[rows],
            torque=None if self.torque is None else self.torque[rows],
        )

    def of(self, robot: Robot) -> Log:
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
            self,
            joints=robot.joint_names,
            command=put(self.command),
            position=put(self.position),
            velocity=None if self.velocity is None else put(self.velocity),
            torque=None if self.torque is None else put(self.torque),
        )


def make_log(
    source: str, time: Array, kinds: Mapping[str, Mapping[str, Array]], lines: Sequence[int]
) -> Log:
    """Makes a log of columns.

    Args:
        source: Where they are from.
        time: (n,) s; empty if there is none.
        kinds: {``position``, ``command``, ``velocity`` or ``torque``: {joint: (n,)}}.
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
    columns = {kind: kinds.get(kind, {}) for kind in ("command", "velocity", "torque")}
    for kind, found in columns.items():
        for joint in found:
            if joint not in position:
                told = diagnose("column-without-position", column=f"{kind}.{joint}", joint=joint)
                raise MeasurementError(source, told)
    blank = np.full(len(time), np.nan)
    stacked = {
        kind: np.column_stack([found.get(joint, blank) for joint in joints])
        for kind, found in columns.items()
    }
    for place, joint in enumerate(joints):
        if not np.isfinite(stacked["command"][:, place]).any():
            raise MeasurementError(source, diagnose("joint-without-command", joint=joint))
    return Log(
        source,
        time,
        joints,
        stacked["command"],
        np.column_stack([position[joint] for joint in joints]),
        stacked["velocity"] if columns["velocity"] else None,
        stacked["torque"] if columns["torque"] else None,
    )


def _check_time(source: str, time: Array, lines: Sequence[int]) -> None:
    """Checks that time is told in all rows, and rises.

    Raises:
        MeasurementError: If not.
    """
    if len(time) < LEAST_SAMPLES:
        told = diagnose("log-too-short", samples=len(time), least=LEAST_SAMPLES)
        raise MeasurementError(source, told)
    if np.isnan(time).any():
        line = lines[int(np.flatnonzero(np.isnan(time))[0])]
        raise MeasurementError(source, diagnose("time-missing", line=line))
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0])
        told = diagnose(
            "time-not-rising",
            line=lines[row + 1],
            back=Quantity(-steps[row], "s") if steps[row] else None,
            count=int((steps <= 0).sum()),
        )
        raise MeasurementError(source, told)
