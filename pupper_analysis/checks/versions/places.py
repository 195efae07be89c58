"""Where what has changed stands in one version of a file."""

from __future__ import annotations

from pupper_analysis.checks.places import (
    MJCF_SECTION,
    URDF_CHILD,
    WHOLE,
    bodies_moving_with,
    first_place,
    links_moving_with,
)
from pupper_analysis.checks.versions.version import Version
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree

_BODY = ("mass", "com", "inertia")
_SECTION = {**MJCF_SECTION, "motor": "actuator"}


def place_in(version: Version, kind: str, element: str) -> Place:
    """Returns where a number stands; the file alone where it has none.

    Args:
        version: The file.
        kind: What has changed.
        element: Of which joint, body, frame or motor, by its name in this file.
    """
    if isinstance(version.file, UrdfFile):
        return _in_urdf(version, version.file, kind, element)
    return _in_mjcf(version, version.file, kind, element)


def _in_urdf(version: Version, file: UrdfFile, kind: str, element: str) -> Place:
    root, child = version.root, URDF_CHILD.get(kind)
    assert root is not None
    if kind in _BODY and element in version.carriers:
        members = links_moving_with(UrdfTree(root), version.carriers[element])
        return file.place("link", max(members, key=lambda member: member[1])[0], child)
    if element == version.tree.base:
        return file.place("link", element, child)
    if kind == "frame":
        joint = file.tree.above.get(element)
        if joint is not None:
            return file.place("joint", joint.name, "origin")
    return file.place("joint", element, child)


def _in_mjcf(version: Version, file: MjcfFile, kind: str, element: str) -> Place:
    model, carriers = version.model, version.carriers
    assert model is not None
    if kind in _SECTION:
        if element.startswith("#"):
            return file.numbered(_SECTION[kind], int(element[1:]))
        return file.place(_SECTION[kind], element)
    if kind in WHOLE:
        words = set(WHOLE[kind]) or {element}
        tag = "flag" if kind == "flag" else "option"
        stated = (at for found, at in file.elements(tag) if words & set(found))
        return next(stated, Place(file.path))
    if kind in _BODY and element in carriers:
        members = bodies_moving_with(model, carriers[element])
        return file.weighing(max(members, key=lambda member: member[1])[0])
    if kind in ("base frame", "zero", "position", "rotation", "parent") and element in carriers:
        return file.place("body", carriers[element])
    if kind == "gravity compensation" or element == version.tree.base:
        return file.place("body", element, "joint" if kind in ("damping", "type") else None)
    tries: list[tuple[str, str, str | None]]
    tries = [("joint", element, None), ("body", carriers.get(element, ""), "joint")]
    if kind == "frame":
        tries = [("site", element, None), ("body", element, None)]
    if kind == "effort":
        tries.insert(0, ("actuator", element, None))
    return first_place(file, kind, tries)
