"""What a task demands beyond the nominal stand, in numbers, and how these are said."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, Vector, diagnose
from pupper_analysis.frozen import FrozenDict
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS, Field
from pupper_analysis.stance.footholds import feet_places, nominal_feet
from pupper_analysis.stance.task import StandTask

_FIELDS: dict[str, list[Field]] = {}
for _field in FIELDS.values():
    if _field.gives != "no":
        _FIELDS.setdefault(_field.attribute, []).append(_field)

DEMANDS = tuple(_FIELDS)
"""The fields of a task that may put a stance out of reach; those of the ground give together."""

_FAR = 3.0
"""No place or height need be further from what was asked (stand heights): no leg reaches so far."""

_LEAST = 1e-3
"""Part of a height that is always left of it: none is zero or less."""

_FINE = 0.005
"""A value is rounded by no more than this part of its distance from the nominal stand's."""

_DOUBTFUL = 50.0
"""Degrees are 57 radians, a centimetre is a hundredth of a metre: more is no slip of a finger."""

_MOST_DIGITS = 12


@dataclass(frozen=True)
class Number:
    """One number of a demand.

    Attributes:
        key: Which: a field of the task or its ground, or (field, foot), or (field, foot, axis).
        value: Its value (m, or rad).
        nominal: That of the nominal stand.
    """

    key: tuple[str, ...]
    value: float
    nominal: float


def numbers_of(robot: Robot, task: StandTask, demand: str) -> Iterator[Number]:
    """Yields the numbers of a demand."""
    for field in _FIELDS[demand]:
        for foot, value in _values(task, field):
            nominal = _nominal(robot, task, field, foot)
            key = (field.name, foot) if foot else (field.name,)
            if isinstance(value, tuple):
                for axis, one, other in zip("xy", value, nominal, strict=True):
                    yield Number((*key, axis), one, float(other))
            else:
                yield Number(key, value, nominal)


def _values(task: StandTask, field: Field) -> Iterator[tuple[str, Any]]:
    """Yields what a field has that is in numbers, with its foot; empty if it is of none."""
    value = getattr(task if field.part == "task" else task.ground, field.name)
    if field.per_foot:
        yield from value.items()
    elif value is not None and not isinstance(value, str):
        yield "", value


def _nominal(robot: Robot, task: StandTask, field: Field, foot: str) -> Any:
    """Returns what the nominal stand has of a field."""
    if field.nominal == "zero":
        return (0.0, 0.0) if field.axes else 0.0
    if field.nominal == "foot_places":
        return nominal_feet(robot)[foot][:2]
    return _centre(robot, task) if field.nominal == "centre" else getattr(robot, field.nominal)


def _centre(robot: Robot, task: StandTask) -> tuple[float, float]:
    """Returns the middle of the feet that carry, seen from above (m)."""
    stance_feet = [
        place
        for foot, place in feet_places(robot, task).items()
        if foot not in task.swing
        for _ in robot.soles[foot]
    ]
    x, y = np.mean(stance_feet, axis=0)
    return float(x), float(y)


def range_of(robot: Robot, asked: Number) -> tuple[float, float]:
    """Returns the least and the most that a number may become where its demand gives (m, rad).

    Margins and lifts only become less, a slope or a step as well; all else may go either way.
    """
    field, value, far = FIELDS[asked.key[0]], asked.value, _FAR * robot.stand_height
    if field.gives == "less":
        least = _LEAST * value if field.open else min(0.0, value)
        return least, max(0.0, value)
    if field.kind == "angle":
        return min(field.low, value), max(field.high, value)
    return (_LEAST * value if field.open else value - far), value + far


def with_numbers(
    task: StandTask, values: dict[tuple[str, ...], float], demands: Sequence[str]
) -> StandTask:
    """Returns a task with other numbers for some demands, by the keys of ``numbers_of``.

    They are not checked: nobody's but our own.
    """
    changed: dict[str, dict[str, Any]] = {"task": {}, "ground": {}}
    for demand in demands:
        for field in _FIELDS[demand]:
            new = {foot: _new(field, foot, one, values) for foot, one in _values(task, field)}
            if new or field.per_foot:
                changed[field.part][field.name] = FrozenDict(new) if field.per_foot else new[""]
    if changed["ground"]:
        changed["task"]["ground"] = replace(task.ground, **changed["ground"])
    return task.filled(**changed["task"])


def _new(field: Field, foot: str, had: Any, values: Mapping[tuple[str, ...], float]) -> Any:
    key = (field.name, foot) if foot else (field.name,)
    return tuple(values[*key, axis] for axis in "xy") if isinstance(had, tuple) else values[key]


