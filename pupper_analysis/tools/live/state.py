"""State of a page in the units of the sliders, and the conversion to tasks and files.

Sliders use mm and degrees, tasks use SI units, and files use the values as typed on the command
line. `State` holds the requested values and converts them to a task, `make_state` converts a
task to a state, and `write_stance_file` writes a state as a file for ``--stance``.
"""

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
    """Check that a page supports a robot.

    Raises:
        ConfigurationError: If the base is fixed or the robot has no feet.
    """
    robot.check_floating("page-of-fixed-base")
    if not robot.contact_points:
        raise ConfigurationError("robot", diagnose("robot-without-feet", robot=robot.name))


PLACE_MODES = ("centre", "inside", "offset")
"""Modes of the horizontal base position: CoM over the centre of the feet, CoM inside the support
polygon, or an offset of the base that the user sets."""

ROBOT_SLIDER_FIELDS = {name: field for name, field in ROBOT_FIELDS.items() if field.slider}
"""Fields of the robot with a slider: payload, position of the payload, servo gains."""

SLIDER_FIELDS = {
    name: field for name, field in FIELDS.items() if field.slider
} | ROBOT_SLIDER_FIELDS
"""All fields with a slider: {name: field}."""

PAGE_UNITS = {kind: (unit, 1.0) for kind, unit in UNIT_BY_KIND.items()} | {
    **dict.fromkeys(("length", "point", "point3"), ("mm", 1e3)),
    "angle": ("°", math.degrees(1.0)),
    "position": ("", 1.0),  # rad, or m for a prismatic joint
    "contact": ("mm, °", 1.0),  # typed with its unit
}
"""{kind of field: (unit on the web page, factor from the SI unit)}; for example mm for a length."""

_TEXT_TYPES = str, Contact, Weld
"""Types of field values that are not numbers, and therefore are not converted between units."""


@dataclass(frozen=True, init=False)
class State:
    """Requested state of a web page, in the units of the page.

    Lengths are in mm, angles in degrees, joint positions in rad or m. Each field of `SLIDER_FIELDS`
    is an attribute; without a request the field has the default, which is None for values of the
    robot itself.

    Attributes:
        place: Mode of the base position: ``centre``, ``inside`` or ``offset``.
        values: {field name: value}, for values that differ from the default.

    Raises:
        ConfigurationError: If the mode is unknown, or a number is not finite.
        TypeError: If a field does not exist.
    """

    place: str
    values: Mapping[str, Any]

    def __init__(self, place: str = "centre", **values: Any) -> None:
        if place not in PLACE_MODES:
            raise ConfigurationError("place", diagnose("none-of", value=place, known=PLACE_MODES))
        changed = {}
        for name, field in SLIDER_FIELDS.items():
            default = find_default_value(field)
            value = _check_value(field, values.pop(name, default))
            if value != default:
                changed[name] = value
        if values:
            raise TypeError(f"a State has no {', '.join(values)}")
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "values", FrozenDict(changed))

    def __getattr__(self, name: str) -> Any:
        if name not in SLIDER_FIELDS:
            raise AttributeError(f"a State has no {name}")
        return self.values[name] if name in self.values else find_default_value(SLIDER_FIELDS[name])

    def with_values(self, **values: Any) -> State:
        """Return a copy of the page's state with changed values, {field: value in page units}."""
        return State(**{"place": self.place, **self.values, **values})

    def requested_values(self) -> Iterator[tuple[Field, Any]]:
        """Yield (field, value in page units) for the values that define the stand task.

        The mode of the base position determines whether ``offset`` or ``com`` is yielded.
        """
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
        """Return the stand task, in SI units, that the state of the page requests.

        Raises:
            ConfigurationError: If a value is out of bounds. The message uses the page's units.
        """
        for field, value in self.requested_values():
            if not isinstance(value, str):
                for element, number in _iterate_numbers(value):
                    name = f"{field.address} {element}" if element else field.name
                    field.check_range(name, number, *PAGE_UNITS[field.kind])
        return StandTask().with_values(
            {field.name: convert_to_si(field, value) for field, value in self.requested_values()}
        )

    def payload_point(self) -> tuple[str | float, ...]:
        """Return the position of the payload that the page requests, in SI units.

        Returns:
            (x, y, z) [m] in the base frame, or (frame, x, y, z).
        """
        place: tuple[str | float, ...] = convert_to_si(SLIDER_FIELDS["payload_at"], self.payload_at)
        return place

    def with_task(self, task: StandTask) -> State:
        """Return a copy of this state with the numbers of a stand task, in the units of the page.

        A field whose value in this state is None, such as a height that was not requested, stays
        None. The task must have the feet and the mode of the base position (``place``) of this
        state.
        """
        values = {
            name: convert_to_page_units(SLIDER_FIELDS[name], value)
            for name, value in task.values().items()
            if name in SLIDER_FIELDS and value is not None and getattr(self, name) is not None
        }
        return self.with_values(**values)


def find_contact_factor(contact: Contact | Weld) -> float:
    """Return the factor that converts the position number of a contact from SI to page units.

    The position is an angle for a sloped plane (rad to degrees), and otherwise a length (m to mm).
    """
    return PAGE_UNITS["angle" if contact.has_angle else "length"][1]


