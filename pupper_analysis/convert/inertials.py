"""Inertials that MuJoCo refuses, given to the body that they are fixed to."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.arrays import inertia_entries, inertia_tensor
from pupper_analysis.convert.xml_text import words
from pupper_analysis.errors import ModelError
from pupper_analysis.models.urdf_file import UrdfFile

_TRIANGLE = 1e-12
"""Slack of A + B >= C between principal moments, relative: rounding of the eigenvalues."""


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
    total = inertia
    if own is not None:
        total = inertia_of(own) + inertia
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


def mend_inertials(urdf: UrdfFile, worldbody: etree._Element) -> list[str]:
    """Moves inertials that no body can have, and MuJoCo refuses, to a body they are fixed to.

    What moves with the two is the same then.

    Returns:
        What was moved, in words.

    Raises:
        ModelError: If there is no such body, or it would be refused with it.
    """
    moved = []
    for body in worldbody.iter("body"):
        inertial = body.find("inertial")
        if inertial is None or _is_possible(inertia_of(inertial)):
            continue
        name, inertia = str(body.get("name")), inertia_of(inertial)
        for other, placement in _fixed_to(body):
            there = other.find("inertial")
            total = placement.act(inertia)
            if there is not None and _is_possible(inertia_of(there) + total):
                add_to(other, total)
                body.remove(inertial)
                moved.append(
                    f"MuJoCo refuses the inertia of link {name!r} ({_why(inertia)}): it is part of "
                    f"{other.get('name')!r}, to which the link is fixed"
                )
                break
        else:
            place = urdf.place("link", name, "inertial/inertia")
            raise ModelError(
                f"{place.file}:{place.line}" if place.line else str(place.file),
                f"MuJoCo refuses the inertia of link {name!r}: {_why(inertia)}, which no body has; "
                "mend it (pupper-analysis audit says more)",
            )
    return moved


def _fixed_to(body: etree._Element) -> Iterator[tuple[etree._Element, pin.SE3]]:
    """Yields the bodies that a body is fixed to, with the body's placement in their frames."""
    parent = body.getparent()
    if parent.tag == "body" and not body.findall("joint"):
        yield parent, placement_of(body)
    for child in body.findall("body"):
        if not child.findall("joint"):
            yield child, placement_of(child).inverse()


def _is_possible(inertia: pin.Inertia) -> bool:
    if inertia.mass <= 0:
        return not np.array(inertia.inertia).any()
    low, middle, high = np.linalg.eigvalsh(np.array(inertia.inertia))
    return bool(low > 0 and low + middle >= high * (1 - _TRIANGLE))


def _why(inertia: pin.Inertia) -> str:
    moments = np.linalg.eigvalsh(np.array(inertia.inertia))
    principal = ", ".join(f"{moment:.3g}" for moment in moments)
    return f"mass {inertia.mass:g} kg, principal moments {principal} kg m^2"
