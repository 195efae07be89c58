"""Locations in model files, and errors that contain locations.

A `Place` is a file with a line number (XML) or with the path of an element (binary formats). The
functions ``make_..._error`` create a ``ModelError`` whose message starts with the location.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, Source
from pupper_analysis.base.errors import InputError, ModelError

T = TypeVar("T")
"""Type of an element in the tree of a file format."""


@dataclass(frozen=True)
class Place:
    """Location in a model file.

    Attributes:
        file: The file.
        line: Line number, from 1; None for the whole file, if unknown, or in files without lines.
        element: Path of the element in files without lines; None in other files.
    """

    file: Path
    line: int | None = None
    element: str | None = None

    def __str__(self) -> str:
        return f"{self.file.name}{self.location_in_file}"

    @property
    def location_in_file(self) -> str:
        """Location within the file, as a suffix of the file name.

        Examples: ``":7"`` for line 7, ``":</Robot/base>"`` for an element in a file without lines,
        "" for the whole file.
        """
        if self.element is not None:
            return f":<{self.element}>"
        return "" if self.line is None else f":{self.line}"

    @property
    def path(self) -> str:
        """Path of the file with line or element, as CI services recognise it."""
        return f"{self.file}{self.location_in_file}"

    @property
    def source(self) -> Source:
        """This file, with line or element, as the source of a diagnostic."""
        return Source(str(self.file), self.line, self.element or "")


def innermost_element(element: T, path: str | None, child: Callable[[T, str], T | None]) -> T:
    """Follow a path of tags from an element, as far as child elements exist.

    Args:
        element: Start of the path.
        path: Tags, such as ``"inertial/mass"``; None for ``element`` itself.
        child: Function that returns the first child with a tag, or None.

    Returns:
        Last element found; ``element`` itself if it has no child with the first tag.
    """
    for tag in path.split("/") if path else ():
        found = child(element, tag)
        if found is None:
            break
        element = found
    return element


def quote_short(value: str) -> str:
    """Quote a text for a message; a text of more than 40 characters is cut to 37 and ``...``."""
    return repr(value if len(value) <= 40 else value[:37] + "...")


NO_LINE: Final = 65535
"""Line number from which `line_of` returns None: the largest number of the 16 bits in which libxml2
stores lines."""


def forget_lines(root: etree._Element) -> None:
    """Set the line numbers of all elements to unknown, for a text that is not in a file.

    White space between the elements is removed. Otherwise libxml2 would return its line for an
    element whose line is unknown.
    """
    for element in root.iter():
        if element.text is not None and not element.text.strip():
            element.text = None
        if element.tail is not None and not element.tail.strip():
            element.tail = None
        element.sourceline = NO_LINE


def line_of(element: etree._Element) -> int | None:
    """Return the line number of an XML element in the file; None if unknown."""
    line = element.sourceline
    return line if line is not None and line < NO_LINE else None


def make_element_error(path: Path, element: etree._Element, problem: Diagnostic) -> ModelError:
    """Return the ModelError for a problem of an element, with file and line."""
    return make_file_error(Place(path, line_of(element)), problem)


def make_file_error(place: Place, problem: Diagnostic) -> ModelError:
    """Return the ModelError for a problem of a file, or of a location in the file.

    Args:
        place: File, with line or element if known; becomes the source of a problem without sources.
        problem: Diagnostic of the problem.
    """
    sources = problem.sources or (place.source,)
    name = source_name(place.file, place.line) + (
        place.location_in_file if place.element is not None else ""
    )
    return ModelError(name, replace(problem, sources=sources))


def make_input_error(path: Path, error: InputError) -> ModelError:
    """Return the ModelError for a model file that cannot be read."""
    return make_file_error(Place(path, error.line), error.cause)


def source_name(path: Path, line: int | None = None) -> str:
    """Return a path as printable text for messages, followed by ``:LINE`` if a line is given."""
    name = str(path) if str(path).isprintable() else repr(str(path))
    return name if line is None else f"{name}:{line}"


def shorten_message(message: str) -> str:
    """Shorten an error message of MuJoCo to the cause and the name of the element, if any.

    The line is omitted, because reports state the place of the error. An example is
    ``unknown element 'foo' in equality constraint 0``.
    """
    cause = message.removeprefix("Error: ")
    return _MUJOCO_ELEMENT_PATTERN.sub(lambda found: f" ({found[1]})" if found[1] else "", cause)


_MUJOCO_ELEMENT_PATTERN = re.compile(r" *Element name '([^']*)', id \d+(?:, line \d+)?$")
"""End of an error message of MuJoCo's compiler: name, index and line of the element at fault."""


def one_line(text: object) -> str:
    """Convert a text to a single line: one space replaces each white space between words."""
    return " ".join(str(text).split())
