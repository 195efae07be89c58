"""Locations (file and line) of compared values in a URDF or MJCF.

Input: kind of a value and name of the element in a comparison. Output: file and line, from
`UrdfSources` or `MjcfSources`. A body in a comparison may consist of several links or bodies that
are fixed to each other. For mass, CoM or inertia, the location is in the heaviest part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from pupper_analysis.models.attributes import BY_KIND, TREE_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree

BODY_KINDS: Final = ("mass", "com", "inertia")
"""Kinds of values in the inertial element of a link or body."""

_URDF_CHILD_PATHS: Final = {
    "mass": "inertial/mass",
    "com": "inertial/origin",
    "inertia": "inertial/inertia",
    "zero": "origin",
    "position": "origin",
    "rotation": "origin",
    "axis": "axis",
    "mimic": "mimic",
    # "dynamics" is the nearest element for parameters that URDF does not support.
    **{row.kind: row.urdf[0] if row.urdf else "dynamics" for row in TREE_ATTRIBUTES},
}
"""{kind of a difference: path of the element with the value, below the link or joint of a URDF}.
If a URDF does not support the value, the path of the nearest element is used."""

_MJCF_SECTIONS: Final = {
    "tendon": "tendon",
    "actuator": "actuator",
    "motor": "actuator",
    "equality": "equality",
}
"""{kind of difference: section of an MJCF}. For these kinds, `UrdfSources` returns no line."""

_GLOBAL_OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "fluid": ("density", "viscosity"),
    "gravity": ("gravity",),
    "flag": (),
}
"""{kind of difference: attributes of ``<option>``}, for kinds that concern the whole robot. For the
kind "flag", the name of the compared element is the attribute of ``<flag>``."""


@dataclass(frozen=True, eq=False)
class UrdfSources:
    """Locations (file and line) of compared values in a URDF.

    Attributes:
        file: The file.
        tree: Links and joints of the compared URDF.
        links: {base or joint: link that moves with it}.
        joints: {joint in the comparison: name in the file}. Other joints have equal names.
        frames: {frame in the comparison: link}. Other frames have the name of their link.
        base: Names of the base in the comparison.
    """

    file: UrdfFile
    tree: UrdfTree
    links: Mapping[str, str]
    joints: Mapping[str, str]
    frames: Mapping[str, str]
    base: tuple[str, ...]

    def place(self, kind: str, element: str) -> Place:
        """Return the file and line in the URDF at which a compared value is stated.

        Args:
            kind: Kind of the value, as in a `Difference`, for example ``mass``.
            element: Name in the comparison: a joint, a frame, or another element. A body has the
                name of the joint that moves the body, or of the base.

        Returns:
            The location of the value; if no value is stated, of the innermost existing element
            (such as the joint). Without line if unknown.
        """
        child, file = _URDF_CHILD_PATHS.get(kind), self.file
        if kind in _MJCF_SECTIONS or kind in _GLOBAL_OPTIONS or kind == "gravity compensation":
            return Place(file.path)
        if kind in BODY_KINDS and element in self.links:
            return self.locate_inertial(kind, _find_heaviest(self.list_masses(element)))
        if element in self.base:
            return file.place("link", self.links[self.base[0]], child)
        if kind == "frame":
            link = self.frames.get(element, element)
            joint = file.tree.parent_joints.get(link)
            if joint is None:
                return file.place("link", link)
            return file.place("joint", joint.name, "origin")
        return file.place("joint", self.joints.get(element, element), child)

    def list_masses(self, mover: str) -> list[tuple[str, float]]:
        """Return (link, mass [kg]) of the links that move together with a joint or with the base.

        The first entry is the link that the joint moves. Links fixed to this link follow, if their
        mass is not zero.

        Args:
            mover: Joint that moves the links, or the base.
        """
        first_link = self.links[mover]
        masses = [
            (name, self.tree.links[name].mass or 0.0) for name in self.tree.fixed_group(first_link)
        ]
        return [masses[0], *((name, mass) for name, mass in masses[1:] if mass)]

    def locate_inertial(self, kind: str, name: str) -> Place:
        """Return the file and line in the URDF at which mass, CoM or inertia of a link is stated.

        If no value is stated, the result is the location of ``<inertial>`` or of the link.

        Args:
            kind: ``"mass"``, ``"com"`` or ``"inertia"``.
            name: Name of the link.
        """
        return self.file.place("link", name, _URDF_CHILD_PATHS[kind])


@dataclass(frozen=True, eq=False)
class MjcfSources:
    """Locations (file and line) of compared values in an MJCF.

    Attributes:
        file: The file.
        model: Compiled model.
        bodies: {base or joint: body that moves with it}.
        frames: {frame in the comparison: site, body or geom}. Other frames have the name of their
            element.
        base: Names of the base in the comparison.
        renumbered: Whether joints were removed for the comparison. The numbers of elements without
            name may then differ from the file.
    """

    file: MjcfFile
    model: mujoco.MjModel
    bodies: Mapping[str, str]
    frames: Mapping[str, str]
    base: tuple[str, ...]
    renumbered: bool = False

    def place(self, kind: str, element: str) -> Place:
        """Return the file and line in the MJCF at which a compared value is stated.

        Args:
            kind: Kind of the value, as in a `Difference`, for example ``mass``.
            element: Name in the comparison: a joint, a frame, or another element. A body has the
                name of the joint that moves the body, or of the base.

        Returns:
            The location of the value, or of its element if no value is stated; without line if
            unknown.
        """
        file, body = self.file, self.bodies.get(element, "")
        if kind in _MJCF_SECTIONS:
            if not element.startswith("#"):
                return file.place(_MJCF_SECTIONS[kind], element)
            if self.renumbered:
                return Place(file.path)
            return file.place_by_number(_MJCF_SECTIONS[kind], int(element[1:].split()[0]))
        if kind in _GLOBAL_OPTIONS:
            words = set(_GLOBAL_OPTIONS[kind]) or {element}
            tag = "flag" if kind == "flag" else "option"
            places = (place for attributes, place in file.elements(tag) if words & set(attributes))
            return next(places, Place(file.path))
        if kind == "gravity compensation":
            return file.place("body", element)
        if kind in BODY_KINDS and body:
            return self.locate_inertial(kind, _find_heaviest(self.list_masses(element)))
        if kind == "base frame":
            return file.place("body", body or element)
        if element in self.base:
            return file.place("body", self.bodies[self.base[0]], "joint")
        if kind in ("zero", "position", "rotation", "parent") and body:
            return file.place("body", body)
        candidates = [("joint", element, None), ("body", body, "joint")]
        if kind in ("effort", "servo stiffness", "servo damping"):
            candidates.insert(0, ("actuator", element, None))
        if kind == "frame":
            name = self.frames.get(element, element)
            candidates = [("site", name, None), ("body", name, None), ("geom", name, None)]
        return _locate_value(file, kind, candidates)

    def list_masses(self, mover: str) -> list[tuple[str, float]]:
        """Return (body, mass [kg]) of the bodies that move together with a joint or with the base.

        The first entry is the body that the joint moves. Bodies fixed to this body follow, if their
        mass is positive.

        Args:
            mover: Joint that moves the bodies, or the base.
        """
        model = self.model
        first_body = model.body(self.bodies[mover]).id
        welded = np.flatnonzero(model.body_weldid == model.body_weldid[first_body]).tolist()
        group = [body for body in welded if model.body_mass[body] > 0 or body == first_body]
        group.sort(key=lambda body: body != first_body)
        return [(str(model.body(body).name), float(model.body_mass[body])) for body in group]

    def locate_inertial(self, kind: str, name: str) -> Place:
        """Return the file and line of a body's ``<inertial>`` in the MJCF; without it, of the body.

        Args:
            kind: Ignored, because ``<inertial>`` states mass, CoM and inertia.
            name: Name of the body.
        """
        del kind
        return self.file.place("body", name, "inertial")


Sources = UrdfSources | MjcfSources
"""Finder of the file and line of a compared value, for a URDF or for an MJCF."""


def _find_heaviest(members: Sequence[tuple[str, float]]) -> str:
    """Return the heaviest link or body: the name with the largest mass of (name, mass [kg])."""
    return max(members, key=lambda member: member[1])[0]


def _locate_value(
    file: MjcfFile, kind: str, candidates: Sequence[tuple[str, str, str | None]]
) -> Place:
    """Return the location of the attribute that sets a kind of value in an MJCF.

    Without such an attribute, the result is an element in ``candidates``: (tag, name, tag of a
    descendant or None) of elements that may set the value.
    """
    attribute = BY_KIND.get(kind)
    words = attribute.mjcf if attribute is not None else (kind,) if kind == "axis" else ()
    for tag, name, child in candidates:
        place = None if child else file.find_attribute(tag, name, words)
        if place is not None:
            return place
    places = [file.place(*candidate) for candidate in candidates]
    return next((place for place in places if place.line is not None), places[0])
