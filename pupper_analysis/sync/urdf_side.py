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
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES
from pupper_analysis.models.digits import Digits
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.orientation import origin_changes, read_origin
from pupper_analysis.models.urdf_in_place import UrdfInPlace, parent_of, pose_of
from pupper_analysis.models.xml_bytes import Element
from pupper_analysis.sync.frames import Key, mass_of, place_joint
from pupper_analysis.sync.inertia import (
    Mass,
    is_same_mass,
    total_mass,
    turned_like,
)
from pupper_analysis.sync.side import Side

Array = NDArray[np.float64]

Changes = dict[tuple[str, str], str]
"""{(path below an element, attribute): new value}."""

_RANGE = ("lower limit", "upper limit")

_NUMBERS = [one.kind for one in JOINT_ATTRIBUTES if one.in_both and one.kind not in _RANGE]


@dataclass(eq=False, kw_only=True)
class UrdfSide(Side):
    """A URDF that gets numbers of an MJCF.

    Attributes:
        file: The file.
    """

    file: UrdfInPlace

    def __post_init__(self) -> None:
        self._links, self._above = self.file.links, self.file.above
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
            pose = pose_of(joint) * pose
            link = parent_of(joint)
        return pose

    def _mover(self, link: str) -> str:
        while link not in self._movers:
            link = parent_of(self._above[link])
        return self._movers[link]

    def _frame(self, key: Key) -> None:
        name = key[1]
        joint = self._above[self.sides.matched.robot.description.frames[name][0]]
        if not self.on_same_body(key):
            return
        owner, position = self.wanted.frames[name]
        inside = self.sides.urdf_frames[owner].inverse() * position
        there = self._pose(parent_of(joint)).inverse() * inside
        self.file.set_pose(joint, pin.SE3(np.array(pose_of(joint).rotation), there))

    def _place(self, name: str) -> None:
        joint = self._joint(name)
        parent = parent_of(joint)
        frame = self.sides.urdf_frames[self._mover(parent)] * self._pose(parent)
        self.file.set_pose(joint, frame.inverse() * place_joint(self.wanted.joints[name]))

    def _joint(self, name: str) -> Element:
        return self.file.joints[self.sides.matched.urdf_joint[name]]

    def _axis(self, name: str) -> None:
        self.file.set_axis(self._joint(name), self.wanted.joints[name].axis)

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
        for kind in _RANGE:
            attribute = BY_KIND[kind]
            self.file.set_number(element, attribute, getattr(joint, attribute.field), 1.0)
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
        self.file.set_number(self._joint(name), BY_KIND[kind], value)
        if kind == "effort":
            self._complete(key, self._joint(name))

    def _complete(self, key: Key, joint: Element) -> None:
        """Gives a new <limit> what the format demands of it, though no file states it."""
        for word, value in self.file.complete_limit(joint).items():
            self.notes[key] = diagnose("limit-completed", attribute=word, value=value)

    def _members(self, mover: str) -> list[str]:
        """Returns the links that move with a joint, or are the base; the moved one first."""
        top = self.sides.matched.urdf_link[mover]
        members, waiting = [], [top]
        while waiting:
            here = waiting.pop(0)
            members += [here] if here in self._compared else []
            waiting += [link for link in self.file.carried(here) if link not in self._movers]
        return members

    def _inertial(self, mover: str, keys: list[Key]) -> None:
        keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
        frame = self.sides.urdf_frames[mover].inverse()
        wanted = mass_of(self.wanted.bodies[mover]).moved(frame)
        members = self._members(mover)
        own = {link: _stated(self._links[link]) for link in members}
        placed = {link: mass.moved(self._pose(link)) for link, mass in own.items() if mass}
        if is_same_mass(total_mass(list(placed.values())), wanted):
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


def _stated(link: Element) -> Mass | None:
    """Returns the mass that a link states, in its frame; None if it states none."""
    inertial = link.child("inertial")
    weight = None if inertial is None else inertial.child("mass")
    if inertial is None or weight is None or not float(weight.get("value") or 0) > 0:
        return None
    values = inertial.child("inertia")
    own = np.array([float((values and values.get(name)) or 0) for name in INERTIA_ENTRIES])
    mass = Mass(float(weight.get("value") or 0), np.zeros(3), inertia_tensor(own))
    return mass.moved(read_origin(inertial.child("origin")))


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
    rotation = np.array(read_origin(parts["origin"]).rotation)
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
