"""A result without a document of its own: its fields, their values, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from pupper_analysis.base.diagnostics import LANGUAGES, meaning
from pupper_analysis.base.results import Result, Tabular, shorten
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import Cell, Name, number_cell
from pupper_analysis.present.documents.standing import task_text
from pupper_analysis.present.words import text
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


MOST_ROWS = 500
"""Of a table of which nothing is known: more than anyone reads."""


def fields_of(result: Result) -> doc.Document:
    """Returns the fields of a result that has no page of its own, with what they mean."""
    kind = type(result)
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(field.name),
            value_cell(getattr(result, field.name)),
            doc.Text(*(meaning(kind, field.name, language) for language in LANGUAGES)),
        )
        for field in fields(result)  # type: ignore[arg-type]  # all results are dataclasses
    ]
    table = doc.Table(
        doc.Name(kind.__name__),
        (
            doc.Column(text("field"), left=True),
            doc.Column(text("value"), left=True),
            doc.Column(text("meaning-and-unit"), left=True),
        ),
        tuple(rows),
    )
    blocks: list[doc.Block] = [table]
    if isinstance(result, Tabular):
        columns = {key: list(values) for key, values in result._columns().items()}  # type: ignore[arg-type]
        cells = list(zip(*columns.values(), strict=True))[:MOST_ROWS]
        blocks.append(
            doc.Table(
                text("as-a-table"),
                tuple(doc.Column(doc.Name(key)) for key in columns),
                tuple(tuple(map(value_cell, row)) for row in cells),
                (text("units-are-those"),),
            )
        )
    passed = getattr(result, "passed", None)
    verdict = None if passed is None else text("passed") if passed else text("FAILED")
    return doc.Document(text("result"), doc.Name(""), tuple(blocks), passed=passed, verdict=verdict)
