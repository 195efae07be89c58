"""Measurements of stands at rest: commands, positions, feet in the air and known masses.

`read_stands` reads a CSV file with a row per reading of a stand, and `format_stands` writes the
same format. The methods of `MeasuredStands` check the stands for a robot and average repeated
readings.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import MeasurementError, UnknownNameError
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.columns import Columns, MeasurementColumn, read_columns
from pupper_analysis.tools.fit.measurements.log_quality import find_column_step, find_degrees

MIN_STANDS = 3
"""Smallest number of stands of a fit or a plan. Chosen, not tuned."""

STAND_COLUMNS = (
    MeasurementColumn("stand", ""),
    MeasurementColumn("command.*", "position"),
    MeasurementColumn("position.*", "position"),
    MeasurementColumn("swing", ""),
    MeasurementColumn("heading", "angle"),
    MeasurementColumn("added.*", "mass"),
    MeasurementColumn("added_x.*", "length"),
    MeasurementColumn("added_y.*", "length"),
    MeasurementColumn("added_z.*", "length"),
)
"""Columns that a file of stands may contain."""

_MAX_REPEAT_RANGE = 5e-3
"""Largest range [rad, m] of a joint position in repeated readings of a stand; with a larger range,
the robot moved. The value exceeds the step of a 12-bit encoder, 1.5e-3 rad.
"""


@dataclass(frozen=True, eq=False)
class MeasuredStands:
    """Measured stands at rest: commands and joint positions, a reading per row; NaN if missing.

    Attributes:
        source: File, or another source of the stands, for example the name of the robot.
        names: Stand names, shape (m,).
        joints: Joints of the columns, shape (n,).
        command: Commanded joint positions in servo coordinates, shape (m, n) [rad, m].
        position: Measured joint positions, shape (m, n) [rad, m].
        swing: Feet in the air, shape (m,).
        heading: Rotation of the robot about the vertical, shape (m,) [rad]; zeros by default.
        added: {link: known mass [kg] and position in the link frame [m], shape (m, 4)}; zeros
            without a mass.
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
        """Return the measured stands with the joints in actuator order.

        Raises:
            UnknownNameError: If the robot lacks a joint, foot or link of the stands.
            MeasurementError: If a joint of the robot was not measured.
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
        """Check measured stands for a robot; return the stands with joints in actuator order.

        Raises:
            UnknownNameError: If the robot lacks a joint, foot or link of the stands.
            MeasurementError: If a joint was not measured, a position is missing or impossible, a
                position or command is probably in degrees, or too few contact points carry load.
        """
        ordered = self.order_joints(robot)
        for finding in find_degrees(robot, range(robot.nu), ordered.position, ordered.command):
            raise MeasurementError(self.source, finding)
        ordered.check_limits(robot, ordered.position, _LIMIT_MARGIN)
        for row, name in enumerate(ordered.names):
            missing = np.flatnonzero(~np.isfinite(ordered.position[row]))
            if missing.size:
                joints = [robot.joint_names[joint] for joint in missing]
                finding = diagnose("stand-position-missing", stand=name, joints=joints)
                raise MeasurementError(self.source, finding)
            points = [
                point
                for foot, foot_points in robot.feet.items()
                if foot not in ordered.swing[row]
                for point in foot_points
            ]
            if len(points) < _MIN_CONTACT_POINTS:
                finding = diagnose(
                    "stand-on-too-few-feet", stand=name, feet=list(ordered.swing[row])
                )
                raise MeasurementError(self.source, finding)
        return ordered

    def check_limits(self, robot: Robot, angles: Array, margin: float = 0.0) -> None:
        """Check that joint positions or commands are within the joint limits.

        Args:
            robot: Robot.
            angles: Joint positions or commands, shape (m, nu) [rad, m]; NaN is ignored.
            margin: Tolerance beyond the limits [rad, m].

        Raises:
            MeasurementError: If a value exceeds a limit by more than ``margin``.
        """
        beyond = np.fmax(angles - robot.upper_limits, robot.lower_limits - angles)
        for row, joint in np.argwhere(beyond > margin).tolist():
            name, joint_name = self.names[row], robot.joint_names[joint]
            limits = robot.lower_limits[joint], robot.upper_limits[joint]
            angle_and_limits = (angles[row, joint], *limits)
            unit = joint_unit(robot, joint_name)
            angle, lower, upper = (Quantity(float(value), unit) for value in angle_and_limits)
            finding = diagnose(
                "stand-beyond-limits",
                stand=name,
                joint=joint_name,
                position=angle,
                low=lower,
                high=upper,
            )
            raise MeasurementError(self.source, finding)

    def _group_repeats(self) -> list[IntArray]:
        """Return the rows of each stand: name, feet in the air, heading and masses are equal."""
        loads = np.column_stack([self.heading, *self.added.values()]).tolist()
        keys = list(zip(self.names, self.swing, map(tuple, loads), strict=True))
        return [
            np.flatnonzero([other_key == key for other_key in keys]) for key in dict.fromkeys(keys)
        ]

    def make_names_unique(self) -> MeasuredStands:
        """Return the measured stands with a different name for each stand.

        Stands of one name that differ in feet in the air, heading or added masses get other names,
        for example ``NAME #2``. Repeated readings keep a common name.
        """
        names, used = list(self.names), set[str]()
        for rows in self._group_repeats():
            name = unique_name = self.names[rows[0]]
            numbers = itertools.count(2)
            while unique_name in used or (unique_name in self.names and unique_name != name):
                unique_name = f"{name} #{next(numbers)}"
            used.add(unique_name)
            for row in rows:
                names[row] = unique_name
        return replace(self, names=tuple(names))

    def average_repeats(self, units: Mapping[str, str]) -> MeasuredStands:
        """Average the commands and positions of repeated readings of a stand.

        Rows are repeated readings if name, feet in the air, heading, and added masses with
        positions are equal. Missing values are left out of the mean.

        Args:
            units: {joint: unit of the position, rad or m}.

        Raises:
            MeasurementError: If repeated positions differ by more than `_MAX_REPEAT_RANGE`, so that
                the robot moved.
        """
        groups = self._group_repeats()
        if len(groups) == len(self):
            return self
        for rows in groups:
            ranges = np.ptp(self.position[rows], axis=0)
            if ranges.max() > _MAX_REPEAT_RANGE:
                joint = int(ranges.argmax())
                finding = diagnose(
                    "stand-not-at-rest",
                    stand=self.names[rows[0]],
                    joint=self.joints[joint],
                    apart=Quantity(float(ranges[joint]), units[self.joints[joint]]),
                )
                raise MeasurementError(self.source, finding)

        def average_groups(values: Array) -> Array:
            return np.array([_average_finite(values[rows]) for rows in groups])

        first_rows = self.select_rows([int(rows[0]) for rows in groups])
        return replace(
            first_rows, command=average_groups(self.command), position=average_groups(self.position)
        )

    def select_rows(self, rows: Sequence[int]) -> MeasuredStands:
        """Select measured stands by row index, in the order of ``rows``."""
        chosen = list(rows)
        return replace(
            self,
            names=tuple(self.names[row] for row in chosen),
            command=self.command[chosen],
            position=self.position[chosen],
            swing=tuple(self.swing[row] for row in chosen),
            heading=self.heading[chosen],
            added={link: load[chosen] for link, load in self.added.items()},
        )


_LIMIT_MARGIN = 0.3
"""Distance beyond a joint limit [rad, m] up to which a measured position is accepted: 0.3 rad is
17 deg, more than an unnoticed encoder offset. Chosen, not tuned."""

_MIN_CONTACT_POINTS = 3
"""Smallest number of carrying contact points of a measured stand. Derived: fewer do not determine
the tilt of the base."""


def _average_finite(values: Array) -> Array:
    """Return the mean of the finite values of each column; NaN for a column without values."""
    counted = np.isfinite(values)
    total = np.where(counted, values, 0.0).sum(axis=0)
    count = counted.sum(axis=0)
    averaged: Array = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return averaged


def read_stands(path: str | Path) -> MeasuredStands:
    """Read stands at rest from a CSV file, a reading of a stand per row.

    Required columns, for at least a single joint: ``command.<joint>`` and ``position.<joint>``.
    Optional columns:

    - ``stand``: name of the stand; for repeated readings see `MeasuredStands.average_repeats`.
    - ``swing``: feet in the air, separated by blanks.
    - ``heading``: rotation of the robot about the vertical.
    - ``added.<link>``: known mass on a link.
    - ``added_x.<link>``, ``added_y.<link>``, ``added_z.<link>``: position of the known mass in the
      link frame.

    Units are SI units, or stated in brackets: ``position.FL_knee [deg]``, ``added.base [g]``. Empty
    cells are missing values; an empty heading is 0.

    Args:
        path: CSV file.

    Raises:
        MeasurementError: If the file cannot be read, or is not a list of stands.
    """
    table = read_columns(path, STAND_COLUMNS)
    position, command = table.get_columns("position"), table.get_columns("command")
    if not position or not command:
        missing = "position.<joint>" if not position else "command.<joint>"
        raise MeasurementError(table.source, diagnose("column-missing", column=missing))
    joints, missing_values = tuple(position), np.full(len(table.lines), np.nan)
    for joint in command:
        if joint not in position:
            finding = diagnose("column-without-position", column=f"command.{joint}", joint=joint)
            raise MeasurementError(table.source, finding)
    columns = {
        kind: np.column_stack(
            [table.get_columns(kind).get(joint, missing_values) for joint in joints]
        )
        for kind in ("command", "position")
    }
    rows = [str(row + 1) for row in range(len(missing_values))]
    return MeasuredStands(
        source=table.source,
        names=tuple(table.words.get("stand", rows)),
        joints=joints,
        command=columns["command"],
        position=columns["position"],
        swing=tuple(tuple(words.split()) for words in table.words.get("swing", [""] * len(rows))),
        heading=np.nan_to_num(table.numbers.get("heading", missing_values)),
        added=dict(_read_loads(table)),
    )


def format_stands(stands: MeasuredStands, *, header: bool = True) -> str:
    """Format measured or planned stands as CSV text for ``read_stands``.

    Units are rad, m and kg. Missing commands and positions are empty cells.
    """
    loads = [f"added{suffix}.{link}" for link in stands.added for suffix in ("", "_x", "_y", "_z")]
    kinds = [f"{kind}.{name}" for kind in ("command", "position") for name in stands.joints]
    rows: list[list[str]] = [["stand", "swing", "heading", *loads, *kinds]] if header else []
    for row, name in enumerate(stands.names):
        load_cells = [f"{value:.6g}" for load in stands.added.values() for value in load[row]]
        numbers = [*stands.command[row], *stands.position[row]]
        cells = [f"{number:.6f}" if math.isfinite(number) else "" for number in numbers]
        heading = f"{stands.heading[row]:.8g}"
        rows.append([name, " ".join(stands.swing[row]), heading, *load_cells, *cells])
    return csv_text(rows)


def _read_loads(table: Columns) -> Iterator[tuple[str, Array]]:
    """Yield each link with a column of known masses, and the masses and positions in m stands.

    The second result has the shape (m, 4): mass [kg], position in the link frame [m]; zeros without
    mass.
    """
    axes = ("added_x", "added_y", "added_z")
    for kind in axes:
        for link in table.get_columns(kind):
            if link not in table.get_columns("added"):
                finding = diagnose("column-missing", column=f"added.{link}")
                raise MeasurementError(table.source, finding)
    for link, masses in table.get_columns("added").items():
        blank = np.full(len(masses), np.nan)
        places = np.column_stack([table.get_columns(kind).get(link, blank) for kind in axes])
        has_mass = np.nan_to_num(masses) != 0
        for row in np.flatnonzero(has_mass & ((masses < 0) | ~np.isfinite(places).all(axis=1))):
            finding = diagnose("added-mass-of-nowhere", line=table.lines[row], link=link)
            raise MeasurementError(table.source, finding)
        yield link, np.where(has_mass[:, None], np.column_stack([masses, places]), 0.0)


def estimate_encoder_step(stands: MeasuredStands) -> float:
    """Estimate the resolution of the joint encoders [rad, m] from measured positions.

    The result is the median over the joints with a known step (`find_column_step`); 0 if at most
    half of the joints have a step.
    """
    steps = [quantum for column in stands.position.T if (quantum := find_column_step(column))]
    return float(np.median(steps)) if 2 * len(steps) > len(stands.joints) else 0.0
