"""Where something stands in a model file, and refusals that say so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, Source
from pupper_analysis.base.errors import InputError, ModelError

T = TypeVar("T")


@dataclass(frozen=True)
class Place:
    """Where something stands.

    Attributes:
        file: The file.
        line: Its line, from 1; None where the file as a whole is meant, or has no lines.
        element: What a file without lines calls it; None in other files.
    """

    file: Path
    line: int | None = None
    element: str | None = None

    def __str__(self) -> str:
        return f"{self.file.name}{self.within}"

    @property
    def within(self) -> str:
        """Where in the file: ``":7"``, ``":</Robot/base>"``, or "" for all of it."""
        if self.element is not None:
            return f":<{self.element}>"
        return "" if self.line is None else f":{self.line}"

    @property
    def path(self) -> str:
        """The whole path, and the line: by it a CI service finds the file."""
        return f"{self.file}{self.within}"

    @property
    def source(self) -> Source:
        """The same, as a diagnostic has it."""
        return Source(str(self.file), self.line, self.element or "")


def innermost_element(element: T, path: str | None, child: Callable[[T, str], T | None]) -> T:
    """Returns the innermost element that exists on a path below one.

    Args:
        element: Where the path begins.
        path: Tags, such as ``"inertial/mass"``; None for the element itself.
        child: Returns an element's first child of a tag; None where it has none.
    """
    for tag in path.split("/") if path else ():
        below = child(element, tag)
        if below is None:
            break
        element = below
    return element


def quote_short(value: str) -> str:
    """Quotes a value; of a long one, its first 37 characters."""
    return repr(value if len(value) <= 40 else value[:37] + "...")


NO_LINE: Final = 65535
"""lxml is not sure of this line, and those after it; so it stands for no line at all."""


def line_of(element: etree._Element) -> int | None:
    """Returns an element's line, where it is known."""
    line = element.sourceline
    return line if line is not None and line < NO_LINE else None


def refusal_at(path: Path, element: etree._Element, problem: Diagnostic) -> ModelError:
    """Returns the error that tells an element's file and line, and what is wrong with it."""
    return refuse_file(Place(path, line_of(element)), problem)


def refuse_file(place: Place, problem: Diagnostic) -> ModelError:
    """Returns the error that tells what is wrong with a file, or in a line of it."""
    sources = problem.sources or (place.source,)
    name = source_name(place.file, place.line) + (place.within if place.element is not None else "")
    return ModelError(name, replace(problem, sources=sources))


def refuse_input(path: Path, error: InputError) -> ModelError:
    """Returns the error that tells why a model's file did not come in."""
    return refuse_file(Place(path, error.line), error.cause)


def source_name(path: Path, line: int | None = None) -> str:
    """Names a file, and a line of it, on one line of text."""
    name = str(path) if str(path).isprintable() else repr(str(path))
    return name if line is None else f"{name}:{line}"


def one_line(text: object) -> str:
    """Makes one line of a text of several."""
    return " ".join(str(text).split())
