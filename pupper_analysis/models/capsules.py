"""URDFs as they are used, for readers that know less: capsules, and joints without limits.

ROS 2 knows capsules, the URDF reader of Pinocchio and PlaCo does not. Joints that state no limits
are locked at zero by the format, or refused.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree, origin_of
from pupper_analysis.models.xml import to_text

ENDLESS_SLIDE = 1e3
"""Limit of a slide that has none (m): a URDF's must have two, which are 0 where left out. No robot
slides so far, and a number with 12 digits is a nanometre still."""

_DEMANDED = ("effort", "velocity")
"""What the format demands of a <limit>, and some exporters leave out."""


def complete_limits(root: etree._Element) -> Diagnostic | None:
    """Gives each <limit> the effort and the velocity that it lacks, in place: 0, which is none.

    Pinocchio's reader refuses a joint without them, though nobody's effort is known.

    Returns:
        Which joints they were; None if there was none.
    """
    names = []
    for name, joint in UrdfTree(root).joints.items():
        for limit in joint.element.findall("limit"):
            missing = [word for word in _DEMANDED if limit.get(word) is None]
            names += [name] if missing else []
            limit.attrib.update(dict.fromkeys(missing, "0"))
    return diagnose("effort-or-velocity-unstated", names=names) if names else None


def states_no_limits(joint: UrdfJoint) -> bool:
    """Tells whether a revolute joint's <limit> says nothing of its range.

    ``lower`` and ``upper`` count as 0 where they are left out, as many exporters do where nothing
    is known, and some write all of 0 there, the effort too. A range of 0 to 0 with an effort stays
    what it says.
    """
    limit = joint.element.find("limit")
    if joint.kind != "revolute" or limit is None:
        return False
    words = [limit.get(name) for name in ("lower", "upper", "effort")]
    if words[:2] == [None, None]:
        return True
    try:
        return not any(float(word or 0.0) for word in words)
    except ValueError:
        return False  # no number: whoever reads it says so


def unlimited_joints(root: etree._Element) -> list[UrdfJoint]:
    """Returns the joints of a URDF that state no limits; see ``states_no_limits``."""
    return [joint for joint in UrdfTree(root).joints.values() if states_no_limits(joint)]


def taken_as_unlimited(root: etree._Element) -> Diagnostic | None:
    """Tells which joints state no limits."""
    names = [joint.name for joint in unlimited_joints(root)]
    return diagnose("range-unstated", names=names) if names else None


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
