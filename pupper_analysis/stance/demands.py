"""What a task demands beyond the nominal stand, in numbers, and how these are said."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[np.float64]

_FIELDS: dict[str, list[Field]] = {}
for _field in FIELDS.values():
    if _field.gives != "no":
        _FIELDS.setdefault(_field.attribute, []).append(_field)

DEMANDS = tuple(_FIELDS)
"""The fields of a task that may put a stance out of reach; those of the ground give together."""

_FARTHEST = 3.0
"""No place or height need be further from what was asked (stand heights): no leg reaches so far."""

_LEAST_HEIGHT = 1e-3
"""Part of a height that is always left of it: none is zero or less."""

_ROUNDING = 1e-12
"""A number that is no further from what was asked is that (m, rad)."""

_ROUNDING_SHARE = 0.005
"""A value is rounded by no more than this part of its distance from the nominal stand's."""

_MOST_DIGITS = 12


class DemandValue(NamedTuple):
    """Which number of a task: a field's, a foot's where it has some, of a point that of an axis."""

    field: str
    foot: str = ""
    axis: str = ""


class DemandVector:
    """The numbers of some demands of a task, as a vector (n,), and how far each may give.

    Margins and lifts only become less, a slope or a step as well; all else may go either way.

    Args:
        robot: The robot.
        task: The task.
        demands: Which of ``DEMANDS``.

    Attributes:
        keys: Which numbers they are.
        demands: Of each, its demand.
        values: (n,) what the task has (m, rad).
        nominal: (n,) what the nominal stand has.
        low: (n,) the least that they may become where their demand gives.
        high: (n,) the most.
        angles: Whether each is an angle.
        units: (n,) in which it is counted how much they give: a stand height, or a radian.
    """

    def __init__(self, robot: Robot, task: StandTask, demands: Sequence[str]) -> None:
        self._task = task
        self.keys: list[DemandValue] = []
        self.demands: list[str] = []
        rows = []
        for demand in demands:
            for field in _FIELDS[demand]:
                for foot, value in _values(task, field):
                    nominal = _nominal(robot, task, field, foot)
                    for axis, one, usual in _parts(value, nominal):
                        self.keys.append(DemandValue(field.name, foot, axis))
                        self.demands.append(demand)
                        turns = field.kind == "angle" or getattr(value, "turns", False)
                        ends = _range(robot, field, one, turns=turns)
                        rows.append((one, float(usual), *ends, turns))
        table = np.array(rows).reshape(-1, 5).T
        self.values, self.nominal, self.low, self.high, self.angles = table
        self.units = np.where(self.angles, 1.0, robot.stand_height)

    def read_task(self, task: StandTask) -> Array:
        """Returns what a task with the same feet has of them (n,)."""
        has = task.values()
        found = [has[key.field][key.foot] if key.foot else has[key.field] for key in self.keys]
        parts = [{axis: number for axis, number, _ in _parts(one, one)} for one in found]
        return np.array([one[key.axis] for one, key in zip(parts, self.keys, strict=True)])

    def make_task(self, values: Array) -> StandTask:
        """Returns the task with others (n,)."""
        changed: dict[str, dict[str, list[float]]] = {}
        for (field, foot, _), value in zip(self.keys, values.tolist(), strict=True):
            changed.setdefault(field, {}).setdefault(foot, []).append(value)
        return self._task.with_values(
            {
                name: {
                    **(self._task.contacts if FIELDS[name].kind == "contact" else {}),
                    **{foot: self._one(name, foot, parts) for foot, parts in of.items()},
                }
                if FIELDS[name].per
                else self._one(name, "", of[""])
                for name, of in changed.items()
            }
        )

    def _one(self, field: str, foot: str, parts: list[float]) -> Any:
        contact = self._task.contacts.get(foot)
        if FIELDS[field].kind == "contact" and contact is not None:
            return contact.moved(parts)
        return parts[0] if len(parts) == 1 else tuple(parts)

    def clip(self, values: Array) -> Array:
        """Returns values (n,) no further than they may go."""
        inside: Array = np.clip(values, self.low, self.high)
        return inside


def _parts(value: Any, nominal: Any) -> Iterator[tuple[str, float, float]]:
    """Yields the axis, the value and the nominal value of each number of a field."""
    if isinstance(value, tuple):
        yield from zip("xy", value, nominal, strict=True)
    elif isinstance(value, Contact | Weld):  # how far off its plane is, or where
        yield from zip("xyz", value.numbers, nominal.numbers, strict=False)
    else:
        yield "", value, nominal


def _values(task: StandTask, field: Field) -> Iterator[tuple[str, Any]]:
    """Yields what a field has that is in numbers, with its foot; empty if it is of none."""
    value = getattr(task if field.part == "task" else task.ground, field.name)
    if field.per:
        yield from value.items()
    elif value is not None and not isinstance(value, str):
        yield "", value


def _nominal(robot: Robot, task: StandTask, field: Field, foot: str) -> Any:
    if field.kind == "contact":
        contact = task.contacts[foot]
        if not contact.numbers:
            return contact
        place = default_contact_position(robot, foot)
        if isinstance(contact, Weld):
            return contact.moved(place.tolist())
        if isinstance(contact.plane, Slope):
            return contact.at(0.0)
        if isinstance(contact.plane, Bar):
            below = contact.plane.radius + robot.contact_radius[robot.feet[foot][0]]
            return contact.moved((place - (0.0, 0.0, below)).tolist())
        if foot in robot.hands:  # it is its ball's
            place -= robot.contact_radius[robot.feet[foot][0]] * np.array(contact.plane.normal)
        x, y, z = place.tolist()
        plane = Plane((x, y, z), contact.plane.normal, contact.plane.friction)
        return replace(contact, plane=plane)
    if field.nominal == "zero":
        return (0.0, 0.0) if field.axes else 0.0
    if field.nominal == "foot_places":
        return nominal_foot_positions(robot)[foot][:2]
    return _centre(robot, task) if field.nominal == "centre" else getattr(robot, field.nominal)


