"""The elements of an MJCF and of what it includes, found by their names, and written in place."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.published import existing_file
from pupper_analysis.tools.sync.digits import format_numbers
from pupper_analysis.tools.sync.xml_bytes import Element, XmlDocument, read_document

Array = NDArray[np.float64]


class EditableMjcf:
    """The elements of an MJCF, with its includes put in.

    Attributes:
        documents: {file: its document}.
        root: The root element.
        angle: A unit of its angles (rad).
    """

    def __init__(self, file: MjcfFile) -> None:
        self.documents: dict[Path, XmlDocument] = {}
        self._file = file
        self._main = file.path
        self.root = self._read(file.path)
        compiler = file.spec.compiler
        self.angle = math.pi / 180 if compiler.degree else 1.0
        self.autolimits = bool(compiler.autolimits)
        self._bodies = self._named_bodies(file.spec)

    def body(self, name: str) -> Element | None:
        """Returns a body; None where the file has none of that name (but a copy of another)."""
        return self._bodies.get(name)

    def joint(self, name: str, body: str) -> Element | None:
        """Returns a joint; one without a name is found by its body."""
        found = self._bodies.get(body)
        if found is None:
            return None
        joints = [e for e in iterate_body_elements(found) if e.tag in ("joint", "freejoint")]
        named = [joint for joint in joints if joint.get("name") == name]
        unnamed = [joint for joint in joints if joint.get("name") is None]
        return (*named, *unnamed, None)[0]

    def find_actuators(self, joint: str) -> list[Element]:
        """Returns the actuators at a joint."""
        return [
            element
            for section in self._sections("actuator")
            for element in section.children
            if joint in (element.get("joint"), element.get("jointinparent"))
        ]

    def write(
        self, element: Element, attribute: str, value: str | ArrayLike, floor: float = 0.0
    ) -> None:
        """Writes an attribute of an element itself, unless it states that already.

        Args:
            element: The element.
            attribute: The attribute.
            value: A word, or one or more numbers.
            floor: The least scale of what counts as the same number.
        """
        if isinstance(value, str):
            text: str | None = value
        else:
            stated = (element.get(attribute) or "").split()
            text = format_numbers(stated, value, floor)
        if text is not None:
            element.set(attribute, text)

    def is_framed(self, element: Element) -> bool:
        """Says whether an element is in a <frame>, in which it states its place."""
        above = element.parent
        while above is not None and above.tag not in ("body", "worldbody"):
            if above.tag == "frame":
                return True
            above = above.parent
        return False

    def _sections(self, tag: str) -> Iterator[Element]:
        return (section for section in self.root.children if section.tag == tag)

    def _named_bodies(self, spec: mujoco.MjSpec) -> dict[str, Element]:
        found = [e for s in self._sections("worldbody") for e in s.walk() if e.tag == "body"]
        bodies = {str(e.get("name")): e for e in found if e.get("name")}
        if len(spec.bodies) == len(found) + 1:  # no body is a copy of another
            for number, element in enumerate(found, start=1):
                if not element.get("name"):  # as `mjcf.name_elements` calls it
                    bodies[f"body_{number}"] = element
        return bodies

    def _read(self, path: Path) -> Element:
        if path not in self.documents:
            self.documents[path] = read_document(path)
        document = self.documents[path]
        for element in document.elements:
            children: list[Element] = []
            for child in element.children:
                included = self._included(child, path) if child.tag == "include" else None
                children += [child] if included is None else included.children
            element.children = children
            for child in children:
                child.parent = element
        return document.root

    def _included(self, element: Element, path: Path) -> Element | None:
        name = element.get("file") or ""
        for folder in (self._main.parent, path.parent):
            found = existing_file(folder / name)
            if found is not None:
                return self._read(found)
        return None


def iterate_body_elements(body: Element) -> Iterator[Element]:
    """Yields what is in a body and in its frames, without the bodies in it."""
    for child in body.children:
        if child.tag == "frame":
            yield from iterate_body_elements(child)
        elif child.tag != "body":
            yield child
