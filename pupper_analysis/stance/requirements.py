"""Requirements of a stand task that may be relaxed if the stance is out of reach.

A requirement is an attribute of `StandTask`, for example the base height, a foot position or a
margin. Its field in ``fields.toml`` has another value of ``relaxation`` than ``"no"``.
`RequirementVector` converts requirements of a task to a vector [m, rad] with bounds and back. Other
functions relax requirements further, round them for a report, describe them, and reset them to
their values in the nominal stand (the stand of the default `StandTask`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.robot.plane import Bar, Contact, Plane, Slope, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS, Field
from pupper_analysis.stance.problem import (
    MIN_SUPPORT_NORMAL_Z,
    default_contact_position,
    foot_positions_of_task,
    nominal_foot_positions,
)
from pupper_analysis.stance.task import StandTask

_FIELDS_BY_REQUIREMENT: dict[str, list[Field]] = {}
"""{requirement (attribute of `StandTask`): its relaxable fields in ``fields.toml``}."""
for _field in FIELDS.values():
    if _field.relaxation != "no":
        _FIELDS_BY_REQUIREMENT.setdefault(_field.attribute, []).append(_field)

RELAXABLE_REQUIREMENTS = tuple(_FIELDS_BY_REQUIREMENT)
"""Attributes of `StandTask` that may be relaxed. Slope and steps of the ground form one
requirement."""

_MAX_RELAXATION = 3.0
"""Upper bound of the change of a length by relaxation, in units of the robot's stand height, if the
length may change in both directions. The decrease of a height has another bound
(`_MIN_HEIGHT_RATIO`). Chosen, not tuned."""

_MIN_HEIGHT_RATIO = 1e-3
"""Lower bound of the ratio (relaxed value) / (requested value), for values that must stay positive
(``open`` in ``fields.toml``), such as the height. Chosen, not tuned."""

_ROUNDING_ATOL = 1e-12
"""Difference [m, rad] below which a relaxed value counts as equal to the requested value, or to the
value in the nominal stand. Chosen as the size of rounding errors."""

_ROUNDING_SHARE = 0.005
"""Largest change of a reported value by rounding, as a fraction of the difference from the value in
the nominal stand. Chosen, not tuned."""

_MAX_DIGITS = 12
"""Largest number of decimals of a reported value in mm or deg. Chosen, not tuned."""


class RequirementKey(NamedTuple):
    """Key that identifies a number of a stand task: field, foot and axis.

    Attributes:
        field: Name of the field.
        foot: Foot, joint or link, for a field that is a mapping; else empty.
        axis: Axis, for a component of a point; else empty.
    """

    field: str
    foot: str = ""
    axis: str = ""


class RequirementVector:
    """Numbers of some relaxable requirements of a stand task as a vector, with bounds.

    Margins, clearances, lifts, slopes and steps can only change towards zero.

    Args:
        robot: Robot.
        task: Task.
        requirements: Names of relaxable requirements, from `RELAXABLE_REQUIREMENTS`.

    Attributes:
        keys: Key (field, foot, axis) of each number.
        requirements: Name of the requirement to which each number belongs.
        values: Values in the task, shape (n,) [m, rad].
        nominal: Values in the nominal stand (`differs_from_nominal`), shape (n,) [m, rad].
        low: Lower bounds of relaxed values, shape (n,) [m, rad].
        high: Upper bounds of relaxed values, shape (n,) [m, rad].
        angles: 1 for angles, 0 for lengths, shape (n,).
        units: Unit of the relaxation of each number, shape (n,): stand height [m], or 1 rad.
    """

    def __init__(self, robot: Robot, task: StandTask, requirements: Sequence[str]) -> None:
        self._task = task
        self.keys: list[RequirementKey] = []
        self.requirements: list[str] = []
        rows = []
        for requirement in requirements:
            for field in _FIELDS_BY_REQUIREMENT[requirement]:
                for foot, value in _list_values(task, field):
                    nominal = _nominal_value(robot, task, field, foot)
                    for axis, number, usual in _split_value(value, nominal):
                        self.keys.append(RequirementKey(field.name, foot, axis))
                        self.requirements.append(requirement)
                        turns = field.kind == "angle" or getattr(value, "has_angle", False)
                        ends = _find_bounds(robot, field, number, turns=turns)
                        rows.append((number, float(usual), *ends, turns))
        table = np.array(rows).reshape(-1, 5).T
        self.values, self.nominal, self.low, self.high, self.angles = table
        self.units = np.where(self.angles, 1.0, robot.stand_height)

    def read_task(self, task: StandTask) -> Array:
        """Read the numbers (n,) [m, rad] that ``keys`` identifies (field, foot, axis) from a task.

        Args:
            task: Task that specifies the same fields for the same feet as the task of this vector.
        """
        fields = task.values()
        values = [
            fields[key.field][key.foot] if key.foot else fields[key.field] for key in self.keys
        ]
        parts = [
            {axis: number for axis, number, _ in _split_value(value, value)} for value in values
        ]
        return np.array([part[key.axis] for part, key in zip(parts, self.keys, strict=True)])

    def make_task(self, values: Array, *, checked: bool = True) -> StandTask:
        """Return a copy of the stand task with new values of the requirements in ``keys``.

        Args:
            values: New values in the order of ``keys``, shape (n,) [m, rad].
            checked: If True, check the values.
        """
        changed: dict[str, dict[str, list[float]]] = {}
        for (field, foot, _), value in zip(self.keys, values.tolist(), strict=True):
            changed.setdefault(field, {}).setdefault(foot, []).append(value)
        return self._task.with_values(
            {
                name: {
                    **(self._task.contacts if FIELDS[name].kind == "contact" else {}),
                    **{foot: self._make_value(name, foot, parts) for foot, parts in of.items()},
                }
                if FIELDS[name].per
                else self._make_value(name, "", of[""])
                for name, of in changed.items()
            },
            checked=checked,
        )

    def _make_value(self, field: str, foot: str, parts: list[float]) -> Any:
        """Convert numbers [m, rad] to the value of a task's field (for ``foot``, unless empty)."""
        contact = self._task.contacts.get(foot)
        if FIELDS[field].kind == "contact" and contact is not None:
            return contact.with_parameters(parts)
        return parts[0] if len(parts) == 1 else tuple(parts)

    def clip(self, values: Array) -> Array:
        """Clip values of the requirements, (n,) [m, rad], to the bounds ``low`` and ``high``."""
        inside: Array = np.clip(values, self.low, self.high)
        return inside


