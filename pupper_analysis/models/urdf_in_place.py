"""A URDF whose numbers are changed where they stand, and no other byte of it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.attributes import JointAttribute
from pupper_analysis.models.digits import SAME, Digits
from pupper_analysis.models.orientation import origin_changes, parse_numbers, read_origin
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.xml_bytes import Element, XmlDocument, read_document

Array = NDArray[np.float64]

UNKNOWN = {"effort": "0", "velocity": "1000"}
"""What is written where nothing is known: 0 is what exporters write, which cross-checking knows to
be none; but a velocity of 0 would be taken for one by whoever plans a motion."""


class UrdfInPlace:
    """The elements of a URDF, to be written.

    Attributes:
        document: The file, with what is to be changed.
        digits: Writes the numbers.
    """

    def __init__(self, file: UrdfFile, digits: Digits) -> None:
        self.document: XmlDocument = read_document(file.path)
        self.digits = digits

    def _named(self, tag: str) -> dict[str, Element]:
        return {str(e.get("name")): e for e in self.document.root.children if e.tag == tag}

    @cached_property
    def links(self) -> dict[str, Element]:
        """{name: link}."""
        return self._named("link")

    @cached_property
    def joints(self) -> dict[str, Element]:
        """{name: joint}."""
        return self._named("joint")

    @cached_property
    def above(self) -> dict[str, Element]:
        """{link: the joint that moves or holds it}."""
        return {child_of(joint): joint for joint in self.joints.values()}

    def carried(self, link: str) -> list[str]:
        """Returns the links on the joints that a link carries."""
        return [child_of(joint) for joint in self.joints.values() if parent_of(joint) == link]

    def set_pose(self, joint: Element, pose: pin.SE3) -> None:
        """States where a joint's frame is in its parent's."""
        for attribute, text in origin_changes(joint.child("origin"), pose, self.digits).items():
            joint.ensure("origin").set(attribute, text)

    def set_axis(self, joint: Element, axis: Array) -> None:
        """States a joint's axis (3,), unless it has that direction."""
        old = joint.child("axis")
        stated = None if old is None else old.get("xyz")
        before = parse_numbers(stated, "1 0 0")
        text = self.digits.words((stated or "1 0 0").split(), axis, 1.0)
        apart = np.abs(before / float(np.linalg.norm(before)) - axis)
        if text is not None and float(apart.max()) > SAME:
            joint.ensure("axis").set("xyz", text)

    def set_number(
        self, joint: Element, attribute: JointAttribute, value: float, floor: float = 0.0
    ) -> None:
        """States a number of a joint, which a URDF has words for.

        Args:
            joint: The joint.
            attribute: Which number.
            value: Its value.
            floor: The least scale of what counts as the same.
        """
        assert attribute.urdf is not None, f"a URDF has no words for {attribute.kind}"
        tag, word = attribute.urdf
        there = joint.child(tag)
        old = None if there is None else there.get(word)
        text = self.digits.words((old or "").split(), np.array([value]), floor)
        if text is not None:
            joint.ensure(tag).set(word, text)

    def complete_limit(self, joint: Element) -> dict[str, str]:
        """Gives a joint's ``<limit>`` what the format demands of it; returns what it lacked."""
        limit = joint.child("limit")
        if limit is None:
            return {}
        lacking = {word: text for word, text in UNKNOWN.items() if limit.get(word) is None}
        for word, text in lacking.items():
            limit.set(word, text)
        return lacking


def pose_of(joint: Element) -> pin.SE3:
    """Returns where a joint's frame is in its parent's."""
    return read_origin(joint.child("origin"))


def parent_of(joint: Element) -> str:
    """Returns the link that carries a joint."""
    return _end(joint, "parent")


def child_of(joint: Element) -> str:
    """Returns the link that a joint moves or holds."""
    return _end(joint, "child")


def _end(joint: Element, tag: str) -> str:
    found = joint.child(tag)
    assert found is not None
    return str(found.get("link"))
