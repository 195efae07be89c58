"""The XML of an MJCF that is made of a URDF: its bodies."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base import arrays
from pupper_analysis.base.arrays import (
    inertia_entries,
    inertia_of,
    inertia_tensor,
    quaternion_from_rotation,
)
from pupper_analysis.models.attributes import (
    COUPLING_TIME,
    Number,
)
from pupper_analysis.models.xml import add_element, parse_numbers, write_numbers

_MOVERS: Final = ("joint", "freejoint")

VISUAL: Final = "visual"
"""The class of geoms that are only seen."""

COLLISION: Final = "collision"
"""The class of geoms that touch."""


@dataclass(frozen=True)
class XmlBody:
    """A body.

    Attributes:
        element: Its XML.
    """

    element: etree._Element

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.element.get("name"))

    @property
    def parent(self) -> XmlBody | None:
        """The body that carries it; None for a child of the world."""
        above = self.element.getparent()
        return XmlBody(above) if above is not None and above.tag == "body" else None

    @property
    def children(self) -> list[XmlBody]:
        """The bodies that it carries."""
        return [XmlBody(child) for child in self.element if child.tag == "body"]

    @property
    def joints(self) -> list[etree._Element]:
        """Its joints."""
        return [child for child in self.element if child.tag in _MOVERS]

    @property
    def moves(self) -> bool:
        """Whether it can move against what carries it."""
        return bool(self.joints)

    @property
    def mover(self) -> str | None:
        """The name of its first joint that is no free one; None if there is none."""
        named = (str(joint.get("name")) for joint in self.joints if joint.tag == "joint")
        return next(named, None)

    @property
    def touching(self) -> list[etree._Element]:
        """Its geoms that touch."""
        own = (child for child in self.element if child.tag == "geom")
        return [geom for geom in own if geom.get("class") == COLLISION]

    @property
    def inertia(self) -> pin.Inertia | None:
        """What its ``<inertial>`` states, in its own frame; None if it has none."""
        stated = self.element.find("inertial")
        if stated is None:
            return None
        lever = parse_numbers(stated.get("pos"), "0 0 0")
        texts = (stated.get("fullinertia") or f"{stated.get('diaginertia')} 0 0 0").split()
        return inertia_of(float(str(stated.get("mass"))), lever, inertia_tensor(map(float, texts)))

    def set_inertia(self, inertia: pin.Inertia | None) -> None:
        """States an inertia, in its own frame, in the place of what it states; None: nothing."""
        own = self.element.find("inertial")
        if own is not None:
            self.element.remove(own)
        if inertia is None:
            return
        texts = {
            "pos": write_numbers(inertia.lever),
            "mass": write_numbers(inertia.mass),
            "fullinertia": write_numbers(inertia_entries(np.array(inertia.inertia))),
        }
        self.element.insert(len(self.joints), etree.Element("inertial", texts))

    def add_inertia(self, inertia: pin.Inertia) -> None:
        """Adds an inertia, in its own frame, to what it states."""
        own = self.inertia
        self.set_inertia(inertia if own is None else own + inertia)

    @property
    def placement(self) -> pin.SE3:
        """Where it is in what carries it."""
        return placement_of(self.element)

    def fixed_group(self) -> Iterator[tuple[XmlBody, pin.SE3]]:
        """Yields it and all that are fixed to it, above and below, the nearest first.

        Each with the placement of this body's frame in its own.
        """
        known, waiting = {self}, [(self, pin.SE3.Identity())]
        while waiting:
            here, placement = waiting.pop(0)
            yield here, placement
            near = [(child, child.placement.inverse()) for child in here.children]
            near = [(child, there) for child, there in near if not child.moves]
            if here.parent is not None and not here.moves:
                near.insert(0, (here.parent, here.placement))
            for other, there in near:
                if other not in known:
                    known.add(other)
                    waiting.append((other, there * placement))

    def merge(self) -> None:
        """Makes it part of the body that carries it; a site of its name stays."""
        parent, placement, inertia = self.parent, self.placement, self.inertia
        assert parent is not None
        if inertia is not None:
            parent.add_inertia(placement.act(inertia))
        _place(add_element(parent.element, "site", name=self.name), placement)
        at = parent.element.index(self.element)
        for child in list(self.element):
            if child.tag in ("geom", "body", "site"):
                _place(child, placement * placement_of(child))
                parent.element.insert(at, child)
                at += 1
        parent.element.remove(self.element)

    def give_shapes(self) -> None:
        """Gives the geoms that touch to the body that carries it."""
        parent, placement = self.parent, self.placement
        assert parent is not None
        for geom in self.touching:
            _place(geom, placement * placement_of(geom))
            parent.element.insert(parent.element.index(self.element), geom)


@dataclass(frozen=True, eq=False)
class MjcfXml:
    """An MJCF that is made of a URDF.

    Attributes:
        root: Its ``<mujoco>``.
    """

    root: etree._Element

    @staticmethod
    def of_urdf(name: str) -> MjcfXml:
        """Begins an MJCF whose angles are a URDF's, about fixed axes.

        What has no ``<inertial>`` weighs nothing in it.
        """
        root = etree.Element("mujoco", {"model": name})
        add_element(root, "compiler", angle="radian", eulerseq="XYZ", inertiafromgeom="false")
        default = add_element(root, "default")
        seen = add_element(default, "default", class_=VISUAL)
        add_element(seen, "geom", contype="0", conaffinity="0", group="2")
        add_element(add_element(default, "default", class_=COLLISION), "geom", group="3")
        add_element(root, "asset")
        add_element(root, "worldbody")
        return MjcfXml(root)

    def copy(self) -> MjcfXml:
        """Returns an MJCF with XML of its own."""
        return MjcfXml(copy.deepcopy(self.root))

    @property
    def text(self) -> str:
        """Its XML, as it is so far."""
        return str(etree.tostring(self.root, encoding="unicode"))

    def section(self, tag: str) -> etree._Element:
        """Returns a section of the file, which is added where there is none."""
        found = self.root.find(tag)
        return add_element(self.root, tag) if found is None else found

    @property
    def bodies(self) -> list[XmlBody]:
        """All bodies, parents first."""
        return [XmlBody(body) for body in self.section("worldbody").iter("body")]

    def body(self, name: str) -> XmlBody:
        """Returns a body by its name."""
        return next(body for body in self.bodies if body.name == name)

    @property
    def geoms(self) -> list[etree._Element]:
        """All geoms, those of the world and of classes included."""
        return list(self.root.iter("geom"))

    @property
    def used_meshes(self) -> set[str]:
        """The meshes of its geoms."""
        return {str(geom.get("mesh")) for geom in self.geoms}

    def remove_visuals(self) -> None:
        """Takes out what is only seen."""
        for geom in self.geoms:
            if geom.get("class") == VISUAL:
                geom.getparent().remove(geom)

    def add_coupling(self, follower: str, leader: str, multiplier: Number, offset: Number) -> None:
        """Makes a joint follow another: q = offset + multiplier q of the leader."""
        add_element(
            self.section("equality"),
            "joint",
            joint1=follower,
            joint2=leader,
            polycoef=f"{text_of(offset)} {text_of(multiplier)} 0 0 0",
            solref=write_numbers([COUPLING_TIME, 1.0]),
        )


def placement_of(node: etree._Element) -> pin.SE3:
    """Returns where an element of an MJCF is in its parent; angles are a URDF's ``rpy``."""
    position = parse_numbers(node.get("pos"), "0 0 0")
    if node.get("quat"):
        quaternion = parse_numbers(node.get("quat"), "")
        return arrays.placement_of(quaternion / np.linalg.norm(quaternion), position)
    return pin.SE3(pin.rpy.rpyToMatrix(parse_numbers(node.get("euler"), "0 0 0")), position)


def _place(node: etree._Element, placement: pin.SE3) -> None:
    for name in ("pos", "euler", "quat"):
        node.attrib.pop(name, None)
    position = np.array(placement.translation)
    if position.any():
        node.set("pos", write_numbers(position))
    quaternion = quaternion_from_rotation(placement.rotation)
    if not np.allclose(quaternion[1:], 0.0, atol=1e-15):
        node.set("quat", write_numbers(quaternion))


def text_of(number: Number) -> str:
    """Returns how a number is written, or what was written of it."""
    return number if isinstance(number, str) else write_numbers(number)