def _split_value(value: Any, nominal: Any) -> Iterator[tuple[str, float, float]]:
    """Yield (axis, value, nominal value) [m, rad] of each number in a field's value.

    The axis of a scalar is "". ``value`` is a number, a point (x, y), or a contact with a surface.
    """
    if isinstance(value, tuple):
        yield from zip("xy", value, nominal, strict=True)
    elif isinstance(value, Contact | Weld):  # position or angle of the surface
        yield from zip("xyz", value.parameters, nominal.parameters, strict=False)
    else:
        yield "", value, nominal


def _list_values(task: StandTask, field: Field) -> Iterator[tuple[str, Any]]:
    """Yield (foot, joint or link, value) for each value of a field in a stand task.

    The name is "" if the field has a single value. Texts and None are left out.
    """
    value = getattr(task if field.part == "task" else task.ground, field.name)
    if field.per:
        yield from value.items()
    elif value is not None and not isinstance(value, str):
        yield "", value


def _nominal_value(robot: Robot, task: StandTask, field: Field, foot: str) -> Any:
    """Return the nominal value of a field [m, rad] (`differs_from_nominal`)."""
    if field.kind == "contact":
        contact = task.contacts[foot]
        if not contact.parameters:
            return contact
        place = default_contact_position(robot, foot)
        if isinstance(contact, Weld):
            return contact.with_parameters(place.tolist())
        if isinstance(contact.plane, Slope):
            return contact.with_plane_parameter(0.0)
        if isinstance(contact.plane, Bar):
            below = contact.plane.radius + robot.contact_radius[robot.feet[foot][0]]
            return contact.with_parameters((place - (0.0, 0.0, below)).tolist())
        if foot in robot.hands:  # the position is that of the hand's sphere
            place -= robot.contact_radius[robot.feet[foot][0]] * np.array(contact.plane.normal)
        x, y, z = place.tolist()
        plane = Plane((x, y, z), contact.plane.normal, contact.plane.friction)
        return replace(contact, plane=plane)
    if field.nominal == "zero":
        return (0.0, 0.0) if field.axes else 0.0
    if field.nominal == "foot_places":
        return nominal_foot_positions(robot)[foot][:2]
    return (
        _stance_centre(robot, task) if field.nominal == "centre" else getattr(robot, field.nominal)
    )


