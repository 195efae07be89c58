"""Mistakes that are written into a URDF, in one leg, or in all legs so that symmetry does not
reveal them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from lxml import etree

from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree

Element = etree._Element


def list_legs(tree: UrdfTree) -> list[list[UrdfJoint]]:
    """Return the moving joints of each of the four legs of three joints, from the base outwards.

    Raises:
        AssertionError: If there are not four such legs.
    """
    found = []
    for first in tree.moving:
        chain = [first]
        while True:
            link = chain[-1].child
            carried = tree.fixed_group(link)
            following = [joint for joint in tree.moving if joint.parent in carried]
            if len(following) != 1:
                break
            chain += following
        above = [joint for joint in tree.moving if first.parent in tree.fixed_group(joint.child)]
        if len(chain) == 3 and not above:
            found.append(chain)
    assert len(found) == 4
    return found


Change = Callable[[UrdfTree, UrdfJoint], None]
Slip = Callable[[UrdfTree, list[UrdfJoint]], None]
"""Function that writes a mistake into one leg: the tree, and the joints of the leg."""


def _change_part(part: int, change: Change) -> Slip:
    """Return a mistake that changes one joint of a leg."""
    return lambda tree, leg: change(tree, leg[part])


def _change_all(change: Change) -> Slip:
    """Return a mistake that changes all joints of a leg."""

    def slip(tree: UrdfTree, leg: list[UrdfJoint]) -> None:
        for joint in leg:
            change(tree, joint)

    return slip


def _read_numbers(element: Element, name: str, default: str = "0 0 0") -> list[float]:
    """Return the numbers of an attribute."""
    return [float(text) for text in element.get(name, default).split()]


def _write_numbers(element: Element, name: str, values: list[float]) -> None:
    """Write numbers to an attribute."""
    element.set(name, " ".join(repr(value) for value in values))


def _make_scaling(tag: str, factor: float) -> Change:
    """Return a change that scales the mass or inertia of a joint's child link."""

    def change(tree: UrdfTree, joint: UrdfJoint) -> None:
        element = tree.links[joint.child].element.find(f"inertial/{tag}")
        for name, text in list(element.attrib.items()):
            element.set(name, repr(float(text) * factor))

    return change


def _make_com_scaling(factors: tuple[float, float, float]) -> Change:
    """Return a change that scales the CoM position of a joint's child link, per axis."""

    def change(tree: UrdfTree, joint: UrdfJoint) -> None:
        origin = tree.links[joint.child].element.find("inertial/origin")
        xyz = _read_numbers(origin, "xyz")
        _write_numbers(origin, "xyz", [a * b for a, b in zip(xyz, factors, strict=True)])

    return change


def _write_limits_in_degrees(_: UrdfTree, joint: UrdfJoint) -> None:
    """Write the limits of a joint in degrees."""
    limit = joint.element.find("limit")
    for name in ("lower", "upper"):
        limit.set(name, repr(round(math.degrees(float(limit.get(name, "0"))), 1)))


def _flip_limits(_: UrdfTree, joint: UrdfJoint) -> None:
    """Replace the range [lower, upper] of a joint by [-upper, -lower]."""
    limit = joint.element.find("limit")
    lower, upper = (float(limit.get(name, "0")) for name in ("lower", "upper"))
    limit.set("lower", repr(-upper))
    limit.set("upper", repr(-lower))


def _make_effort_scaling(factor: float) -> Change:
    """Return a change that scales the effort of a joint."""

    def change(_: UrdfTree, joint: UrdfJoint) -> None:
        limit = joint.element.find("limit")
        limit.set("effort", repr(float(limit.get("effort")) * factor))

    return change


def _shift_shapes(tree: UrdfTree, joint: UrdfJoint) -> None:
    """Translate the collision shapes of a joint's child link by 0.1 m along the joint axis."""
    axis = _read_numbers(joint.element.find("axis"), "xyz")
    for shape in tree.links[joint.child].element.findall("collision"):
        origin = shape.find("origin")
        if origin is None:
            origin = etree.SubElement(shape, "origin", xyz="0 0 0")
        xyz = _read_numbers(origin, "xyz")
        _write_numbers(origin, "xyz", [a + 0.1 * b for a, b in zip(xyz, axis, strict=True)])


def _swap_axis(_: UrdfTree, joint: UrdfJoint) -> None:
    """Exchange x and y of the axis of a joint."""
    axis = joint.element.find("axis")
    x, y, z = _read_numbers(axis, "xyz")
    _write_numbers(axis, "xyz", [y, x, z])


def _reverse_axis(_: UrdfTree, joint: UrdfJoint) -> None:
    """Change the sign of the axis of a joint."""
    axis = joint.element.find("axis")
    _write_numbers(axis, "xyz", [0.0 - value for value in _read_numbers(axis, "xyz")])


THIGH, KNEE = 1, 2
"""Index of thigh and knee joint in a leg."""

SLIPS: dict[str, Slip] = {
    "mass x 1000": _change_part(THIGH, _make_scaling("mass", 1000.0)),
    "inertia x 100": _change_part(THIGH, _make_scaling("inertia", 100.0)),
    "inertia x 0.001": _change_part(THIGH, _make_scaling("inertia", 0.001)),
    "limits in degrees": _change_all(_write_limits_in_degrees),
    "collision shape 10 cm aside": _change_part(THIGH, _shift_shapes),
    "com in mm": _change_part(THIGH, _make_com_scaling((1000.0, 1000.0, 1000.0))),
    "com y flipped": _change_part(THIGH, _make_com_scaling((1.0, -1.0, 1.0))),
    "axis of another direction": _change_part(THIGH, _swap_axis),
    "sign of an axis": _change_part(KNEE, _reverse_axis),
    "sign of limits": _change_part(KNEE, _flip_limits),
    "effort x 10": _change_all(_make_effort_scaling(10.0)),
    "effort 0": _change_all(_make_effort_scaling(0.0)),
}
"""{name: mistake}."""


def write_slip(source: Path, slip: str, path: Path, number: int = 4) -> Path:
    """Write a URDF with a mistake in some of its four legs; return the path.

    Args:
        source: The URDF.
        slip: Key of `SLIPS`.
        path: Output file.
        number: Number of legs with the mistake.
    """
    tree = UrdfTree.of(source.read_text(encoding="utf-8"))
    for leg in list_legs(tree)[:number]:
        SLIPS[slip](tree, leg)
    path.write_bytes(etree.tostring(tree.root))
    return path
