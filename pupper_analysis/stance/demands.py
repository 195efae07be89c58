"""What a task demands beyond the nominal stand, how it gives way, and how it is said."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.footholds import feet_places, nominal_feet
from pupper_analysis.stance.task import StandTask

DEMANDS = (
    *("height", "roll", "pitch", "yaw", "offset", "com", "feet", "foot_offsets", "swing"),
    *("ground", "com_margin", "joint_margin", "ground_clearance", "self_clearance"),
)
"""The fields of a task that may put a stance out of reach."""

_ANGLES = ("roll", "pitch", "yaw", "slope", "joint_margin")

_FINE = 0.005
"""A value is rounded by no more than this part of its distance from the nominal stand's."""

_DOUBTFUL = 50.0
"""Degrees are 57 radians, a centimetre is a hundredth of a metre: more is no slip of a finger."""

_MOST_DIGITS = 12
_LEAST_SHARE = 1e-9
"""Of a swing foot's height, as a foot that is not lifted would carry; and of the com's margin, as
with an offset none at all would let the com leave the support polygon."""


@dataclass(frozen=True)
class _Number:
    """One number of a demand.

    Attributes:
        key: Which: a field of the task or its ground, or (field, foot), or (field, foot, axis).
        value: Its value (m, or rad).
        nominal: That of the nominal stand.
    """

    key: tuple[str, ...]
    value: float
    nominal: float


def _numbers(robot: Robot, task: StandTask, demand: str) -> Iterator[_Number]:
    """Yields the numbers of a demand."""
    value = getattr(task, demand)
    if value is None or (demand == "com" and isinstance(value, str)):
        return
    if demand == "height":
        yield _Number((demand,), value, robot.stand_height)
    elif demand == "ground":
        yield _Number(("slope",), value.slope, 0.0)
        for foot, height in value.heights.items():
            yield _Number(("heights", foot), height, 0.0)
    elif demand in ("offset", "com"):
        centre = (0.0, 0.0) if demand == "offset" else _centre(robot, task)
        for axis, one, other in zip("xy", value, centre, strict=True):
            yield _Number((demand, axis), one, float(other))
    elif demand in ("feet", "foot_offsets"):
        places = nominal_feet(robot)
        for foot, place in value.items():
            nominal = places[foot] if demand == "feet" else (0.0, 0.0)
            for axis, one, other in zip("xy", place, nominal, strict=True):
                yield _Number((demand, foot, axis), one, float(other))
    elif demand == "swing":
        for foot, height in value.items():
            yield _Number((demand, foot), height, 0.0)
    else:
        yield _Number((demand,), value, 0.0)


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


def _replaced(task: StandTask, demand: str, values: dict[tuple[str, ...], float]) -> StandTask:
    """Returns a task with other numbers for a demand, by the keys of ``_numbers``."""
    if not values:
        return task
    if demand == "ground":
        steps = {foot: values["heights", foot] for foot in task.ground.heights}
        return replace(task, ground=replace(task.ground, slope=values["slope",], heights=steps))
    new: object
    if demand in ("offset", "com"):
        new = values[demand, "x"], values[demand, "y"]
    elif demand in ("feet", "foot_offsets"):
        feet = getattr(task, demand)
        new = {foot: (values[demand, foot, "x"], values[demand, foot, "y"]) for foot in feet}
    elif demand == "swing":
        new = {foot: values[demand, foot] for foot in task.swing}
    else:
        new = values[demand,]
    return replace(task, **{demand: new})  # type: ignore[arg-type]


