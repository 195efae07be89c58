"""Which result is shown how: the builder of its type makes its document.

A builder is registered by the type of its result (``@build_document.register``), in the module
``document`` of the tool that has the result, or, of one of the core, of the tool that shows it:
that of a ``Comparison`` stands in ``tools/crosscheck``. The module is imported when such a result
is shown for the first time, so that an audit loads no stance. Of a result without a builder its
fields are shown, with what they mean.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from functools import singledispatch
from importlib import import_module
from importlib.util import find_spec

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


def value_cell(value: object) -> Cell:
    """Returns a value as it is shown: in few words, what is long by its size."""
    if hasattr(value, "phrase"):  # as a stand's task says what it asks for
        return diagnostic_text(value.phrase())
    if isinstance(value, float | int) and not isinstance(value, bool):
        return number_cell(float(value), ".6g")
    return Name(str(value) if isinstance(value, str) else shorten(value))


def make_fields_document(result: Result) -> doc.Document:
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
    columns = (text("field"), text("value"), text("meaning-and-unit"))
    heads = tuple(doc.Column(name, left=True) for name in columns)
    table = doc.Table(doc.Name(kind.__name__), heads, tuple(rows))
    passed = getattr(result, "passed", None)
    verdict = None if passed is None else text("passed") if passed else text("FAILED")
    return doc.Document(text("result"), doc.Name(""), (table,), passed=passed, verdict=verdict)


_HOUSE = "pupper_analysis"


@singledispatch
def build_document(result: object, _: Robot | None = None) -> Document:
    """Returns the document of a result; of one without a builder its fields, and what they mean.

    Args:
        result: The result.
        _: The robot that it is of, for views and the lines of its files, if it is at hand.

    Raises:
        TypeError: If it is no result.
    """
    if not isinstance(result, Result):
        raise TypeError(f"{type(result).__name__} is no result")

    return make_fields_document(result)


@singledispatch
def compare_results(_: object, __: Sequence[Result]) -> tuple[Block, ...]:
    """Returns what compares several results, all of the type of the first; nothing by default."""
    return ()


def make_document(result: Result, robot: Robot | None = None, name: str = "") -> Document:
    """Returns the document of a result, by the builder of its type; see ``build_document``.

    Args:
        result: The result.
        robot: The robot that it is of, if it is at hand.
        name: What it is called, where it does not say so itself.
    """
    _load_builder(type(result))
    built = build_document(result, robot)
    if get_english(built.title):
        return built
    return replace(built, title=Name(name or type(result).__name__))


def build_report(
    results: Iterable[tuple[str, Result]],
    robots: Iterable[Robot] = (),
    overview: Iterable[Block] = (),
) -> Report:
    """Returns the documents of several results, and what compares them.

    Args:
        results: (name, result) of each; the name may be empty, if the result has one of its own.
        robots: The robots at hand.
        overview: What else compares them; it stands first.
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
    return Report(_title(documents), documents, blocks)


def _title(documents: Sequence[Document]) -> Words:
    if not documents:
        return text("report")
    kinds = {get_english(one.kind) for one in documents}
    kind = documents[0].kind if len(kinds) == 1 else text("report")
    return text("kind-names", kind=kind, names=join_words(one.title for one in documents))


def _load_builder(kind: type) -> None:
    """Imports the module of a result's builder, if there is one."""
    for one in kind.__mro__:
        package = getattr(sys.modules.get(one.__module__), "__package__", None) or ""
        while package and package != _HOUSE:
            if find_spec(f"{package}.document") is not None:
                import_module(f"{package}.document")
                return
            package = package.rpartition(".")[0]
        registered = f"@build_document.register({one.__name__})"
        for tool in own_tools().values():
            shown = tool.folder / "document.py"
            if shown.is_file() and registered in shown.read_text(encoding="utf-8"):
                import_module(f"{tool.package}.document")
                return
