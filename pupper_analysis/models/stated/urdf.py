"""Reading of a robot model as stated by a URDF (`stated.model`), including meshes.

`read_urdf_model` returns the links and joints of a URDF, expressed in the frame of its root link at
zero joint positions. Convex hulls and integrals of meshes are computed on demand, and cached until
the file changes.
"""

from __future__ import annotations

import math
from decimal import Decimal, InvalidOperation
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.inputs import read_change_time, read_input
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES, MIN_UNSTATED_LIMIT, known_limit
from pupper_analysis.models.mesh_limits import MAX_MESH_BYTES
from pupper_analysis.models.mesh_scenes import read_collada_asset, read_merged_mesh
from pupper_analysis.models.places import one_line
from pupper_analysis.models.shapes import Mesh, Pose, Shape
from pupper_analysis.models.stated.model import (
    FIXED_JOINT,
    FREE_JOINT,
    HINGE_JOINT,
    SLIDE_JOINT,
    Inertial,
    Joint,
    Link,
    UrdfModel,
)
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfLink, origin_of
from pupper_analysis.models.xml import parse_numbers

_JOINT_KINDS = {
    "revolute": HINGE_JOINT,
    "continuous": HINGE_JOINT,
    "prismatic": SLIDE_JOINT,
    "fixed": FIXED_JOINT,
}
"""{joint type of a URDF: joint kind of `stated.model`}."""


def read_urdf_model(file: UrdfFile, *, turn: bool = False) -> UrdfModel:
    """Read the links and joints of a URDF with the values that the file specifies.

    The links must form a single tree.

    Args:
        file: The file.
        turn: Whether COLLADA meshes with another up axis are turned until z is up (`find_turn`).
    """
    tree = file.tree
    root = tree.base
    bodies = {root.name: _make_link(file, root, None, Pose(), (), turn)}
    for parent in (pending := [root.name]):
        for joint in tree.child_joints.get(parent, []):
            name = joint.child
            pose = bodies[parent].pose * _read_origin(joint.element)
            bodies[name] = _make_link(
                file, tree.links[name], parent, pose, (_make_joint(joint, pose),), turn
            )
            pending.append(name)
    return UrdfModel("urdf", "link", root.name, bodies, file.notes, file, turn)


def _read_origin(element: etree._Element) -> Pose:
    """Return the pose in the ``<origin>`` of an element."""
    return Pose.of(origin_of(element))


def _read_number(element: etree._Element | None, attribute: str, default: float) -> float:
    """Return the number in an attribute; the default without element or attribute."""
    text = None if element is None else element.get(attribute)
    return default if text is None else float(text)


def _make_joint(joint: UrdfJoint, pose: Pose) -> Joint:
    """Convert a joint of a URDF; ``pose`` is the pose of the child link in the base frame."""
    element = joint.element
    axis = element.find("axis")
    raw = parse_numbers(None if axis is None else axis.get("xyz"), "1 0 0")
    length = float(np.linalg.norm(raw))
    limit = element.find("limit")
    limited = joint.kind in ("revolute", "prismatic") and limit is not None
    return Joint(
        name=joint.name,
        kind=_JOINT_KINDS.get(joint.kind, FREE_JOINT),
        parent=joint.parent,
        child=joint.child,
        position=pose.position,
        axis=pose.rotation @ raw / length if length > 0 else np.zeros(3),
        raw_axis=raw,
        stated=_stated_values(joint),
        lower=_read_number(limit, "lower", 0.0) if limited else -math.inf,
        upper=_read_number(limit, "upper", 0.0) if limited else math.inf,
        effort=known_limit(_read_number(limit, "effort", math.inf)),
    )


def _stated_values(joint: UrdfJoint) -> dict[str, float]:
    """Return {kind, such as ``damping``: value} of the joint parameters that the file specifies.

    Effort and velocity limits of `MIN_UNSTATED_LIMIT` or more are omitted.
    """
    texts = {attribute.kind: joint.parameter_text(attribute) for attribute in JOINT_ATTRIBUTES}
    found = {kind: float(text) for kind, text in texts.items() if text is not None}
    # The reader adds values of MIN_UNSTATED_LIMIT to a <limit> that lacks them.
    return {
        kind: value
        for kind, value in found.items()
        if kind not in ("effort", "velocity") or value < MIN_UNSTATED_LIMIT
    }


def _make_link(
    file: UrdfFile,
    link: UrdfLink,
    parent: str | None,
    pose: Pose,
    joints: tuple[Joint, ...],
    turn: bool,
) -> Link:
    """Convert a link of a URDF, with inertia and shapes; ``pose`` is in the base frame."""
    shapes = [
        _make_shape(file, shape, geometry, tag == "collision", turn)
        for tag, shape, geometry in link.shapes
    ]
    return Link(link.name, parent, pose, joints, _make_inertial(link), tuple(shapes))


