"""A result that has no document of its own: its fields, and what they mean."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.values import value_cell
from pupper_analysis.report.words import text
from pupper_analysis.results import Result, Tabular

MOST_ROWS = 500
"""Of a table of which nothing is known: more than anyone reads."""


def fields_of(result: Result) -> doc.Document:
    """Returns the fields of a result that has no page of its own, with what they mean."""
    said = meanings(type(result))
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(field.name),
            value_cell(getattr(result, field.name)),
            _said_meaning(said.get(field.name, "")),
        )
        for field in fields(result)  # type: ignore[arg-type]  # all results are dataclasses
    ]
    table = doc.Table(
        doc.Name(type(result).__name__),
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


def meanings(kind: type) -> dict[str, str]:
    """Returns {field: what the docstring of its class says of it, unit included}."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        said = inspect.cleandoc(one.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
        entries = re.findall(r"^    ([\w, ]+): (.*(?:\n {8}.*)*)", said, flags=re.MULTILINE)
        for names, meaning in entries:
            found |= dict.fromkeys(names.split(", "), re.sub(r"\s+", " ", meaning))
    return found


def _said_meaning(meaning: str) -> doc.Text | doc.Said:
    """Returns what a field means in both languages, or as it is."""
    chinese = chinese_meanings().get(meaning)
    plain = meaning.replace("``", "")  # the marks of code in docstrings
    return doc.Said(plain) if chinese is None else doc.Text(plain, chinese.replace("``", ""))


@cache
def chinese_meanings() -> Mapping[str, str]:
    """Returns {what a docstring says of a field: the same in Simplified Chinese}."""
    file = files("pupper_analysis.report.html").joinpath("templates", "meanings.toml")
    return MappingProxyType(tomllib.loads(file.read_text(encoding="utf-8")))
