"""A URDF's links and joints: what is fixed to what, what moves, and edits of that structure.

This is the one place that walks over the elements of a URDF; all others ask it.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import (
    INERTIA_ENTRIES,
    inertia_entries,
    inertia_of,
    inertia_tensor,
)
from pupper_analysis.models.attributes import BY_KIND, JointAttribute
from pupper_analysis.models.xml import (
    NUM_ANGLE_DIGITS,
    add_element,
    is_zero,
    parse_numbers,
    parse_text,
    write_numbers,
)

Array = NDArray[np.float64]


def origin_of(element: etree._Element | None) -> pin.SE3:
    """Returns the pose that an element's ``<origin>`` states: none is the parent's own."""
    origin = None if element is None else element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    xyz, rpy = (parse_numbers(origin.get(key) or None, "0 0 0") for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def set_origin(element: etree._Element, placed: pin.SE3, digits: int | None = None) -> None:
    """States an element's pose, in the place of what it states; what is zero is left out.

    With all digits, or so many significant ones of lengths.
    """
    for old in element.findall("origin"):
        element.remove(old)
    angles = pin.rpy.matrixToRpy(np.array(placed.rotation))
    xyz = write_numbers(placed.translation, scale=1.0, digits=digits)  # m
    rpy = write_numbers(angles, scale=1.0, digits=digits and NUM_ANGLE_DIGITS)  # rad
    if not (is_zero(xyz) and is_zero(rpy)):
        add_element(element, "origin", xyz=xyz, rpy=None if is_zero(rpy) else rpy)


_NO_LIMIT = {"effort": "0", "velocity": "0"}
"""What a <limit> must state, and means none: the readers of both engines take no ``inf``."""


@dataclass(frozen=True, eq=False)
class UrdfElement:
    """A link or a joint.

    Attributes:
        element: Its XML.
    """

    element: etree._Element

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.element.get("name"))

    def remove(self, *tags: str) -> None:
        """Takes its children of some tags out of it."""
        for tag in tags:
            for child in self.element.findall(tag):
                self.element.remove(child)


class UrdfLink(UrdfElement):
    """A link."""

    @property
    def inertial(self) -> etree._Element | None:
        """Its ``<inertial>``; None if it states none."""
        return self.element.find("inertial")

    @property
    def inertia(self) -> pin.Inertia | None:
        """What it states that it weighs, in its own frame; None if it states nothing."""
        stated = self.inertial
        if stated is None:
            return None
        mass, entries = stated.find("mass"), stated.find("inertia")
        texts = [entries.get(word) if entries is not None else None for word in INERTIA_ENTRIES]
        tensor = inertia_tensor(float(text or 0.0) for text in texts)
        weight = 0.0 if mass is None else float(mass.get("value") or 0.0)
        return origin_of(stated).act(inertia_of(weight, np.zeros(3), tensor))

    def set_inertia(self, inertia: pin.Inertia, digits: int | None = None) -> None:
        """States an inertia, in its own frame, in the place of what it states."""
        self.remove("inertial")
        stated = etree.SubElement(self.element, "inertial")
        add_element(stated, "origin", xyz=write_numbers(inertia.lever, digits=digits))
        add_element(stated, "mass", value=write_numbers(inertia.mass, digits=digits))
        tensor = inertia_entries(np.array(inertia.inertia))
        entries = write_numbers(tensor, digits=digits).split()
        etree.SubElement(stated, "inertia", dict(zip(INERTIA_ENTRIES, entries, strict=True)))

    @property
    def shapes(self) -> Iterator[tuple[str, etree._Element, etree._Element | None]]:
        """Its visuals, then its collision shapes: tag, element, and the element of its form."""
        for tag in ("visual", "collision"):
            for shape in self.element.iterfind(tag):
                around = shape.find("geometry")
                yield tag, shape, None if around is None else next(iter(around), None)

    @property
    def touches(self) -> bool:
        """Whether it has a collision shape."""
        return self.element.find("collision/geometry/*") is not None

    @property
    def mass(self) -> float | None:
        """What it weighs (kg); None if it states no mass."""
        element = self.element.find("inertial/mass")
        return None if element is None else float(element.get("value"))


class UrdfJoint(UrdfElement):
    """A joint."""

    @property
    def kind(self) -> str:
        """Its type: ``revolute``, ``continuous``, ``prismatic``, ``fixed``, ``floating``, ..."""
        return str(self.element.get("type"))

    @property
    def is_fixed(self) -> bool:
        """Whether its link is fixed to the parent."""
        return self.kind == "fixed"

    @property
    def moves(self) -> bool:
        """Whether it is a hinge or a slide."""
        return self.kind in ("revolute", "continuous", "prismatic")

    @property
    def parent(self) -> str:
        """The name of the link that carries it."""
        return self._end("parent")

    @property
    def child(self) -> str:
        """The name of the link that it moves."""
        return self._end("child")

    def _end(self, tag: str) -> str:
        end = self.element.find(tag)
        return "" if end is None else str(end.get("link"))

    @property
    def mimic(self) -> etree._Element | None:
        """Its ``<mimic>``; None if it follows no other joint."""
        return self.element.find("mimic")

    @property
    def origin(self) -> pin.SE3:
        """Where its frame is in the parent's."""
        return origin_of(self.element)

    def stated(self, attribute: JointAttribute) -> str | None:
        """Returns one of its numbers as it is written; None where the file states none."""
        if attribute.urdf is None:
            return None
        element = self.element.find(attribute.urdf[0])
        return None if element is None else element.get(attribute.urdf[1])

    def state(self, attribute: JointAttribute, value: float) -> None:
        """States one of its numbers, which a URDF has words for."""
        assert attribute.urdf is not None, f"a URDF has no words for {attribute.kind}"
        tag, word = attribute.urdf
        element = self.element.find(tag)
        if element is None:
            element = etree.SubElement(self.element, tag, _NO_LIMIT if tag == "limit" else {})
        element.set(word, repr(float(value)))

    def follow(
        self, leader: str, multiplier: float, offset: float, digits: int | None = None
    ) -> None:
        """Makes it mimic another joint: q = multiplier q of the leader + offset."""
        one, two = (write_numbers(value, digits=digits) for value in (multiplier, offset))
        add_element(self.element, "mimic", joint=leader, multiplier=one, offset=two)

    def set_axis(self, axis: Array, digits: int | None = None) -> None:
        """States the axis of a joint that states none."""
        add_element(self.element, "axis", xyz=write_numbers(axis, digits=digits))

    def fix(self) -> None:
        """Makes it a fixed joint."""
        self.element.set("type", "fixed")

    def set_range(self, lower: float, upper: float) -> None:
        """Limits a joint (rad, m); one that turned without end no longer does."""
        if self.kind == "continuous":
            self.element.set("type", "revolute")
        self.state(BY_KIND["lower limit"], lower)
        self.state(BY_KIND["upper limit"], upper)