def _make_inertial(link: UrdfLink) -> Inertial | None:
    """Return the inertia of a link; None without ``<inertial>``."""
    element, inertia = link.inertial, link.inertia
    if element is None or inertia is None:
        return None
    tag = element.find("inertia")
    texts = ["0" if tag is None else tag.get(word, "0") for word in INERTIA_ENTRIES]
    return Inertial.of(inertia, stated=True, rounding=max(map(half_digit, texts)))


def half_digit(text: str) -> float:
    """Return the rounding error of a written number: half a unit of its last digit, or 0 for zero.

    For example, 0.05 for ``1.5``. The result is 0 for an invalid text, too.
    """
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        return 0.0
    exponent = value.as_tuple().exponent
    return 0.0 if value == 0 or not isinstance(exponent, int) else 0.5 * 10.0**exponent


def _make_shape(
    file: UrdfFile,
    element: etree._Element,
    tag: etree._Element | None,
    collides: bool,
    turn: bool,
) -> Shape:
    """Convert a shape of a URDF from its ``<collision>`` or ``<visual>`` (``element``).

    ``tag`` is the child of ``<geometry>``; None if missing.
    """
    pose, name = _read_origin(element), element.get("name", "")
    if tag is None:
        return Shape(name, "none", pose, (), collides)
    kind = str(tag.tag)
    match kind:
        case "box":
            size = tuple(parse_numbers(tag.get("size"), "0 0 0") / 2)
        case "sphere":
            size = (_read_number(tag, "radius", 0.0),)
        case "cylinder" | "capsule":
            size = (_read_number(tag, "radius", 0.0), _read_number(tag, "length", 0.0) / 2)
        case _:
            size = ()
    if kind != "mesh":
        return Shape(name, kind, pose, size, collides)
    read, read_volume = partial(_read_mesh, file, tag), partial(_read_volume, file, tag)
    read_solid = partial(_read_solid, file, tag)
    if turn and (rotation := find_turn(file, tag)) is not None:
        pose = pose * Pose(rotation=rotation)
    return Shape(name, kind, pose, size, collides, read, read_volume, read_solid)


def _read_mesh(file: UrdfFile, tag: etree._Element) -> Mesh | None:
    """Return the convex hull [m] of a ``<mesh>``, with its scale; None if it cannot be read.

    A mesh without hull, for example a flat mesh, is returned itself.
    """
    path = file.resolve_mesh(tag.get("filename", ""))
    hull = None if path is None else mesh_hull(path)
    scale = parse_numbers(tag.get("scale"), "1 1 1")
    return None if hull is None else Mesh(hull.vertices * scale, hull.faces)


def _read_volume(file: UrdfFile, tag: etree._Element) -> float | None:
    """Return the volume [m^3] of a ``<mesh>``, with its scale; None if `_read_solid` is None."""
    solid = _read_solid(file, tag)
    return None if solid is None else float(solid.mass)


def _read_solid(file: UrdfFile, tag: etree._Element) -> pin.Inertia | None:
    """Return the spatial inertia of a ``<mesh>`` with its scale and a density of 1 kg/m^3.

    None if unknown, for example for an open surface.
    """
    path = file.resolve_mesh(tag.get("filename", ""))
    if path is None or path.suffix.lower() not in MESH_SUFFIXES or not path.is_file():
        return None
    integrals = read_mesh_integrals(path, read_change_time(path))
    if integrals is None:
        return None
    volume, com, second = integrals
    scale = parse_numbers(tag.get("scale"), "1 1 1")
    size = abs(math.prod(scale))
    second = size * second * np.outer(scale, scale)
    return pin.Inertia(size * volume, scale * com, np.trace(second) * np.eye(3) - second)


MESH_SUFFIXES = (".stl", ".obj", ".dae")
"""Suffixes, in lower case, of the mesh files that this module reads. The hulls of other files, such
as glTF, are unknown here.
"""

_TURNS = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""{up axis: rotation, shape (3, 3), from the axes of a mesh to axes of which z is up}, from the
directions right, up and inwards of COLLADA 1.4.1, <up_axis>."""


def find_turn(file: UrdfFile, tag: etree._Element) -> NDArray[np.float64] | None:
    """Return the rotation, shape (3, 3), that turns the up axis of a ``<mesh>`` to z.

    Programs differ: RViz, for example, does not turn a mesh, Blender does.

    Returns:
        The rotation; None if z is up or the axis is unknown, for example in an STL file.

    Raises:
        OutputError: If this run of the command line also writes the file.
    """
    path = file.resolve_mesh(tag.get("filename", ""))
    if path is None or path.suffix.lower() != ".dae" or not path.is_file():
        return None
    return _TURNS.get(_read_up_axis(path, read_change_time(path)))


@lru_cache(maxsize=256)
def _read_up_axis(path: Path, _changed: int) -> str:
    """Return the axis that a COLLADA file states to point up; "" if not readable. Cached."""
    try:
        return read_collada_asset(read_input(path, MAX_MESH_BYTES)).up_axis
    except Exception:  # of a broken file, which an audit rule reports
        return ""


def mesh_hull(path: Path) -> Mesh | None:
    """Return the convex hull [m] of an STL, OBJ or COLLADA file; None if it cannot be read.

    A mesh without hull, for example a flat mesh, is returned itself. The scale of a ``<mesh>`` is
    not applied.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        return None
    result = read_mesh_file(path, read_change_time(path))
    return None if isinstance(result, Diagnostic) else result


