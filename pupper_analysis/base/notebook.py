"""HTML tables of results for notebooks: a row per field, with value and unit.

``Result._repr_html_`` and the same method of ``Robot`` and ``Configuration`` use this module.
Jupyter calls ``_repr_html_`` to display the value of a cell. Long arrays are summarised; the page
of a result (``pa.report.write_report``) shows longer arrays.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from typing import Any

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, format_number
from pupper_analysis.base.units import POSITION_UNIT, get_field_units

MAX_SHOWN_NUMBERS = 12
"""Largest number of elements of a vector that a table cell shows on one line. Chosen: number of
joints of a quadruped with three joints per leg.
"""

MAX_SHOWN_ROWS = 12
"""Largest number of entries of a mapping or sequence that a table cell shows, one per line; also
the largest number of fields of a result whose nested tables are unfolded. Chosen: number of joints
of a quadruped with three joints per leg.
"""

MAX_TEXT_LENGTH = 200
"""Largest number of characters of the text of a nested object. A longer text is cut off, or a table
replaces it. Chosen, not tuned.
"""

NUMBER_FORMAT = ".4g"
"""Format of floats in a cell, with 4 significant digits; ``to_dict`` returns all digits."""

ROUNDING_RTOL = 1e-12
"""Absolute value up to which a float of an array or sequence is shown as 0 in a table cell or in
``repr``. The value is relative to the largest number of the array or sequence, or to 1 if larger.
Chosen, not tuned.
"""

_NOTHING = "&ndash;"
"""HTML of an absent value."""

TableRow = tuple[str, str, str]
"""Name, HTML of the value, unit."""


def render_result(result: object) -> str:
    """Return the HTML table of a result: a row per public field, with value and unit.

    Warnings (`list_warnings`) are the first rows. A nested result with a long text is a table that
    the reader can fold.

    Args:
        result: Instance of a dataclass. The properties that its class lists in ``_reported`` have
            rows, too.
    """
    kind: Any = type(result)
    units = get_field_units(result)
    names = [f.name for f in fields(kind) if not f.name.startswith("_")]
    names += [name for name in getattr(result, "_reported", ()) if name not in names]
    rows = [(name, format_value(value), "") for name, value in list_warnings(result)]
    for name in names:
        value, unit = getattr(result, name), units.get(name, "")
        if _is_result(value) and describe_dataclass(value) is None:
            shown = _make_foldable_table(value, is_open=len(names) <= MAX_SHOWN_ROWS)
        else:
            shown = format_value(_name_joints(result, name, value), unit)
        rows.append((name, shown, unit if isinstance(unit, str) else ""))
    return render_table(kind.__name__, rows)


def _name_joints(result: object, name: str, value: object) -> object:
    """Return {joint: value} for a vector with a value per joint, else the value unchanged.

    Names of such fields start with ``joint_`` or ``motor_``, or end with ``_torques``.
    """
    joints = getattr(result, "joint_names", ())
    is_of_joints = name.startswith(("joint_", "motor_")) or name.endswith("_torques")
    is_vector = isinstance(value, np.ndarray) and value.shape == (len(joints),)
    if not (joints and is_of_joints and is_vector and isinstance(value, np.ndarray)):
        return value
    return dict(zip(joints, zero_rounding_errors(value), strict=True))


def describe_dataclass(value: object, unit: str = "") -> str | None:
    """Return the fields of an object as text: ``mass 5.44 kg, failure ...``.

    None if a field has no short text, or the text is longer than `MAX_TEXT_LENGTH`.

    Args:
        value: Instance of a dataclass.
        unit: Unit of positions, if the container of the object states their unit.
    """
    kind: Any = type(value)
    items = []
    units = get_field_units(value)
    for name in (field.name for field in fields(kind) if not field.name.startswith("_")):
        text = _describe_simple(getattr(value, name))
        if text is None:
            return None
        items.append(_join_unit(name, text, units.get(name, ""), unit))
    text = ", ".join(items)
    return text if len(text) <= MAX_TEXT_LENGTH else None


def list_shown_fields(value: Any) -> list[str]:
    """Return the names of the fields for a short text: key fields, then other public fields."""
    public = [field.name for field in fields(value) if not field.name.startswith("_")]
    return list(dict.fromkeys((*getattr(value, "_key_fields", ()), *public)))


def _summarise_dataclass(value: object, unit: str) -> str:
    """Return the text of an object in a list: the simple fields that fit, key fields first."""
    if (text := describe_dataclass(value, unit)) is not None:
        return text
    units, items = get_field_units(value), []
    for name in list_shown_fields(value):
        text = _describe_simple(getattr(value, name))
        if text is None or getattr(value, name) is None:
            continue
        items.append(_join_unit(name, text, units.get(name, ""), unit))
        if len(", ".join(items)) > MAX_TEXT_LENGTH:
            return ", ".join([*items[:-1], "..."])
    return ", ".join([*items, "..."])


def _join_unit(name: str, text: str, unit: object, position_unit: str) -> str:
    """Return ``name text unit``; without the unit if it is 1, or if there is no value.

    ``position_unit`` replaces the unit of a position; "" if unknown.
    """
    unit = position_unit if position_unit and unit == POSITION_UNIT else unit
    has_unit = isinstance(unit, str) and unit not in ("", "1") and text != "none"
    return f"{name} {text} {unit}" if has_unit else f"{name} {text}"


def _describe_simple(value: object) -> str | None:
    """Return the text of a number, text, enum or short list; None for other objects."""
    if value is None:
        return "none"
    if isinstance(value, Diagnostic | str):
        return str(value) or "none"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool | np.bool_ | int | np.integer):
        return str(value)
    if isinstance(value, float | np.floating):
        return _number_text(float(value))
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiu":
        value = zero_rounding_errors(value).tolist()
    if isinstance(value, tuple | list) and len(value) <= MAX_SHOWN_NUMBERS:
        texts = [_describe_simple(item) for item in value]
        if not texts:
            return "none"
        return None if None in texts else f"({', '.join(map(str, texts))})"
    return None


def list_warnings(result: object) -> list[tuple[str, object]]:
    """Return (name, value) of each warning of a result, and of the results in its fields.

    A warning is a property that the class lists in ``_warnings``, and whose value is not empty. The
    name of a warning of a field contains the field, for example ``stand.blocked``.
    """
    own = [(name, getattr(result, name)) for name in getattr(result, "_warnings", ())]
    found: list[tuple[str, object]] = [(name, value) for name, value in own if value]
    kind: Any = result
    for field in fields(kind):
        value = getattr(result, field.name)
        if _is_result(value):
            found += [(f"{field.name}.{name}", item) for name, item in list_warnings(value)]
    return found


def _is_result(value: object) -> bool:
    """Return True for a result: an instance of a dataclass with its own table."""
    return is_dataclass(value) and hasattr(type(value), "_repr_html_")


def _make_foldable_table(result: object, *, is_open: bool) -> str:
    """Return the HTML table of a result that the reader can fold and unfold."""
    state = ' open="open"' if is_open else ""
    name = escape(type(result).__name__)
    return f"<details{state}><summary>{name}</summary>{render_result(result)}</details>"


def render_table(caption: str, rows: Iterable[TableRow]) -> str:
    """Return an HTML table with the columns field, value and unit.

    Args:
        caption: Plain text above the table. This function escapes it for HTML.
        rows: (name as plain text, value as HTML from ``format_value``, unit as plain text).
    """
    style = "text-align: left; vertical-align: top"
    head = "".join(f'<th style="{style}">{name}</th>' for name in ("field", "value", "unit"))
    body = "".join(
        f'<tr><td style="{style}"><code>{escape(name)}</code></td>'
        f'<td style="{style}">{value}</td><td style="{style}">{escape(unit)}</td></tr>'
        for name, value, unit in rows
    )
    return (
        f'<table><caption style="text-align: left; font-weight: bold">{escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def format_value(value: object, unit: str | Mapping[str, str] = "") -> str:
    """Return the HTML of a value: floats with 4 significant digits, long containers summarised.

    ``unit`` is the unit of positions in the objects of a container; or {key: unit}, which is added
    to the entries of a mapping.
    """
    if isinstance(value, Diagnostic):
        return escape(str(value))
    if isinstance(value, Enum):
        return escape(str(value.value))
    if isinstance(value, bool | np.bool_) or value is None:
        return _NOTHING if value is None else str(bool(value))
    if isinstance(value, float | np.floating):
        return _number_text(float(value))
    if isinstance(value, str | int | np.integer):
        return escape(str(value))
    if isinstance(value, np.ndarray):
        return _make_array_html(value)
    if isinstance(value, Mapping):
        return _lines_html([_format_entry(name, item, unit) for name, item in value.items()])
    if isinstance(value, Sequence):
        return _make_sequence_html(value, unit if isinstance(unit, str) else "")
    if is_dataclass(value) and type(value).__str__ is object.__str__:
        return escape(_summarise_dataclass(value, unit if isinstance(unit, str) else ""))
    return escape(_get_shortened_text(value))


def _format_entry(name: object, item: object, unit: str | Mapping[str, str]) -> str:
    """Return the HTML of an entry of a mapping, with the unit of this entry if there is one.

    Rounding errors are found in each entry alone, because entries may have different units.
    """
    own = unit if isinstance(unit, str) else unit.get(str(name), "")
    (kept,) = _zero_rounding_errors_of_items([item])
    text = format_value(kept, own)
    is_object = is_dataclass(item) and type(item).__str__ is object.__str__
    shown = "" if isinstance(unit, str) or is_object or own in ("", "1") else f" {escape(own)}"
    return f"{escape(str(name))}: {text}{shown}"


def zero_rounding_errors(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return a copy of an array of real numbers with 0 for rounding errors (`ROUNDING_RTOL`)."""
    scale = float(np.abs(values[np.isfinite(values)]).max(initial=1.0))
    return np.where(np.abs(values) <= ROUNDING_RTOL * scale, 0.0, values)


