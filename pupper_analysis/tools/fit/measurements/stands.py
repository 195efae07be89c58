"""Stands at rest as they were measured: commands, positions, and what else was read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import MeasurementError, UnknownNameError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.columns import Column, Columns, read_columns
from pupper_analysis.tools.fit.measurements.log_quality import find_column_step, find_degrees

Array = NDArray[np.float64]

STAND_COLUMNS = (
    Column("stand", ""),
    Column("command.*", "position"),
    Column("position.*", "position"),
    Column("swing", ""),
    Column("heading", "angle"),
    Column("added.*", "mass"),
    Column("added_x.*", "length"),
    Column("added_y.*", "length"),
    Column("added_z.*", "length"),
)
"""What may stand in a file of stands."""

_AT_REST = 5e-3
"""rad: readings of one stand that are further apart are of a robot that moves, or was moved. An
encoder of 12 bits has steps of 1.5e-3."""


@dataclass(frozen=True, eq=False)
class MeasuredStands:
    """Stands at rest, one a row. NaN is not measured.

    Attributes:
        source: Where they are from: a file, or what stands for it.
        names: (m,) of the stands.
        joints: (n,) whose columns follow.
        command: (m, n) commanded joint positions, as the servos have them (rad).
        position: (m, n) measured joint positions, as the encoders have them (rad).
        swing: (m,) the feet that are in the air.
        heading: (m,) how the robot was turned about the vertical (rad); zeros by default.
        added: {link: (m, 4) known mass that was put on it (kg), and where in its frame (m)}; 0 of
            none.
    """

    source: str
    names: tuple[str, ...]
    joints: tuple[str, ...]
    command: Array
    position: Array
    swing: tuple[tuple[str, ...], ...]
    heading: Array = field(default_factory=lambda: np.zeros(0))
    added: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.heading.size:
            object.__setattr__(self, "heading", np.zeros(len(self.names)))

    def __len__(self) -> int:
        return len(self.names)

    def order_joints(self, robot: Robot) -> MeasuredStands:
        """Returns the same with a robot's joints in its order.

        Raises:
            UnknownNameError: If the robot has not one of the joints or feet.
            MeasurementError: If a joint's position was not measured.
        """
        for name in self.joints:
            if name not in robot.joint_names:
                raise UnknownNameError(self.source, "joint", name, robot.joint_names)
        for name in (foot for feet in self.swing for foot in feet):
            if name not in robot.feet:
                raise UnknownNameError(self.source, "foot", name, tuple(robot.feet))
        for name in self.added:
            if name not in robot.structure.links:
                raise UnknownNameError(self.source, "link", name, tuple(robot.structure.links))
        missing = [name for name in robot.joint_names if name not in self.joints]
        if missing:
            raise MeasurementError(self.source, diagnose("joints-not-measured", joints=missing))
        order = [self.joints.index(name) for name in robot.joint_names]
        return replace(
            self,
            joints=robot.joint_names,
            command=self.command[:, order],
            position=self.position[:, order],
        )

    def check_readings(self, robot: Robot) -> MeasuredStands:
        """Returns the same with a robot's joints in its order, if it can stand so.

        Raises:
            UnknownNameError: If the robot has not one of the joints or feet.
            MeasurementError: If a joint's position was not measured, or cannot be, or too few feet
                carry.
        """
        found = self.order_joints(robot)
        for finding in find_degrees(robot, range(robot.nu), found.position, found.command):
            raise MeasurementError(self.source, finding)
        found.check_limits(robot, found.position, _BEYOND)
        for row, name in enumerate(found.names):
            unread = np.flatnonzero(~np.isfinite(found.position[row]))
            if unread.size:
                joints = [robot.joint_names[joint] for joint in unread]
                finding = diagnose("stand-position-missing", stand=name, joints=joints)
                raise MeasurementError(self.source, finding)
            points = [p for f, own in robot.feet.items() if f not in found.swing[row] for p in own]
            if len(points) < _LEAST_POINTS:
                finding = diagnose("stand-on-too-few-feet", stand=name, feet=list(found.swing[row]))
                raise MeasurementError(self.source, finding)
        return found

    def check_limits(self, robot: Robot, angles: Array, margin: float = 0.0) -> None:
        """Checks that no joint is read, or led, to where it cannot be.

        Args:
            robot: The robot.
            angles: (m, nu) of the stands (rad); NaN is not looked at.
            margin: Beyond a limit that is no mistake.

        Raises:
            MeasurementError: If one is.
        """
        beyond = np.fmax(angles - robot.upper_limits, robot.lower_limits - angles)
        for row, joint in np.argwhere(beyond > margin).tolist():
            name, who = self.names[row], robot.joint_names[joint]
            ends = robot.lower_limits[joint], robot.upper_limits[joint]
            found = (angles[row, joint], *ends)
            at, low, high = (Quantity(float(one), "rad") for one in found)
            finding = diagnose(
                "stand-beyond-limits", stand=name, joint=who, position=at, low=low, high=high
            )
            raise MeasurementError(self.source, finding)

    def average_repeats(self) -> MeasuredStands:
        """Returns the same with readings of one stand, which are rows of one name, averaged.

        Raises:
            MeasurementError: If they are not those of a robot at rest.
        """
        loads = np.column_stack([self.heading, *self.added.values()]).tolist()
        keys = list(zip(self.names, self.swing, map(tuple, loads), strict=True))
        groups = [np.flatnonzero([one == key for one in keys]) for key in dict.fromkeys(keys)]
        if len(groups) == len(keys):
            return self
        for rows in groups:
            apart = np.ptp(self.position[rows], axis=0)
            if apart.max() > _AT_REST:
                joint = int(apart.argmax())
                finding = diagnose(
                    "stand-not-at-rest",
                    stand=self.names[rows[0]],
                    joint=self.joints[joint],
                    apart=Quantity(float(apart[joint]), "rad"),
                )
                raise MeasurementError(self.source, finding)

        def mean(values: Array) -> Array:
            return np.array([_mean(values[rows]) for rows in groups])

        first = self.select_rows([int(rows[0]) for rows in groups])
        return replace(first, command=mean(self.command), position=mean(self.position))

    def select_rows(self, rows: Sequence[int]) -> MeasuredStands:
        """Returns the same of some of the stands, by their rows."""
        chosen = list(rows)
        return replace(
            self,
            names=tuple(self.names[row] for row in chosen),
            command=self.command[chosen],
            position=self.position[chosen],
            swing=tuple(self.swing[row] for row in chosen),
            heading=self.heading[chosen],
            added={link: own[chosen] for link, own in self.added.items()},
        )


_BEYOND = 0.3
"""rad, m: 17 deg beyond a stop, no encoder's zero is off by so much unnoticed."""