def differ(robot: Robot, task: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether some demands are not the nominal stand's."""
    return any(
        number.value != number.nominal
        for demand in demands
        for number in _numbers(robot, task, demand)
    )


def far_off(robot: Robot, task: StandTask, possible: StandTask, demands: Sequence[str]) -> bool:
    """Tells whether a task asks for so much more than is possible that its unit is in doubt."""
    return any(
        abs(asked.value - asked.nominal) > _DOUBTFUL * abs(found.value - found.nominal)
        for demand in demands
        for asked, found in zip(
            _numbers(robot, task, demand), _numbers(robot, possible, demand), strict=True
        )
    )


def shrunk(robot: Robot, task: StandTask, demands: Sequence[str], share: float) -> StandTask:
    """Returns a task with some demands between the nominal stand's (0) and its own (1)."""
    for demand in demands:
        values = {
            number.key: number.nominal + _share(demand, share) * (number.value - number.nominal)
            for number in _numbers(robot, task, demand)
        }
        task = _replaced(task, demand, values)
    return task


def _share(demand: str, share: float) -> float:
    return max(share, _LEAST_SHARE) if demand in ("swing", "com_margin") else share


def rounded(robot: Robot, task: StandTask, demands: Sequence[str]) -> StandTask:
    """Returns a task with some demands rounded to what ``in_words`` prints.

    Every number is rounded towards the nominal stand's: by up to 0.1 mm, 0.1 degrees or 1/200 of
    its distance from that, whichever is the least.
    """
    for demand in demands:
        values = {number.key: _inwards(number) for number in _numbers(robot, task, demand)}
        task = _replaced(task, demand, values)
    return task


def in_radians(task: StandTask, demands: Sequence[str]) -> StandTask:
    """Returns a task with the angles of some demands as ``in_words`` prints them in radians."""
    for demand in demands:
        if demand in _ANGLES:
            task = replace(task, **{demand: _short(getattr(task, demand))})  # type: ignore[arg-type]
        elif demand == "ground":
            task = replace(task, ground=replace(task.ground, slope=_short(task.ground.slope)))
    return task


def _short(angle: float) -> float:
    """Returns an angle rounded towards zero, as limits are."""
    return math.trunc(angle * 1e4) / 1e4


def _inwards(number: _Number) -> float:
    unit = math.radians(1.0) if _is_angle(number.key) else 1e-3  # degrees, millimetres
    value, nominal = number.value / unit, number.nominal / unit
    away = abs(value - nominal)
    if away == 0.0:
        return number.value
    digits = min(_MOST_DIGITS, max(1, math.ceil(-math.log10(_FINE * away))))
    step = 10.0**-digits
    down = math.floor if value > nominal else math.ceil
    result = round(down(value / step + (1e-6 if value > nominal else -1e-6)) * step, digits)
    if (result - nominal) * (value - nominal) <= 0:  # beyond the nominal: nothing is left of it
        return number.value
    return math.radians(result) if _is_angle(number.key) else round(result * 1e-3, digits + 3)


def _is_angle(key: tuple[str, ...]) -> bool:
    return key[0] in _ANGLES


def in_words(task: StandTask, demand: str) -> str:
    """Returns a demand's value with its unit, in as many digits as it has."""
    value = getattr(task, demand)
    if demand == "height":
        return f"{_text(value, 3)} m"
    if demand in _ANGLES:
        return _angle(value)
    if demand == "ground":
        steps = ", ".join(f"{foot} {_millimetres(h)}" for foot, h in value.heights.items())
        return f"slope {_angle(value.slope)}" + (f", steps {steps}" if steps else "")
    if demand == "swing":
        return ", ".join(f"{foot} {_millimetres(h)}" for foot, h in value.items())
    if demand in ("offset", "com"):
        return _point(value)
    if demand in ("feet", "foot_offsets"):
        return ", ".join(f"{foot} {_point(place)}" for foot, place in value.items())
    return _millimetres(value)


def _text(value: float, digits: int) -> str:
    """Returns a number with at least some digits, and as many as it needs, up to a limit."""
    while digits < _MOST_DIGITS and abs(round(value, digits) - value) > 1e-12 * max(
        1.0, abs(value)
    ):
        digits += 1
    return f"{value:.{digits}f}"


def _angle(value: float) -> str:
    """Returns an angle in degrees, and in radians."""
    return f"{_text(math.degrees(value), 1)} deg ({_short(value):.4f} rad)"


def _millimetres(value: float) -> str:
    return f"{_text(1e3 * value, 1)} mm"


def _point(place: Sequence[float]) -> str:
    return f"({', '.join(_text(1e3 * value, 1) for value in place)}) mm"