def _centre(robot: Robot, task: StandTask) -> tuple[float, float]:
    """Returns the middle of the feet that carry, seen from above (m)."""
    stance_feet = [
        place
        for foot, place in foot_positions_of_task(robot, task).items()
        if foot not in task.swing and foot not in robot.hands
        for _ in robot.feet[foot]
    ]
    x, y = np.mean(stance_feet, axis=0) if stance_feet else robot.home[:2]
    return float(x), float(y)


def _range(robot: Robot, field: Field, value: float, *, turns: bool) -> tuple[float, float]:
    """Returns the least and the most that a number may become; see ``DemandVector`` (m, rad)."""
    far = _FARTHEST * robot.stand_height
    if field.gives == "less" or (turns and field.kind == "contact"):  # a slope becomes flatter
        least = _LEAST_HEIGHT * value if field.open else min(0.0, value)
        return least, max(0.0, value)
    if turns:
        return min(field.low, value), max(field.high, value)
    return (_LEAST_HEIGHT * value if field.open else value - far), value + far


def differs_from_nominal(robot: Robot, task: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether some demands are not the nominal stand's."""
    numbers = DemandVector(robot, task, demands)
    return bool((numbers.values != numbers.nominal).any())


def reset_to_nominal(robot: Robot, task: StandTask, demands: Sequence[str]) -> StandTask:
    """Returns a task with the nominal stand's numbers for some demands; lifts are next to none."""
    numbers = DemandVector(robot, task, demands)
    return numbers.make_task(numbers.clip(numbers.nominal))


def relax_further(
    robot: Robot, task: StandTask, asked: StandTask, demands: Sequence[str], share: float
) -> StandTask:
    """Returns a task in which some demands give more, by a share of what they give already."""
    now, before = DemandVector(robot, task, demands), DemandVector(robot, asked, demands)
    return now.make_task(before.clip(now.values + share * (now.values - before.values)))


def round_outward(
    robot: Robot, task: StandTask, asked: StandTask, demands: Sequence[str]
) -> StandTask:
    """Returns a task with some demands rounded as they are reported, away from what was asked.

    By up to 0.1 mm, 0.1 degrees or 1/200 of the distance from the nominal stand, whichever is
    least.
    """
    now, before = DemandVector(robot, task, demands), DemandVector(robot, asked, demands)
    numbers = zip(now.angles, now.values, now.nominal, before.values, strict=True)
    rounded = [_rounded(*map(float, three), angle=bool(a)) for a, *three in numbers]
    return now.make_task(before.clip(np.array(rounded)))


def _rounded(number: float, usual: float, asked: float, *, angle: bool) -> float:
    unit = math.radians(1.0) if angle else 1e-3  # degrees, millimetres
    value, nominal = number / unit, usual / unit
    if abs(number - asked) < _ROUNDING:
        return asked
    if number == usual:
        return number
    digits = max(1, math.ceil(-math.log10(_ROUNDING_SHARE * abs(value - nominal))))
    step, up = 10.0 ** -min(_MOST_DIGITS, digits), number > asked
    away = math.ceil if up else math.floor
    result = round(away(value / step + (-1e-6 if up else 1e-6)) * step, digits)
    if (result - nominal) * (value - nominal) <= 0:  # nothing would be left of it
        return number
    return math.radians(result) if angle else round(result * 1e-3, digits + 3)


def describe_limit(
    robot: Robot, task: StandTask, possible: StandTask, demands: Sequence[str]
) -> Diagnostic:
    """Tells how far some demands of a task can go."""
    told = [_describe_demand(robot, possible, demand, task) for demand in demands]
    return diagnose("demands-can-go", demands=told)


def _describe_demand(robot: Robot, task: StandTask, demand: str, asked: StandTask) -> Diagnostic:
    """Tells a demand's value with its unit, in as many digits as it has; of contacts what gives."""
    name = Term(demand)
    if demand == "ground":
        slope = Quantity(task.ground.slope, "rad")
        steps = list(_of_feet(task, FIELDS["heights"]))
        return diagnose("demanded-ground", field=name, value=slope, steps=steps)
    (field,) = _FIELDS[demand]
    if field.kind == "contact":
        given = {of: one for of, one in task.contacts.items() if one != asked.contacts[of]}
        feet = []
        for of, one in given.items():
            wall = isinstance(one.plane, Plane) and abs(one.plane.normal[2]) < MIN_SUPPORT_NORMAL_Z
            low = wall and one.place is None and of not in robot.hands
            feet.append(diagnose("demanded-contact", link=of, value=f"{one:.7g}", low=low))
        return diagnose("demanded-of-feet", field=name, feet=feet)
    if field.per:
        return diagnose("demanded-of-feet", field=name, feet=list(_of_feet(task, field)))
    return _describe_value(name, field.quantity(getattr(task, demand)))


def _of_feet(task: StandTask, field: Field) -> Iterator[Diagnostic]:
    return (_describe_value(foot, field.quantity(value)) for foot, value in _values(task, field))


def _describe_value(name: Term | str, value: Quantity | Vector) -> Diagnostic:
    if isinstance(value, Vector):
        return diagnose("demanded-place", field=name, place=value)
    return diagnose("demanded-value", field=name, value=value)
