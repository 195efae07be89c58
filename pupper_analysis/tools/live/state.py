"""What a page asks for, in the units of its sliders, and as a file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS, ROBOT_FIELDS, UNIT_BY_KIND, Field
from pupper_analysis.stance.task import StandTask


def check_page_robot(robot: Robot) -> None:
    """Checks that a page can be of a robot.

    Raises:
        ConfigurationError: If its base is fixed, or it has no feet.
    """
    if not robot.floating:
        raise ConfigurationError("robot", diagnose("page-of-fixed-base", robot=robot.name))
    if not robot.contact_points:
        raise ConfigurationError("robot", diagnose("robot-without-feet", robot=robot.name))


PLACE_MODES = ("centre", "inside", "offset")
"""What decides where the base is: com over the centre, com anywhere inside, or an offset."""

ROBOT_SLIDER_FIELDS = {name: field for name, field in ROBOT_FIELDS.items() if field.slider}
"""Fields that make another robot, which takes longer than a stance, or no other stance."""

SLIDER_FIELDS = {
    name: field for name, field in FIELDS.items() if field.slider
} | ROBOT_SLIDER_FIELDS
"""{name: field} of all that a page asks for by sliders."""

PAGE_UNITS = {kind: (unit, 1.0) for kind, unit in UNIT_BY_KIND.items()} | {
    **dict.fromkeys(("length", "point", "point3"), ("mm", 1e3)),
    "angle": ("°", math.degrees(1.0)),
    "position": ("", 1.0),  # a joint's is in rad, or in m
    "contact": ("mm, °", 1.0),  # which says its own
}
"""{kind of a field: unit of a page, and how many are an SI unit}."""

_WORDS = str, Contact, Weld
"""What is no number, and is written as it is typed."""


@dataclass(frozen=True, init=False)
class State:
    """What a page asks for, as sliders have it: lengths in mm, angles in degrees.

    Positions of joints are in rad, or in m of one that slides.

    Each field of ``SHOWN`` is an attribute, with its usual value where nothing is asked: None where
    that is the robot's own.

    Attributes:
        place: What decides where the base is: ``centre``, ``inside`` or ``offset``.
        values: {name of a field: its value}, where it is not the usual one.
    """

    place: str
    values: Mapping[str, Any]

    def __init__(self, place: str = "centre", **values: Any) -> None:
        if place not in PLACE_MODES:
            raise ConfigurationError("place", diagnose("none-of", value=place, known=PLACE_MODES))
        asked = {}
        for name, field in SLIDER_FIELDS.items():
            usual = find_default_value(field)
            value = _finite(field, values.pop(name, usual))
            if value != usual:
                asked[name] = value
        if values:
            raise TypeError(f"a State has no {', '.join(values)}")
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "values", FrozenDict(asked))

    def __getattr__(self, name: str) -> Any:
        if name not in SLIDER_FIELDS:
            raise AttributeError(f"a State has no {name}")
        return self.values[name] if name in self.values else find_default_value(SLIDER_FIELDS[name])

    def having(self, **values: Any) -> State:
        """Returns the state with other values."""
        return State(**{"place": self.place, **self.values, **values})

    def requested_values(self) -> Iterator[tuple[Field, Any]]:
        """Yields what is asked of the stand: fields of ``FIELDS``, and their values."""
        for name, field in FIELDS.items():
            if name == "offset":
                if self.place == "offset":
                    yield field, self.offset
            elif name == "com":
                if self.place == "inside":
                    yield field, "inside"
            elif name in self.values:
                yield field, self.values[name]

    def task(self) -> StandTask:
        """Returns the stand task.

        Raises:
            ConfigurationError: If it is none; in the units in which it was asked.
        """
        for field, value in self.requested_values():
            if not isinstance(value, str):
                for of, number in _numbers(value):
                    name = f"{field.address} {of}" if of else field.name
                    field.check_range(name, number, *PAGE_UNITS[field.kind])
        return StandTask().with_values(
            {field.name: convert_to_si(field, value) for field, value in self.requested_values()}
        )

    def payload_point(self) -> tuple[str | float, ...]:
        """Returns where the payload is (m); see ``robot.tool.find_place``."""
        place: tuple[str | float, ...] = convert_to_si(SLIDER_FIELDS["payload_at"], self.payload_at)
        return place

    def with_task(self, task: StandTask) -> State:
        """Returns the state that has another task's numbers, as near as a slider has them.

        Args:
            task: As ``task`` makes them: with the same feet, and the same thing deciding where the
                base is.
        """
        found = {
            name: convert_to_page_units(SLIDER_FIELDS[name], value)
            for name, value in task.values().items()
            if name in SLIDER_FIELDS and value is not None and getattr(self, name) is not None
        }
        return self.having(**found)


def find_contact_factor(contact: Contact | Weld) -> float:
    """Returns how many of a page's mm or degrees are an SI unit of a contact's number."""
    return PAGE_UNITS["angle" if contact.turns else "length"][1]


def find_default_value(field: Field) -> Any:
    """Returns a field's value on a page just opened; None if it is the robot's own."""
    if field.per:
        return FrozenDict()
    if field.nominal != "zero":
        return None
    return (0.0,) * len(field.axes) if field.axes else 0.0


def _finite(field: Field, value: Any) -> Any:
    """Returns a value of finite numbers; of feet or joints, those that it makes a difference to."""
    if value is None:
        return None
    if field.per:
        # A foot that is where it is anyway is not moved, and stands on no step.
        return FrozenDict(
            {
                of: _each(one, partial(check_finite, f"{field.address} {of}"))
                for of, one in value.items()
                if _zero_counts(field) or any(number for _, number in _numbers(one))
            }
        )
    return _each(value, partial(check_finite, field.name))


def _zero_counts(field: Field) -> bool:
    """Whether 0, of a foot or joint, is another thing than nothing."""
    return field.open or field.nominal != "zero" or field.kind == "contact"


def _numbers(value: Any) -> Iterator[tuple[str, float]]:
    """Yields the numbers of a value, each with its foot or joint, or an empty name."""
    for of, one in value.items() if isinstance(value, dict) else [("", value)]:
        for number in one if isinstance(one, tuple) else (one,):
            if not isinstance(number, _WORDS):  # a point's frame
                yield of, number


def convert_to_si(field: Field, value: Any) -> Any:
    """Returns a field's value in SI units."""
    unit, _ = PAGE_UNITS[field.kind]
    if isinstance(value, str) or unit not in ("mm", "°"):
        return value
    return _each(value, parse_length if unit == "mm" else parse_angle)


