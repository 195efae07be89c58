"""What a page asks for, in the units of its sliders: as an address, a command, a file, a link."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.parse import quote, unquote

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.cli.stance_fields import parse_contact
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VARIANTS, Scaled, VariantSpec
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS, ROBOT_FIELDS, UNITS, Field, read_table
from pupper_analysis.stance.task import StandTask

# Which robot a page is about, and how a script or a command line names it.


def load_source(files: RobotFiles) -> FileSource:
    """Loads the robot of a page.

    Raises:
        ConfigurationError: If its base is free, and it has no feet.
        ModelError: As ``load_robot``.
    """
    robot = files.load()
    if robot.floating and not robot.contact_points:
        raise ConfigurationError("robot", diagnose("robot-without-feet", robot=robot.name))
    return FileSource(files, robot)


PLACES = ("centre", "inside", "offset")
"""What decides where the base is: com over the centre, com anywhere inside, or an offset."""

OF_THE_ROBOT = {
    name: field
    for name, field in {
        **ROBOT_FIELDS,
        **read_table("pupper_analysis.tools.live", "fields.toml"),
    }.items()
    if field.slider
}
"""Fields that make another robot, which takes longer than a stance, or no other stance."""

SHOWN = {name: field for name, field in FIELDS.items() if field.slider} | OF_THE_ROBOT
"""{name: field} of all that a page asks for by sliders."""

_BY_ADDRESS = {field.address: field for field in SHOWN.values()}

PAGE_UNITS = {kind: (unit, 1.0) for kind, unit in UNITS.items()} | {
    **dict.fromkeys(("length", "point", "point3"), ("mm", 1e3)),
    "angle": ("°", math.degrees(1.0)),
    **dict.fromkeys(("ratio", "position"), ("", 1.0)),  # a joint's is in rad, or in m
    "contact": ("mm, °", 1.0),  # which says its own
}
"""{kind of a field: unit of a page, and how many are an SI unit}."""

_WORDS = str, Contact, Weld
"""What is no number, and is written as it is typed."""

_MOST_LETTERS = 4000
"""Letters of a state: 50 feet's worth; a longer one is none of ours."""


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
        if place not in PLACES:
            raise ConfigurationError("place", diagnose("none-of", value=place, known=PLACES))
        asked = {}
        for name, field in SHOWN.items():
            usual = usual_of(field)
            value = _finite(field, values.pop(name, usual))
            if value != usual:
                asked[name] = value
        if values:
            raise TypeError(f"a State has no {', '.join(values)}")
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "values", FrozenDict(asked))

    def __getattr__(self, name: str) -> Any:
        if name not in SHOWN:
            raise AttributeError(f"a State has no {name}")
        return self.values[name] if name in self.values else usual_of(SHOWN[name])

    def having(self, **values: Any) -> State:
        """Returns the state with other values."""
        return State(**{"place": self.place, **self.values, **values})

    def asked(self) -> Iterator[tuple[Field, Any]]:
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
        for field, value in self.asked():
            if not isinstance(value, str):
                for of, number in _numbers(value):
                    name = f"{field.address} {of}" if of else field.name
                    field.check_range(name, number, *PAGE_UNITS[field.kind])
        return StandTask().having(
            {field.name: in_si(field, value) for field, value in self.asked()}
        )

    def scales(self) -> dict[str, float]:
        """Returns the scales that are not the robot's own."""
        return {name: v for name, v in self.values.items() if SHOWN[name].kind == "ratio"}

    def payload_point(self) -> tuple[str | float, ...]:
        """Returns where the payload is (m); see ``robot.tool.find_place``."""
        place: tuple[str | float, ...] = in_si(SHOWN["payload_at"], self.payload_at)
        return place

    def with_task(self, task: StandTask) -> State:
        """Returns the state that has another task's numbers, as near as a slider has them.

        Args:
            task: As ``task`` makes them: with the same feet, and the same thing deciding where the
                base is.
        """
        found = {
            name: on_page(SHOWN[name], value)
            for name, value in task.values().items()
            if name in SHOWN and value is not None and getattr(self, name) is not None
        }
        return self.having(**found)

    def __str__(self) -> str:
        """Returns what differs from a page just opened, as ``parse_state`` reads it."""
        parts, feet = [], []
        for name, value in self.values.items():
            field = SHOWN[name]
            if field.per:
                for of, one in sorted(value.items()):
                    feet.append(f"{field.address}:{quote(of, safe='')},{_plainly(one)}")
            else:
                parts.append(f"{field.address}:{_plainly(value)}")
        place = [] if self.place == PLACES[0] else [f"place:{self.place}"]
        return ";".join([*parts, *place, *feet])


