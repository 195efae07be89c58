"""What a task demands beyond the nominal stand, in numbers, and how these are said."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, Vector, diagnose
from pupper_analysis.frozen import FrozenDict
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.footholds import feet_places, nominal_feet
from pupper_analysis.stance.task import StandTask

DEMANDS = (
    *("height", "roll", "pitch", "yaw", "offset", "com", "feet", "foot_offsets", "swing"),
    *("ground", "com_margin", "joint_margin", "ground_clearance", "self_clearance"),
)
"""The fields of a task that may put a stance out of reach."""

MARGINS = ("com_margin", "joint_margin", "ground_clearance", "self_clearance")
"""Those of which more is only harder, and less than nothing is not to be had."""

_FAR = 3.0
"""No place or height need be further from what was asked (stand heights): no leg reaches so far."""

_LEAST = 1e-3
"""Part of a height that is always left of it: none is zero or less."""

_ANGLES = ("roll", "pitch", "yaw", "slope", "joint_margin")

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
    value = getattr(task, demand)
    if value is None or (demand == "com" and isinstance(value, str)):
        return
    if demand == "height":
        yield Number((demand,), value, robot.stand_height)
    elif demand == "ground":
        yield Number(("slope",), value.slope, 0.0)
        for foot, height in value.heights.items():
            yield Number(("heights", foot), height, 0.0)
    elif demand in ("offset", "com"):
        centre = (0.0, 0.0) if demand == "offset" else _centre(robot, task)
        for axis, one, other in zip("xy", value, centre, strict=True):
            yield Number((demand, axis), one, float(other))
    elif demand in ("feet", "foot_offsets"):
        places = nominal_feet(robot)
        for foot, place in value.items():
            nominal = places[foot] if demand == "feet" else (0.0, 0.0)
            for axis, one, other in zip("xy", place, nominal, strict=True):
                yield Number((demand, foot, axis), one, float(other))
    elif demand == "swing":
        for foot, height in value.items():
            yield Number((demand, foot), height, 0.0)
    else:
        yield Number((demand,), value, 0.0)


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


def range_of(robot: Robot, demand: str, asked: Number) -> tuple[float, float]:
    """Returns the least and the most that a number may become where its demand gives (m, rad).

    Margins and lifts only become less, a slope or a step as well; all else may go either way.
    """
    value, far = asked.value, _FAR * robot.stand_height
    if demand in MARGINS:
        return 0.0, value
    if demand == "ground":
        return min(0.0, value), max(0.0, value)
    if demand in ("roll", "pitch", "yaw"):
        return min(-math.pi, value), max(math.pi, value)
    if demand == "swing":
        return _LEAST * value, value
    return (_LEAST * value if demand == "height" else value - far), value + far


def with_numbers(
    task: StandTask, values: dict[tuple[str, ...], float], demands: Sequence[str]
) -> StandTask:
    """Returns a task with other numbers for some demands, by the keys of ``numbers_of``.

    They are not checked: nobody's but our own.
    """
    return task.filled(**{demand: _value(task, demand, values) for demand in demands})


def _value(task: StandTask, demand: str, values: dict[tuple[str, ...], float]) -> object:
    """Returns what a field of a task is with other numbers."""
    if demand == "ground":
        steps = {foot: values["heights", foot] for foot in task.ground.heights}
        return replace(task.ground, slope=values["slope",], heights=steps)
    if demand in ("offset", "com"):
        return values[demand, "x"], values[demand, "y"]
    if demand in ("feet", "foot_offsets"):
        return FrozenDict(
            {
                foot: (values[demand, foot, "x"], values[demand, foot, "y"])
                for foot in getattr(task, demand)
            }
        )
    if demand == "swing":
        return FrozenDict({foot: values[demand, foot] for foot in task.swing})
    return values[demand,]


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
            least, most = range_of(robot, demand, number)
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
            least, most = range_of(robot, demand, before)
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
    for demand in demands:
        if demand in _ANGLES:
            task = task.filled(**{demand: _short(getattr(task, demand))})
        elif demand == "ground":
            task = task.filled(ground=replace(task.ground, slope=_short(task.ground.slope)))
    return task


def _short(angle: float) -> float:
    """Returns an angle rounded towards zero, as limits are."""
    return math.trunc(angle * 1e4) / 1e4


def is_angle(key: tuple[str, ...]) -> bool:
    """Tells whether a number is in radians; all others are in metres."""
    return key[0] in _ANGLES


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
    field, value = Term(demand), getattr(task, demand)
    if demand in _ANGLES:
        return diagnose(
            "demanded-angle", field=field, value=Quantity(value, "rad"), cut=_cut(value)
        )
    if demand == "ground":
        steps = [
            diagnose("demanded-of-foot", subject=("foot", foot), value=Quantity(height, "m"))
            for foot, height in value.heights.items()
        ]
        slope = Quantity(value.slope, "rad")
        return diagnose(
            "demanded-ground", field=field, value=slope, cut=_cut(value.slope), steps=steps
        )
    if demand == "swing":
        feet = [
            diagnose("demanded-of-foot", subject=("foot", foot), value=Quantity(height, "m"))
            for foot, height in value.items()
        ]
        return diagnose("demanded-of-feet", field=field, feet=feet)
    if demand in ("offset", "com"):
        return diagnose("demanded-place", field=field, place=Vector(value, "m"))
    if demand in ("feet", "foot_offsets"):
        feet = [
            diagnose("demanded-place", field=foot, place=Vector(place, "m"))
            for foot, place in value.items()
        ]
        return diagnose("demanded-of-feet", field=field, feet=feet)
    length = Quantity(value, "m")
    if demand == "height":
        return diagnose("demanded-height", field=field, value=length)
    return diagnose("demanded-length", field=field, value=length)


def _cut(angle: float) -> Quantity:
    return Quantity(_short(angle), "rad")
