"""Create the document of a result, by the builder that is registered for the result's type.

A builder is a function that is registered for the type of a result (``@build_document.register``).
The builder is in the module ``document`` of the tool that computes or shows the result.

If a result has no builder, the document lists all fields with their meanings.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from enum import Enum
from functools import singledispatch
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from pupper_analysis.base.diagnostics import LANGUAGES, meaning
from pupper_analysis.base.results import Result, shorten
from pupper_analysis.base.tools import own_tools
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import (
    Block,
    Cell,
    Document,
    Name,
    Report,
    Words,
    diagnostic_text,
    get_english,
    join_words,
    number_cell,
    text,
)
from pupper_analysis.robot.robot import Robot

MAX_SHOWN_ENTRIES = 24
"""Largest number of entries of a list, mapping or array that a cell shows. Chosen, not tuned."""

MAX_CELL_LENGTH = 600
"""Largest number of characters of a value in a table cell, except for descriptions of tasks. A
longer value is replaced by the text of `shorten`, for example the size of a list. Chosen, not
tuned.
"""


def value_cell(value: object) -> Cell:
    """Create a table cell with the value of a result's field, numbers with six digits.

    The cell of a large list, mapping or array contains its size or shape, for example.
    """
    if hasattr(value, "phrase"):  # such as the description of a stand task
        return diagnostic_text(value.phrase())
    if isinstance(value, float | int) and not isinstance(value, bool):
        return number_cell(float(value), ".6g")
    words = _write_value(value)
    return Name(words if len(words) <= MAX_CELL_LENGTH else shorten(value))


def _write_value(value: object) -> str:
    """Format the value of a result's field as text; large containers are shortened."""
    if isinstance(value, str) and not isinstance(value, Enum):
        return value
    if isinstance(value, float):
        return number_cell(value, ".6g").text
    if isinstance(value, np.ndarray):
        is_short = value.size <= MAX_SHOWN_ENTRIES and 0 < value.ndim <= 2
        return _write_value(value.tolist()) if is_short else shorten(value)
    if isinstance(value, Mapping):
        entries = [f"{_write_value(key)}: {_write_value(item)}" for key, item in value.items()]
        return "; ".join(entries) if 0 < len(entries) <= MAX_SHOWN_ENTRIES else shorten(value)
    if isinstance(value, tuple | list):
        if not 0 < len(value) <= MAX_SHOWN_ENTRIES:
            return shorten(value) if value else "-"
        is_nested = any(isinstance(item, tuple | list) for item in value)
        return f"({('; ' if is_nested else ', ').join(map(_write_value, value))})"
    if isinstance(value, Result):
        names = [field.name for field in fields(value)]  # type: ignore[arg-type]
        return ", ".join(f"{name} {_write_value(getattr(value, name))}" for name in names)
    return shorten(value)


def make_fields_document(result: Result) -> doc.Document:
    """Create a document with a table of a result's fields: name, value, meaning and unit.

    The verdict is ``passed`` of the result, if the result has such a field.
    """
    kind = type(result)
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(field.name),
            value_cell(getattr(result, field.name)),
            doc.Text(*(meaning(kind, field.name, language) for language in LANGUAGES)),
        )
        for field in fields(result)  # type: ignore[arg-type]  # all results are dataclasses
    ]
    columns = (text("field"), text("value"), text("meaning-and-unit"))
    heads = tuple(doc.Column(name, left=True) for name in columns)
    table = doc.Table(doc.Name(kind.__name__), heads, tuple(rows))
    passed = getattr(result, "passed", None)
    verdict = None if passed is None else text("passed") if passed else text("FAILED")
    return doc.Document(text("result"), doc.Name(""), (table,), passed=passed, verdict=verdict)


_PACKAGE_NAME = "pupper_analysis"
"""Name of the top package, below which the search for the builder of a result ends."""


@singledispatch
def build_document(result: object, _: Robot | None = None) -> Document:
    """Create the document of a result; without a registered builder, a list of the fields.

    The module of the builder must have been imported (`make_document`).

    Raises:
        TypeError: If ``result`` is no result.
    """
    if not isinstance(result, Result):
        raise TypeError(f"{type(result).__name__} is no result")

    return make_fields_document(result)


@singledispatch
def compare_results(_: object, __: Sequence[Result]) -> tuple[Block, ...]:
    """Create tables and plots that compare results of one type; none without an implementation.

    The first argument, the first result, selects the implementation; the second contains all
    results.
    """
    return ()


def make_document(result: Result, robot: Robot | None = None, name: str = "") -> Document:
    """Import the builder of a result's type, and create the document of the result.

    ``name`` is the title if the builder provides no title; by default the name of the type.

    Raises:
        TypeError: If ``result`` is no result.
    """
    load_builder(type(result))
    built = build_document(result, robot)
    if get_english(built.title):
        return built
    return replace(built, title=Name(name or type(result).__name__))


def build_report(
    results: Iterable[tuple[str, Result]],
    robots: Iterable[Robot] = (),
    overview: Iterable[Block] = (),
) -> Report:
    """Create the documents of several results, and the blocks that compare the results.

    Results are compared if all have the same type. ``results`` are (name, result) pairs; the name
    is used if the document has no title. A robot belongs to the results with the name of the robot.
    The blocks of ``overview`` come first.
    """
    known = {robot.name: robot for robot in robots}
    named = list(results)
    documents = tuple(
        make_document(result, known.get(getattr(result, "name", "")), name)
        for name, result in named
    )
    listed = [result for _, result in named]
    blocks = tuple(overview)
    if len({type(result) for result in listed}) == 1 and len(listed) > 1:
        blocks += compare_results(listed[0], listed)
    return Report(_make_title(documents), documents, blocks)


def _make_title(documents: Sequence[Document]) -> Words:
    """Create the title of a report: common kind of result, or "report", and titles of documents."""
    if not documents:
        return text("report")
    kinds = {get_english(document.kind) for document in documents}
    kind = documents[0].kind if len(kinds) == 1 else text("report")
    return text("kind-names", kind=kind, names=join_words(document.title for document in documents))


def load_builder(kind: type) -> None:
    """Import the module that registers the builder of a result type's document, if there is one.

    For the type, then for each base class, a module ``document`` is searched in the package of the
    class and its parent packages, then in the tools of this package.
    """
    for base in kind.__mro__:
        package = getattr(sys.modules.get(base.__module__), "__package__", None) or ""
        while package and package != _PACKAGE_NAME:
            if find_spec(f"{package}.document") is not None:
                import_module(f"{package}.document")
                return
            package = package.rpartition(".")[0]
        registered = f"@build_document.register({base.__name__})"
        for tool in own_tools().values():
            shown = tool.folder / "document.py"
            if shown.is_file() and registered in shown.read_text(encoding="utf-8"):
                import_module(f"{tool.package}.document")
                return
