"""The one reader of XML: its limits, no DOCTYPE, no entities, every line known."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, decode_input, read_content
from pupper_analysis.base.tools import format_begun
from pupper_analysis.models.places import (
    Place,
    one_line,
    refusal_at,
    refuse_file,
    refuse_input,
)

MAX_BYTES: Final = MAX_TEXT_BYTES
"""Largest file that is read."""

MAX_DEPTH: Final = 250
"""Deepest nesting of XML elements, and longest chain of a URDF's joints."""

MAX_ELEMENTS: Final = 30_000
"""Most elements of a file with all it includes."""

LFS_POINTER: Final = b"version https://git-lfs.github.com/spec/"
"""How a file begins that Git LFS leaves in place of one whose content was not brought along."""

NUMBER: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""A number as a model file writes it; what XML Schema calls a decimal or a double."""

_DOCTYPE: Final = re.compile(r"(?:\s|<!--.*?-->|<\?.*?\?>)*+<!(?!--)", re.DOTALL)
"""How a text with a DOCTYPE begins: it stands before the root element, and is not needed."""

MAX_NUMBER: Final = 1e50
"""Largest mass, length or moment: products of six such are numbers still."""


def parse_xml(path: Path) -> tuple[str, etree._Element]:
    """Returns a file's text, and its root element without comments and default namespace."""
    text = _text(path)
    return text, parse_file_text(path, text)


def parse_file_text(path: Path, text: str) -> etree._Element:
    """Returns the root element of a file's text, without comments and default namespace."""
    if found := _DOCTYPE.match(text):
        line = text.count("\n", 0, found.end()) + 1
        raise refuse_file(Place(path, line), diagnose("doctype-refused"))
    parser = _parser()
    try:
        root = etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        errors = parser.error_log
        line, message = (errors[0].line, errors[0].message) if errors else (1, str(error))
        problem = diagnose("xml-not-well-formed", message=one_line(message))
        if "Excessive depth" in message:  # libxml2's words
            problem = diagnose("nested-too-deep", most=MAX_DEPTH)
        elif "prefix xacro" in message:
            problem = diagnose("file-is-xacro")
        raise refuse_file(Place(path, line or None), problem) from error
    count = 0
    ends = etree.iterwalk(root, events=("start", "end"))
    depth = 0
    for event, element in ends:
        depth += 1 if event == "start" else -1
        count += event == "start"
        if depth > MAX_DEPTH:
            raise refusal_at(path, element, diagnose("nested-too-deep", most=MAX_DEPTH))
        name = etree.QName(element)
        if element.prefix == "xacro":
            raise refusal_at(path, element, diagnose("file-is-xacro"))
        if name.namespace and element.prefix is None:
            element.tag = name.localname
    if count > MAX_ELEMENTS:
        raise refuse_file(
            Place(path), diagnose("too-many-elements", count=count, most=MAX_ELEMENTS)
        )
    return root


def parse_numbers(text: str | None, default: str) -> NDArray[np.float64]:
    """Returns the numbers of an attribute that has been checked, or was written here.

    Hexadecimal ones, too, which MuJoCo reads in a file as C's ``strtod`` does.
    """
    words = (default if text is None else text).split()
    return np.array([float.fromhex(w) if "x" in w.lower() else float(w) for w in words])


def parse_text(text: str) -> etree._Element:
    """Parses XML that was read before, or written here; comments are left out."""
    return etree.fromstring(text.encode(), _parser())


def to_text(root: etree._Element) -> str:
    """Writes XML, without a declaration."""
    return str(etree.tostring(root, encoding="unicode"))


def _text(path: Path) -> str:
    try:
        data = read_content(path, MAX_BYTES)
        if data.startswith(LFS_POINTER):
            raise refuse_file(Place(path), diagnose("model-is-lfs-pointer"))
        other = format_begun(data)
        if other is not None:
            raise refuse_file(
                Place(path), diagnose("file-of-other-format", format=other.name.upper())
            )
        text = decode_input(path, data)
    except InputError as error:
        raise refuse_input(path, error) from error
    if not text.strip():
        raise refuse_file(Place(path), diagnose("file-is-empty"))
    return text


def _parser() -> etree.XMLParser:
    return etree.XMLParser(
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )


# How a new model file is written, so that people like to read it: numbers, elements, defaults.

Array = NDArray[np.float64]

NOISE = 1e-13
"""Relative size of what products of rotations make of a zero."""

DIGITS: Final = 12
"""Significant digits: a thousand times finer than what `crosscheck --strict` tells apart, coarse
enough for a number that went through rotations to be what it was."""


ANGLE_DIGITS = 15
"""Of angles: half of pi is what it is to a hundredth of a rounding error."""


def write_numbers(values: ArrayLike, scale: float = 0.0, digits: int | None = DIGITS) -> str:
    """Writes numbers, separated by spaces.

    Args:
        values: The numbers.
        scale: What their errors are relative to, if it is more than the greatest of them.
        digits: How many significant ones; None: all.
    """
    array = np.atleast_1d(np.asarray(values, dtype=float))
    noise = NOISE * max(scale, float(np.abs(array).max(initial=0.0)))
    rounded = repr if digits is None else f"{{:.{digits}g}}".format
    return " ".join("0" if abs(v) <= noise else rounded(v) for v in array.tolist())


def is_zero(text: str) -> bool:
    """Tells whether all numbers of a text are zero."""
    return all(float(word) == 0 for word in text.split())


def write_halves(text: str) -> str:
    """Writes the halves of numbers: a URDF gives lengths, an MJCF half of them."""
    return write_numbers([float(word) / 2 for word in text.split()])


def add_element(parent: etree._Element, tag: str, **attributes: str | None) -> etree._Element:
    """Adds an element; attributes that are None are left out, ``class_`` is ``class``."""
    given = {name.rstrip("_"): text for name, text in attributes.items() if text is not None}
    return etree.SubElement(parent, tag, given)


def free_name(wanted: str, taken: set[str]) -> str:
    """Returns a name that is not taken, and takes it: the wanted one, or one with a number."""
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


_COMPACT_SECTIONS = {"transmission"}
"""Sections of a URDF that stand without a blank line between them."""


_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\udc80-\udcff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What no XML can have; the bytes of names that are no UTF-8 are escaped when they are encoded."""


def new_file_text(root: etree._Element, header: str) -> str:
    """Writes a new model file: two spaces a level, a blank line between sections.

    Args:
        root: Its root element.
        header: What a comment at its top says; nothing in it can end the comment.
    """
    etree.indent(root, space="  ")
    text = etree.tostring(root, encoding="unicode")
    tags = "|".join(sorted({str(section.tag) for section in root} - _COMPACT_SECTIONS))
    text = re.sub(rf"\n  <({tags})(?=[ >/])", r"\n\n  <\1", text)
    legal = _NO_XML.sub(lambda found: f"\\x{ord(found[0]):02x}", header)
    quiet = re.sub("-(?=-)", "- ", legal)
    return f"<!-- {quiet} -->\n{text}\n"