def factor_of(contact: Contact | Weld) -> float:
    """Returns how many of a page's mm or degrees are an SI unit of a contact's number."""
    return PAGE_UNITS["angle" if contact.turns else "length"][1]


def usual_of(field: Field) -> Any:
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


def in_si(field: Field, value: Any) -> Any:
    """Returns a field's value in SI units."""
    unit, _ = PAGE_UNITS[field.kind]
    if isinstance(value, str) or unit not in ("mm", "°"):
        return value
    return _each(value, parse_length if unit == "mm" else parse_angle)


def on_page(field: Field, value: Any) -> Any:
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


def format_number(number: float) -> str:
    """Returns a number in as few letters as say it exactly."""
    return repr(number).removesuffix(".0")


def state_of_task(task: StandTask, **more: Any) -> State:
    """Returns the state of a page that asks for a task.

    Args:
        task: The task.
        **more: What is asked of the robot, as a ``State`` has it.

    Raises:
        ConfigurationError: If it asks for what no slider has.
    """
    values = {name: value for name, value in task.values().items() if value != FIELDS[name].usual}
    place = "offset" if "offset" in values else "centre"
    if values.get("com") == "inside":
        place, _ = "inside", values.pop("com")
    for name in values:
        if name not in SHOWN:
            raise ConfigurationError(
                "stance", diagnose("entry-unknown", entry=name, known=[*SHOWN])
            )
    asked = {name: on_page(SHOWN[name], value) for name, value in values.items()}
    return State(place, **asked, **more)


def _plainly(value: Any) -> str:
    parts = value if isinstance(value, tuple) else (value,)
    return ",".join(
        quote(str(p), safe=":,=/" * (not isinstance(p, str)))
        if isinstance(p, _WORDS)
        else format_number(p)
        for p in parts
    )


def parse_state(text: str) -> State:
    """Returns the state that a text says, as ``str(state)`` writes it.

    ``height:120;roll:5;place:offset;offset:10,0;move:FR,10,0;lift:FL,20``: names and numbers, in mm
    and degrees; ``move``, ``lift`` and ``step`` once per foot, ``joint`` once per joint (rad, m),
    ``contact:FL,wall:0.4m,mu=0.6`` once per contact, as it is typed.

    Raises:
        ConfigurationError: If it says none.
    """
    if len(text) > _MOST_LETTERS:
        raise ConfigurationError(
            "stance", diagnose("text-too-long", count=len(text), most=_MOST_LETTERS)
        )
    given: dict[str, Any] = {}
    for part in filter(None, (part.strip() for part in text.split(";"))):
        name, _, value = part.partition(":")
        field = _BY_ADDRESS.get(name)
        if field is not None and field.kind == "contact":
            of, _, typed = unquote(value).partition(",")
            given.setdefault(field.name, {})[of] = parse_contact("stance", typed, part)
        elif field is not None and field.per:
            of, *said = _split(name, value, 1 + max(1, len(field.axes)))
            given.setdefault(field.name, {})[unquote(of)] = _value(name, said)
        elif (field.name if field else name) in given:
            raise ConfigurationError("stance", diagnose("said-twice", entry=name))
        elif name == "place":
            given[name] = value
        elif field is not None:
            framed = field.frame and value.count(",") == len(field.axes)
            frame, _, numbers = value.partition(",") if framed else ("", "", value)
            found = _value(name, _split(name, numbers, max(1, len(field.axes))))
            given[field.name] = (unquote(frame), *found) if framed else found  # type: ignore[misc]
        else:
            message = diagnose("entry-unknown", entry=name, known=[*_BY_ADDRESS, "place"])
            raise ConfigurationError("stance", message)
    return State(**given)


