"""Planning of changes to a URDF: positions, limits, joint numbers, masses.

Inputs are target values from the MJCF, converted to the frames of the URDF, and selected
differences. Elements are changed in memory; a difference that cannot be written gets a reason.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_entries
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES, MIN_UNSTATED_LIMIT
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree, origin_of
from pupper_analysis.models.xml import join_numbers
from pupper_analysis.models.xml_bytes import XmlElement
from pupper_analysis.robot.compare.differences import PropertyKey
from pupper_analysis.tools.sync.digits import format_numbers
from pupper_analysis.tools.sync.frames import Side, is_same_body, list_single_part_changes

Changes = dict[tuple[str, str], str]
"""New values: {(path below an element, attribute): text}."""

UNKNOWN_LIMITS = {"effort": join_numbers(MIN_UNSTATED_LIMIT), "velocity": "1000"}
"""{attribute that a URDF's <limit> requires: text that is written if the URDF lacks the attribute}.
The effort, in N m or N, means an unknown limit (`MIN_UNSTATED_LIMIT`). The velocity is in rad/s or
m/s. Chosen, not tuned.
"""

_LIMIT_KINDS = ("lower limit", "upper limit")
"""Kinds of the two position limits of a joint, which `sync` writes together."""

_NUMBER_KINDS = [
    attribute.kind
    for attribute in JOINT_ATTRIBUTES
    if attribute.is_in_both_formats and attribute.kind not in _LIMIT_KINDS
]
"""Kinds of joint numbers in both formats, except position limits."""


@dataclass(eq=False, kw_only=True)
class UrdfSide(Side):
    """URDF that receives numbers: planner of the changes.

    Attributes:
        tree: Links and joints, as elements that are changed in place.
    """

    tree: UrdfTree

    def __post_init__(self) -> None:
        self._links, self._parent_joints = self.tree.links, self.tree.parent_joints
        self._mover_of_link = {link: mover for mover, link in self.sides.matched.urdf_link.items()}
        self._compared_links = self.sides.matched.urdf_tree.links

    def plan(self, taken: Collection[PropertyKey]) -> None:
        """Plan the changes of the URDF in memory, without writing any file.

        The reason for a difference that cannot be written is recorded in ``unwritten``.

        Args:
            taken: Differences (kind, element) whose values are taken from the MJCF.
        """
        for kind, name in taken:
            if kind == "position":
                self._plan_position(name)
        for key in taken:
            kind, name = key
            if kind in _LIMIT_KINDS:
                self._plan_limits(key)
            elif kind in _NUMBER_KINDS:
                self._plan_number(key)
        for name in dict.fromkeys(e for k, e in taken if k in ("mass", "com", "inertia")):
            self._plan_inertial(name, [key for key in taken if key[1] == name])

    def _compute_link_pose(self, link: str) -> pin.SE3:
        """Return the pose of a link in the frame of the base or moving link above the link."""
        pose = pin.SE3.Identity()
        while link not in self._mover_of_link and link in self._parent_joints:
            joint = self._parent_joints[link]
            pose, link = joint.origin * pose, joint.parent
        return pose

    def _find_mover(self, link: str) -> str:
        """Return the joint that moves a link (links on fixed joints included), or the base."""
        while link not in self._mover_of_link:
            link = self._parent_joints[link].parent
        return self._mover_of_link[link]

    def _plan_position(self, name: str) -> None:
        """Plan to set the ``xyz`` of a joint's <origin> in the URDF to the MJCF's position [m]."""
        joint = self._find_joint(name)
        frame = self.sides.urdf_frames[self._find_mover(joint.parent)] * self._compute_link_pose(
            joint.parent
        )
        target = frame.inverse() * self.target.joints[name].placement
        text = make_xyz_text(joint.element, np.array(target.translation))
        if text is not None:
            joint.element.ensure("origin").set("xyz", text)

    def _find_joint(self, name: str) -> UrdfJoint:
        """Return the joint of the URDF that matches the joint ``name`` of the robot."""
        return self.tree.joints[self.sides.matched.urdf_joint[name]]

    def _write_number(self, joint: UrdfJoint, kind: str, value: float, floor: float = 0.0) -> None:
        """Set a number of a joint in the URDF, in SI units, unless the file already has this value.

        ``floor`` is the smallest reference of the relative tolerance `NUMBER_RTOL`.
        """
        attribute = BY_KIND[kind]
        assert attribute.urdf is not None
        tag, word = attribute.urdf
        old_words = (joint.parameter_text(attribute) or "").split()
        text = format_numbers(old_words, value, floor)
        if text is not None:
            joint.element.ensure(tag).set(word, text)

    def _plan_limits(self, key: PropertyKey) -> None:
        """Plan to set a joint's limits in the URDF to the limits of the MJCF [rad or m].

        ``key`` is the difference (kind, joint). A continuous joint becomes revolute.
        """
        urdf_joint, joint = self._find_joint(key[1]), self.target.joints[key[1]]
        element = urdf_joint.element
        if not (math.isfinite(joint.lower) and math.isfinite(joint.upper)):
            self.unwritten[key] = diagnose("urdf-limits-unwritten")
            return
        if element.get("type") == "continuous":
            element.set("type", "revolute")
        for kind in _LIMIT_KINDS:
            self._write_number(urdf_joint, kind, getattr(joint, BY_KIND[kind].field), 1.0)
        self._complete_limit(key, urdf_joint)

    def _plan_number(self, key: PropertyKey) -> None:
        """Plan to copy a number of a joint from the MJCF to the URDF, in SI units.

        ``key`` is the difference (kind, joint).
        """
        kind, name = key
        if name not in self.target.joints:
            self.unwritten[key] = diagnose("base-without-joint")
            return
        joint: TreeJoint = self.target.joints[name]
        self._write_number(self._find_joint(name), kind, float(getattr(joint, kind)))
        if kind == "effort":
            self._complete_limit(key, self._find_joint(name))

    def _complete_limit(self, key: PropertyKey, joint: UrdfJoint) -> None:
        """Add missing attributes that a <limit> requires, with the values of `UNKNOWN_LIMITS`.

        `notes` of the difference ``key`` then names the added attributes.
        """
        limit = joint.element.find("limit")
        missing = {
            word: value
            for word, value in UNKNOWN_LIMITS.items()
            if limit is not None and limit.get(word) is None
        }
        for word, value in missing.items():
            limit.set(word, value)
        if missing:
            written = " ".join(f'{word}="{value}"' for word, value in missing.items())
            self.notes[key] = diagnose("limit-completed", written=written)

    def _list_members(self, mover: str) -> list[str]:
        """Return the compared links that move with ``mover``, a joint or the base."""
        top = self.sides.matched.urdf_link[mover]
        members, waiting = [], [top]
        while waiting:
            link_name = waiting.pop(0)
            members += [link_name] if link_name in self._compared_links else []
            children = (joint.child for joint in self.tree.child_joints.get(link_name, ()))
            waiting += [link for link in children if link not in self._mover_of_link]
        return members

    def _plan_inertial(self, mover: str, keys: list[PropertyKey]) -> None:
        """Plan the change of the inertial of one link so that a rigid body has the target inertia.

        The rigid body consists of the links that move together with ``mover``, a joint or the base.
        """
        keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
        frame = self.sides.urdf_frames[mover].inverse()
        targets = [frame.act(body.spatial_inertia) for body in self.list_body_targets(mover)]
        members = self._list_members(mover)
        stated_inertias = {link: self._links[link].inertia for link in members}
        inertias = {
            link: self._compute_link_pose(link).act(inertia)
            for link, inertia in stated_inertias.items()
            if inertia is not None
        }
        inertias = {link: inertia for link, inertia in inertias.items() if inertia.mass > 0}
        if is_same_body(sum(inertias.values(), pin.Inertia.Zero()), targets[0]):
            return
        part_changes = [
            way
            for target in targets
            for way in list_single_part_changes(inertias, target, members[0])
        ]
        if not part_changes:
            self.unwritten.update(dict.fromkeys(keys, diagnose("no-link-to-change")))
            return

        def changed(link: str, part: pin.Inertia) -> Changes:
            """Return the changes that give a link an inertia in the frame of the moving link."""
            in_link_frame = self._compute_link_pose(link).actInv(part)
            return make_inertial_changes(self._links[link].element, in_link_frame)

        candidates = [(link, changed(link, part)) for link, part in part_changes]
        best, changes = min(candidates, key=lambda way: len(way[1]))
        for (path, attribute), text in changes.items():
            self._links[best].element.ensure("inertial").ensure(path).set(attribute, text)


def make_xyz_text(owner: XmlElement | None, place: Array) -> str | None:
    """Format a position, shape (3,) [m], as the attribute ``xyz`` of an <origin>.

    None if ``owner`` already has this position; without an <origin>, its position is zero.
    """
    origin = None if owner is None else owner.find("origin")
    old_text = None if origin is None else origin.get("xyz")
    return format_numbers((old_text or "0 0 0").split(), place, 1.0)


def make_inertial_changes(link: XmlElement, target: pin.Inertia) -> Changes:
    """Compute the attributes of a link's <inertial> that must change to state a target inertia.

    The stated axes of the inertia tensor are kept.
    """
    inertial = link.find("inertial")
    mass_element, inertia_element = (inertial and inertial.find(tag) for tag in ("mass", "inertia"))
    changes: Changes = {}
    old_mass = mass_element and mass_element.get("value")
    text = format_numbers((old_mass or "").split(), target.mass)
    if text is not None:
        changes["mass", "value"] = text
    rotation = np.array(origin_of(inertial).rotation)
    old_entries = [
        None if inertia_element is None else inertia_element.get(name) for name in INERTIA_ENTRIES
    ]
    in_inertial_axes = rotation.T @ np.array(target.inertia) @ rotation
    changes |= dict(_list_tensor_changes(old_entries, inertia_entries(in_inertial_axes)))
    text = make_xyz_text(inertial, np.array(target.lever))
    return changes if text is None else changes | {("origin", "xyz"): text}


def _list_tensor_changes(
    old_entries: list[str | None], values: Array
) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield the new text of each changed entry of an inertia tensor: ((``inertia``, entry), text).

    Stated texts (or None) and new ``values``, shape (6,) [kg m^2], have the order of
    `INERTIA_ENTRIES`.
    """
    scale = float(np.abs(values).max())
    for name, old, value in zip(INERTIA_ENTRIES, old_entries, values, strict=True):
        text = format_numbers((old or "").split(), value, scale)
        if text is not None:
            yield ("inertia", name), text