_LEAST_POINTS = 3
"""A base on fewer points may turn about the line through them: how it is tilted is not known."""


def _mean(values: Array) -> Array:
    counted = np.isfinite(values)
    total = np.where(counted, values, 0.0).sum(axis=0)
    count = counted.sum(axis=0)
    averaged: Array = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return averaged


def read_stands(path: str | Path) -> MeasuredStands:
    """Reads stands at rest from a CSV file, one a row.

    Columns are ``command.<joint>`` and ``position.<joint>``; there may be ``stand`` (its name: rows
    of one name are readings of one stand), ``roll`` and ``pitch`` of the base, ``swing`` (the feet
    in the air, with blanks between them), ``heading`` (how the robot was turned on the spot), and
    ``added.<link>`` with ``added_x.<link>``, ``added_y.``, ``added_z.`` (a known mass that was put
    on it, and where in the link's frame). Units are SI unless they are said in brackets:
    ``position.FL_knee [deg]``, ``added.base [g]``. A cell that is empty is missing.

    Args:
        path: The file.

    Raises:
        MeasurementError: If it cannot be read, or is no list of stands.
    """
    table = read_columns(path, STAND_COLUMNS)
    position, command = table.get_columns("position"), table.get_columns("command")
    if not position or not command:
        missing = "position.<joint>" if not position else "command.<joint>"
        raise MeasurementError(table.source, diagnose("column-missing", column=missing))
    joints, blank = tuple(position), np.full(len(table.lines), np.nan)
    for joint in command:
        if joint not in position:
            finding = diagnose("column-without-position", column=f"command.{joint}", joint=joint)
            raise MeasurementError(table.source, finding)
    columns = {
        kind: np.column_stack([table.get_columns(kind).get(joint, blank) for joint in joints])
        for kind in ("command", "position")
    }
    rows = [str(row + 1) for row in range(len(blank))]
    return MeasuredStands(
        source=table.source,
        names=tuple(table.words.get("stand", rows)),
        joints=joints,
        command=columns["command"],
        position=columns["position"],
        swing=tuple(tuple(words.split()) for words in table.words.get("swing", [""] * len(rows))),
        heading=np.nan_to_num(table.numbers.get("heading", blank)),
        added=dict(_added(table)),
    )


def format_stands(stands: MeasuredStands, *, header: bool = True) -> str:
    """Returns stands as a CSV file has them, which ``read_stands`` reads."""
    loads = [f"added{one}.{link}" for link in stands.added for one in ("", "_x", "_y", "_z")]
    kinds = [f"{kind}.{name}" for kind in ("command", "position") for name in stands.joints]
    rows: list[list[str]] = [["stand", "swing", "heading", *loads, *kinds]] if header else []
    for row, name in enumerate(stands.names):
        on = [f"{one:.6g}" for own in stands.added.values() for one in own[row]]
        numbers = [*stands.command[row], *stands.position[row]]
        cells = [f"{one:.6f}" if math.isfinite(one) else "" for one in numbers]
        heading = f"{stands.heading[row]:.8g}"
        rows.append([name, " ".join(stands.swing[row]), heading, *on, *cells])
    return csv_text(rows)


def _added(table: Columns) -> Iterator[tuple[str, Array]]:
    """Yields the links that known masses were put on: mass and place (m, 4)."""
    axes = ("added_x", "added_y", "added_z")
    for kind in axes:
        for link in table.get_columns(kind):
            if link not in table.get_columns("added"):
                finding = diagnose("column-missing", column=f"added.{link}")
                raise MeasurementError(table.source, finding)
    for link, masses in table.get_columns("added").items():
        blank = np.full(len(masses), np.nan)
        places = np.column_stack([table.get_columns(kind).get(link, blank) for kind in axes])
        on = np.nan_to_num(masses) != 0
        for row in np.flatnonzero(on & ((masses < 0) | ~np.isfinite(places).all(axis=1))):
            finding = diagnose("added-mass-of-nowhere", line=table.lines[row], link=link)
            raise MeasurementError(table.source, finding)
        yield link, np.where(on[:, None], np.column_stack([masses, places]), 0.0)


def estimate_encoder_step(stands: MeasuredStands) -> float:
    """Returns the encoders' step (rad): all positions of a joint are whole multiples of it apart.

    0 if there is none, or it is finer than what a file holds.
    """
    found = [quantum for column in stands.position.T if (quantum := find_column_step(column))]
    return float(np.median(found)) if 2 * len(found) > len(stands.joints) else 0.0