def differ(robot: Robot, task: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether some demands are not the nominal stand's."""
    return any(
        number.value != number.nominal
        for demand in demands
        for number in numbers_of(robot, task, demand)
    )


def far_off(robot: Robot, task: StandTask, possible: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether a task asks for so much more than is possible that its unit is in doubt."""
    return any(
        abs(asked.value - asked.nominal) > _DOUBTFUL * abs(found.value - found.nominal)
        for demand in demands
        for asked, found in zip(
            numbers_of(robot, task, demand), numbers_of(robot, possible, demand), strict=True
        )
    )


def given_up(robot: Robot, task: StandTask, demands: Sequence[str]) -> StandTask:
    """Returns a task with the nominal stand's numbers for some demands; lifts are next to none."""
    values = {}
    had = [demand for demand in demands if any(True for _ in numbers_of(robot, task, demand))]
    for demand in had:
        for number in numbers_of(robot, task, demand):
            least, most = range_of(robot, number)
            values[number.key] = min(max(number.nominal, least), most)
    return with_numbers(task, values, had)


def further(
    robot: Robot, task: StandTask, asked: StandTask, demands: Sequence[str], share: float
) -> StandTask:
    """Returns a task in which some demands give more, by a share of what they give already."""
    values = {}
    for demand in demands:
        both = numbers_of(robot, task, demand), numbers_of(robot, asked, demand)
        for number, before in zip(*both, strict=True):
            least, most = range_of(robot, before)
            more = number.value + share * (number.value - before.value)
            values[number.key] = min(max(more, least), most)
    return with_numbers(task, values, demands)


def rounded(
    robot: Robot,
    task: StandTask,
    asked: StandTask,
    demands: Sequence[str],
    *,
    back: bool = False,
) -> StandTask:
    """Returns a task with some demands rounded to what is told of them, away from what was asked.

    By up to 0.1 mm, 0.1 degrees or 1/200 of the distance from the nominal stand, whichever is
    least; ``back`` rounds towards what was asked.
    """
    values = {
        number.key: _rounded(number, before.value, back=back)
        for demand in demands
        for number, before in zip(
            numbers_of(robot, task, demand), numbers_of(robot, asked, demand), strict=True
        )
    }
    return with_numbers(task, values, demands)


def _rounded(number: Number, asked: float, *, back: bool) -> float:
    unit = math.radians(1.0) if is_angle(number.key) else 1e-3  # degrees, millimetres
    value, nominal = number.value / unit, number.nominal / unit
    if number.value == asked or number.value == number.nominal:
        return number.value
    digits = max(1, math.ceil(-math.log10(_FINE * abs(value - nominal))))
    step, up = 10.0 ** -min(_MOST_DIGITS, digits), (number.value > asked) != back
    away = math.ceil if up else math.floor
    result = round(away(value / step + (-1e-6 if up else 1e-6)) * step, digits)
    if (result - nominal) * (value - nominal) <= 0:  # nothing would be left of it
        return number.value
    return math.radians(result) if is_angle(number.key) else round(result * 1e-3, digits + 3)


def in_radians(task: StandTask, demands: Sequence[str]) -> StandTask:
    """Returns a task with the angles of some demands as they are told in radians."""
    angles = [one for name in demands for one in _FIELDS[name] if one.kind == "angle"]
    values = {one.name: _short(value) for one in angles for _, value in _values(task, one)}
    return task.having(values)


def _short(angle: float) -> float:
    """Returns an angle rounded towards zero, as limits are."""
    return math.trunc(angle * 1e4) / 1e4


def is_angle(key: tuple[str, ...]) -> bool:
    """Tells whether a number is in radians; all others are in metres."""
    return FIELDS[key[0]].kind == "angle"


def told_limit(
    robot: Robot, task: StandTask, possible: StandTask, demands: Sequence[str]
) -> Diagnostic:
    """Tells how far some demands of a task can go."""
    return diagnose(
        "demands-can-go",
        demands=[_told(possible, demand) for demand in demands],
        far_off=far_off(robot, task, possible, demands),
    )


def _told(task: StandTask, demand: str) -> Diagnostic:
    """Tells a demand's value with its unit, in as many digits as it has."""
    name = Term(demand)
    if demand == "ground":
        slope = Quantity(task.ground.slope, "rad")
        steps = list(_of_feet(task, FIELDS["heights"]))
        return diagnose("demanded-ground", field=name, value=slope, cut=_cut(slope), steps=steps)
    (field,) = _FIELDS[demand]
    if field.per_foot:
        return diagnose("demanded-of-feet", field=name, feet=list(_of_feet(task, field)))
    value = field.quantity(getattr(task, demand))
    if isinstance(value, Vector):
        return diagnose("demanded-place", field=name, place=value)
    if field.kind == "angle":
        return diagnose("demanded-angle", field=name, value=value, cut=_cut(value))
    if field.nominal != "zero":
        return diagnose("demanded-height", field=name, value=value)
    return diagnose("demanded-length", field=name, value=value)


def _of_feet(task: StandTask, field: Field) -> Iterator[Diagnostic]:
    for foot, value in _values(task, field):
        told = field.quantity(value)
        if isinstance(told, Vector):
            yield diagnose("demanded-place", field=foot, place=told)
        else:
            yield diagnose("demanded-of-foot", subject=("foot", foot), value=told)


def _cut(angle: Quantity) -> Quantity:
    return Quantity(_short(angle.value), angle.unit)
