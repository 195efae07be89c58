"""Reads the model of a URDF, built from its XML."""

from __future__ import annotations

import math
from decimal import Decimal, InvalidOperation
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from lxml import etree

from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.places import one_line
from pupper_analysis.models.shapes import Mesh, Pose, Shape
from pupper_analysis.models.stated.model import (
    FIXED,
    FREE,
    HINGE,
    SLIDE,
    Inertial,
    Joint,
    Link,
    UrdfModel,
)
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfLink, origin_of
from pupper_analysis.models.xml import parse_numbers

_KINDS = {"revolute": HINGE, "continuous": HINGE, "prismatic": SLIDE, "fixed": FIXED}


def read_urdf_model(file: UrdfFile) -> UrdfModel:
    """Returns the model of a URDF; the reader has made sure that it is one tree."""
    tree = file.tree
    root = tree.base
    bodies = {root.name: _body(file, root, None, Pose(), ())}
    for parent in (waiting := [root.name]):
        for joint in tree.below.get(parent, []):
            name = joint.child
            pose = bodies[parent].pose * _placed(joint.element)
            bodies[name] = _body(file, tree.links[name], parent, pose, (_joint(joint, pose),))
            waiting.append(name)
    return UrdfModel("urdf", "link", root.name, bodies, file.notes, file)


def _placed(element: etree._Element) -> Pose:
    """Returns the pose that an element's ``<origin>`` states."""
    return Pose.of(origin_of(element))


def _number(element: etree._Element | None, attribute: str, default: float) -> float:
    text = None if element is None else element.get(attribute)
    return default if text is None else float(text)


def _joint(joint: UrdfJoint, pose: Pose) -> Joint:
    element = joint.element
    axis = element.find("axis")
    raw = parse_numbers(None if axis is None else axis.get("xyz"), "1 0 0")
    length = float(np.linalg.norm(raw))
    limit = element.find("limit")
    limited = joint.kind in ("revolute", "prismatic") and limit is not None
    return Joint(
        name=joint.name,
        kind=_KINDS.get(joint.kind, FREE),
        parent=joint.parent,
        child=joint.child,
        position=pose.position,
        axis=pose.rotation @ raw / length if length > 0 else np.zeros(3),
        raw_axis=raw,
        stated=_stated(joint),
        lower=_number(limit, "lower", 0.0) if limited else -math.inf,
        upper=_number(limit, "upper", 0.0) if limited else math.inf,
        effort=_number(limit, "effort", math.inf),
    )


def _stated(joint: UrdfJoint) -> dict[str, float]:
    texts = {one.kind: joint.stated(one) for one in JOINT_ATTRIBUTES}
    return {kind: float(text) for kind, text in texts.items() if text is not None}


def _body(
    file: UrdfFile,
    link: UrdfLink,
    parent: str | None,
    pose: Pose,
    joints: tuple[Joint, ...],
) -> Link:
    shapes = [
        _shape(file, shape, geometry, tag == "collision") for tag, shape, geometry in link.shapes
    ]
    return Link(link.name, parent, pose, joints, _inertial(link), tuple(shapes))


def _inertial(link: UrdfLink) -> Inertial | None:
    element, stated = link.inertial, link.inertia
    if element is None or stated is None:
        return None
    tag = element.find("inertia")
    words = ["0" if tag is None else tag.get(word, "0") for word in INERTIA_ENTRIES]
    return Inertial.of(stated, stated=True, rounding=max(map(half_digit, words)))


def half_digit(text: str) -> float:
    """Returns half a unit of the last digit of a number as it is written; 0 for a zero."""
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        return 0.0
    exponent = value.as_tuple().exponent
    return 0.0 if value == 0 or not isinstance(exponent, int) else 0.5 * 10.0**exponent


def _shape(
    file: UrdfFile, element: etree._Element, tag: etree._Element | None, collides: bool
) -> Shape:
    pose, name = _placed(element), element.get("name", "")
    if tag is None:
        return Shape(name, "none", pose, (), collides)
    kind = str(tag.tag)
    match kind:
        case "box":
            size = tuple(parse_numbers(tag.get("size"), "0 0 0") / 2)
        case "sphere":
            size = (_number(tag, "radius", 0.0),)
        case "cylinder" | "capsule":
            size = (_number(tag, "radius", 0.0), _number(tag, "length", 0.0) / 2)
        case _:
            size = ()
    read = partial(_read_mesh, file, tag) if kind == "mesh" else lambda: None
    return Shape(name, kind, pose, size, collides, read)


def _read_mesh(file: UrdfFile, tag: etree._Element) -> Mesh | None:
    path = file.resolve_mesh(tag.get("filename", ""))
    found = None if path is None else mesh_hull(path)
    scale = parse_numbers(tag.get("scale"), "1 1 1")
    return None if found is None else Mesh(found.vertices * scale, found.faces)


# The convex hulls of meshes' files.


def mesh_hull(path: Path) -> Mesh | None:
    """Returns an STL or OBJ file's convex hull; None if it cannot be read.

    Other kinds (COLLADA) carry units and poses of their own and are not read.
    """
    if path.suffix.lower() not in (".stl", ".obj"):
        return None
    found = read_mesh_file(path, path.stat().st_mtime_ns)
    return None if isinstance(found, Diagnostic) else found


LARGEST_MESH = 200_000_000
"""Bytes: the greatest meshes that are published have a quarter of it."""


@lru_cache(maxsize=256)
def read_mesh_file(path: Path, _changed: int) -> Mesh | Diagnostic:
    """Returns a mesh's convex hull (m), or what is wrong with the file."""
    import trimesh  # slow to import; yourdfpy depends on it

    try:
        mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        points = np.asarray(mesh.vertices, dtype=float)
        faces = np.asarray(mesh.faces)
    except Exception as error:  # whatever a broken mesh makes a parser raise
        return diagnose("no-mesh", problem=one_line(error) or type(error).__name__)
    if not len(points) or not len(faces):
        return diagnose("mesh-without-triangle")
    if not np.isfinite(points).all():
        return diagnose("mesh-vertex-not-finite")
    if faces.min() < 0 or faces.max() >= len(points):
        return diagnose("mesh-vertex-unknown", vertex=int(faces.max()) + 1, vertices=len(points))
    return Mesh(points, faces).hull()
