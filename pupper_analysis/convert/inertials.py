"""Placements and inertials of a new MJCF's bodies, as they are written."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.arrays import inertia_entries, inertia_tensor
from pupper_analysis.convert.xml_text import words


def placement_of(node: etree._Element) -> pin.SE3:
    """Returns where an element of an MJCF is in its parent; angles are a URDF's ``rpy``."""
    position = np.array((node.get("pos") or "0 0 0").split(), dtype=float)
    if node.get("quat"):
        w, x, y, z = (float(word) for word in str(node.get("quat")).split())
        return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), position)
    angles = np.array((node.get("euler") or "0 0 0").split(), dtype=float)
    return pin.SE3(pin.rpy.rpyToMatrix(angles), position)


def inertia_of(inertial: etree._Element) -> pin.Inertia:
    """Returns what an <inertial> states, in its body's frame."""
    lever = np.array((inertial.get("pos") or "0 0 0").split(), dtype=float)
    texts = (inertial.get("fullinertia") or f"{inertial.get('diaginertia')} 0 0 0").split()
    tensor = inertia_tensor(map(float, texts))
    result = pin.Inertia.Zero()
    result.mass, result.lever, result.inertia = float(str(inertial.get("mass"))), lever, tensor
    return result


def add_to(body: etree._Element, inertia: pin.Inertia) -> None:
    """Adds an inertia, in a body's frame, to what the body's <inertial> states."""
    own = body.find("inertial")
    put_inertia(body, inertia if own is None else inertia_of(own) + inertia)


def put_inertia(body: etree._Element, total: pin.Inertia) -> None:
    """Writes an inertia, in a body's frame, in the place of the body's <inertial>."""
    own = body.find("inertial")
    if own is not None:
        body.remove(own)
    joints = [child for child in body if child.tag in ("joint", "freejoint")]
    node = etree.Element(
        "inertial",
        {
            "pos": words(total.lever),
            "mass": words(total.mass),
            "fullinertia": words(inertia_entries(np.array(total.inertia))),
        },
    )
    body.insert(len(joints), node)
