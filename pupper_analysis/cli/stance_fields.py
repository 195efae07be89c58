"""How a stand shall be, on the command line: an option per field of the table that has a help.

Or ``--stance FILE``: the same options from a file, which the live page saves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.inputs import read_toml
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.cli import shared
from pupper_analysis.stance.fields import FIELDS, Field

if TYPE_CHECKING:
    from pupper_analysis.robot.plane import Contact, Weld
    from pupper_analysis.stance.task import StandTask

Command = Callable[..., None]

OPTION_FIELDS = {name: field for name, field in FIELDS.items() if field.help}
"""The fields that have an option, whose value a command gets by the field's name."""


def make_option(field: Field) -> Callable[[Command], Command]:
    """Returns a field's option."""
    example = f"; e.g. {field.example}." if field.example else "."
    options: dict[str, Any] = {"help": field.help.removesuffix(".") + example}
    point = field.axes or field.choices
    if field.per:
        form = "X,Y" if point else "PLANE" if field.kind == "contact" else field.kind.upper()
        options |= {"multiple": True, "metavar": f"{field.per.upper()}={form}"}
    elif point:
        frame = "[FRAME,]" if field.frame else ""
        options |= {"metavar": frame + ",".join(field.axes or "xy").upper()}
    elif field.kind in UNIT_FACTORS:
        options |= {"type": shared.QuantityType(field.kind), "default": field.default_value}
    else:
        options |= {"type": float, "metavar": field.unit.upper(), "default": field.default_value}
    return click.option(f"--{field.option}", field.name, **options)


def make_options(*folders: str) -> tuple[Callable[[Command], Command], ...]:
    """Returns the options of the fields, or of those under some headings of the live page."""
    return tuple(
        make_option(field)
        for field in OPTION_FIELDS.values()
        if not folders or (field.slider is not None and field.slider.folder in folders)
    )


def make_task(values: Mapping[str, Any]) -> StandTask:
    """Returns the task that options say.

    Args:
        values: {field: as click read its option}; the others are as usual.
    """
    from pupper_analysis.stance.task import StandTask

    return StandTask().with_values(
        {name: to_task_value(OPTION_FIELDS[name], value) for name, value in values.items()}
    )


def to_task_value(field: Field, value: Any) -> Any:
    """Returns an option's value as the task has it."""
    if field.per:
        given = [(shared.parse_assignment(field.option, text), text) for text in value]
        names = [of for (of, _), _ in given]
        twice = next((of for of in names if names.count(of) > 1), None)
        if field.kind == "contact" and twice is not None:
            raise ConfigurationError(field.option, diagnose("contact-stated-twice", name=twice))
        return {of: _one(field, text, whole) for (of, text), whole in given}
    if value is None or value in field.choices or not (field.axes or field.choices):
        return value
    return _one(field, value, value)


def _one(field: Field, text: str, given: str) -> Any:
    if field.kind == "contact":
        return parse_contact(field.option, text, given)
    if field.axes or field.choices:
        return shared.parse_point(field.option, text, len(field.axes or "xy"), field.choices)
    return shared.parse_measure(field.option, field.kind, text, given)


