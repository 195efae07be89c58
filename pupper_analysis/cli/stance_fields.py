"""Create the command-line options of a stand task: one for each field that has a help text.

``--stance FILE`` reads the same options from a file, as saved by the live page, or the stance from
results as JSON.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from pupper_analysis.base.diagnostics import Phrase, diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.inputs import read_text, read_toml
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.cli import shared
from pupper_analysis.stance.fields import FIELDS, Field

if TYPE_CHECKING:
    from pupper_analysis.robot.plane import Contact, Weld
    from pupper_analysis.stance.task import StandTask

Command = Callable[..., None]
"""Function of a command-line command. The arguments of the function are the values of the command's
parameters."""

OPTION_FIELDS = {name: field for name, field in FIELDS.items() if field.help}
"""{name of a field of the stand task: field}, for the fields with an option. A command receives the
value of the option under this name."""


def make_option(field: Field) -> Callable[[Command], Command]:
    """Create a decorator that adds the option of a stand-task field to a command-line command."""
    example = f"; e.g. {field.example}." if field.example else "."
    options: dict[str, Any] = {"help": field.help.removesuffix(".") + example}
    if field.per or field.choices:
        options["shell_complete"] = partial(_complete_value, field)
    is_point = field.axes or field.choices
    if field.per:
        form = "X,Y" if is_point else "PLANE" if field.kind == "contact" else field.kind.upper()
        options |= {"multiple": True, "metavar": f"{field.per.upper()}={form}"}
    elif is_point:
        frame = "[FRAME,]" if field.frame else ""
        options |= {"metavar": frame + ",".join(field.axes or "xy").upper()}
    elif field.kind in UNIT_FACTORS:
        options |= {"type": shared.QuantityType(field.kind), "default": field.default_value}
    else:
        options |= {"type": float, "metavar": field.unit.upper(), "default": field.default_value}
    return click.option(f"--{field.option}", field.name, **options)


def _complete_value(
    field: Field, context: click.Context, _: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Return the completions of an incomplete value of a field's option, for a shell."""
    words = [*field.choices]
    if field.per:
        words = [f"{name}=" for name in _list_elements(field.per, context.params.get("words"))]
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def _list_elements(kind: str, words: Sequence[str] | None) -> list[str]:
    """Return the names of the feet, joints or links of a robot; none if the robot cannot be loaded.

    ``kind`` is ``foot``, ``joint`` or ``link``; ``words`` name the robot (default: v3).
    """
    with suppress(Exception):  # a shell shows no error while it completes a word
        from pupper_analysis import load_robot

        robot = load_robot(*(words or ("v3",)))
        names = {"foot": robot.feet, "joint": robot.joint_names, "link": robot.structure.links}
        return [*names[kind]]
    return []


def make_options(*headings: str) -> tuple[Callable[[Command], Command], ...]:
    """Create decorators that add the options of the stand task to a command-line command.

    Args:
        *headings: Headings of the sliders on the page of ``live``, to select options; by default
            all options are included.
    """
    return tuple(
        make_option(field)
        for field in OPTION_FIELDS.values()
        if not headings or (field.slider is not None and field.slider.folder in headings)
    )


def make_task(values: Mapping[str, Any]) -> StandTask:
    """Create the stand task that option values specify.

    Args:
        values: {name of a field: value of the option}; other fields have the default value.

    Raises:
        ConfigurationError: If a value is not valid.
    """
    from pupper_analysis.stance.task import StandTask

    return StandTask().with_values(
        {name: to_task_value(OPTION_FIELDS[name], value) for name, value in values.items()}
    )


def format_as_options(task: StandTask, attributes: Sequence[str]) -> dict[str, list[str]]:
    """Format requirements of a stand task as options of a command.

    Args:
        task: Stand task.
        attributes: Names of attributes of the task, such as ``swing``.

    Returns:
        {option: its values}, for example ``{"--swing": ["FL=20mm"]}``, without values that are
        None. Empty if a value has no form as option, for example a contact surface.
    """
    stated = task.values()
    fields = [field for field in FIELDS.values() if field.attribute in attributes]
    options: dict[str, list[str]] = {}
    for field in fields:
        values = stated[field.name] if field.per else {"": stated[field.name]}
        for key, value in values.items():
            if value is None:
                continue
            if field.name not in OPTION_FIELDS or field.kind not in ("length", "angle", "point"):
                return {}
            numbers = ",".join(
                _format_number(number, field.kind)
                for number in (value if isinstance(value, tuple) else (value,))
            )
            options.setdefault(f"--{field.option}", []).append(
                f"{key}={numbers}" if key else numbers
            )
    return options


