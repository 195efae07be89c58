"""``UrdfTree``: links and joints of a URDF, with queries and edits of the kinematic tree."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import (
    INERTIA_ENTRIES,
    inertia_entries,
    inertia_tensor,
    make_inertia,
)
from pupper_analysis.models.attributes import BY_KIND, MIN_UNSTATED_LIMIT, JointAttribute
from pupper_analysis.models.xml import (
    NUM_ANGLE_DIGITS,
    add_element,
    is_zero,
    join_numbers,
    parse_numbers,
    parse_text,
)

WORLD_LINK: Final = "world"
"""Name of a root link of a URDF that is the world itself. MuJoCo's own importer treats the name in
the same way."""


def origin_of(element: etree._Element | None) -> pin.SE3:
    """Return the pose in the ``<origin>`` of an element; the identity without ``<origin>``."""
    origin = None if element is None else element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    xyz, rpy = (parse_numbers(origin.get(key) or None, "0 0 0") for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def set_origin(element: etree._Element, placement: pin.SE3, digits: int | None = None) -> None:
    """Replace the ``<origin>`` of an element, in place.

    A zero rotation is omitted. For an identity pose, no ``<origin>`` is written.

    Args:
        element: Element to modify.
        placement: New pose.
        digits: Number of significant digits of lengths; None for all.
    """
    for old in element.findall("origin"):
        element.remove(old)
    angles = pin.rpy.matrixToRpy(np.array(placement.rotation))
    xyz = join_numbers(placement.translation, scale=1.0, digits=digits)  # m
    rpy = join_numbers(angles, scale=1.0, digits=digits and NUM_ANGLE_DIGITS)  # rad
    if not (is_zero(xyz) and is_zero(rpy)):
        add_element(element, "origin", xyz=xyz, rpy=None if is_zero(rpy) else rpy)


UNSTATED_LIMITS = dict.fromkeys(("effort", "velocity"), f"{MIN_UNSTATED_LIMIT:g}")
"""{required attribute of ``<limit>`` in a URDF: text of `MIN_UNSTATED_LIMIT`, for an unknown
limit}."""


@dataclass(frozen=True, eq=False)
class UrdfElement:
    """Link or joint of a URDF.

    Attributes:
        element: XML element.
    """

    element: etree._Element

    @property
    def name(self) -> str:
        """Name of this link or joint, the attribute ``name``."""
        return str(self.element.get("name"))

    def remove(self, *tags: str) -> None:
        """Remove the child elements with given tags from this link or joint, in place."""
        for tag in tags:
            for child in self.element.findall(tag):
                self.element.remove(child)


class UrdfLink(UrdfElement):
    """Link of a URDF, with access to its inertia and shapes."""

    @property
    def inertial(self) -> etree._Element | None:
        """``<inertial>`` element of this URDF link; None if missing."""
        return self.element.find("inertial")

    @property
    def inertia(self) -> pin.Inertia | None:
        """Spatial inertia that the URDF states, in the link frame; None without ``<inertial>``."""
        inertial = self.inertial
        if inertial is None:
            return None
        mass, entries = inertial.find("mass"), inertial.find("inertia")
        texts = [entries.get(word) if entries is not None else None for word in INERTIA_ENTRIES]
        tensor = inertia_tensor(float(text or 0.0) for text in texts)
        mass_value = 0.0 if mass is None else float(mass.get("value") or 0.0)
        return origin_of(inertial).act(make_inertia(mass_value, np.zeros(3), tensor))

    @property
    def inertial_rotation(self) -> NDArray[np.float64]:
        """Rotation (3, 3) from the axes of ``<inertial><origin>`` to the axes of the link."""
        inertial = self.inertial
        return np.eye(3) if inertial is None else np.array(origin_of(inertial).rotation)

    def set_inertia(self, inertia: pin.Inertia, digits: int | None = None) -> None:
        """Replace the ``<inertial>`` element of this URDF link by a new one.

        Args:
            inertia: Spatial inertia in the link frame.
            digits: Number of significant digits; None for all.
        """
        self.remove("inertial")
        inertial = etree.SubElement(self.element, "inertial")
        add_element(inertial, "origin", xyz=join_numbers(inertia.lever, digits=digits))
        add_element(inertial, "mass", value=join_numbers(inertia.mass, digits=digits))
        tensor = inertia_entries(np.array(inertia.inertia))
        entries = join_numbers(tensor, digits=digits).split()
        etree.SubElement(inertial, "inertia", dict(zip(INERTIA_ENTRIES, entries, strict=True)))

    @property
    def shapes(self) -> Iterator[tuple[str, etree._Element, etree._Element | None]]:
        """Shapes of this link, visual before collision: (tag, element, child of ``<geometry>``).

        The child is None if it is missing.
        """
        for tag in ("visual", "collision"):
            for shape in self.element.iterfind(tag):
                geometry = shape.find("geometry")
                yield tag, shape, None if geometry is None else next(iter(geometry), None)

    @property
    def has_collision_shape(self) -> bool:
        """Whether the link has a collision shape."""
        return self.element.find("collision/geometry/*") is not None

    @property
    def mass(self) -> float | None:
        """Mass [kg] that the URDF states for this link; None if missing."""
        element = self.element.find("inertial/mass")
        return None if element is None else float(element.get("value"))


class UrdfJoint(UrdfElement):
    """Joint of a URDF, with access to its type, links and parameters."""

    @property
    def kind(self) -> str:
        """Type of the joint, such as ``revolute``, ``continuous``, ``prismatic`` or ``fixed``."""
        return str(self.element.get("type"))

    @property
    def is_fixed(self) -> bool:
        """Whether the joint is fixed."""
        return self.kind == "fixed"

    @property
    def moves(self) -> bool:
        """Whether the joint is a hinge or a slide."""
        return self.kind in ("revolute", "continuous", "prismatic")

    @property
    def parent(self) -> str:
        """Name of the link to which this joint attaches its child link."""
        return self._link_name("parent")

    @property
    def child(self) -> str:
        """Name of the child link of this joint."""
        return self._link_name("child")

    def _link_name(self, tag: str) -> str:
        """Return the link that the child element ``tag`` (parent or child) names; "" without it."""
        element = self.element.find(tag)
        return "" if element is None else str(element.get("link"))

    @property
    def mimic(self) -> etree._Element | None:
        """The ``<mimic>`` element of this joint; None if missing."""
        return self.element.find("mimic")

    @property
    def origin(self) -> pin.SE3:
        """Pose of the joint frame in the parent link, from ``<origin>``."""
        return origin_of(self.element)

    def parameter_text(self, attribute: JointAttribute) -> str | None:
        """Return the text of a joint parameter in the XML tree; None if missing."""
        if attribute.urdf is None:
            return None
        element = self.element.find(attribute.urdf[0])
        return None if element is None else element.get(attribute.urdf[1])

    def set_parameter(self, attribute: JointAttribute, value: float) -> None:
        """Write a joint parameter into the XML element of the joint.

        Args:
            attribute: Parameter that a URDF can specify, for example damping.
            value: Value in SI units.
        """
        assert attribute.urdf is not None, f"a URDF has no words for {attribute.kind}"
        tag, word = attribute.urdf
        element = self.element.find(tag)
        if element is None:
            element = etree.SubElement(self.element, tag, UNSTATED_LIMITS if tag == "limit" else {})
        element.set(word, repr(float(value)))

    def add_mimic(
        self, leader: str, multiplier: float, offset: float, digits: int | None = None
    ) -> None:
        """Add a ``<mimic>`` element to this joint: q = multiplier q_leader + offset.

        Args:
            leader: Joint whose position this joint follows.
            multiplier: Factor.
            offset: Offset [rad, m].
            digits: Number of significant digits; None for all.
        """
        multiplier_text, offset_text = (
            join_numbers(value, digits=digits) for value in (multiplier, offset)
        )
        add_element(
            self.element, "mimic", joint=leader, multiplier=multiplier_text, offset=offset_text
        )

    def add_axis(self, axis: Array, digits: int | None = None) -> None:
        """Add an ``<axis>`` to a joint without ``<axis>``; existing elements are not removed.

        Args:
            axis: Axis, shape (3,), in the joint frame.
            digits: Number of significant digits; None for the shortest exact form.
        """
        add_element(self.element, "axis", xyz=join_numbers(axis, digits=digits))

    def fix(self) -> None:
        """Change the type of this joint to ``fixed``."""
        self.element.set("type", "fixed")

    def set_range(self, lower: float, upper: float) -> None:
        """Set the position limits of this joint [rad, m]; a continuous joint becomes revolute."""
        if self.kind == "continuous":
            self.element.set("type", "revolute")
        self.set_parameter(BY_KIND["lower limit"], lower)
        self.set_parameter(BY_KIND["upper limit"], upper)


def _scale_attribute(element: etree._Element | None, attribute: str, factor: float) -> None:
    """Multiply the number in an XML attribute by a factor; no effect if it is missing."""
    text = None if element is None else element.get(attribute)
    if element is not None and text is not None:
        element.set(attribute, repr(float(text) * float(factor)))


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """Links and joints of a URDF, with queries and edits.

    Links and joints are cached. If elements are added or removed without the methods of this class,
    a new tree must be created.

    Attributes:
        root: ``<robot>`` element.
    """

    root: etree._Element

    @staticmethod
    def of(text: str) -> UrdfTree:
        """Parse the text of a valid URDF to a tree of links and joints."""
        return UrdfTree(parse_text(text))

    def copy(self) -> UrdfTree:
        """Return a copy of this URDF tree that shares no XML elements with this tree."""
        return UrdfTree(copy.deepcopy(self.root))

    @cached_property
    def links(self) -> dict[str, UrdfLink]:
        """Links of the URDF as ``{name: link}``, in the order of the file."""
        links = map(UrdfLink, self.root.findall("link"))
        return {link.name: link for link in links}

    @cached_property
    def joints(self) -> dict[str, UrdfJoint]:
        """Joints of the URDF as ``{name: joint}``, in the order of the file."""
        joints = map(UrdfJoint, self.root.findall("joint"))
        return {joint.name: joint for joint in joints}

    @cached_property
    def parent_joints(self) -> dict[str, UrdfJoint]:
        """``{link: joint whose child is the link}``; the base has no entry."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def child_joints(self) -> dict[str, list[UrdfJoint]]:
        """``{link: joints whose parent is the link}``, for links with such joints."""
        joints_by_parent: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints.values():
            joints_by_parent.setdefault(joint.parent, []).append(joint)
        return joints_by_parent

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the links, in the order of the file."""
        return tuple(self.links)

    def parent(self, link: str) -> str | None:
        """Return the name of the parent link of a link; None for the base."""
        return self.parent_joints[link].parent if link in self.parent_joints else None

    def movers(self, link: str) -> tuple[str, ...]:
        """Return the moving joint between a link and its parent, as a tuple of at most one name.

        A body of an MJCF may have several joints (`SpecTree.movers`).
        """
        joint = self.parent_joints.get(link)
        return () if joint is None or joint.is_fixed else (joint.name,)

    def moved_by(self, joint: str) -> str | None:
        """Return the name of the child link of a joint; None if there is no such joint."""
        return self.joints[joint].child if joint in self.joints else None

    def link_mass(self, link: str) -> float:
        """Return the specified mass of a link [kg]; 0 if missing."""
        return self.links[link].mass or 0.0

    @property
    def base(self) -> UrdfLink:
        """Root link of this URDF: the first link that is not the child of a joint."""
        return next(link for name, link in self.links.items() if name not in self.parent_joints)

    @property
    def moving(self) -> list[UrdfJoint]:
        """Moving joints of the URDF (hinges and slides)."""
        return [joint for joint in self.joints.values() if joint.moves]

    @property
    def moved_links(self) -> dict[str, str]:
        """Child link of each joint of the URDF, as ``{joint: link}``."""
        return {name: joint.child for name, joint in self.joints.items()}

    def fixed_group(self, link: str) -> list[str]:
        """Return the names of a link and of all descendants fixed to the link, breadth first."""
        group = [link]
        for name in group:
            group += [joint.child for joint in self.child_joints.get(name, ()) if joint.is_fixed]
        return group

    def subtree(self, link: str) -> Iterator[str]:
        """Yield the names of a link and of all its descendants, depth first."""
        pending = [link]
        while pending:
            name = pending.pop()
            yield name
            pending += [joint.child for joint in reversed(self.child_joints.get(name, ()))]

    def chain(self, link: str) -> Iterator[UrdfJoint]:
        """Yield the joints between a link and the base, the parent joint of the link first."""
        while link in self.parent_joints:
            yield self.parent_joints[link]
            link = self.parent_joints[link].parent

    def fix(self, names: Collection[str]) -> None:
        """Change joints of this URDF to the type ``fixed``; unknown names are ignored."""
        for name in names:
            if name in self.joints:
                self.joints[name].fix()

    def remove_shapes(self) -> None:
        """Remove the visual and collision shapes of all links of this URDF."""
        for link in self.links.values():
            link.remove("visual", "collision")

    def remove_subtree(self, link: str) -> None:
        """Remove a link, all descendants and their joints."""
        for name in list(self.subtree(link)):
            if name in self.parent_joints:
                self.root.remove(self.parent_joints[name].element)
            self.root.remove(self.links[name].element)
        self._clear_cache()

    def remove_base(self) -> None:
        """Remove the base link, and the joints between the base and its children."""
        base = self.base
        for joint in self.child_joints.get(base.name, ()):
            self.root.remove(joint.element)
        self.root.remove(base.element)
        self._clear_cache()

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Add a link that is fixed to another link, with parallel axes.

        Args:
            name: Name of the new link.
            parent: Parent link.
            joint: Name of the new fixed joint.
            place: Position of the new link in the parent frame, shape (3,) [m].
            inertia: Spatial inertia in the frame of the new link; None for no ``<inertial>``.
        """
        link = self.new_link(name)
        if inertia is not None:
            link.set_inertia(inertia)
        self.new_joint(joint, "fixed", parent, name, pin.SE3(np.eye(3), place))

    def new_link(self, name: str) -> UrdfLink:
        """Add a link without inertia, shapes and joint to this URDF, and return the link."""
        self._clear_cache()
        return UrdfLink(etree.SubElement(self.root, "link", name=name))

    def new_joint(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        placed: pin.SE3,
        digits: int | None = None,
    ) -> UrdfJoint:
        """Add a joint between two links of this URDF, and return the joint.

        Args:
            name: Name of the joint.
            kind: Type of the joint in URDF, such as ``revolute``.
            parent: Parent link.
            child: Child link.
            placed: Pose of the child in the parent at a joint position of zero.
            digits: Number of significant digits of lengths; None for all.
        """
        self._clear_cache()
        element = add_element(self.root, "joint", name=name, type=kind)
        add_element(element, "parent", link=parent)
        add_element(element, "child", link=child)
        set_origin(element, placed, digits)
        return UrdfJoint(element)

    def scale_mass(self, link: str, factor: float) -> None:
        """Multiply mass and rotational inertia of a link by a factor, in place."""
        inertial = self.links[link].inertial
        _scale_attribute(None if inertial is None else inertial.find("mass"), "value", factor)
        self.scale_inertia(link, factor)

    def scale_inertia(self, link: str, factor: float) -> None:
        """Multiply the rotational inertia of a link about its CoM by a factor, in place."""
        inertial = self.links[link].inertial
        for entry in INERTIA_ENTRIES:
            _scale_attribute(None if inertial is None else inertial.find("inertia"), entry, factor)

    def move_com(self, link: str, offset: Array) -> None:
        """Translate the CoM of a link, in place. A link without ``<inertial>`` is unchanged.

        Args:
            link: Name of the link.
            offset: Displacement, shape (3,) [m], in the link frame.
        """
        inertial = self.links[link].inertial
        if inertial is None:
            return
        origin = inertial.find("origin")
        if origin is None:
            origin = etree.SubElement(inertial, "origin")
        place = parse_numbers(origin.get("xyz") or None, "0 0 0") + offset
        origin.set("xyz", join_numbers(place, digits=None))

    def scale(self, joint: str, attribute: JointAttribute, factor: float) -> None:
        """Multiply a joint parameter, such as damping, by a factor, in place, if stated."""
        text = self.joints[joint].parameter_text(attribute)
        if text is not None:
            self.joints[joint].set_parameter(attribute, float(text) * float(factor))

    def _clear_cache(self) -> None:
        """Discard the cached links and joints, after a change of the elements."""
        for name in ("links", "joints", "parent_joints", "child_joints"):
            self.__dict__.pop(name, None)