MAX_READ_MESH_BYTES = 200_000_000
"""Size [bytes] above which the audit does not check the content of a mesh file. Chosen, not tuned:
several times the size of large published meshes, for example 29 MB (trunk of Go1)."""


@lru_cache(maxsize=256)
def read_mesh_file(path: Path, _changed: int) -> Mesh | Diagnostic:
    """Return the convex hull of a mesh file, or a diagnostic if the file is invalid. Cached.

    A mesh without hull, for example a flat mesh, is returned itself. The unit of length of an STL
    or OBJ file counts as metre in a URDF.

    Args:
        path: The file.
        _changed: Result of ``read_change_time`` [ns]; only a part of the cache key.
    """
    try:
        mesh = _read_binary_stl(path) or _load_mesh(path, merge=False)
        points = np.asarray(mesh.vertices, dtype=float)
        faces = np.asarray(mesh.faces)
    except Exception as error:  # parsers raise various exceptions for broken meshes
        return diagnose("no-mesh", problem=one_line(error) or type(error).__name__)
    if not len(points) or not len(faces):
        return diagnose("mesh-without-triangle")
    if not np.isfinite(points).all():
        return diagnose("mesh-vertex-not-finite")
    if faces.min() < 0 or faces.max() >= len(points):
        return diagnose("mesh-vertex-unknown", vertex=int(faces.max()) + 1, vertices=len(points))
    return Mesh(points, faces).hull()


_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
"""Record of a triangle in a binary STL file (de facto standard of the format)."""

_STL_HEADER_BYTES = 84
"""Number of bytes of a binary STL file before the triangles: a text of 80 bytes, and the number of
triangles."""


def _read_binary_stl(path: Path) -> Mesh | None:
    """Read a binary STL file, with three vertices per triangle; None for other or empty files.

    Reason: trimesh, which reads other files, is slow to import.
    """
    if path.suffix.lower() != ".stl" or path.stat().st_size <= _STL_HEADER_BYTES:
        return None
    content = path.read_bytes()
    count = int.from_bytes(content[_STL_HEADER_BYTES - 4 : _STL_HEADER_BYTES], "little")
    if len(content) != _STL_HEADER_BYTES + count * _STL_TRIANGLE.itemsize:
        return None
    triangles = np.frombuffer(content, _STL_TRIANGLE, offset=_STL_HEADER_BYTES)
    points = triangles["vertices"].reshape(-1, 3).astype(float)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _load_mesh(path: Path, *, merge: bool) -> Any:
    """Read all parts of a mesh file as one mesh of trimesh; ``merge`` merges equal vertices.

    A broken file can raise any exception of the parsers.
    """
    import trimesh  # slow to import; yourdfpy depends on it

    if path.suffix.lower() == ".dae":
        parts = _read_collada(path, read_change_time(path))
        mesh = trimesh.Trimesh(parts.vertices, parts.faces, process=False)
        if merge:
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
        return mesh
    return trimesh.load(path, force="mesh", process=merge, skip_materials=True)


@lru_cache(maxsize=64)
def _read_collada(path: Path, _changed: int) -> Mesh:
    """Read all parts of a COLLADA file as one mesh [m]; its arrays are read-only.

    The results are cached by path and modification time ``_changed`` [ns].
    """
    mesh = read_merged_mesh(read_input(path, MAX_MESH_BYTES), ".dae")
    points, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces)
    for array in (points, faces):
        array.flags.writeable = False
    return Mesh(points, faces)


@lru_cache(maxsize=256)
def read_mesh_integrals(
    path: Path, _changed: int
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]] | None:
    """Return volume, CoM and second moments of the solid that a mesh file encloses. Cached.

    Args:
        path: The file.
        _changed: Modification time [ns]; only a part of the cache key.

    Returns:
        Volume; CoM, shape (3,); integral of x x^T about the CoM, shape (3, 3); in powers of the
        unit of `mesh_hull`. None if the file is unreadable or encloses no solid, for example.
    """
    try:
        mesh = _load_mesh(path, merge=True)
        if not mesh.is_volume:
            return None
        tensor = np.array(mesh.moment_inertia, dtype=float)
        second = np.trace(tensor) / 2 * np.eye(3) - tensor
        return abs(float(mesh.volume)), np.array(mesh.center_mass, dtype=float), second
    except Exception:  # various exceptions for broken meshes, which an audit rule reports
        return None