def _format_number(value: float, kind: str) -> str:
    """Format a length [m] in mm, or an angle [rad] in deg, with its unit and up to ten digits."""
    if kind == "angle":
        return f"{math.degrees(value):.10g}deg"
    return f"{1e3 * value:.10g}mm"


def to_task_value(field: Field, value: Any) -> Any:
    """Convert the value of a command-line option into the value of a `StandTask` field.

    Texts such as ``FL=10cm`` of a repeatable option become a mapping, with numbers in SI units.

    Raises:
        ConfigurationError: If a text has another form, or a contact is stated twice.
    """
    if field.per:
        assignments = [(shared.parse_assignment(field.option, text), text) for text in value]
        names = [key for (key, _), _ in assignments]
        duplicate = next((key for key in names if names.count(key) > 1), None)
        if field.kind == "contact" and duplicate is not None:
            raise ConfigurationError(field.option, diagnose("contact-stated-twice", name=duplicate))
        return {
            key: _parse_value(field, text, text_given) for (key, text), text_given in assignments
        }
    if value is None or value in field.choices or not (field.axes or field.choices):
        return value
    return _parse_value(field, value, value)


def _parse_value(field: Field, text: str, given: str) -> Any:
    """Parse the typed value of a stand-task field: contact, point, or number with unit.

    ``given`` is the whole typed value that contains ``text``, for error messages.
    """
    if field.kind == "contact":
        return parse_contact(field.option, text, given)
    if field.axes or field.choices:
        return shared.parse_point(field.option, text, len(field.axes or "xy"), field.choices)
    return shared.parse_measure(field.option, field.kind, text, given)


_NO_SURFACE = ("none", "free", "air", "off", "swing")
"""Words that users may type as the surface of a foot without contact."""


def parse_contact(option: str, text: str, given: str) -> Contact | Weld:
    """Parse the text of a contact, such as ``wall:0.4m,mu=0.6``, into a contact surface.

    Returns:
        Surface that a part of the robot touches; for ``weld``, the fixation of the part in the
        world.

    Raises:
        ConfigurationError: If the text has another form, or a value is not valid.
    """
    from pupper_analysis.robot.plane import PLANE_NORMALS, Bar, Contact, Plane, Slope, Weld

    surface, *parts = (part.strip() for part in text.split(","))
    kind, _, first = surface.partition(":")
    numbers = [first, *(part for part in parts if "=" not in part)]
    valid_words: tuple[str, ...] = ("mu", "place", "offset", "radius", "force", "grip")
    sizes = {"plane": 6, "bar": 7, "slope": 1, **dict.fromkeys(PLANE_NORMALS, 1)}
    if surface == "weld" and numbers == [""]:
        numbers, valid_words = [], ("place", "offset")
    elif surface in _NO_SURFACE:
        part = given.partition("=")[0]
        raise ConfigurationError(
            option, diagnose("contact-without-surface", given=given, part=part)
        )
    elif sizes.get(kind) != len(numbers) or not first:
        forms = (
            "[wall|table|ceiling]:LENGTH, slope:ANGLE, plane:X,Y,Z,NX,NY,NZ, bar:X,Y,Z,DX,DY,DZ,R,"
            " weld"
        )
        form = Phrase(f"{forms}; for example wall:0.4m", f"{forms}（例如 wall:0.4m）")  # noqa: RUF001
        raise ConfigurationError(option, diagnose("not-of-the-form", given=given, form=form))
    unit = "length"
    if kind == "slope":
        unit, valid_words = "angle", (*valid_words, "uphill")
    lengths = [
        shared.parse_measure(option, unit, number, given)
        if not 3 <= position < 6  # numbers 3 to 5: normal of a plane, or direction of a bar
        else shared.parse_measure(option, "direction", number, given)
        for position, number in enumerate(numbers)
    ]
    properties: dict[str, Any] = {}
    for part in (part for part in parts if "=" in part):
        word, _, value = part.partition("=")
        if word not in valid_words:
            raise ConfigurationError(option, diagnose("not-one-of", given=word, known=valid_words))
        if word in ("place", "offset"):
            properties[word] = shared.parse_point(option, value.replace("/", ","), 3)
        elif word == "mu":
            _, properties[word] = shared.parse_number_assignment(option, part)
        else:
            quantity = {"radius": "length", "uphill": "angle", "grip": "force"}.get(word, word)
            properties[word] = shared.parse_measure(option, quantity, value, given)
    friction = properties.pop("mu", None)
    try:
        if not lengths:
            return Weld(**properties)
        if kind == "slope":
            return Contact(Slope(lengths[0], properties.pop("uphill", 0.0), friction), **properties)
        if kind == "bar":
            x, y, z, *way, radius = lengths
            return Contact(Bar((x, y, z), (way[0], way[1], way[2]), radius, friction), **properties)
        x, y, z, *normal = lengths if kind == "plane" else (0.0, 0.0, 0.0, *PLANE_NORMALS[kind])
        plane = Plane((x, y, z), (normal[0], normal[1], normal[2]), friction)
        return Contact(plane if kind == "plane" else plane.with_parameter(lengths[0]), **properties)
    except ConfigurationError as error:
        raise ConfigurationError(option, error.diagnostic) from None