def _stance_centre(robot: Robot, task: StandTask) -> tuple[float, float]:
    """Compute the mean (x, y) [m] of stance foot positions, weighted by their contact points.

    Hands are left out. World frame. Without such feet, the base position in ``home``.
    """
    stance_feet = [
        place
        for foot, place in foot_positions_of_task(robot, task).items()
        if foot not in task.swing and foot not in robot.hands
        for _ in robot.feet[foot]
    ]
    x, y = np.mean(stance_feet, axis=0) if stance_feet else robot.home[:2]
    return float(x), float(y)


def _find_bounds(robot: Robot, field: Field, value: float, *, turns: bool) -> tuple[float, float]:
    """Return bounds (lower, upper) [m, rad] of a relaxed number; ``turns`` is True for an angle."""
    far = _MAX_RELAXATION * robot.stand_height
    if field.relaxation == "less" or (turns and field.kind == "contact"):  # a slope becomes flatter
        least = _MIN_HEIGHT_RATIO * value if field.open else min(0.0, value)
        return least, max(0.0, value)
    if turns:
        return min(field.low, value), max(field.high, value)
    stays_positive = field.open and value > 0.0  # beside contacts a height may be negative
    return (_MIN_HEIGHT_RATIO * value if stays_positive else value - far), value + far


def differs_from_nominal(robot: Robot, task: StandTask, requirements: Sequence[str]) -> bool:
    """Return True if a requirement of a task differs from its value in the nominal stand.

    The nominal stand is that of the default `StandTask`; its CoM is above the centre of the stance
    feet of ``task``. Values None and texts are not compared.

    Args:
        robot: Robot.
        task: Task.
        requirements: Names of the compared requirements, from `RELAXABLE_REQUIREMENTS`.
    """
    numbers = RequirementVector(robot, task, requirements)
    return bool((numbers.values != numbers.nominal).any())


def reset_to_nominal(robot: Robot, task: StandTask, requirements: Sequence[str]) -> StandTask:
    """Return a copy of a task with some requirements reset to their values in the nominal stand.

    `differs_from_nominal` describes this stand. Values are clipped to the bounds of relaxed values
    (`RequirementVector`).

    Args:
        robot: Robot.
        task: Task.
        requirements: Names of the requirements, from `RELAXABLE_REQUIREMENTS`, for example the base
            height.
    """
    numbers = RequirementVector(robot, task, requirements)
    return numbers.make_task(numbers.clip(numbers.nominal))


def relax_further(
    robot: Robot, task: StandTask, requested: StandTask, requirements: Sequence[str], share: float
) -> StandTask:
    """Increase the relaxation of a task: move relaxed values further away from requested values.

    The new value is ``relaxed + share * (relaxed - requested)``, clipped to the relaxation's
    bounds.

    Args:
        robot: Robot.
        task: Task with relaxed values.
        requested: Task with the requested values.
        requirements: Names of the relaxable requirements to change, from `RELAXABLE_REQUIREMENTS`.
        share: Added fraction of the present relaxation; negative to reduce the relaxation.
    """
    now = RequirementVector(robot, task, requirements)
    before = RequirementVector(robot, requested, requirements)
    return now.make_task(before.clip(now.values + share * (now.values - before.values)))


