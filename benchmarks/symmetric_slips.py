"""Slips written into a URDF: in all its legs alike, so that no mirror shows them, or in one."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from lxml import etree

from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree

Element = etree._Element


def legs(tree: UrdfTree) -> list[list[UrdfJoint]]:
    """The moving joints of each chain of three, from the base outwards."""
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
"""Of one leg."""


def _each(part: int, change: Change) -> Slip:
    return lambda tree, leg: change(tree, leg[part])


def _all(change: Change) -> Slip:
    def slip(tree: UrdfTree, leg: list[UrdfJoint]) -> None:
        for joint in leg:
            change(tree, joint)

    return slip


def _numbers(element: Element, name: str, default: str = "0 0 0") -> list[float]:
    return [float(text) for text in element.get(name, default).split()]


def _write(element: Element, name: str, values: list[float]) -> None:
    element.set(name, " ".join(repr(value) for value in values))


def _scaled(tag: str, factor: float) -> Change:
    def change(tree: UrdfTree, joint: UrdfJoint) -> None:
        element = tree.links[joint.child].element.find(f"inertial/{tag}")
        for name, text in list(element.attrib.items()):
            element.set(name, repr(float(text) * factor))

    return change


def _com(factors: tuple[float, float, float]) -> Change:
    def change(tree: UrdfTree, joint: UrdfJoint) -> None:
        origin = tree.links[joint.child].element.find("inertial/origin")
        xyz = _numbers(origin, "xyz")
        _write(origin, "xyz", [a * b for a, b in zip(xyz, factors, strict=True)])

    return change


def _degrees(_: UrdfTree, joint: UrdfJoint) -> None:
    limit = joint.element.find("limit")
    for name in ("lower", "upper"):
        limit.set(name, repr(round(math.degrees(float(limit.get(name, "0"))), 1)))


def _flipped(_: UrdfTree, joint: UrdfJoint) -> None:
    limit = joint.element.find("limit")
    lower, upper = (float(limit.get(name, "0")) for name in ("lower", "upper"))
    limit.set("lower", repr(-upper))
    limit.set("upper", repr(-lower))


def _effort(factor: float) -> Change:
    def change(_: UrdfTree, joint: UrdfJoint) -> None:
        limit = joint.element.find("limit")
        limit.set("effort", repr(float(limit.get("effort")) * factor))

    return change


def _aside(tree: UrdfTree, joint: UrdfJoint) -> None:
    axis = _numbers(joint.element.find("axis"), "xyz")
    for shape in tree.links[joint.child].element.findall("collision"):
        origin = shape.find("origin")
        if origin is None:
            origin = etree.SubElement(shape, "origin", xyz="0 0 0")
        xyz = _numbers(origin, "xyz")
        _write(origin, "xyz", [a + 0.1 * b for a, b in zip(xyz, axis, strict=True)])


def _turned(_: UrdfTree, joint: UrdfJoint) -> None:
    axis = joint.element.find("axis")
    x, y, z = _numbers(axis, "xyz")
    _write(axis, "xyz", [y, x, z])


def _reversed(_: UrdfTree, joint: UrdfJoint) -> None:
    axis = joint.element.find("axis")
    _write(axis, "xyz", [0.0 - value for value in _numbers(axis, "xyz")])


THIGH, KNEE = 1, 2

SLIPS: dict[str, Slip] = {
    "mass x 1000": _each(THIGH, _scaled("mass", 1000.0)),
    "inertia x 100": _each(THIGH, _scaled("inertia", 100.0)),
    "inertia x 0.001": _each(THIGH, _scaled("inertia", 0.001)),
    "limits in degrees": _all(_degrees),
    "collision shape 10 cm aside": _each(THIGH, _aside),
    "com in mm": _each(THIGH, _com((1000.0, 1000.0, 1000.0))),
    "com y flipped": _each(THIGH, _com((1.0, -1.0, 1.0))),
    "axis of another direction": _each(THIGH, _turned),
    "sign of an axis": _each(KNEE, _reversed),
    "sign of limits": _each(KNEE, _flipped),
    "effort x 10": _all(_effort(10.0)),
    "effort 0": _all(_effort(0.0)),
}


def written(source: Path, slip: str, path: Path, number: int = 4) -> Path:
    """Writes a URDF with a slip in so many of its four legs."""
    tree = UrdfTree.of(source.read_text(encoding="utf-8"))
    for leg in legs(tree)[:number]:
        SLIPS[slip](tree, leg)
    path.write_bytes(etree.tostring(tree.root))
    return path