_ROBOT_OPTION_NAMES = (
    "payload",
    "payload_at",
    "kp",
    "kd",
    "integrator",
    "timestep",
    "cone",
    "impratio",
)
"""Parameter names of options that are not fields of the stand task, but may be in a stance file:
payload, servos and MuJoCo options."""


def _load_defaults(context: click.Context, _option: click.Parameter, path: Path | None) -> None:
    """Use the values of a stance file as defaults of command-line options; called by click."""
    if path is not None:
        context.default_map = {**(context.default_map or {}), **read_stance_file(path)}


stance_option = click.option(
    "--stance",
    type=click.Path(path_type=Path),
    is_eager=True,  # processed before the options whose defaults it sets
    expose_value=False,
    callback=_load_defaults,
    help=(
        "TOML file with stance options, as saved by the live page; e.g. a line height = '12cm'. "
        "Or results as JSON, e.g. of best --json: their stance. Typed options have precedence."
    ),
)
"""Option ``--stance``: TOML or JSON file with default values of the stance options."""


def read_stance_file(path: Path) -> dict[str, Any]:
    """Read the option values of a stance file: options as TOML, or results as JSON with a stance.

    Returns:
        {parameter: value in the form of the command line}.

    Raises:
        ConfigurationError: If the file cannot be read, contains an unknown option, or contains
            results without a stance, for example.
    """
    try:
        if (text := read_text(path)).lstrip().startswith("{"):  # JSON; such a file is no TOML
            from pupper_analysis.stance.stance_file import format_stance, read_task_of_results

            values = tomllib.loads(format_stance(read_task_of_results(str(path), text)))
        else:
            _, values = read_toml(path)
    except InputError as error:
        raise ConfigurationError(str(path), error.cause) from error
    parameters = {field.option: name for name, field in OPTION_FIELDS.items()}
    parameters |= {name.replace("_", "-"): name for name in _ROBOT_OPTION_NAMES}
    options = {}
    for key, value in values.items():
        option = key.replace("_", "-")
        if option not in parameters:
            unknown = diagnose(
                "no-option-of-a-stance",
                given=key,
                alike=difflib.get_close_matches(option, parameters, 1),
                known=sorted(parameters),
            )
            raise ConfigurationError(str(path), unknown)
        typed = _format_as_typed(path, key, value)
        field = OPTION_FIELDS.get(parameters[option])
        if field is not None and field.per and not isinstance(value, Mapping):
            form = '{}."{}" = "{}"'.format(option, *field.example.strip("'").split("=", 1))
            raise ConfigurationError(str(path), diagnose("not-of-the-form", given=key, form=form))
        is_single_gain = option in ("kp", "kd") and not isinstance(typed, list)
        options[parameters[option]] = [typed] if is_single_gain else typed
    return options


def _format_as_typed(path: Path, key: str, value: Any) -> Any:
    """Convert a value of a stance file to the form that is typed on the command line.

    A point becomes a text with commas, and {foot: value} a list of texts ``FOOT=VALUE``.
    """
    if isinstance(value, Mapping):
        return [f"{name}={_format_as_typed(path, key, item)}" for name, item in value.items()]
    if isinstance(value, list):
        return ",".join(str(_format_as_typed(path, key, item)) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ConfigurationError(str(path), diagnose("no-value-of-a-stance", given=key))
    return value