def find_default_value(field: Field) -> Any:
    """Return the default of a field of the page; None if the default is a value of the robot."""
    if field.per:
        return FrozenDict()
    if field.nominal != "zero":
        return None
    return (0.0,) * len(field.axes) if field.axes else 0.0


def _check_value(field: Field, value: Any) -> Any:
    """Check that all numbers of a field's value are finite, and return the value.

    Entries of feet or joints without effect (0 for most fields) are left out of the returned value.
    """
    if value is None:
        return None
    if field.per:
        # Zero displacements of a foot, and steps of zero height, are left out.
        return FrozenDict(
            {
                element: _map_numbers(item, partial(check_finite, f"{field.address} {element}"))
                for element, item in value.items()
                if _is_zero_significant(field)
                or any(number for _, number in _iterate_numbers(item))
            }
        )
    return _map_numbers(value, partial(check_finite, field.name))


def _is_zero_significant(field: Field) -> bool:
    """Return True if the number 0 for a foot or joint differs in effect from a missing entry."""
    return field.open or field.nominal != "zero" or field.kind == "contact"


def _iterate_numbers(value: Any) -> Iterator[tuple[str, float]]:
    """Yield (foot or joint, number) for all numbers of a value; "" if not per foot or joint."""
    for element, item in value.items() if isinstance(value, dict) else [("", value)]:
        for number in item if isinstance(item, tuple) else (item,):
            if not isinstance(number, _TEXT_TYPES):  # not the frame of a point
                yield element, number


def convert_to_si(field: Field, value: Any) -> Any:
    """Convert a field's value from the page's units (`PAGE_UNITS`: mm, degrees) to SI units."""
    unit, _ = PAGE_UNITS[field.kind]
    if isinstance(value, str) or unit not in ("mm", "°"):
        return value
    return _map_numbers(value, parse_length if unit == "mm" else parse_angle)


def convert_to_page_units(field: Field, value: Any) -> Any:
    """Convert a field's value from SI to the page's units (`PAGE_UNITS`), to 9 decimals."""
    _, factor = PAGE_UNITS[field.kind]
    return _map_numbers(value, lambda number: round(factor * number, 9))


def _map_numbers(value: Any, change: Callable[[float], float]) -> Any:
    """Return a value with the function ``change`` applied to all numbers; texts are kept."""
    if isinstance(value, dict):
        return {element: _map_numbers(item, change) for element, item in value.items()}
    if isinstance(value, tuple):
        return tuple(_map_numbers(number, change) for number in value)
    return value if isinstance(value, _TEXT_TYPES) else change(value)


def parse_length(millimetres: float) -> float:
    """Convert a length typed in mm to m, without the rounding error of a product.

    The decimal text followed by ``e-3`` is converted, so the result is the floating-point number
    nearest to the typed decimal number. A number whose text has an exponent already (for example,
    below 1e-4 mm) is multiplied by 1e-3.
    """
    return float(f"{millimetres!r}e-3") if "e" not in repr(millimetres) else millimetres * 1e-3


def parse_angle(degrees: float) -> float:
    """Convert an angle typed in degrees to rad, with the formula of the command line."""
    return degrees * (math.pi / 180)


def make_state(task: StandTask, **robot_values: Any) -> State:
    """Return the state of the page of ``live`` that requests a stand task.

    ``robot_values`` are further fields of the `State`, which concern the robot, in page units.

    Raises:
        ConfigurationError: If the page has no slider for a value of the task, or a number is not
            finite.
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
    page_values = {
        name: convert_to_page_units(SLIDER_FIELDS[name], value) for name, value in values.items()
    }
    return State(place, **page_values, **robot_values)


# Stance as a file of options.


def write_stance_file(state: State) -> str:
    """Return the stance, payload and gains of a state as TOML text, a file for ``--stance``."""
    lines, tables = [], []
    for option, element, value in _list_options(state):
        if element:
            tables.append(f"{option}.{json.dumps(element)} = {json.dumps(value)}")
        else:
            lines.append(f"{option} = {json.dumps(value)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def _list_options(state: State) -> Iterator[tuple[str, str, str]]:
    """Yield the command-line options that specify the stance, payload and gains of a page.

    Each option is (option, element, value as typed). The element is the foot, joint or link to
    which the value belongs; "" for an option with a single value.
    """
    for field, value in state.requested_values():
        for element, item in value.items() if field.per else [("", value)]:
            yield field.option, element, _format_option_value(field, item)
    for name in ("payload", "payload_at", "kp", "kd"):
        value = getattr(state, name)
        if value is not None and (state.payload or not name.startswith("payload")):
            yield SLIDER_FIELDS[name].option, "", _format_option_value(SLIDER_FIELDS[name], value)


def _format_option_value(field: Field, value: Any) -> str:
    """Return a value (page units) as text for an option of the command line.

    A single angle is in degrees (``deg``), other numbers are in SI units without a unit.
    """
    if field.kind == "angle":
        return f"{value!r}deg"
    if isinstance(value, tuple):
        return ",".join(p if isinstance(p, str) else repr(p) for p in convert_to_si(field, value))
    return str(value) if isinstance(value, _TEXT_TYPES) else repr(convert_to_si(field, value))
