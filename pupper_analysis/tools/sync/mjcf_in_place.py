"""Elements of an MJCF and the included files, found by name and changed in place.

Each <include> is replaced by the included elements, which remain elements of the included
documents. A body that MuJoCo copies, for example by ``<replicate>``, has no element in the file,
and is not found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import mujoco
from numpy.typing import ArrayLike

from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.xml_bytes import XmlDocument, XmlElement, read_xml_bytes
from pupper_analysis.tools.sync.digits import format_numbers


class EditableMjcf:
    """XML elements of an MJCF and the included files, for changes in place.

    Args:
        file: MJCF.

    Attributes:
        documents: {file: XML document}.
        root: Root element.
        angle: Angle unit of the file [rad].
        autolimits: True if the compiler option ``autolimits`` is set.
    """

    def __init__(self, file: MjcfFile) -> None:
        self.documents: dict[Path, XmlDocument] = {}
        self._file = file
        self._main_path = file.path
        self.root = self._read_file(file.path)
        compiler = file.spec.compiler
        self.angle = math.pi / 180 if compiler.degree else 1.0
        self.autolimits = bool(compiler.autolimits)
        self._bodies = self._find_bodies(file.spec)

    def find_body(self, name: str) -> XmlElement | None:
        """Return the XML element of a body of the MJCF; None if absent.

        A body that MuJoCo copies, for example by <replicate>, has no element.
        """
        return self._bodies.get(name)

    def find_joint(self, name: str, body: str) -> XmlElement | None:
        """Return the XML element of a joint in a body of the MJCF; None if absent.

        If the body has no joint with this name, the body's first joint without a name is returned.
        """
        element = self._bodies.get(body)
        if element is None:
            return None
        joints = [
            child for child in iterate_body_elements(element) if child.tag in ("joint", "freejoint")
        ]
        same_name = [joint for joint in joints if joint.get("name") == name]
        unnamed = [joint for joint in joints if joint.get("name") is None]
        return (*same_name, *unnamed, None)[0]

    def find_actuators(self, joint: str) -> list[XmlElement]:
        """Return the XML elements of the actuators of a joint."""
        return [
            element
            for section in self._iterate_sections("actuator")
            for element in section.children
            if joint in (element.get("joint"), element.get("jointinparent"))
        ]

    def write(
        self, element: XmlElement, attribute: str, value: str | ArrayLike, floor: float = 0.0
    ) -> None:
        """Set an attribute of an element; unchanged numbers keep the text of the file.

        Args:
            element: Element.
            attribute: Name of the attribute.
            value: Text, a number, or several numbers.
            floor: Lower bound of the magnitude to which the relative tolerance `NUMBER_RTOL` is
                applied, in the unit of the numbers.
        """
        if isinstance(value, str):
            text: str | None = value
        else:
            old_words = (element.get(attribute) or "").split()
            text = format_numbers(old_words, value, floor)
        if text is not None:
            element.set(attribute, text)

    def is_in_frame_element(self, element: XmlElement) -> bool:
        """Return True if a <frame> is between an element and the next <body> above the element.

        The pose of the element is then relative to the frame.
        """
        parent = element.parent
        while parent is not None and parent.tag not in ("body", "worldbody"):
            if parent.tag == "frame":
                return True
            parent = parent.parent
        return False

    def _iterate_sections(self, tag: str) -> Iterator[XmlElement]:
        """Yield the sections of the MJCF with a tag, such as ``worldbody``."""
        return (section for section in self.root.children if section.tag == tag)

    def _find_bodies(self, spec: mujoco.MjSpec) -> dict[str, XmlElement]:
        """Find the XML elements of the bodies of the MJCF: {name: element}.

        Unnamed bodies are included as ``body_N`` if no body is a copy.
        """
        elements = [
            element
            for section in self._iterate_sections("worldbody")
            for element in section.walk()
            if element.tag == "body"
        ]
        bodies = {str(element.get("name")): element for element in elements if element.get("name")}
        if len(spec.bodies) == len(elements) + 1:  # no body is a copy of another
            for number, element in enumerate(elements, start=1):
                if not element.get("name"):  # same name as by `mjcf.name_elements`
                    bodies[f"body_{number}"] = element
        return bodies

    def _read_file(self, path: Path) -> XmlElement:
        """Return the root element of a file, with the contents of included files in place."""
        if path not in self.documents:
            self.documents[path] = read_xml_bytes(path)
        document = self.documents[path]
        for element in document.elements:
            children: list[XmlElement] = []
            for child in element.children:
                included = self._read_include(child, path) if child.tag == "include" else None
                children += [child] if included is None else included.children
            element.children = children
            for child in children:
                child.parent = element
        return document.root

    def _read_include(self, element: XmlElement, path: Path) -> XmlElement | None:
        """Return the root element of an included file; None if the file is missing."""
        name = element.get("file") or ""
        for folder in (self._main_path.parent, path.parent):
            path_found = existing_file(folder / name)
            if path_found is not None:
                return self._read_file(path_found)
        return None


def iterate_body_elements(body: XmlElement) -> Iterator[XmlElement]:
    """Yield the elements of a body and of the frames in the body, without child bodies."""
    for child in body.children:
        if child.tag == "frame":
            yield from iterate_body_elements(child)
        elif child.tag != "body":
            yield child
