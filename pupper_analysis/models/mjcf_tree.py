"""The elements of an MJCF, with its includes put in and its attached models."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lxml import etree

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.packages import existing_file
from pupper_analysis.models.places import (
    Place,
    line_of,
    quote_short,
    refusal_at,
    refuse_file,
)
from pupper_analysis.models.xml import (
    MAX_DEPTH,
    MAX_ELEMENTS,
    NUMBER,
    parse_xml,
)

MAX_INCLUDES: Final = 1000
"""Most includes and attached models of an MJCF."""

MAX_INCLUDE_DEPTH: Final = 30
"""Deepest nesting of an MJCF's includes, and of the models it attaches."""

MAX_COPIES: Final = 10_000
"""Most elements that an MJCF's replicates and attached models make."""


@dataclass(frozen=True)
class Node:
    """An element of an MJCF with its includes put in.

    Attributes:
        tag: Its tag.
        attributes: As they are written.
        place: Where it stands.
        children: Those below it.
        childclass: The default class that reaches it from the bodies around it.
    """

    tag: str
    attributes: Mapping[str, str]
    place: Place
    children: list[Node]
    childclass: str | None = None


# The product of the whole numbers in these attributes has a limit: MuJoCo would hang, or take all
# the memory. The tag "*" means any.
_LARGEST: Final = (
    ("texture", ("width", "height"), 2**26),
    ("hfield", ("nrow", "ncol"), 10**7),
    ("numeric", ("size",), 10**6),
    ("mesh", ("params",), 10**4),
    ("flexcomp", ("count",), 10**4),
    ("flexcomp", ("cellcount",), 10**4),
    ("composite", ("count",), 10**4),
    ("camera", ("resolution",), 10**7),
    ("size", ("nkey",), 10**4),
    *(
        ("size", (f"nuser_{kind}",), 10**4)
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    ),
    ("size", ("nuserdata",), 10**7),
    *(("*", (attribute,), 10**6) for attribute in ("nsample", "num", "dim", "actdim")),
)

_SECTIONS: Final = ("actuator", "sensor", "equality", "tendon", "contact", "deformable")


class Tree:
    """The elements of an MJCF, with its includes put in.

    Attributes:
        files: The file and all it includes or attaches.
        attached: The root elements of the models that it attaches, and that these attach.
        folders: The folders of the file and of the models it attaches.
        root: The root element.
        copies: How many elements MuJoCo will make of its replicates and attached models.
    """

    def __init__(
        self,
        path: Path,
        root: etree._Element,
        within: tuple[Path, ...] = (),
        includes: Iterator[int] | None = None,
    ) -> None:
        self.path = path
        self.files: dict[Path, None] = {path: None}
        self.folders: dict[Path, None] = {path.parent: None}
        self._within = (*within, path.resolve())
        self.attached: list[Node] = []
        self._models: dict[str, int] = {}
        self._parsed: dict[Path, etree._Element] = {}
        self._count = 0
        self._includes = includes or itertools.count(1)
        if len(self._within) > MAX_INCLUDE_DEPTH:
            raise refuse_file(Place(path), diagnose("attached-too-deep", most=MAX_INCLUDE_DEPTH))
        self.root = self._node(root, path, self._within, 0)
        self.copies = self._copies(self.root)
        if self.copies > self._count + MAX_COPIES:
            raise refuse_file(Place(path), diagnose("too-many-copies", most=MAX_COPIES))

    def _node(
        self,
        element: etree._Element,
        path: Path,
        within: tuple[Path, ...],
        depth: int,
        childclass: str | None = None,
    ) -> Node:
        attributes = {str(name): str(value) for name, value in element.attrib.items()}
        place = Place(path, line_of(element))
        node = Node(str(element.tag), attributes, place, [], childclass)
        childclass = attributes.get("childclass", childclass)
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise refuse_file(
                Place(self.path), diagnose("too-many-elements", count=None, most=MAX_ELEMENTS)
            )
        if depth > MAX_DEPTH:
            raise refusal_at(path, element, diagnose("nested-too-deep", most=MAX_DEPTH))
        _refuse_large(path, element)
        _refuse_formats(path, element)
        if element.tag == "model" and element.get("file", "").endswith(".xml"):
            self._attach(element, path)
        pending = [(child, path, within) for child in reversed(element)]
        while pending:
            child, file, inside = pending.pop()
            if child.tag == "include":
                included, top = self._include(child, file, inside)
                opened = (*inside, included.resolve())
                pending.extend((below, included, opened) for below in reversed(top))
            else:
                node.children.append(self._node(child, file, inside, depth + 1, childclass))
        return node

    def _include(
        self, element: etree._Element, path: Path, within: tuple[Path, ...]
    ) -> tuple[Path, etree._Element]:
        included = self._file(element, path)
        resolved = included.resolve()
        if resolved in within:
            raise refusal_at(path, element, diagnose("includes-itself", file=included.name))
        if len(within) > MAX_INCLUDE_DEPTH:
            raise refusal_at(path, element, diagnose("includes-too-deep", most=MAX_INCLUDE_DEPTH))
        if resolved not in self._parsed:
            self.files[included] = None
            _, self._parsed[resolved] = parse_xml(included)
        return included, self._parsed[resolved]

    def _attach(self, element: etree._Element, path: Path) -> None:
        attached = self._file(element, path)
        if attached.resolve() in self._within:
            raise refusal_at(path, element, diagnose("attaches-itself", file=attached.name))
        _, root = parse_xml(attached)
        tree = Tree(attached, root, self._within, self._includes)
        self.files |= tree.files
        self.attached += [tree.root, *tree.attached]
        self.folders |= tree.folders
        name = element.get("name") or root.get("model") or attached.stem
        self._models[name] = tree.copies

    def _file(self, element: etree._Element, path: Path) -> Path:
        """Counts and finds an include: by the main file first, then by its own file."""
        if next(self._includes) > MAX_INCLUDES:
            raise refusal_at(path, element, diagnose("too-many-includes", most=MAX_INCLUDES))
        name = element.get("file")
        if not name:
            raise refusal_at(path, element, diagnose("element-without-file", tag=element.tag))
        for folder in (self.path.parent, path.parent):
            found = existing_file(folder / name)
            if found is not None:
                return found
        missing = diagnose("included-file-missing", tag=element.tag, file=quote_short(name))
        raise refusal_at(path, element, missing)

    def _copies(self, node: Node) -> int:
        number = 1 + sum(self._copies(child) for child in node.children)
        if node.tag == "replicate":
            number *= max(_product(node.attributes.get("count", "1")), 1)
        if node.tag == "attach":
            number += self._models.get(node.attributes.get("model", ""), 0)
        return number


