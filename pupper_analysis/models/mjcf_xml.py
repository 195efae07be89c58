"""The XML of an MJCF that is made of a URDF: its bodies."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Final

from lxml import etree

from pupper_analysis.models.attributes import COUPLING_TIME, Number
from pupper_analysis.models.xml import add_element, write_numbers

VISUAL: Final = "visual"
"""The class of geoms that are only seen."""

COLLISION: Final = "collision"
"""The class of geoms that touch."""


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

    def body(self, name: str) -> etree._Element:
        """Returns a body by its name."""
        return next(body for body in self.root.iter("body") if body.get("name") == name)

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


def text_of(number: Number) -> str:
    """Returns how a number is written, or what was written of it."""
    return number if isinstance(number, str) else write_numbers(number)