def _split(name: str, value: str, count: int) -> list[str]:
    parts = value.split(",")
    if len(parts) != count:
        message = diagnose("values-by-commas", given=f"{name}:{value}", count=count)
        raise ConfigurationError("stance", message)
    return parts


def _value(name: str, texts: list[str]) -> float | tuple[float, ...]:
    numbers = tuple(_number(name, text) for text in texts)
    return numbers if len(numbers) > 1 else numbers[0]


def _number(name: str, text: str) -> float:
    try:
        return check_finite(name, float(text))
    except ValueError:
        message = diagnose("part-is-no-number", part=text, given=name)
        raise ConfigurationError("stance", message) from None


class LiveVariants(Scaled):
    """The robots that scales make of a variant."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales.

        Raises:
            VariantError: If a scale is not a finite positive number, or nothing can be made so.
        """
        return load_variant(self._spec(scales))

    def arguments(self, scales: Mapping[str, float]) -> list[str]:
        """Returns a variant's name, or the options of its scales."""
        spec = self._spec(scales)
        if spec.name in VARIANTS:
            return [spec.name]
        words = ["--base", spec.base]
        for name, value in (
            ("--leg-scale", spec.leg_scale),
            ("--torso-mass-scale", spec.torso_mass_scale),
        ):
            words += [name, repr(value)] if value != 1.0 else []
        return words

    def _spec(self, scales: Mapping[str, float]) -> VariantSpec:
        """Returns the variant of some scales, by the name that it has, if any."""
        made = self.scaled(scales)
        return {spec: spec for spec in VARIANTS.values()}.get(made, made)


LiveSource = FileSource | LiveVariants
"""Makes the robots of a page, and says how others make them."""


# A stance for elsewhere: as a command, as a file of options, as a link.


def write_command(source: LiveSource, state: State) -> str:
    """Returns the command that solves and simulates the same stand."""
    words = source.arguments(state.scales())
    return shlex.join(["pupper-analysis", "stand", *words, *_options(state)])


def hold_command(
    source: LiveSource, scales: Mapping[str, float], positions: Mapping[str, float]
) -> str:
    """Returns the command that holds a posture with the base fixed.

    Args:
        source: The robot.
        scales: Its own scales.
        positions: {joint: where it is (rad, m)}.
    """
    words = ["pupper-analysis", "hold", *source.arguments(scales)]
    return shlex.join([*words, *(f"--joints={n}={at:.6g}" for n, at in positions.items())])


def write_stance_file(state: State) -> str:
    """Returns the options of the same stance as TOML, for ``--stance``; without the robot's."""
    lines, tables = [], []
    for option, of, value in _typed_options(state):
        if of:
            tables.append(f"{option}.{json.dumps(of)} = {json.dumps(value)}")
        else:
            lines.append(f"{option} = {json.dumps(value)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def _options(state: State) -> list[str]:
    """Returns what the command line's options of stance, payload and servos say."""
    return [
        f"--{option}={of}={value}" if of else f"--{option}={value}"
        for option, of, value in _typed_options(state)
    ]


def _typed_options(state: State) -> Iterator[tuple[str, str, str]]:
    """Yields options of stance, payload and servos, of which foot, and how one types the value."""
    for field, value in state.asked():
        for of, one in value.items() if field.per else [("", value)]:
            yield field.option, of, _typed(field, one)
    for name in ("payload", "payload_at", "kp", "kd"):
        value = getattr(state, name)
        if value is not None and (state.payload or not name.startswith("payload")):
            yield SHOWN[name].option, "", _typed(SHOWN[name], value)


def _typed(field: Field, value: Any) -> str:
    if field.kind == "angle":
        return f"{format_number(value)}deg"
    if isinstance(value, tuple):
        return ",".join(p if isinstance(p, str) else repr(p) for p in in_si(field, value))
    return str(value) if isinstance(value, _WORDS) else repr(in_si(field, value))


def write_link(address: str, state: State) -> str:
    """Returns the address of a page with the same state, of a server as a browser reaches it.

    What viser's page takes to be its server's address is, with a state behind it, what the server
    is asked for: so it learns what it is to show.

    Args:
        address: Host and port.
        state: The state.
    """
    asked = f"?websocket=ws://{address}/?state={quote(str(state), safe=':;,.%')}"
    return f"http://{address}/{asked if str(state) else ''}"
