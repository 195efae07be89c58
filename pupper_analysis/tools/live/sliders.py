"""The sliders of a page: what each is about, and how far it goes for one robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pupper_analysis.base.diagnostics import Term
from pupper_analysis.base.diagnostics.templates import fill_template
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.stance.fields import Field, Slider
from pupper_analysis.tools.live.state import PAGE_UNITS, SHOWN

_WAYS = {"x": Term("forward"), "y": Term("to the left"), "z": Term("up")}


@dataclass(frozen=True)
class Control:
    """One slider: a field's number, or one of a point's.

    Attributes:
        name: What it is called: ``roll``, ``offset_x``.
        field: What it sets.
        axis: Which number of a point; None for a number.
    """

    name: str
    field: Field
    axis: int | None = None

    def label(self, language: str) -> str:
        """Returns what it is called, with its unit."""
        unit, _ = PAGE_UNITS[self.field.kind]
        axis = "" if self.axis is None else f" {self.field.axes[self.axis]}"
        return f"{self.field.words(language).label}{axis}" + (f" ({unit})" if unit else "")

    def hint(self, language: str) -> str:
        """Returns what it is about."""
        way = {} if self.axis is None else {"axis": _WAYS[self.field.axes[self.axis]]}
        return fill_template(self.field.words(language).hint, way, language)

    def of(self, value: float | tuple[str | float, ...]) -> float:
        """Returns its number of the field's value."""
        if self.axis is None:
            return float(value)  # type: ignore[arg-type]
        return float(value[self.axis - len(self.field.axes)])  # type: ignore[index]  # behind a frame


CONTROLS = {
    control.name: control
    for field in SHOWN.values()
    if field.per != "joint"
    for control in (
        [Control(f"{field.address}_{axis}", field, at) for at, axis in enumerate(field.axes)]
        or [Control(field.address, field)]
    )
}
"""{name: slider} of all there are, by the names that the page's address has for them; those of
joints are the robot's (``live.joints``)."""


@dataclass(frozen=True)
class Range:
    """How a slider goes.

    Attributes:
        low: Where it begins.
        high: Where it ends.
        step: From notch to notch.
        value: Where it is on a page just opened.
    """

    low: float
    high: float
    step: float
    value: float


def ranges_of(robot: Robot, scales: Mapping[str, float]) -> dict[str, Range]:
    """Returns the range of each slider: in mm, degrees, kg and N m/rad.

    Lengths are parts of the height of the nominal stand, so that they suit a robot of any size.

    Args:
        robot: The robot.
        scales: {name of a scale that it can be made with: its own}.
    """
    found = {}
    for name, control in CONTROLS.items():
        field, slider = control.field, control.field.slider
        assert slider is not None  # or the page would not show it
        if field.kind == "ratio":
            if name in scales:
                found[name] = _scale(slider, scales[name])
        elif field.kind in ("stiffness", "damping"):
            found[name] = _gain(field, slider, robot)
        elif field.kind == "angle":
            found[name] = Range(slider.low, slider.high, slider.step or 0.1, 0.0)
        else:
            found[name] = _span(field, slider, robot)
    return found


def _span(field: Field, slider: Slider, robot: Robot) -> Range:
    """Returns how a length goes, in parts of the robot's height; a mass, of its mass."""
    whole = robot.total_mass if field.kind == "mass" else 1e3 * robot.stand_height
    low, high = (math.copysign(round_up(abs(end) * whole), end) if end else 0.0
                 for end in (slider.low, slider.high))  # fmt: skip
    step = fine_step((slider.high - max(slider.low, 0.0)) * whole)
    value = 0.0 if field.nominal == "zero" else 1e3 * getattr(robot, field.nominal)
    if slider.start is not None:
        value = min(1e3 * slider.start, high)
    return Range(step if field.open and low == 0.0 else low, high, step, value)


def _scale(slider: Slider, own: float) -> Range:
    return Range(min(slider.low, own), max(slider.high, own), slider.step or 0.01, own)


def _gain(field: Field, slider: Slider, robot: Robot) -> Range:
    """Returns the range of a gain, around the model's own; 0 is no stiffness."""
    own = own_servos(robot)
    values = [gains[("kp", "kd").index(field.name)] for gains in own.values()]
    middle = float(np.median(values)) if values else 0.0
    middle = middle or slider.start or 1.0
    high = round_up(8 * middle)
    low = fine_step(high) if field.kind == "stiffness" else 0.0
    return Range(low, high, fine_step(high), middle)


def fine_step(span: float) -> float:
    """Returns a step of which a span has some hundreds: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(span / 200))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= span / 400)


def round_up(value: float) -> float:
    """Returns the next number of one digit, or of one and a half."""
    power = 10.0 ** math.floor(math.log10(value))
    factors = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(round(f * power, 9) for f in factors if f * power >= value * (1 - 1e-9))
