"""Bodies without joints, merged into the body that carries them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.convert.inertials import add_to, inertia_of, placement_of
from pupper_analysis.convert.xml_text import element, words


def merge_fixed(worldbody: etree._Element) -> list[str]:
    """Merges bodies without joints into their parents; a site of its name stays of each.

    Masses, coms and inertias add up, shapes and bodies go along.

    Returns:
        The names of those that were merged.
    """
    merged = []
    # From the ends of the tree, so that a parent takes what its child has taken.
    for body in reversed(list(worldbody.iter("body"))):
        parent = body.getparent()
        joints = body.findall("joint") + body.findall("freejoint")
        if joints or parent.tag == "worldbody":
            continue
        placement = placement_of(body)
        inertial = body.find("inertial")
        if inertial is not None:
            add_to(parent, placement.act(inertia_of(inertial)))
        site = element(parent, "site", name=str(body.get("name")))
        _place(site, placement)
        at = parent.index(body)
        for child in list(body):
            if child.tag in ("geom", "body", "site"):
                _place(child, placement * placement_of(child))
                parent.insert(at, child)
                at += 1
        parent.remove(body)
        merged.append(str(body.get("name")))
    return merged[::-1]


def carry_shapes(worldbody: etree._Element) -> list[str]:
    """Moves collision shapes of bodies without joint and mass to the body that carries them.

    MuJoCo's ground is the softer under a shape the more lightly the shape's body can be pushed, at
    that body's own frame: a toe's sphere in a massless body of its own, at the end of a foot with
    light ankles, sinks in 25 times as far as in the foot's body. MuJoCo's own importer merges both.

    Returns:
        The names of the bodies whose shapes were moved.
    """
    moved = []
    # From the ends of the tree, so that a parent passes on what its child has passed on.
    for body in reversed(list(worldbody.iter("body"))):
        parent = body.getparent()
        weighs = any(body.find(tag) is not None for tag in ("joint", "freejoint", "inertial"))
        geoms = [geom for geom in body.findall("geom") if geom.get("class") == "collision"]
        if weighs or not geoms or parent.tag == "worldbody":
            continue
        placement = placement_of(body)
        for geom in geoms:
            _place(geom, placement * placement_of(geom))
            parent.insert(parent.index(body), geom)
        moved.append(str(body.get("name")))
    return moved[::-1]


def _place(node: etree._Element, placement: pin.SE3) -> None:
    """Writes a placement."""
    for name in ("pos", "euler", "quat"):
        node.attrib.pop(name, None)
    position = np.array(placement.translation)
    if position.any():
        node.set("pos", words(position))
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    if not np.allclose([x, y, z], 0.0, atol=1e-15):
        node.set("quat", words([w, x, y, z]))
