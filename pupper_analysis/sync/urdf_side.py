"""Writes numbers into a URDF."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arrays import INERTIA_ENTRIES, inertia_entries, inertia_tensor
from pupper_analysis.diagnostics import Term, diagnose
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.sync.digits import SAME, Digits
from pupper_analysis.sync.frames import Key, mass_of, placement
from pupper_analysis.sync.inertia import (
    Mass,
    same,
    total,
    turned_like,
)
from pupper_analysis.sync.orientation import numbers, origin, origin_changes
from pupper_analysis.sync.side import Side
from pupper_analysis.sync.xml_bytes import Element, XmlDocument

Array = NDArray[np.float64]

Changes = dict[tuple[str, str], str]
"""{(path below an element, attribute): new value}."""

_RANGE = ("lower limit", "upper limit")

_NUMBERS = {
    one.kind: one.urdf
    for one in JOINT_ATTRIBUTES
    if one.urdf and one.mjcf and one.kind not in _RANGE
}


_UNKNOWN = {"effort": "0", "velocity": "1000"}
"""What is written where nothing is known: 0 is what exporters write, which cross-checking knows to
be none; but a velocity of 0 would be taken for one by whoever plans a motion."""


@dataclass(eq=False, kw_only=True)
class UrdfSide(Side):
    """A URDF that gets numbers of an MJCF.

    Attributes:
        document: The file.
    """

    document: XmlDocument

    def __post_init__(self) -> None:
        root = self.document.root
        self._links = {str(e.get("name")): e for e in root.children if e.tag == "link"}
        self._joints = {str(e.get("name")): e for e in root.children if e.tag == "joint"}
        self._above = {_end(joint, "child"): joint for joint in self._joints.values()}
        self._movers = {link: mover for mover, link in self.sides.matched.urdf_link.items()}
        self._compared = self.sides.matched.urdf_tree.links

    def plan(self, taken: Collection[Key]) -> None:
        """Notes all changes in the document: places first, for what is on them moves along."""
        for key in taken:
            if key[0] == "frame":
                self._frame(key)
        for name in dict.fromkeys(e for k, e in taken if k in ("position", "rotation", "zero")):
            self._place(name)
        for key in taken:
            kind, name = key
            if kind == "axis":
                self._axis(name)
            elif kind in (*_RANGE, "zero"):
                self._limits(key)
            elif kind in _NUMBERS:
                self._number(key)
        for name in dict.fromkeys(e for k, e in taken if k in ("mass", "com", "inertia")):
            self._inertial(name, [key for key in taken if key[1] == name])

    def _pose(self, link: str) -> pin.SE3:
        """Returns where a link is in the frame of the link that moves it."""
        pose = pin.SE3.Identity()
        while link not in self._movers and link in self._above:
            joint = self._above[link]
            pose = origin(joint.child("origin")) * pose
            link = _end(joint, "parent")
        return pose

    def _mover(self, link: str) -> str:
        while link not in self._movers:
            link = _end(self._above[link], "parent")
        return self._movers[link]

    def _frame(self, key: Key) -> None:
        name = key[1]
        joint = self._above[self.sides.matched.robot.description.frames[name][0]]
        if not self.on_same_body(key):
            return
        owner, position = self.wanted.frames[name]
        inside = self.sides.urdf_frames[owner].inverse() * position
        there = self._pose(_end(joint, "parent")).inverse() * inside
        old = origin(joint.child("origin"))
        self._set_origin(joint, pin.SE3(np.array(old.rotation), there))

    def _place(self, name: str) -> None:
        joint = self._joint(name)
        parent = _end(joint, "parent")
        frame = self.sides.urdf_frames[self._mover(parent)] * self._pose(parent)
        self._set_origin(joint, frame.inverse() * placement(self.wanted.joints[name]))

    def _set_origin(self, element: Element, pose: pin.SE3) -> None:
        changes = origin_changes(element.child("origin"), pose, self.digits)
        for attribute, text in changes.items():
            element.ensure("origin").set(attribute, text)

    def _joint(self, name: str) -> Element:
        return self._joints[self.sides.matched.urdf_joint[name]]

    def _axis(self, name: str) -> None:
        joint = self._joint(name)
        old = joint.child("axis")
        stated = None if old is None else old.get("xyz")
        before = numbers(stated, "1 0 0")
        length = float(np.linalg.norm(before))
        wanted = self.wanted.joints[name].axis
        text = self.digits.words((stated or "1 0 0").split(), wanted, 1.0)
        if text is not None and float(np.abs(before / length - wanted).max()) > SAME:
            joint.ensure("axis").set("xyz", text)

    def _limits(self, key: Key) -> None:
        element, joint = self._joint(key[1]), self.wanted.joints[key[1]]
        finite = math.isfinite(joint.lower), math.isfinite(joint.upper)
        if element.get("type") == "continuous" and not any(finite):
            return
        if not all(finite):
            if any(finite) or joint.slides:
                self.left[key] = diagnose("urdf-limits-unwritten")
            else:
                element.set("type", "continuous")
                self.notes[key] = diagnose("joint-made-continuous")
            return
        if element.get("type") == "continuous":
            element.set("type", "revolute")
            self.notes[key] = diagnose("joint-made-revolute")
        for word, value in (("lower", joint.lower), ("upper", joint.upper)):
            self._write(element, "limit", word, value, 1.0)
        self._complete(key, element)

    def _number(self, key: Key) -> None:
        kind, name = key
        if name not in self.wanted.joints:
            self.left[key] = diagnose("base-without-joint")
            return
        joint: TreeJoint = self.wanted.joints[name]
        value = float(getattr(joint, kind))
        if not math.isfinite(value):
            self.left[key] = diagnose("urdf-number-unlimited", kind=Term(kind))
            return
        self._write(self._joint(name), *_NUMBERS[kind], value, 0.0)
        if kind == "effort":
            self._complete(key, self._joint(name))

    def _complete(self, key: Key, joint: Element) -> None:
        """Gives a new <limit> what the format demands of it, though no file states it."""
        limit = joint.child("limit")
        if limit is None:
            return
        for word, value in _UNKNOWN.items():
            if limit.get(word) is None:
                limit.set(word, value)
                told = diagnose("limit-completed", attribute=word, value=value)
                self.notes[key] = told

    def _write(
        self, element: Element, tag: str, attribute: str, value: float, floor: float
    ) -> None:
        there = element.child(tag)
        old = None if there is None else there.get(attribute)
        text = self.digits.words((old or "").split(), np.array([value]), floor)
        if text is not None:
            element.ensure(tag).set(attribute, text)

    def _members(self, mover: str) -> list[str]:
        """Returns the links that move with a joint, or are the base; the moved one first."""
        top = self.sides.matched.urdf_link[mover]
        members, waiting = [], [top]
        while waiting:
            here = waiting.pop(0)
            members += [here] if here in self._compared else []
            waiting += [
                _end(joint, "child")
                for joint in self._joints.values()
                if _end(joint, "parent") == here and _end(joint, "child") not in self._movers
            ]
        return members

    def _inertial(self, mover: str, keys: list[Key]) -> None:
        keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
        frame = self.sides.urdf_frames[mover].inverse()
        wanted = mass_of(self.wanted.bodies[mover]).moved(frame)
        members = self._members(mover)
        own = {link: _stated(self._links[link]) for link in members}
        placed = {link: mass.moved(self._pose(link)) for link, mass in own.items() if mass}
        if same(total(list(placed.values())), wanted):
            return
        heavy = sorted(placed, key=lambda link: -placed[link].mass)
        found: list[tuple[str, Changes]] = []
        for link in heavy or members[:1]:
            others = [mass for other, mass in placed.items() if other != link]
            left = wanted.minus(others)
            if left is None or (others and not left.is_physical):
                continue
            inside = left.moved(self._pose(link).inverse())
            found.append((link, inertial_changes(self._links[link], inside, self.digits)))
        if not found:
            for key in keys:
                self.left[key] = diagnose("no-link-to-change")
            return
        link, changes = min(found, key=lambda one: len(one[1]))
        for (path, attribute), text in changes.items():
            element = self._links[link].ensure("inertial")
            (element.ensure(path)).set(attribute, text)
        if len(heavy) > 1:
            told = diagnose("one-link-changed", links=len(heavy), link=link)
            self.notes.update(dict.fromkeys(keys, told))


def _end(joint: Element, tag: str) -> str:
    found = joint.child(tag)
    assert found is not None
    return str(found.get("link"))


def _stated(link: Element) -> Mass | None:
    """Returns the mass that a link states, in its frame; None if it states none."""
    inertial = link.child("inertial")
    weight = None if inertial is None else inertial.child("mass")
    if inertial is None or weight is None or not float(weight.get("value") or 0) > 0:
        return None
    values = inertial.child("inertia")
    own = np.array([float((values and values.get(name)) or 0) for name in INERTIA_ENTRIES])
    mass = Mass(float(weight.get("value") or 0), np.zeros(3), inertia_tensor(own))
    return mass.moved(origin(inertial.child("origin")))


def inertial_changes(link: Element, wanted: Mass, digits: Digits) -> Changes:
    """Returns the fewest changes by which a link's inertial states a mass.

    Either the entries of the tensor change, or the axes in which they are given.
    """
    inertial = link.child("inertial")
    parts = {tag: inertial and inertial.child(tag) for tag in ("origin", "mass", "inertia")}
    changes: Changes = {}
    old = parts["mass"] and parts["mass"].get("value")
    text = digits.words((old or "").split(), np.array([wanted.mass]))
    if text is not None:
        changes["mass", "value"] = text
    rotation = np.array(origin(parts["origin"]).rotation)
    entry = parts["inertia"]
    stated = [None if entry is None else entry.get(name) for name in INERTIA_ENTRIES]
    inside = rotation.T @ wanted.inertia @ rotation
    turn = None
    numbers_now = inertia_tensor(np.array([float(word or 0) for word in stated]))
    of_tensor = dict(_tensor_changes(stated, inertia_entries(inside), digits))
    if len(of_tensor) > 1:
        turn = turned_like(wanted.inertia, numbers_now, rotation)
    pose = pin.SE3(rotation if turn is None else turn, wanted.com)
    place = origin_changes(parts["origin"], pose, digits)
    if turn is None:
        changes |= of_tensor
    return changes | {("origin", attribute): text for attribute, text in place.items()}


def _tensor_changes(
    stated: list[str | None], values: Array, digits: Digits
) -> Iterator[tuple[tuple[str, str], str]]:
    scale = float(np.abs(values).max())
    for name, old, value in zip(INERTIA_ENTRIES, stated, values, strict=True):
        text = digits.words((old or "").split(), np.array([value]), scale)
        if text is not None:
            yield ("inertia", name), text
