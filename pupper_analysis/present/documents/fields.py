"""A result that has no document of its own: its fields, and what they mean."""

from __future__ import annotations

from dataclasses import fields

from pupper_analysis.base.diagnostics import LANGUAGES, meaning
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.present import document as doc
from pupper_analysis.present.documents.values import value_cell
from pupper_analysis.present.words import text

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
