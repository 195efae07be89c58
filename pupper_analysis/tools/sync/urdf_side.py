"""Writes numbers into a URDF."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_entries
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES, UNSTATED
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree, origin_of
from pupper_analysis.models.xml import write_numbers
from pupper_analysis.tools.sync.digits import format_numbers
from pupper_analysis.tools.sync.frames import Key, Side, is_same_body, list_single_part_changes
from pupper_analysis.tools.sync.xml_bytes import Element

Array = NDArray[np.float64]

Changes = dict[tuple[str, str], str]
"""{(path below an element, attribute): new value}."""

UNKNOWN_LIMITS = {"effort": write_numbers(UNSTATED), "velocity": "1000"}
"""Limits that a new <limit> gets if no file states them, since a URDF requires both. An effort of
``UNSTATED`` means that none is stated; 0 would be a motor without torque."""

_RANGE = ("lower limit", "upper limit")

_NUMBERS = [one.kind for one in JOINT_ATTRIBUTES if one.in_both and one.kind not in _RANGE]


@dataclass(eq=False, kw_only=True)
class UrdfSide(Side):
    """A URDF that gets numbers of an MJCF.

    Attributes:
        tree: Its links and joints, of elements that are to be written in place.
    """

    tree: UrdfTree

    def __post_init__(self) -> None:
        self._links, self._above = self.tree.links, self.tree.above
        self._movers = {link: mover for mover, link in self.sides.matched.urdf_link.items()}
        self._compared = self.sides.matched.urdf_tree.links

    def plan(self, taken: Collection[Key]) -> None:
        """Notes all changes in the document: places first, for what is on them moves along."""
        for kind, name in taken:
            if kind == "position":
                self._place(name)
        for key in taken:
            kind, name = key
            if kind in _RANGE:
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
            pose, link = joint.origin * pose, joint.parent
        return pose

    def _mover(self, link: str) -> str:
        while link not in self._movers:
            link = self._above[link].parent
        return self._movers[link]

    def _place(self, name: str) -> None:
        joint = self._joint(name)
        frame = self.sides.urdf_frames[self._mover(joint.parent)] * self._pose(joint.parent)
        placed = frame.inverse() * self.target.joints[name].placement
        text = make_xyz_text(joint.element, np.array(placed.translation))
        if text is not None:
            joint.element.ensure("origin").set("xyz", text)

    def _joint(self, name: str) -> UrdfJoint:
        return self.tree.joints[self.sides.matched.urdf_joint[name]]

    def _state(self, joint: UrdfJoint, kind: str, value: float, floor: float = 0.0) -> None:
        """States a number of a joint; what is not above the floor is as good as 0."""
        attribute = BY_KIND[kind]
        assert attribute.urdf is not None
        tag, word = attribute.urdf
        stated = (joint.stated(attribute) or "").split()
        text = format_numbers(stated, value, floor)
        if text is not None:
            joint.element.ensure(tag).set(word, text)

    def _limits(self, key: Key) -> None:
        moved, joint = self._joint(key[1]), self.target.joints[key[1]]
        element = moved.element
        if not (math.isfinite(joint.lower) and math.isfinite(joint.upper)):
            self.unwritten[key] = diagnose("urdf-limits-unwritten")
            return
        if element.get("type") == "continuous":
            element.set("type", "revolute")
        for kind in _RANGE:
            self._state(moved, kind, getattr(joint, BY_KIND[kind].field), 1.0)
        self._complete(key, moved)

    def _number(self, key: Key) -> None:
        kind, name = key
        if name not in self.target.joints:
            self.unwritten[key] = diagnose("base-without-joint")
            return
        joint: TreeJoint = self.target.joints[name]
        self._state(self._joint(name), kind, float(getattr(joint, kind)))
        if kind == "effort":
            self._complete(key, self._joint(name))

    def _complete(self, key: Key, joint: UrdfJoint) -> None:
        """Gives a new <limit> what the format demands of it, though no file states it."""
        limit = joint.element.find("limit")
        for word, value in UNKNOWN_LIMITS.items() if limit is not None else ():
            if limit.get(word) is None:
                limit.set(word, value)
                self.notes[key] = diagnose("limit-completed", attribute=word, value=value)

    def _members(self, mover: str) -> list[str]:
        """Returns the links that move with a joint, or are the base; the moved one first."""
        top = self.sides.matched.urdf_link[mover]
        members, waiting = [], [top]
        while waiting:
            here = waiting.pop(0)
            members += [here] if here in self._compared else []
            carried = (joint.child for joint in self.tree.below.get(here, ()))
            waiting += [link for link in carried if link not in self._movers]
        return members

    def _inertial(self, mover: str, keys: list[Key]) -> None:
        keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
        frame = self.sides.urdf_frames[mover].inverse()
        wanted = frame.act(self.target.bodies[mover].rigid)
        members = self._members(mover)
        own = {link: self._links[link].inertia for link in members}
        placed = {link: self._pose(link).act(one) for link, one in own.items() if one is not None}
        placed = {link: one for link, one in placed.items() if one.mass > 0}
        if is_same_body(sum(placed.values(), pin.Inertia.Zero()), wanted):
            return
        ways = list_single_part_changes(placed, wanted, members[0])
        if not ways:
            self.unwritten.update(dict.fromkeys(keys, diagnose("no-link-to-change")))
            return

        def changed(link: str, part: pin.Inertia) -> Changes:
            inside = self._pose(link).actInv(part)
            return make_inertial_changes(self._links[link].element, inside)

        tries = [(link, changed(link, part)) for link, part in ways]
        best, changes = min(tries, key=lambda way: len(way[1]))
        for (path, attribute), text in changes.items():
            self._links[best].element.ensure("inertial").ensure(path).set(attribute, text)


def make_xyz_text(owner: Element | None, place: Array) -> str | None:
    """Returns what the <origin> in an element must say for a place; None if it does."""
    origin = None if owner is None else owner.find("origin")
    stated = None if origin is None else origin.get("xyz")
    return format_numbers((stated or "0 0 0").split(), place, 1.0)


def make_inertial_changes(link: Element, wanted: pin.Inertia) -> Changes:
    """Returns the changes by which a link's inertial states a mass, in the axes that it has."""
    inertial = link.find("inertial")
    weight, entry = (inertial and inertial.find(tag) for tag in ("mass", "inertia"))
    changes: Changes = {}
    old = weight and weight.get("value")
    text = format_numbers((old or "").split(), wanted.mass)
    if text is not None:
        changes["mass", "value"] = text
    rotation = np.array(origin_of(inertial).rotation)
    stated = [None if entry is None else entry.get(name) for name in INERTIA_ENTRIES]
    inside = rotation.T @ np.array(wanted.inertia) @ rotation
    changes |= dict(_tensor_changes(stated, inertia_entries(inside)))
    text = make_xyz_text(inertial, np.array(wanted.lever))
    return changes if text is None else changes | {("origin", "xyz"): text}


def _tensor_changes(
    stated: list[str | None], values: Array
) -> Iterator[tuple[tuple[str, str], str]]:
    scale = float(np.abs(values).max())
    for name, old, value in zip(INERTIA_ENTRIES, stated, values, strict=True):
        text = format_numbers((old or "").split(), value, scale)
        if text is not None:
            yield ("inertia", name), text
