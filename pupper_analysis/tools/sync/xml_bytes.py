"""A file of XML as bytes, in which single attributes are changed and all else stays as it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.parsers import expat
from xml.sax.saxutils import escape

from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.models.xml import blank_late_declaration

_ATTRIBUTE: Final = re.compile(rb"""\s([^\s=<>"'/]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")

_TAG: Final = re.compile(rb"""<[^\s/>]+(?:"[^"]*"|'[^']*'|[^>"'])*>""")


@dataclass(eq=False)
class Element:
    """An element, with the place of its start tag in the file's bytes.

    It is asked for its children and attributes as one of lxml's is: `UrdfTree` reads either.

    Attributes:
        tag: Its tag.
        attributes: As they stand in the file.
        file: The file.
        start: Of its start tag (byte); -1 of an element that is to be written.
        line: Of its start tag, from 1.
        parent: The element around it, across includes.
        children: What is in it, with includes put in.
        changes: {attribute: new value}.
        renamed: {attribute: the one that takes its place}.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    line: int
    parent: Element | None = field(default=None, repr=False)
    children: list[Element] = field(default_factory=list, repr=False)
    changes: dict[str, str] = field(default_factory=dict)
    renamed: dict[str, str] = field(default_factory=dict)

    def get(self, name: str) -> str | None:
        """Returns an attribute, with what is to be changed."""
        return self.changes.get(name, self.attributes.get(name))

    def set(self, name: str, value: str) -> None:
        """Notes that an attribute is to be changed."""
        self.changes[name] = value

    def rename_or_set(self, old: str, name: str, value: str) -> None:
        """Notes that an attribute is to be changed, in the place of another one if it has that."""
        if name != old and old in self.attributes:
            self.renamed[old] = name
        self.set(name, value)

    def findall(self, tag: str) -> list[Element]:
        """Returns the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> Element | None:
        """Returns the first child with a tag."""
        return next(iter(self.findall(tag)), None)

    def ensure(self, tag: str) -> Element:
        """Returns the first child with a tag; one is to be written where there is none."""
        found = self.find(tag)
        if found is None:
            found = Element(tag, {}, self.file, -1, self.line, self)
            new = [child for child in self.children if child.start < 0]
            self.children.insert(len(new), found)
        return found

    def is_changed(self) -> bool:
        """Says whether it, or what is in it, is to be changed."""
        return bool(self.changes) or any(child.is_changed() for child in self.children)

    def walk(self) -> Iterator[Element]:
        """Yields it and all below it, in the order of the file."""
        pending = [self]
        while pending:
            here = pending.pop()
            yield here
            pending.extend(reversed(here.children))


@dataclass(eq=False)
class XmlDocument:
    """A file of XML.

    Attributes:
        path: The file.
        data: Its bytes.
        root: Its root element.
        elements: All its elements.
    """

    path: Path
    data: bytes
    root: Element
    elements: list[Element]

    def render(self) -> bytes:
        """Returns the bytes with all changes, and no other byte changed."""
        splices: list[tuple[int, int, bytes]] = []
        for element in self.elements:
            splices += _of_attributes(self.data, element)
            new = [child for child in element.children if child.start < 0 and child.is_changed()]
            if new:
                splices += _of_children(self.data, element, new)
        data = self.data
        for start, end, text in sorted(splices, key=lambda splice: splice[:2], reverse=True):
            data = data[:start] + text + data[end:]
        return data


def read_document(path: Path) -> XmlDocument:
    """Reads a file of XML that is known to be well-formed UTF-8."""
    data = read_input(path, MAX_TEXT_BYTES)
    parser = expat.ParserCreate("utf-8")
    stack: list[Element] = []
    elements: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        parent = stack[-1] if stack else None
        here = parser.CurrentByteIndex
        element = Element(tag, attributes, path, here, parser.CurrentLineNumber, parent)
        if parent is not None:
            parent.children.append(element)
        stack.append(element)
        elements.append(element)

    def end(_: str) -> None:
        stack.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(blank_late_declaration(data), True)
    return XmlDocument(path, data, elements[0], elements)


def _tag_end(data: bytes, element: Element) -> int:
    """Returns where a start tag ends: after its >."""
    found = _TAG.match(data, element.start)
    assert found is not None
    return found.end()


def _spans(data: bytes, element: Element) -> dict[str, tuple[int, int]]:
    """Returns where the value of each attribute stands, without its quotes."""
    end = _tag_end(data, element)
    spans = {}
    for found in _ATTRIBUTE.finditer(data, element.start, end):
        group = 2 if found[2] is not None else 3
        spans[found[1].decode()] = found.span(group)
    return spans


def _of_attributes(data: bytes, element: Element) -> Iterator[tuple[int, int, bytes]]:
    """Yields the splices that change an element's attributes; new ones follow the last."""
    if not element.changes:
        return
    spans = _spans(data, element)
    for old, new in element.renamed.items():
        spans[new] = spans.pop(old)
        start = data.rfind(old.encode(), element.start, spans[new][0])
        yield start, start + len(old), new.encode()
    name_end = re.compile(rb"<[^\s/>]+").match(data, element.start)
    assert name_end is not None
    last = max((end + 1 for _, end in spans.values()), default=name_end.end())
    quote = data[last - 1 : last] if spans else b'"'
    added = b""
    for name, value in element.changes.items():
        if name in spans:
            start, end = spans[name]
            yield start, end, _escaped(value)
        else:
            added += b" " + name.encode() + b"=" + quote + _escaped(value) + quote
    if added:
        yield last, last, added


def _of_children(
    data: bytes, element: Element, new: list[Element]
) -> Iterator[tuple[int, int, bytes]]:
    """Yields the splices that put new children in front of the others, indented alike."""
    end = _tag_end(data, element)
    if data[end - 2 : end - 1] == b"/":
        tag = element.tag.encode()
        text = b"".join(_written(child, b"") for child in new)
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
    yield end, end, b"".join(indent + _written(child, indent) for child in new)


def _written(element: Element, indent: bytes) -> bytes:
    """Writes a new element, with its children on lines of their own if it is on one."""
    words = "".join(f' {name}="{_escaped(v).decode()}"' for name, v in element.changes.items())
    start = f"<{element.tag}{words}".encode()
    if not element.children:
        return start + b"/>"
    deeper = indent + b"  " if indent else b""
    inside = b"".join(deeper + _written(child, deeper) for child in element.children)
    return start + b">" + inside + indent + f"</{element.tag}>".encode()


def _escaped(value: str) -> bytes:
    return escape(value, {'"': "&quot;", "'": "&apos;"}).encode()
