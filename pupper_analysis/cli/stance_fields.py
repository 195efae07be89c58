"""How a stand shall be, on the command line: an option per field of the table that has a help."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.base.units import UNITS
from pupper_analysis.cli import shared
from pupper_analysis.stance.fields import FIELDS, Field

if TYPE_CHECKING:
    from pupper_analysis.stance.task import StandTask

Command = Callable[..., None]

TYPED = {name: field for name, field in FIELDS.items() if field.help}
"""The fields that have an option, whose value a command gets by the field's name."""


def option_of(field: Field) -> Callable[[Command], Command]:
    """Returns a field's option."""
    example = f"; e.g. {field.example}." if field.example else "."
    options: dict[str, Any] = {"help": field.help.removesuffix(".") + example}
    point = field.axes or field.choices
    if field.per:
        form = "X,Y" if point else field.kind.upper()
        options |= {"multiple": True, "metavar": f"{field.per.upper()}={form}"}
    elif point:
        frame = "[FRAME,]" if field.frame else ""
        options |= {"metavar": frame + ",".join(field.axes or "xy").upper()}
    elif field.kind in UNITS:
        options |= {"type": shared.QuantityType(field.kind), "default": field.usual}
    else:
        options |= {"type": float, "metavar": field.unit.upper(), "default": field.usual}
    return click.option(f"--{field.option}", field.name, **options)


def options_of(*folders: str) -> tuple[Callable[[Command], Command], ...]:
    """Returns the options of the fields, or of those under some headings of the live page."""
    return tuple(
        option_of(field)
        for field in TYPED.values()
        if not folders or (field.slider is not None and field.slider.folder in folders)
    )


def task_of(values: Mapping[str, Any]) -> StandTask:
    """Returns the task that options say.

    Args:
        values: {field: as click read its option}; the others are as usual.
    """
    from pupper_analysis.stance.task import StandTask

    return StandTask().having(
        {name: to_task_value(TYPED[name], value) for name, value in values.items()}
    )


def to_task_value(field: Field, value: Any) -> Any:
    """Returns an option's value as the task has it."""
    if field.per:
        given = [(shared.parse_assignment(field.option, text), text) for text in value]
        return {of: _one(field, text, whole) for (of, text), whole in given}
    if value is None or value in field.choices or not (field.axes or field.choices):
        return value
    return _one(field, value, value)


def _one(field: Field, text: str, given: str) -> Any:
    if field.axes or field.choices:
        return shared.parse_point(field.option, text, len(field.axes or "xy"))
    return shared.parse_measure(field.option, field.kind, text, given)
