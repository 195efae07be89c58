"""A field's value, in a cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from pupper_analysis.base.results import Result, shorten
from pupper_analysis.present.document import Cell, Name, number_cell
from pupper_analysis.present.documents.tasks import task_text
from pupper_analysis.stance.task import StandTask

_MOST_ENTRIES = 24
"""Entries that are written out: a vector of each joint, or of a leg with two hands."""

_MOST_CHARACTERS = 600
"""Characters of a cell; what is longer is told by its size."""


def value_cell(value: object) -> Cell:
    """Returns a value as it is shown: written out where it is short, else by its size."""
    if isinstance(value, StandTask):
        return task_text(value)
    if isinstance(value, float | int) and not isinstance(value, bool):
        return number_cell(float(value), ".6g")
    text = _written(value)
    return Name(text if len(text) <= _MOST_CHARACTERS else shorten(value))


def _written(value: object) -> str:
    if isinstance(value, str):
        return str(value)
    if isinstance(value, float):
        return number_cell(value, ".6g").text
    if isinstance(value, np.ndarray):
        if value.size > _MOST_ENTRIES or value.ndim > 2:
            return shorten(value)
        return _written(value.tolist())
    if isinstance(value, Mapping):
        listed = [f"{_written(key)}: {_written(one)}" for key, one in value.items()]
        return "; ".join(listed) if 0 < len(listed) <= _MOST_ENTRIES else shorten(value)
    if isinstance(value, tuple | list):
        if not 0 < len(value) <= _MOST_ENTRIES:
            return shorten(value) if value else "-"
        deep = any(isinstance(one, tuple | list) for one in value)
        return f"({('; ' if deep else ', ').join(map(_written, value))})"
    if isinstance(value, Result):
        names = [field.name for field in fields(value)]  # type: ignore[arg-type]  # all are dataclasses
        return ", ".join(f"{name} {_written(getattr(value, name))}" for name in names)
    return shorten(value)
