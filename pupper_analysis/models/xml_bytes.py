"""XML file as bytes, in which single attributes are changed and all other bytes are kept.

`read_xml_bytes` returns the elements with the byte offsets of their start tags. Attributes are set
and children added in memory. ``XmlDocument.render`` replaces only the changed parts: comments, the
order of attributes, and white space between elements of the user's file stay the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.parsers import expat
from xml.sax.saxutils import escape

from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.models.xml import blank_faulty_declaration

_ATTRIBUTE_PATTERN: Final = re.compile(rb"""\s([^\s=<>"'/]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
"""Pattern of an attribute with the value in double or single quotes."""

_START_TAG_PATTERN: Final = re.compile(rb"""<[^\s/>]+(?:"[^"]*"|'[^']*'|[^>"'])*>""")
"""Pattern of the start tag of an XML element, with its attributes."""


@dataclass(eq=False)
class XmlElement:
    """XML element with its attributes, its changes, and the position of its start tag in the file.

    ``get``, ``set``, ``find`` and ``findall`` are named as in lxml, so that `UrdfTree` can use
    elements of both classes. Unlike in lxml, a path of several tags finds nothing.

    Attributes:
        tag: Tag.
        attributes: Attributes in the file, without ``changes``.
        file: File.
        start: Byte position of the start tag; -1 for a new element.
        line: Line of the start tag, from 1; for a new element, the line of its parent.
        parent: Parent element; of included content possibly in the including file.
        children: Child elements. A caller may replace an include by the included content.
        changes: {attribute: new value}. The key of a renamed attribute is its new name.
        renamed: {attribute: new name}.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    line: int
    parent: XmlElement | None = field(default=None, repr=False)
    children: list[XmlElement] = field(default_factory=list, repr=False)
    changes: dict[str, str] = field(default_factory=dict)
    renamed: dict[str, str] = field(default_factory=dict)

    def get(self, name: str) -> str | None:
        """Return the value of an attribute, including changes; None if the attribute is missing.

        The old name of a renamed attribute still returns the old value.
        """
        return self.changes.get(name, self.attributes.get(name))

    def set(self, name: str, value: str) -> None:
        """Change or add an attribute in memory; `XmlDocument.render` applies the change."""
        self.changes[name] = value

    def rename_or_set(self, old: str, name: str, value: str) -> None:
        """Set an attribute of this element; rename the attribute with the old name, if present."""
        if name != old and old in self.attributes:
            self.renamed[old] = name
        self.set(name, value)

    def findall(self, tag: str) -> list[XmlElement]:
        """Return the direct children with a tag, without deeper descendants."""
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> XmlElement | None:
        """Return the first child element with a tag; None without such a child."""
        return next(iter(self.findall(tag)), None)

    def ensure(self, tag: str) -> XmlElement:
        """Return the first child with a tag; create the child if there is none."""
        child = self.find(tag)
        if child is None:
            child = XmlElement(tag, {}, self.file, -1, self.line, self)
            new = [child for child in self.children if child.start < 0]
            self.children.insert(len(new), child)
        return child

    def is_changed(self) -> bool:
        """Return True if the element or a descendant has changes."""
        return bool(self.changes) or any(child.is_changed() for child in self.children)

    def walk(self) -> Iterator[XmlElement]:
        """Yield the element and all descendants in the order of the file."""
        pending = [self]
        while pending:
            element = pending.pop()
            yield element
            pending.extend(reversed(element.children))


@dataclass(eq=False)
class XmlDocument:
    """XML file with its bytes and elements, which can be changed and rendered again.

    Attributes:
        path: File.
        data: Bytes of the file.
        root: Root element.
        elements: All elements of the file, in the order of the file, without new elements.
    """

    path: Path
    data: bytes
    root: XmlElement
    elements: list[XmlElement]

    def render(self) -> bytes:
        """Return the bytes of the file with the changes of the elements applied.

        New elements without attributes in themselves or a descendant may be omitted.
        """
        data = self.data
        splices = self.list_splices()
        for start, end, text in sorted(splices, key=lambda splice: splice[:2], reverse=True):
            data = data[:start] + text + data[end:]
        return data

    def list_splices(self) -> list[tuple[int, int, bytes]]:
        """Return the byte replacements (start, end, new bytes) that turn the file into `render`."""
        splices: list[tuple[int, int, bytes]] = []
        for element in self.elements:
            splices += splice_attributes(self.data, element)
            new = [child for child in element.children if child.start < 0 and child.is_changed()]
            if new:
                splices += _splice_children(self.data, element, new)
        return splices


def read_xml_bytes(path: Path) -> XmlDocument:
    """Read an XML file as bytes, with the byte offsets of its elements, for later edits.

    The file must be well-formed UTF-8.

    Raises:
        InputError: If the file cannot be read, or is too large.
        OutputError: If this run of the command line also writes this file.
    """
    data = read_input(path, MAX_TEXT_BYTES)
    parser = expat.ParserCreate("utf-8")
    stack: list[XmlElement] = []
    elements: list[XmlElement] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        """Handle a start tag: create the element, and append it to its parent element."""
        parent = stack[-1] if stack else None
        here = parser.CurrentByteIndex
        element = XmlElement(tag, attributes, path, here, parser.CurrentLineNumber, parent)
        if parent is not None:
            parent.children.append(element)
        stack.append(element)
        elements.append(element)

    def end(_: str) -> None:
        """Make the parent the current element, when the parser reaches an end tag."""
        stack.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(blank_faulty_declaration(data), True)
    return XmlDocument(path, data, elements[0], elements)


def _find_tag_end(data: bytes, element: XmlElement) -> int:
    """Return the index in ``data`` of the byte after the start tag of an element."""
    match = _START_TAG_PATTERN.match(data, element.start)
    assert match is not None
    return match.end()


def _find_value_spans(data: bytes, element: XmlElement) -> dict[str, tuple[int, int]]:
    """Return {attribute: (first byte, byte after the last) of the value, without quotes}."""
    end = _find_tag_end(data, element)
    spans = {}
    for match in _ATTRIBUTE_PATTERN.finditer(data, element.start, end):
        group = 2 if match[2] is not None else 3
        spans[match[1].decode()] = match.span(group)
    return spans


def splice_attributes(data: bytes, element: XmlElement) -> Iterator[tuple[int, int, bytes]]:
    """Yield the byte replacements for the changed attributes of an element.

    Each replacement is (start, end, new bytes): the new bytes replace ``data[start:end]``.
    Attributes are renamed and changed in place; new attributes follow the last attribute.
    """
    if not element.changes:
        return
    spans = _find_value_spans(data, element)
    for old, new in element.renamed.items():
        spans[new] = spans.pop(old)
        start = data.rfind(old.encode(), element.start, spans[new][0])
        yield start, start + len(old), new.encode()
    name_end = re.compile(rb"<[^\s/>]+").match(data, element.start)
    assert name_end is not None
    last = max((end + 1 for _, end in spans.values()), default=name_end.end())
    quote = data[last - 1 : last] if spans else b'"'
    new_attributes = b""
    for name, value in element.changes.items():
        if name in spans:
            start, end = spans[name]
            yield start, end, _escape_value(value)
        else:
            new_attributes += b" " + name.encode() + b"=" + quote + _escape_value(value) + quote
    if new_attributes:
        yield last, last, new_attributes


def _splice_children(
    data: bytes, element: XmlElement, new: list[XmlElement]
) -> Iterator[tuple[int, int, bytes]]:
    """Yield the byte replacements that insert new elements as first children of an element.

    The new bytes of (start, end, new bytes) replace ``data[start:end]``. The new elements get the
    indentation of the present first child.
    """
    end = _find_tag_end(data, element)
    if data[end - 2 : end - 1] == b"/":
        tag = element.tag.encode()
        text = b"".join(_render_element(child, b"") for child in new)
        start = len(data[: end - 2].rstrip())
        yield start, end, b">" + text + b"</" + tag + b">"
        return
    space = re.compile(rb"\s*").match(data, end)
    assert space is not None
    indent = space[0]
    if b"\n" not in indent or data.startswith(b"</", space.end()):
        indent = b""
    else:  # one line end, though there may be empty lines
        indent = (b"\r\n" if b"\r\n" in indent else b"\n") + indent.rpartition(b"\n")[2]
    yield end, end, b"".join(indent + _render_element(child, indent) for child in new)


def _render_element(element: XmlElement, indent: bytes) -> bytes:
    """Render a new element; the children of an indented element are on separate lines."""
    words = "".join(f' {name}="{_escape_value(v).decode()}"' for name, v in element.changes.items())
    start = f"<{element.tag}{words}".encode()
    if not element.children:
        return start + b"/>"
    deeper = indent + b"  " if indent else b""
    inside = b"".join(deeper + _render_element(child, deeper) for child in element.children)
    return start + b">" + inside + indent + f"</{element.tag}>".encode()


def _escape_value(value: str) -> bytes:
    """Return an attribute value in UTF-8, with &, <, > and both quotation marks as entities."""
    return escape(value, {'"': "&quot;", "'": "&apos;"}).encode()