def _scale(element: etree._Element | None, attribute: str, factor: float) -> None:
    text = None if element is None else element.get(attribute)
    if element is not None and text is not None:
        element.set(attribute, repr(float(text) * float(factor)))


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """The links and joints of a URDF.

    Whoever adds or removes elements by other means than its methods makes a new one.

    Attributes:
        root: The ``<robot>``.
    """

    root: etree._Element

    @staticmethod
    def of(text: str) -> UrdfTree:
        """Parses a URDF's text, which has been read before."""
        return UrdfTree(parse_text(text))

    def copy(self) -> UrdfTree:
        """Returns a tree with XML of its own."""
        return UrdfTree(copy.deepcopy(self.root))

    @cached_property
    def links(self) -> dict[str, UrdfLink]:
        """{name: link}, in the file's order."""
        links = map(UrdfLink, self.root.findall("link"))
        return {link.name: link for link in links}

    @cached_property
    def joints(self) -> dict[str, UrdfJoint]:
        """{name: joint}, in the file's order."""
        joints = map(UrdfJoint, self.root.findall("joint"))
        return {joint.name: joint for joint in joints}

    @cached_property
    def above(self) -> dict[str, UrdfJoint]:
        """{link: the joint that moves or holds it}; the base has none."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def below(self) -> dict[str, list[UrdfJoint]]:
        """{link: the joints that it carries}, of those that carry any."""
        found: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints.values():
            found.setdefault(joint.parent, []).append(joint)
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """The links, in the file's order."""
        return tuple(self.links)

    def parent(self, link: str) -> str | None:
        """Returns the link that carries one; None for the base."""
        return self.above[link].parent if link in self.above else None

    def movers(self, link: str) -> tuple[str, ...]:
        """Returns the joint that moves a link; none of one that is fixed, and of the base."""
        joint = self.above.get(link)
        return () if joint is None or joint.is_fixed else (joint.name,)

    def moved_by(self, joint: str) -> str | None:
        """Returns the link that a joint moves; None if there is no such joint."""
        return self.joints[joint].child if joint in self.joints else None

    def weight(self, link: str) -> float:
        """Returns the mass that a link states (kg); 0 where it states none."""
        return self.links[link].mass or 0.0

    @property
    def base(self) -> UrdfLink:
        """The link that no joint moves."""
        return next(link for name, link in self.links.items() if name not in self.above)

    @property
    def moving(self) -> list[UrdfJoint]:
        """The hinges and slides."""
        return [joint for joint in self.joints.values() if joint.moves]

    @property
    def moved_links(self) -> dict[str, str]:
        """{joint: the link that it moves}."""
        return {name: joint.child for name, joint in self.joints.items()}

    def fixed_group(self, link: str) -> list[str]:
        """Returns a link, and all that is fixed to it and carried by it, nearest first."""
        group = [link]
        for name in group:
            group += [joint.child for joint in self.below.get(name, ()) if joint.is_fixed]
        return group

    def subtree(self, link: str) -> Iterator[str]:
        """Yields a link and all that it carries, branch by branch."""
        waiting = [link]
        while waiting:
            name = waiting.pop()
            yield name
            waiting += [joint.child for joint in reversed(self.below.get(name, ()))]

    def chain(self, link: str) -> Iterator[UrdfJoint]:
        """Yields the joints between a link and the base, from the link on."""
        while link in self.above:
            yield self.above[link]
            link = self.above[link].parent

    def fix(self, names: Collection[str]) -> None:
        """Makes joints fixed."""
        for name in names:
            if name in self.joints:
                self.joints[name].fix()

    def remove_shapes(self) -> None:
        """Takes all visuals and collision shapes out."""
        for link in self.links.values():
            link.remove("visual", "collision")

    def remove_subtree(self, link: str) -> None:
        """Takes a link out, with all that it carries and the joint that holds it."""
        for name in list(self.subtree(link)):
            if name in self.above:
                self.root.remove(self.above[name].element)
            self.root.remove(self.links[name].element)
        self._forget()

    def remove_base(self) -> None:
        """Takes out the base, and the joints that it carries."""
        base = self.base
        for joint in self.below.get(base.name, ()):
            self.root.remove(joint.element)
        self.root.remove(base.element)
        self._forget()

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Adds a link that is fixed to another, with its axes.

        Args:
            name: The link's.
            parent: What it is fixed to.
            joint: The name of the joint between them, where the format has one.
            place: (3,) of its frame in the parent's (m).
            inertia: What it weighs, in its own frame; None: nothing is stated.
        """
        link = self.new_link(name)
        if inertia is not None:
            link.set_inertia(inertia)
        self.new_joint(joint, "fixed", parent, name, pin.SE3(np.eye(3), place))

    def new_link(self, name: str) -> UrdfLink:
        """Adds a link that nothing holds yet."""
        self._forget()
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
        """Adds a joint of a kind of URDF's between two links, of where the child is at zero."""
        self._forget()
        element = add_element(self.root, "joint", name=name, type=kind)
        add_element(element, "parent", link=parent)
        add_element(element, "child", link=child)
        set_origin(element, placed, digits)
        return UrdfJoint(element)

    def scale_mass(self, link: str, factor: float) -> None:
        """Multiplies the mass of one link, and its inertia with it."""
        inertial = self.links[link].inertial
        _scale(None if inertial is None else inertial.find("mass"), "value", factor)
        self.scale_inertia(link, factor)

    def scale_inertia(self, link: str, factor: float) -> None:
        """Multiplies the inertia of one link about its com."""
        inertial = self.links[link].inertial
        for entry in INERTIA_ENTRIES:
            _scale(None if inertial is None else inertial.find("inertia"), entry, factor)

    def move_com(self, link: str, offset: Array) -> None:
        """Moves the com of one link by an offset (3,) in its own axes (m)."""
        inertial = self.links[link].inertial
        if inertial is None:
            return
        origin = inertial.find("origin")
        if origin is None:
            origin = etree.SubElement(inertial, "origin")
        place = parse_numbers(origin.get("xyz") or None, "0 0 0") + offset
        origin.set("xyz", write_numbers(place, digits=None))

    def scale(self, joint: str, attribute: JointAttribute, factor: float) -> None:
        """Multiplies a number of a joint; what is not stated, or has no words, stays so."""
        text = self.joints[joint].stated(attribute)
        if text is not None:
            self.joints[joint].state(attribute, float(text) * float(factor))

    def _forget(self) -> None:
        for name in ("links", "joints", "above", "below"):
            self.__dict__.pop(name, None)
