"""Reading and writing of XML: limits of size and depth, no DOCTYPE, no entities, line numbers."""

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
from pupper_analysis.base.tools import detect_format
from pupper_analysis.models.places import (
    Place,
    make_element_error,
    make_file_error,
    make_input_error,
    one_line,
)

MAX_BYTES: Final = MAX_TEXT_BYTES
"""Maximum size of an XML file [bytes]; a larger file is refused."""

MAX_DEPTH: Final = 250
"""Largest nesting depth of XML elements, and largest number of joints in a chain of a URDF; a
deeper file is refused. Chosen, not tuned.
"""

MAX_ELEMENTS: Final = 30_000
"""Largest number of XML elements of a file, or of an MJCF with all included files; a larger file is
refused. Bounds time and memory. Chosen, not tuned."""

LFS_POINTER: Final = b"version https://git-lfs.github.com/spec/"
"""First bytes of a Git LFS pointer, a file that replaces content that was not downloaded."""

NUMBER_PATTERN: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""Pattern of a number in a model file: decimal or double of XML Schema, without infinity and
NaN."""

XACRO_PREFIX: Final = "xacro"
"""Namespace prefix of xacro elements, by convention of ROS."""

XACRO_SUFFIX: Final = ".xacro"
"""Suffix of xacro files."""

_FAULTY_DECLARATION: Final = re.compile(
    rb"(?:\A|(?<=\A\xef\xbb\xbf))"
    rb"(?:\s+<\?xml\s[^>]*\?>|<\?xml\s(?!\s*version\s*=\s*[\"']1\.\d+[\"'])[^>]*\?>)"
)
"""Pattern of an XML declaration that libxml2 rejects: behind white space, or without version 1.N
(for example ``<?xml version="0.0"?>``). Some public URDFs have a rejected version.
"""

_DOCTYPE_START: Final = re.compile(r"(?:\s|<!--.*?-->|<\?.*?\?>)*+<!(?!--)", re.DOTALL)
"""Start of a text with a DOCTYPE, which precedes the root element."""

MAX_NUMBER: Final = 1e50
"""Maximum absolute value of most numbers in a model file, such as masses and lengths [SI units];
larger numbers are refused. Chosen: products of six such numbers do not overflow."""


def parse_xml(path: Path) -> tuple[str, etree._Element]:
    """Read and parse an XML file; comments and the default namespace are removed from the tree.

    Returns:
        Text as read; root element.

    Raises:
        ModelError: For example if the file cannot be read, is not well-formed, or exceeds a limit.
        OutputError: If this run of the command line also writes this file.
    """
    text = _read_model_text(path)
    root = parse_file_text(path, text)
    if path.suffix.lower() == XACRO_SUFFIX and root.tag == "robot":
        _refuse_expressions(path, root)
    return text, root


XACRO_EXPRESSION: Final = re.compile(r"\$[{(]")
"""Start of a xacro expression, ``${...}`` or ``$(...)``."""


def _refuse_expressions(path: Path, root: etree._Element) -> None:
    """Raise a ModelError if a xacro file has an expression outside of its xacro elements."""
    if root.prefix == XACRO_PREFIX:
        return
    texts = (*map(str, root.attrib.values()), root.text or "", root.tail or "")
    if any(map(XACRO_EXPRESSION.search, texts)):
        raise make_element_error(path, root, diagnose("file-is-xacro"))
    for child in root:
        _refuse_expressions(path, child)


def parse_file_text(path: Path, text: str) -> etree._Element:
    """Parse the text of an XML file, and return the root element without comments.

    The default namespace is removed from the tags. A faulty XML declaration is accepted in the
    cases of `blank_faulty_declaration`. Xacro elements of a ``<robot>`` stay in the tree.

    Raises:
        ModelError: For example if the text is not well-formed, or exceeds a limit.
    """
    if found := _DOCTYPE_START.match(text):
        line = text.count("\n", 0, found.end()) + 1
        raise make_file_error(Place(path, line), diagnose("doctype-refused"))
    parser = _make_parser()
    try:
        root = etree.fromstring(blank_faulty_declaration(text.encode()), parser)
    except etree.XMLSyntaxError as error:
        if not text.lstrip("\ufeff \t\r\n").startswith("<"):
            raise make_file_error(Place(path, 1), diagnose("file-is-no-xml")) from error
        errors = parser.error_log
        line, message = (errors[0].line, errors[0].message) if errors else (1, str(error))
        problem = diagnose("xml-not-well-formed", message=one_line(message))
        if "Excessive depth" in message:  # message of libxml2
            problem = diagnose("nested-too-deep", most=MAX_DEPTH)
        elif "prefix xacro" in message:
            problem = diagnose("file-is-xacro")
        raise make_file_error(Place(path, line or None), problem) from error
    count = 0
    events = etree.iterwalk(root, events=("start", "end"))
    depth = 0
    for event, element in events:
        depth += 1 if event == "start" else -1
        count += event == "start"
        if depth > MAX_DEPTH:
            raise make_element_error(path, element, diagnose("nested-too-deep", most=MAX_DEPTH))
        name = etree.QName(element)
        if element.prefix == XACRO_PREFIX and root.tag != "robot":
            raise make_element_error(path, element, diagnose("file-is-xacro"))
        if name.namespace and element.prefix is None:
            element.tag = name.localname
    if count > MAX_ELEMENTS:
        raise make_file_error(
            Place(path), diagnose("too-many-elements", count=count, most=MAX_ELEMENTS)
        )
    return root


def blank_faulty_declaration(data: bytes) -> bytes:
    """Replace an XML declaration behind white space or without version 1.N by blanks.

    XML parsers such as libxml2 reject such a declaration. All other bytes keep their positions and
    lines. The encoding in the declaration is lost: the caller passes UTF-8.
    """
    return _FAULTY_DECLARATION.sub(lambda found: re.sub(rb"[^\n]", b" ", found[0]), data, count=1)


def parse_numbers(text: str | None, default: str) -> NDArray[np.float64]:
    """Convert an attribute to numbers, shape (n,); a default text replaces a missing attribute.

    Hexadecimal numbers are accepted, because MuJoCo uses C's ``strtod``.

    Args:
        text: Valid attribute; None if missing.
        default: Text with the default numbers.
    """
    words = (default if text is None else text).split()
    return np.array([float.fromhex(w) if "x" in w.lower() else float(w) for w in words])


def parse_text(text: str) -> etree._Element:
    """Parse XML text that is known to be valid; comments are removed."""
    return etree.fromstring(text.encode(), _make_parser())


def to_text(root: etree._Element) -> str:
    """Return the XML text of a root element, without a declaration."""
    return str(etree.tostring(root, encoding="unicode"))


def _read_model_text(path: Path) -> str:
    """Return the text of an XML model file; raise a ModelError if it is unreadable, for example."""
    try:
        data = read_content(path, MAX_BYTES)
        if data.startswith(LFS_POINTER):
            raise make_file_error(Place(path), diagnose("model-is-lfs-pointer"))
        other_format = detect_format(data)
        if other_format is not None:
            raise make_file_error(
                Place(path), diagnose("file-of-other-format", format=other_format.name.upper())
            )
        text = decode_input(path, data)
    except InputError as error:
        raise make_input_error(path, error) from error
    if not text.strip():
        raise make_file_error(Place(path), diagnose("file-is-empty"))
    return text


def _make_parser() -> etree.XMLParser:
    """Return a parser that drops comments and processing instructions, and resolves no entities."""
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


# Writing of new model files.

_ROUNDING_RTOL = 1e-13
"""Absolute value up to which `join_numbers` writes 0, relative to the largest of ``scale`` and of
the magnitudes of the written numbers: rounding errors of products of rotation matrices. Chosen, not
tuned.
"""

NUM_DIGITS: Final = 12
"""Number of significant digits of most numbers in new files. The relative rounding error is at most
5e-12, 200 times below the tolerance of `crosscheck --strict`. Chosen, not tuned."""


NUM_ANGLE_DIGITS = 15
"""Number of significant digits of ``rpy`` angles in new URDFs. An angle of pi/2 then has an error
of 3e-15 rad, and the products of its rotation matrix stay zero within `_ROUNDING_RTOL`."""


def join_numbers(values: ArrayLike, scale: float = 0.0, digits: int | None = NUM_DIGITS) -> str:
    """Format numbers as text, separated by spaces, for an attribute of a model file.

    Numbers within the rounding errors of zero are written as 0.

    Args:
        values: Numbers.
        scale: Reference magnitude of the rounding errors, if larger than the largest number.
        digits: Number of significant digits; None for the shortest exact form.
    """
    array = np.atleast_1d(np.asarray(values, dtype=float))
    rounding_error = _ROUNDING_RTOL * max(scale, float(np.abs(array).max(initial=0.0)))
    format_value = repr if digits is None else f"{{:.{digits}g}}".format
    return " ".join("0" if abs(v) <= rounding_error else format_value(v) for v in array.tolist())


def is_zero(text: str) -> bool:
    """Return True if all numbers in a text such as ``0 0 0`` are zero."""
    return all(float(word) == 0 for word in text.split())


def write_halves(text: str) -> str:
    """Return a text with half of each number of a text: lengths of a URDF for an MJCF."""
    return join_numbers([float(word) / 2 for word in text.split()])


def add_element(parent: etree._Element, tag: str, **attributes: str | None) -> etree._Element:
    """Add a child element with attributes, and return it.

    Args:
        parent: Element to which the child is added.
        tag: Tag of the child.
        attributes: Attributes; attributes with the value None are omitted. ``class_`` sets the
            attribute ``class``.
    """
    present = {name.rstrip("_"): text for name, text in attributes.items() if text is not None}
    return etree.SubElement(parent, tag, present)


def make_unique_name(wanted: str, taken: set[str]) -> str:
    """Return an unused name: the wanted name, with a number appended if it is taken.

    Args:
        wanted: Wanted name.
        taken: Used names; the result is added.
    """
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


_COMPACT_SECTIONS = {"transmission"}
"""Tags before which `new_file_text` inserts no blank line, unlike before other sections."""


_INVALID_CHARACTERS: Final = re.compile(
    "[^\t\n\r\x20-\ud7ff\udc80-\udcff\ue000-\ufffd\U00010000-\U0010ffff]"
)
"""Characters that XML does not permit, except surrogate escapes of undecodable bytes."""


def new_file_text(root: etree._Element, header: str) -> str:
    """Return the text of a new model file, indented, with blank lines between sections.

    Args:
        root: Root element; its elements are indented in place.
        header: Text of the comment at the top. Characters that XML does not permit there are
            changed.
    """
    etree.indent(root, space="  ")
    text = etree.tostring(root, encoding="unicode")
    tags = "|".join(sorted({str(section.tag) for section in root} - _COMPACT_SECTIONS))
    text = re.sub(rf"\n  <({tags})(?=[ >/])", r"\n\n  <\1", text)
    valid = _INVALID_CHARACTERS.sub(lambda match: f"\\x{ord(match[0]):02x}", header)
    comment = re.sub("-(?=-)", "- ", valid)
    return f"<!-- {comment} -->\n{text}\n"
