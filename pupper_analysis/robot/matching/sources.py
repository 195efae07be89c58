"""Where the numbers of a tree of joints stand in its file: the same question of either format."""

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

_OF_BODIES: Final = ("mass", "com", "inertia")

_URDF_CHILD: Final = {
    "mass": "inertial/mass",
    "com": "inertial/origin",
    "inertia": "inertial/inertia",
    "zero": "origin",
    "position": "origin",
    "rotation": "origin",
    "axis": "axis",
    "mimic": "mimic",
    # Where it would stand, of what a URDF has no words for.
    **{one.kind: one.urdf[0] if one.urdf else "dynamics" for one in TREE_ATTRIBUTES},
}
"""Below a URDF's link or joint."""

_SECTION: Final = {
    "tendon": "tendon",
    "actuator": "actuator",
    "motor": "actuator",
    "equality": "equality",
}
"""Sections of an MJCF whose elements a URDF has none of."""

_GLOBAL_OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "fluid": ("density", "viscosity"),
    "gravity": ("gravity",),
    "flag": (),
}
"""Kinds that concern the whole of a URDF, and the options of the MJCF that state them."""


@dataclass(frozen=True, eq=False)
class UrdfSources:
    """Where the numbers stand in a URDF.

    Attributes:
        file: The file.
        tree: Its links and joints as they were compared.
        links: {base or joint: the link that it moves}.
        joints: {joint: its name in the file}; others are called so there, too.
        frames: {frame: its link}; likewise.
        base: What the base is called.
    """

    file: UrdfFile
    tree: UrdfTree
    links: Mapping[str, str]
    joints: Mapping[str, str]
    frames: Mapping[str, str]
    base: tuple[str, ...]

    def place(self, kind: str, element: str) -> Place:
        """Returns where a number stands; the file alone where it has none.

        Args:
            kind: Of the number, as of a `Difference`.
            element: The joint, the body (by the joint that moves it, or the base), the frame or
                another element, as it is called in the comparison.
        """
        child, file = _URDF_CHILD.get(kind), self.file
        if kind in _SECTION or kind in _GLOBAL_OPTIONS or kind == "gravity compensation":
            return Place(file.path)
        if kind in _OF_BODIES and element in self.links:
            return self.weight(kind, _heaviest(self.members(element)))
        if element in self.base:
            return file.place("link", self.links[self.base[0]], child)
        if kind == "frame":
            link = self.frames.get(element, element)
            joint = file.tree.above.get(link)
            if joint is None:
                return file.place("link", link)
            return file.place("joint", joint.name, "origin")
        return file.place("joint", self.joints.get(element, element), child)

    def members(self, mover: str) -> list[tuple[str, float]]:
        """Returns (link, kg) of what moves with a joint, or is the base, and has mass.

        What the joint moves comes first, though it may have none.
        """
        top = self.links[mover]
        masses = [(name, self.tree.links[name].mass or 0.0) for name in self.tree.fixed_group(top)]
        return [masses[0], *((name, mass) for name, mass in masses[1:] if mass)]

    def weight(self, kind: str, name: str) -> Place:
        """Returns where a link's mass, com or inertia stands."""
        return self.file.place("link", name, _URDF_CHILD[kind])


@dataclass(frozen=True, eq=False)
class MjcfSources:
    """Where the numbers stand in an MJCF.

    Attributes:
        file: The file.
        model: What MuJoCo makes of it.
        bodies: {base or joint: the body that it moves}.
        frames: {frame: its site, body or geom}; others are called so there, too.
        base: What the base is called.
    """

    file: MjcfFile
    model: mujoco.MjModel
    bodies: Mapping[str, str]
    frames: Mapping[str, str]
    base: tuple[str, ...]

    def place(self, kind: str, element: str) -> Place:
        """Returns where a number stands: see `UrdfSources`."""
        file, body = self.file, self.bodies.get(element, "")
        if kind in _SECTION:
            named = not element.startswith("#")
            return file.place(_SECTION[kind], element) if named else Place(file.path)
        if kind in _GLOBAL_OPTIONS:
            words = set(_GLOBAL_OPTIONS[kind]) or {element}
            tag = "flag" if kind == "flag" else "option"
            stated = (at for found, at in file.elements(tag) if words & set(found))
            return next(stated, Place(file.path))
        if kind == "gravity compensation":
            return file.place("body", element)
        if kind in _OF_BODIES and body:
            return self.weight(kind, _heaviest(self.members(element)))
        if kind == "base frame":
            return file.place("body", body or element)
        if element in self.base:
            return file.place("body", self.bodies[self.base[0]], "joint")
        if kind in ("zero", "position", "rotation", "parent") and body:
            return file.place("body", body)
        tries = [("joint", element, None), ("body", body, "joint")]
        if kind in ("effort", "servo stiffness", "servo damping"):
            tries.insert(0, ("actuator", element, None))
        if kind == "frame":
            name = self.frames.get(element, element)
            tries = [("site", name, None), ("body", name, None), ("geom", name, None)]
        return _first(file, kind, tries)

    def members(self, mover: str) -> list[tuple[str, float]]:
        """Returns the bodies that move with a joint: see `UrdfSources`."""
        model = self.model
        top = model.body(self.bodies[mover]).id
        welded = np.flatnonzero(model.body_weldid == model.body_weldid[top]).tolist()
        group = [each for each in welded if model.body_mass[each] > 0 or each == top]
        group.sort(key=lambda each: each != top)
        return [(str(model.body(each).name), float(model.body_mass[each])) for each in group]

    def weight(self, kind: str, name: str) -> Place:
        """Returns where a body's mass, com or inertia stands: all three in its <inertial>."""
        del kind
        return self.file.place("body", name, "inertial")


Sources = UrdfSources | MjcfSources
"""Where the numbers of a tree of joints stand in its file."""


def _heaviest(members: Sequence[tuple[str, float]]) -> str:
    return max(members, key=lambda member: member[1])[0]


def _first(file: MjcfFile, kind: str, tries: Sequence[tuple[str, str, str | None]]) -> Place:
    """Returns where a kind of number is stated, or else the first of its elements that is there.

    Args:
        file: The MJCF.
        kind: Of the number.
        tries: Tag, name and child of the elements that may state it.
    """
    attribute = BY_KIND.get(kind)
    words = attribute.mjcf if attribute is not None else (kind,) if kind == "axis" else ()
    for tag, name, below in tries:
        place = None if below else file.stated(tag, name, words)
        if place is not None:
            return place
    places = [file.place(*one) for one in tries]
    return next((place for place in places if place.line is not None), places[0])