def round_outward(
    robot: Robot, task: StandTask, requested: StandTask, requirements: Sequence[str]
) -> StandTask:
    """Round the relaxed values of a task for a report, away from the requested values.

    A value changes by at most 0.1 mm or 0.1 deg.

    Args:
        robot: Robot.
        task: Task with relaxed values.
        requested: Task with the requested values.
        requirements: Names of the relaxable requirements to round, from `RELAXABLE_REQUIREMENTS`.
    """
    now = RequirementVector(robot, task, requirements)
    before = RequirementVector(robot, requested, requirements)
    numbers = zip(now.angles, now.values, now.nominal, before.values, strict=True)
    rounded = [_round_number(*map(float, three), angle=bool(a)) for a, *three in numbers]
    return now.make_task(before.clip(np.array(rounded)))


def _round_number(number: float, usual: float, requested: float, *, angle: bool) -> float:
    """Round a relaxed ``number`` [m, or rad if ``angle``] for a report, away from ``requested``.

    ``usual`` is the value in the stand of the default `StandTask`, which rounding must not reach.
    """
    unit = math.radians(1.0) if angle else 1e-3  # degrees, millimetres
    value, nominal = number / unit, usual / unit
    if abs(number - requested) < _ROUNDING_ATOL:
        return requested
    if abs(number - usual) < _ROUNDING_ATOL:
        return usual
    digits = max(1, math.ceil(-math.log10(_ROUNDING_SHARE * abs(value - nominal))))
    step, up = 10.0 ** -min(_MAX_DIGITS, digits), number > requested
    away = math.ceil if up else math.floor
    result = round(away(value / step + (-1e-6 if up else 1e-6)) * step, digits)
    if (result - nominal) * (value - nominal) <= 0:  # the rounded value would reach the nominal one
        return number
    return math.radians(result) if angle else round(result * 1e-3, digits + 3)


def describe_limit(
    robot: Robot, task: StandTask, possible: StandTask, requirements: Sequence[str]
) -> Diagnostic:
    """Create the message that lists reachable values of the requirements of an unreachable task.

    Args:
        robot: Robot.
        task: Unreachable task.
        possible: Reachable task with relaxed values.
        requirements: Names of the relaxed requirements, from `RELAXABLE_REQUIREMENTS`.
    """
    limits = [
        _describe_requirement(robot, possible, requirement, task) for requirement in requirements
    ]
    return diagnose("reachable-requirements", requirements=limits)


def _describe_requirement(
    robot: Robot, task: StandTask, requirement: str, requested: StandTask
) -> Diagnostic:
    """Create the message with the value of a requirement in a relaxed task."""
    name = Term(requirement)
    if requirement == "ground":
        slope = Quantity(task.ground.slope, "rad")
        steps = list(_describe_feet(task, FIELDS["heights"]))
        return diagnose("reachable-ground", field=name, value=slope, steps=steps)
    (field,) = _FIELDS_BY_REQUIREMENT[requirement]
    if field.kind == "contact":
        feet = []
        for of, contact in task.contacts.items():
            if contact == requested.contacts[of]:
                continue
            surface = contact.plane
            wall = isinstance(surface, Plane) and abs(surface.normal[2]) < MIN_SUPPORT_NORMAL_Z
            low = wall and contact.place is None and of not in robot.hands
            feet.append(diagnose("reachable-contact", link=of, value=f"{contact:.7g}", low=low))
        return diagnose("reachable-of-feet", field=name, feet=feet)
    if field.per:
        return diagnose("reachable-of-feet", field=name, feet=list(_describe_feet(task, field)))
    return _describe_value(name, field.quantity(getattr(task, requirement)))


def _describe_feet(task: StandTask, field: Field) -> Iterator[Diagnostic]:
    """Yield a message per foot, joint or link with its value in a mapping field of a task."""
    return (
        _describe_value(foot, field.quantity(value)) for foot, value in _list_values(task, field)
    )


def _describe_value(name: Term | str, value: Quantity | Vector) -> Diagnostic:
    """Create the message with the name of a requirement or foot, and a value with its unit."""
    if isinstance(value, Vector):
        return diagnose("reachable-place", field=name, place=value)
    return diagnose("reachable-value", field=name, value=value)
