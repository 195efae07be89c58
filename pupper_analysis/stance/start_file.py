"""Read the initial guess of a stand from a file: joint positions by name, or a configuration.

Four contents are accepted: results of this package as JSON (``stand --json``, or ``to_json()`` of a
stand or posture); a JSON object {joint: position}; the CSV table of ``stand --csv``; and a list of
numbers in JSON or CSV. A list is a configuration ``qpos`` (nq,), or the joint positions (nu,) in
actuator order. All positions are in rad, or m for a slide.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import orjson

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, UnknownNameError
from pupper_analysis.base.inputs import read_text
from pupper_analysis.robot.robot import Robot


@check_arguments
def read_start(path: str | Path, robot: Robot) -> Array:
    """Read the initial guess of a stand from a file, for ``solve_stand(start=...)``.

    Positions with joint names are assigned by name; other joints keep their position in ``home``.
    The base pose is taken from ``home``, unless a configuration of length nq without joint names is
    read.

    Args:
        path: JSON or CSV file.
        robot: Robot with a floating base, whose stand is solved.

    Returns:
        Configuration, shape (nq,).

    Raises:
        ConfigurationError: If the file cannot be read, contains no configuration, or belongs to
            another robot, for example.
        UnknownNameError: If the file contains a joint name that the robot lacks.
        OutputError: If this run of the command line also writes this file.
    """
    path = Path(path)
    try:
        text = read_text(path)
    except InputError as error:
        raise ConfigurationError(str(path), error.cause) from error
    try:
        content = orjson.loads(text)
    except orjson.JSONDecodeError:
        content = _read_table(text)
    positions, belongs_to = _find_positions(content, str(path))
    # A fingerprint is the robot's name, followed by a hash.
    own_hash = robot.fingerprint.rpartition(" ")[2]
    if belongs_to and belongs_to.rpartition(" ")[2] != own_hash:
        raise ConfigurationError(str(path), diagnose("start-of-another-robot", robot=belongs_to))
    qpos = robot.home.copy()
    if isinstance(positions, Mapping):
        for name, value in positions.items():
            if name not in robot.joint_names:
                unknown = UnknownNameError(robot.name, "joint", name, robot.joint_names)
                raise unknown.with_location(str(path))
            qpos[robot.nq - robot.nu + robot.joint_names.index(name)] = value
        values = list(positions.values())
    else:
        values = list(positions or ())
        if len(values) not in (robot.nq, robot.nu):
            problem = diagnose(
                "start-of-another-length", count=len(values), nq=robot.nq, nu=robot.nu
            )
            raise ConfigurationError(str(path), problem)
        qpos[robot.nq - len(values) :] = values
    if not all(map(math.isfinite, values)):
        raise ConfigurationError(str(path), diagnose("start-not-finite"))
    return qpos


_Positions = Mapping[str, float] | Sequence[float] | None
"""Joint positions by name, or numbers of a configuration; None if a file contains neither."""


def _read_table(text: str) -> Any:
    """Read a CSV: mapping {joint: position}, list of values, or None for another form."""
    try:
        rows = [row for row in csv.reader(text.splitlines()) if any(map(str.strip, row))]
    except csv.Error:
        return None
    if not rows:
        return None
    header = [cell.partition("(")[0].strip() for cell in rows[0]]
    if "joint" in header and "position" in header:
        joint, position = header.index("joint"), header.index("position")
        cells = [(row[joint], row[position]) for row in rows[1:] if len(row) == len(header)]
        table = {name.strip(): _parse_cell(cell) for name, cell in cells}
        return table if len(table) == len(rows) - 1 else None
    numbers = [[_parse_cell(cell) for cell in row] for row in rows]
    if len(rows) == 1:
        return numbers[0]
    return [row[0] for row in numbers] if all(len(row) == 1 for row in numbers) else None


def _parse_cell(cell: str) -> float | str:
    """Return the number in a cell; the cell itself if it contains none."""
    try:
        return float(cell)
    except ValueError:
        return cell


_MAX_POSITION_GAP = 1e-9
"""Largest difference between ``joint_positions`` and the last values of ``qpos`` [rad, m] in a
file, with which both count as equal. Chosen, not tuned."""


def _find_positions(content: Any, file: str) -> tuple[_Positions, str]:
    """Find the joint positions or the configuration in the content of ``file``.

    Returns:
        Positions, None if the content has no positions. Fingerprint (name and hash) of the robot to
        which the positions belong; empty if the file states no robot, or if the positions have
        names.
    """
    if _is_numbers(content):
        return content, ""
    if isinstance(content, Mapping) and content and _is_numbers(list(content.values())):
        return content, ""
    for table in walk_tables(content):
        statics = table.get("statics")
        inner = statics if isinstance(statics, Mapping) else {}
        names = table.get("joint_names", inner.get("joint_names"))
        positions, qpos = table.get("joint_positions"), table.get("qpos")
        if _is_numbers(positions) and _is_numbers(qpos):
            pairs = zip(reversed(positions), reversed(qpos), strict=False)
            gap = max(abs(position - value) for position, value in pairs)
            if len(positions) > len(qpos) or not gap <= _MAX_POSITION_GAP:
                raise ConfigurationError(file, diagnose("start-contradicts-itself"))
        if isinstance(names, list) and _is_numbers(positions) and len(names) == len(positions):
            return dict(zip(map(str, names), positions, strict=True)), ""
        if _is_numbers(qpos):
            owner = table.get("robot")
            return qpos, owner if isinstance(owner, str) else ""
    return None, ""


def walk_tables(content: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the mapping in a JSON file and its nested mappings, top level first, without lists."""
    level = [content]
    while level:
        tables = [value for value in level if isinstance(value, Mapping)]
        yield from tables
        level = [value for table in tables for value in table.values()]


def _is_numbers(value: Any) -> TypeGuard[list[float]]:
    """Return True for a list of numbers that is not empty."""
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, int | float) and not isinstance(item, bool) for item in value)
    )
