"""Which result is told how: the builder of its type makes its document.

A builder is registered by the type of its result (``@build_document.register``): of a tool's
result in the tool's module ``document``, of one of the core in the module here that has the type's
name in small letters: that of a ``Comparison`` stands in ``comparison``. The module is imported
when such a result is shown for the first time, so that an audit loads no stance.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import singledispatch
from importlib import import_module
from importlib.util import find_spec

from pupper_analysis.base.results import Result
from pupper_analysis.present.document import (
    Block,
    Document,
    Name,
    Report,
    Words,
)
from pupper_analysis.present.words import in_english, join_words, text
from pupper_analysis.robot.robot import Robot

_HOUSE, _HERE = "pupper_analysis", "pupper_analysis.present.documents"

MOST_NAMES = 6
"""Of robots or files in a title: what fits on two lines."""


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
    from pupper_analysis.present.documents.fields import fields_of

    return fields_of(result)


@singledispatch
def compare_results(_: object, __: Sequence[Result]) -> tuple[Block, ...]:
    """Returns what compares several results, all of the type of the first; nothing by default."""
    return ()


def document(result: Result, robot: Robot | None = None, name: str = "") -> Document:
    """Returns the document of a result, by the builder of its type; see ``build_document``.

    Args:
        result: The result.
        robot: The robot that it is of, if it is at hand.
        name: What it is called, where it does not say so itself.
    """
    _load_builder(type(result))
    built = build_document(result, robot)
    if in_english(built.title):
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
        document(result, known.get(getattr(result, "name", "")), name) for name, result in named
    )
    listed = [result for _, result in named]
    blocks = tuple(overview)
    if len({type(result) for result in listed}) == 1 and len(listed) > 1:
        blocks += compare_results(listed[0], listed)
    return Report(_title(documents), documents, blocks)


def _title(documents: Sequence[Document]) -> Words:
    """Returns what documents are, and what of: a page's title."""
    if not documents:
        return text("report")
    kinds = {in_english(one.kind) for one in documents}
    kind = documents[0].kind if len(kinds) == 1 else text("report")
    named = [one.title for one in documents[:MOST_NAMES]]
    if len(documents) > MOST_NAMES:
        named.append(text("count-more", count=len(documents) - MOST_NAMES))
    return text("kind-names", kind=kind, names=join_words(named))


def _load_builder(kind: type) -> None:
    """Imports the module of a result's builder, if there is one."""
    for one in kind.__mro__:
        package = getattr(sys.modules.get(one.__module__), "__package__", None) or ""
        while package and package != _HOUSE:
            if find_spec(f"{package}.document") is not None:
                import_module(f"{package}.document")
                return
            package = package.rpartition(".")[0]
        name = re.sub(r"(?<!^)(?=[A-Z])", "_", one.__name__).lower()
        if find_spec(f"{_HERE}.{name}") is not None:
            import_module(f"{_HERE}.{name}")
            return