_HEXADECIMAL: Final = re.compile("0[xX][0-9a-fA-F]+")


def _refuse_large(path: Path, element: etree._Element) -> None:
    for tag, attributes, limit in _LARGEST:
        if tag in ("*", element.tag):
            text = " ".join(element.get(attribute, "") for attribute in attributes)
            if _product(text) > limit:
                names = " x ".join(attributes)
                problem = diagnose("size-too-large", tag=element.tag, names=names, most=limit)
                raise refusal_at(path, element, problem)


_FORMAT: Final = re.compile(r"%[-+ #0-9.*'$hlLqjzt]*[nsS]")
"""What printf writes to memory for, or takes for the address of a text."""

_FREE_TEXT: Final = ("data", "file", "meshdir", "texturedir", "assetdir")


def _refuse_formats(path: Path, element: etree._Element) -> None:
    """Refuses words that MuJoCo's reader takes for a format of its own messages, and dies of."""
    for attribute, value in element.attrib.items():
        if attribute not in _FREE_TEXT and _FORMAT.search(str(value)):
            where = {"tag": element.tag, "attribute": attribute, "value": quote_short(str(value))}
            raise refusal_at(path, element, diagnose("format-in-attribute", **where))


def _product(text: str) -> int:
    # MuJoCo reads 0x10, too.
    words = text.split()
    numbers = [abs(float(word)) for word in words if NUMBER.fullmatch(word)]
    numbers += [float(int(word, 16)) for word in words if _HEXADECIMAL.fullmatch(word)]
    product = math.prod(max(number, 1.0) for number in numbers)
    return int(min(product, 1e18))


def walk_elements(root: Node) -> Iterator[Node]:
    """Yields an element and all below it, in the order of the file."""
    pending = [root]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(node.children))


def index_of(root: Node) -> dict[tuple[str, str], Node]:
    """Finds the elements by kind and name; the first counts where there are several."""
    index: dict[tuple[str, str], Node] = {}
    fallback: dict[tuple[str, str], Node] = {}
    pending: list[tuple[Node, Node]] = [(child, root) for child in reversed(root.children)]
    while pending:
        node, parent = pending.pop()
        pending.extend((child, node) for child in reversed(node.children))
        name = node.attributes.get("class" if node.tag == "default" else "name")
        kinds = [node.tag]
        if parent.tag in _SECTIONS:
            kinds.append(parent.tag)
        if node.tag == "freejoint":
            kinds.append("joint")
        if not name and node.tag in ("mesh", "texture", "hfield"):
            name = Path(node.attributes.get("file", "")).stem
        for kind in kinds:
            if name:
                index.setdefault((kind, name), node)
            if parent.tag == "actuator" and "joint" in node.attributes:
                fallback.setdefault((kind, node.attributes["joint"]), node)
            if not name and kind in ("joint", "freejoint") and "name" in parent.attributes:
                fallback.setdefault((kind, parent.attributes["name"]), node)
    return fallback | index


def stating_element(root: Node, node: Node, attributes: Collection[str]) -> Node | None:
    """Returns the element that states one of an element's attributes: itself, or a default class.

    The class is its own, or the childclass of a body above it; what a class does not state is that
    of the class around it.

    Args:
        root: The root element.
        node: The element.
        attributes: Any of them will do.
    """
    if set(attributes) & set(node.attributes):
        return node
    name = node.attributes.get("class") or node.childclass
    nested = _classes(root, name)
    for default in reversed(nested):
        for child in default.children:
            if child.tag == node.tag and set(attributes) & set(child.attributes):
                return child
    return None


def _classes(root: Node, name: str | None) -> list[Node]:
    """Returns a default class with those around it, the outermost first."""
    tops = [child for child in root.children if child.tag == "default"]
    pending = [[top] for top in tops]
    while name is not None and pending:
        path = pending.pop()
        if path[-1].attributes.get("class") == name:
            return path
        pending.extend([*path, child] for child in path[-1].children if child.tag == "default")
    return tops[:1]
