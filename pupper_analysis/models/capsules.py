"""Capsules of a URDF, which ROS 2 knows and the URDF reader of Pinocchio and PlaCo does not."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
from lxml import etree

from pupper_analysis.models.unlimited import unlimited_joints
from pupper_analysis.models.urdf_tree import origin_of
from pupper_analysis.models.xml import to_text


def for_engines(root: etree._Element) -> str:
    """Writes a URDF as Pinocchio and PlaCo can read it; hinges without limits are continuous."""
    known = without_capsules(root)
    if unlimited_joints(root):
        known = deepcopy(root) if known is None else known
        for joint in unlimited_joints(known):
            joint.element.set("type", "continuous")
    return to_text(root if known is None else known)


def without_capsules(root: etree._Element) -> etree._Element | None:
    """Returns a copy with a cylinder and two spheres for each capsule: the same set of points.

    None if there is no capsule. The reader leaves each out with a complaint, and the robot would be
    thinner than it is.
    """
    if next(root.iter("capsule"), None) is None:
        return None
    root = deepcopy(root)
    for shape in [capsule.getparent() for capsule in root.iter("capsule")]:
        owner = None if shape is None else shape.getparent()
        if owner is not None and owner.tag in ("visual", "collision"):
            _take_apart(owner)
    return root


def _take_apart(owner: etree._Element) -> None:
    """Makes three <visual> or <collision> of one."""
    capsule = owner.find("geometry/capsule")
    try:
        radius, length = (float(capsule.get(name)) for name in ("radius", "length"))
        placed = origin_of(owner)
    except (TypeError, ValueError):
        return  # no number: whoever reads it says so
    link, at = owner.getparent(), owner.getparent().index(owner)
    for number, side in enumerate((1.0, -1.0), start=1):
        end = deepcopy(owner)
        if end.get("name"):
            end.set("name", f"{end.get('name')}_{number}")
        geometry = end.find("geometry")
        geometry.remove(geometry.find("capsule"))
        etree.SubElement(geometry, "sphere", radius=repr(radius))
        place = placed * np.array([0.0, 0.0, side * length / 2])
        origin = end.find("origin")
        if origin is None:
            origin = etree.SubElement(end, "origin")
        origin.set("xyz", " ".join(repr(float(value)) for value in place))
        link.insert(at + number, end)
    capsule.tag = "cylinder"