def parse_contact(option: str, text: str, given: str) -> Contact | Weld:
    """Returns what is touched, of ``wall:0.4m,mu=0.6`` or ``weld``; see the option's help.

    Raises:
        ConfigurationError: For the option, if it is none.
    """
    from pupper_analysis.robot.plane import KINDS, Bar, Contact, Plane, Slope, Weld

    what, *parts = (part.strip() for part in text.split(","))
    kind, _, first = what.partition(":")
    numbers = [first, *(part for part in parts if "=" not in part)]
    known: tuple[str, ...] = ("mu", "place", "offset", "radius", "force", "grip")
    sizes = {"plane": 6, "bar": 7, "slope": 1, **dict.fromkeys(KINDS, 1)}
    if what == "weld" and numbers == [""]:
        numbers, known = [], ("place", "offset")
    elif sizes.get(kind) != len(numbers):
        form = (
            "[wall|table|ceiling]:LENGTH, slope:ANGLE, plane:X,Y,Z,NX,NY,NZ, bar:X,Y,Z,DX,DY,DZ,R,"
            " weld"
        )
        raise ConfigurationError(option, diagnose("not-of-the-form", given=given, form=form))
    unit = "length"
    if kind == "slope":
        unit, known = "angle", (*known, "uphill")
    lengths = [
        shared.parse_measure(option, unit, one, given)
        if not 3 <= place < 6  # of a plane's normal, or a bar's direction: of any length
        else shared.parse_measure(option, "direction", one, given)
        for place, one in enumerate(numbers)
    ]
    asked: dict[str, Any] = {}
    for part in (part for part in parts if "=" in part):
        word, _, value = part.partition("=")
        if word not in known:
            raise ConfigurationError(option, diagnose("not-one-of", given=word, known=known))
        if word in ("place", "offset"):
            asked[word] = shared.parse_point(option, value.replace("/", ","), 3)
        elif word == "mu":
            _, asked[word] = shared.parse_number_assignment(option, part)
        else:
            quantity = {"radius": "length", "uphill": "angle", "grip": "force"}.get(word, word)
            asked[word] = shared.parse_measure(option, quantity, value, given)
    friction = asked.pop("mu", None)
    try:
        if not lengths:
            return Weld(**asked)
        if kind == "slope":
            return Contact(Slope(lengths[0], asked.pop("uphill", 0.0), friction), **asked)
        if kind == "bar":
            x, y, z, *way, radius = lengths
            return Contact(Bar((x, y, z), (way[0], way[1], way[2]), radius, friction), **asked)
        x, y, z, *normal = lengths if kind == "plane" else (0.0, 0.0, 0.0, *KINDS[kind])
        plane = Plane((x, y, z), (normal[0], normal[1], normal[2]), friction)
        return Contact(plane if kind == "plane" else plane.moved(lengths[0]), **asked)
    except ConfigurationError as error:
        raise ConfigurationError(option, error.diagnostic) from None


_OF_ROBOT = ("payload", "payload_at", "kp", "kd", "integrator", "timestep", "cone", "impratio")
"""Options besides those of the stance: the load, and the servos that hold it."""


def _take_options(context: click.Context, _option: click.Parameter, path: Path | None) -> None:
    """Makes what a file says the options' defaults: what is typed goes first."""
    if path is not None:
        context.default_map = {**(context.default_map or {}), **read_stance_file(path)}


stance_option = click.option(
    "--stance",
    type=click.Path(path_type=Path),
    is_eager=True,  # before the options whose defaults it gives
    expose_value=False,
    callback=_take_options,
    help="TOML file of such options, as the live page saves it; e.g. a line height = '12cm'. What "
    "is typed goes first.",
)


def read_stance_file(path: Path) -> dict[str, Any]:
    """Returns {parameter: value as it would be typed} of a stance's file.

    Raises:
        ConfigurationError: If it cannot be read, or has what is no option of a stance.
    """
    try:
        _, given = read_toml(path)
    except InputError as error:
        raise ConfigurationError(str(path), error.cause) from error
    known = {field.option: name for name, field in OPTION_FIELDS.items()}
    known |= {name.replace("_", "-"): name for name in _OF_ROBOT}
    options = {}
    for key, value in given.items():
        option = key.replace("_", "-")
        if option not in known:
            unknown = diagnose("no-option-of-a-stance", given=key, known=sorted(known))
            raise ConfigurationError(str(path), unknown)
        typed = _typed(path, key, value)
        field = OPTION_FIELDS.get(known[option])
        if field is not None and field.per and not isinstance(value, Mapping):
            form = '{}."{}" = "{}"'.format(option, *field.example.strip("'").split("=", 1))
            raise ConfigurationError(str(path), diagnose("not-of-the-form", given=key, form=form))
        several = option in ("kp", "kd") and not isinstance(typed, list)
        options[known[option]] = [typed] if several else typed
    return options


def _typed(path: Path, key: str, value: Any) -> Any:
    """Returns a value as it is typed: a point with commas, of several feet or joints a list.

    Raises:
        ConfigurationError: If none is typed so.
    """
    if isinstance(value, Mapping):
        return [f"{name}={_typed(path, key, one)}" for name, one in value.items()]
    if isinstance(value, list):
        return ",".join(str(_typed(path, key, one)) for one in value)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ConfigurationError(str(path), diagnose("no-value-of-a-stance", given=key))
    return value