def _is_real_number(value: object) -> bool:
    """Return True for an int or float that a float can represent; bools are no numbers."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= sys.float_info.max
    return isinstance(value, float | np.floating | np.integer)


def _zero_rounding_errors_of_items(items: Sequence[object]) -> Sequence[object]:
    """Return items with 0 for rounding errors of floats, if each item is a float or an int."""
    if not items or not all(map(_is_real_number, items)):
        return items
    kept = zero_rounding_errors(np.array(items, dtype=float)).tolist()
    return [
        number if isinstance(item, float | np.floating) else item
        for item, number in zip(items, kept, strict=True)
    ]


def _number_text(value: float) -> str:
    """Format a number by `NUMBER_FORMAT`, with 4 significant digits."""
    return format_number(value, NUMBER_FORMAT)


def _make_array_html(values: np.ndarray[Any, Any]) -> str:
    """Return the HTML of an array: numbers of a short vector, else shape, minimum and maximum.

    Arrays without real numbers have no minimum and maximum.
    """
    if values.size == 0:
        return "empty"
    if values.dtype.kind not in "fiub":
        return escape(f"array of {' x '.join(map(str, values.shape))}")
    if values.ndim <= 1 and values.size <= MAX_SHOWN_NUMBERS:
        kept = zero_rounding_errors(values)
        return escape(", ".join(_number_text(float(value)) for value in kept.ravel()))
    shape = " x ".join(map(str, values.shape))
    kept = zero_rounding_errors(values)
    missing = int(np.isnan(kept).sum())
    if missing == kept.size:
        return escape(f"array of {shape}, all nan")
    low, high = _number_text(float(np.nanmin(kept))), _number_text(float(np.nanmax(kept)))
    return escape(f"array of {shape}, {low} to {high}{f', {missing} nan' if missing else ''}")


def _make_sequence_html(values: Sequence[object], unit: str = "") -> str:
    """Return the HTML of a sequence: a line per item; short simple sequences on a single line.

    At most `MAX_SHOWN_ROWS` lines with items are shown.
    """
    if not values:
        return _NOTHING
    simple = all(isinstance(value, str | int | float | np.number) for value in values)
    items = _zero_rounding_errors_of_items(values)
    if simple and len(values) <= MAX_SHOWN_NUMBERS:
        return ", ".join(format_value(value) for value in items)
    return _lines_html([format_value(value, unit) for value in items])


def _lines_html(lines: Sequence[str]) -> str:
    """Join HTML lines, at most ``MAX_SHOWN_ROWS``; append the number of omitted lines."""
    if not lines:
        return _NOTHING
    hidden = len(lines) - MAX_SHOWN_ROWS
    shown = [*lines[:MAX_SHOWN_ROWS], *([f"and {hidden} more"] if hidden > 0 else [])]
    return "<br>".join(shown)


def _get_shortened_text(value: object) -> str:
    """Return the text of an object (`_get_text`), cut off after `MAX_TEXT_LENGTH` characters."""
    text = _get_text(value)
    return text if len(text) <= MAX_TEXT_LENGTH else f"{text[:MAX_TEXT_LENGTH]} ..."


def _get_text(value: object) -> str:
    """Return ``str(value)`` if the class of a value defines ``__str__``, else ``repr(value)``."""
    own_text = type(value).__str__ is not object.__str__
    return str(value) if own_text else repr(value)