def convert_to_page_units(field: Field, value: Any) -> Any:
    """Returns a field's value, in SI units, as a slider has it: without the noise of the change."""
    _, factor = PAGE_UNITS[field.kind]
    return _each(value, lambda number: round(factor * number, 9))


def _each(value: Any, change: Callable[[float], float]) -> Any:
    """Returns a value, of feet, joints or not, with each of its numbers changed."""
    if isinstance(value, dict):
        return {of: _each(one, change) for of, one in value.items()}
    if isinstance(value, tuple):
        return tuple(_each(number, change) for number in value)
    return value if isinstance(value, _WORDS) else change(value)


def parse_length(millimetres: float) -> float:
    """Returns a length in m: the number that is typed with as many digits, not its neighbour."""
    return float(f"{millimetres!r}e-3") if "e" not in repr(millimetres) else millimetres * 1e-3


def parse_angle(degrees: float) -> float:
    """Returns an angle in rad, as the command line reads ``5deg``."""
    return degrees * (math.pi / 180)


def make_state(task: StandTask, **more: Any) -> State:
    """Returns the state of a page that asks for a task.

    Args:
        task: The task.
        **more: What is asked of the robot, as a ``State`` has it.

    Raises:
        ConfigurationError: If it asks for what no slider has.
    """
    values = {
        name: value for name, value in task.values().items() if value != FIELDS[name].default_value
    }
    place = "offset" if "offset" in values else "centre"
    if values.get("com") == "inside":
        place, _ = "inside", values.pop("com")
    for name in values:
        if name not in SLIDER_FIELDS:
            raise ConfigurationError(
                "stance", diagnose("entry-unknown", entry=name, known=[*SLIDER_FIELDS])
            )
    asked = {
        name: convert_to_page_units(SLIDER_FIELDS[name], value) for name, value in values.items()
    }
    return State(place, **asked, **more)


# A stance for elsewhere: as a file of options.


def write_stance_file(state: State) -> str:
    """Returns the options of the same stance as TOML, for ``--stance``; without the robot's."""
    lines, tables = [], []
    for option, of, value in _typed_options(state):
        if of:
            tables.append(f"{option}.{json.dumps(of)} = {json.dumps(value)}")
        else:
            lines.append(f"{option} = {json.dumps(value)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def _typed_options(state: State) -> Iterator[tuple[str, str, str]]:
    """Yields options of stance, payload and servos, of which foot, and how one types the value."""
    for field, value in state.requested_values():
        for of, one in value.items() if field.per else [("", value)]:
            yield field.option, of, _typed(field, one)
    for name in ("payload", "payload_at", "kp", "kd"):
        value = getattr(state, name)
        if value is not None and (state.payload or not name.startswith("payload")):
            yield SLIDER_FIELDS[name].option, "", _typed(SLIDER_FIELDS[name], value)


def _typed(field: Field, value: Any) -> str:
    if field.kind == "angle":
        return f"{value!r}deg"
    if isinstance(value, tuple):
        return ",".join(p if isinstance(p, str) else repr(p) for p in convert_to_si(field, value))
    return str(value) if isinstance(value, _WORDS) else repr(convert_to_si(field, value))
