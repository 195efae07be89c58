"""Shapes of a USD's bodies, what they would weigh, and poses of prims."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.models.places import Place, refuse_file
from pupper_analysis.models.shapes import Array, Mesh, Pose, Shape, Solid
from pupper_analysis.tools.usd.file import UsdFile

SCALE_ROUNDING: Final = 1e-6
"""A scale so near to 1 is 1: orientations are written in single precision."""

_TO_Z: Final = {
    "X": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "Y": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations that turn z to the axis of a shape."""


@dataclass(frozen=True)
class StageUnits:
    """What a stage's numbers are in.

    Attributes:
        length: m.
        mass: kg.
        up: The rotation (3, 3) that turns its vertical axis to z.
    """

    length: float
    mass: float
    up: Array

    @property
    def force(self) -> float:
        """N; seconds are seconds."""
        return self.mass * self.length

    @property
    def inertia(self) -> float:
        """Kg m^2; so are torques in N m."""
        return self.mass * self.length**2

    @property
    def density(self) -> float:
        """kg/m^3."""
        return self.mass / self.length**3


def units_of(stage: Any) -> StageUnits:
    """Returns a stage's units; a robot's stage says that they are metres, or it is in cm."""
    from pxr import UsdGeom, UsdPhysics

    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return StageUnits(
        float(UsdGeom.GetStageMetersPerUnit(stage)),
        float(UsdPhysics.GetStageKilogramsPerUnit(stage)),
        turn if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(3),
    )


@dataclass(frozen=True, eq=False)
class Placed:
    """Where a prim is in the world of its stage.

    Attributes:
        pose: In m, in the stage's axes.
        scale: (3,) What its own lengths are multiplied by, in m.
    """

    pose: Pose
    scale: Array

    def frame(self, position: Any, rotation: Any) -> Pose:
        """Returns a frame in the prim's, of a position in its lengths and a quaternion."""
        place = np.zeros(3) if position is None else shortest_decimals(position) * self.scale
        if rotation is None:
            return Pose(place)
        return Pose(place, rotation_of((rotation.GetReal(), *rotation.GetImaginary())))


def value_of(prim: Any, name: str, kind: str) -> Any:
    """Returns what an attribute states; None where nothing does.

    Args:
        prim: Its prim.
        name: Its name.
        kind: ``"number"``, ``"vector"`` of three, ``"point"``, which is a finite one,
            ``"quaternion"``, likewise, ``"text"`` or ``"list"``.

    Raises:
        ModelError: If it is of another type: a file may declare any.
    """
    value = prim.GetAttribute(name).Get()
    fits = (
        value is None
        or {
            "number": isinstance(value, bool | int | float),
            "vector": hasattr(value, "GetNormalized") and np.size(value) == 3,
            "point": hasattr(value, "GetNormalized") and np.size(value) == 3 and _finite(*value),
            "quaternion": hasattr(value, "GetImaginary")
            and _finite(value.GetReal(), *value.GetImaginary()),
            "text": isinstance(value, str),
            "list": type(value).__name__.endswith(("Array", "list")),
        }[kind]
    )
    if not fits:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=type(value).__name__)
        raise refuse_file(Place(file, None, str(prim.GetPath())), message)
    return value


def number_of(prim: Any, name: str, usual: float = math.nan) -> float:
    """Returns a number that an attribute states, as it is written; the usual one where none is."""
    value = value_of(prim, name, "number")
    return usual if value is None else float(shortest_decimals(value))


def _finite(*values: float) -> bool:
    return bool(np.isfinite(values).all())


AXES: Final = {"X": 0, "Y": 1, "Z": 2}


def axis_of(prim: Any, name: str, usual: str) -> str:
    """Returns one of X, Y and Z.

    Raises:
        ModelError: If it is none of them.
    """
    axis = str(value_of(prim, name, "text") or usual)
    if axis not in AXES:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=axis)
        raise refuse_file(Place(file, None, str(prim.GetPath())), message)
    return axis


def shortest_decimals(value: Any) -> Array:
    """Returns numbers as they are written: of one in single precision its shortest decimal.

    A file's 0.18 is read as 0.18000000715. Nothing else has that as its nearest number in single
    precision and as few digits.
    """
    values = np.array(value, dtype=float)
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    exact = np.array([float(str(one)) for one in single.ravel()]).reshape(values.shape)
    return np.where(single == values, exact, values)


def rotation_of(quaternion: Any) -> Array:
    """Returns the rotation (3, 3) of a quaternion (w, x, y, z) in single precision; 0 is none."""
    values = np.array(quaternion, dtype=float)
    length = float(np.linalg.norm(values))
    return np.eye(3) if length == 0 else rotation_from_quaternion(values / length)


def world_matrix(file: UsdFile, prim: Any, cache: Any) -> Any:
    """Returns the transform of a prim to the world of its stage, as USD has it.

    Raises:
        ModelError: If one of its operations has no value.
    """
    from pxr import Tf

    try:
        return cache.GetLocalToWorldTransform(prim)
    except Tf.ErrorException as error:
        message = diagnose("usd-transform-without-value")
        raise refuse_file(Place(file.path, None, str(prim.GetPath())), message) from error


def split_transform(file: UsdFile, prim: Any, matrix: Any, units: StageUnits) -> Placed:
    """Splits the transform of a prim into a pose and a scale.

    Raises:
        ModelError: If it shears or mirrors: no joint's or body's frame can.
    """
    whole = np.array(matrix).T
    scale = np.linalg.norm(whole[:3, :3], axis=0)
    turn = whole[:3, :3] / np.where(scale > 0, scale, 1.0)
    if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
        message = diagnose("usd-frame-sheared", scale=Vector(tuple(scale), "1"))
        raise refuse_file(Place(file.path, None, str(prim.GetPath())), message)
    scale = np.where(np.abs(scale - 1.0) < SCALE_ROUNDING, 1.0, scale)
    left, _, right = np.linalg.svd(turn)
    return Placed(Pose(whole[:3, 3] * units.length, left @ right), scale * units.length)


@dataclass(frozen=True, eq=False)
class UsdShape(Shape):
    """A shape of a USD.

    Attributes:
        prim: Its `pxr.Usd.Prim`.
        scale: (3,) What the prim's own lengths are multiplied by, in m.
        convex: Whether the engine takes a mesh's convex hull.
    """

    prim: Any = None
    scale: Any = None
    convex: bool = False

    @cached_property
    def solid(self) -> Solid | None:
        """What it would weigh; None where that is not known: a mesh that is not closed."""
        return _mesh_solid(self) if self.kind == "mesh" else super().solid


def shapes_of(
    file: UsdFile, body: Any, place: Placed, units: StageUnits, cache: Any
) -> list[UsdShape]:
    """Returns the shapes below a body's prim, but not below another body's."""
    from pxr import UsdGeom, UsdPhysics

    found = []
    for prim in own_prims(file, body):
        if not prim.IsA(UsdGeom.Gprim):
            continue
        collides = prim.HasAPI(UsdPhysics.CollisionAPI) and (
            UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is not False
        )
        if not collides and UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide:
            continue
        world = np.array(world_matrix(file, prim, cache)).T
        world[:3] *= units.length
        inverse = place.pose.inverse()
        local = Pose(inverse.point(world[:3, 3]), inverse.rotation @ world[:3, :3])
        found.append(_shape(prim, local, bool(collides)))
    return found


def own_prims(file: UsdFile, body: Any) -> Iterator[Any]:
    """Yields the prims of a body: itself and what is below it, but for other bodies."""
    from pxr import Usd

    others = set(file.bodies.values()) - {str(body.GetPath())}
    prims = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if str(prim.GetPath()) in others:
            prims.PruneChildren()
        else:
            yield prim


def _shape(prim: Any, local: Pose, collides: bool) -> UsdShape:
    """Returns a shape, of where it is in its body: a rotation times a scale, in m."""
    from pxr import UsdGeom

    kind = str(prim.GetTypeName()).removesuffix("_1").lower()
    axis = axis_of(prim, "axis", "Z")
    turn = (
        local.rotation @ _TO_Z[axis] if kind in ("cylinder", "capsule", "cone") else local.rotation
    )
    scale = np.linalg.norm(turn, axis=0)
    pose = Pose(local.position, turn / np.where(scale > 0, scale, 1.0))
    own = np.linalg.norm(local.rotation, axis=0)
    size: tuple[float, ...] = ()
    round_ = abs(scale[0] - scale[1]) <= 1e-4 * scale[0]
    match kind:
        case "cube":
            kind, size = "box", tuple(number_of(prim, "size", 2.0) / 2 * scale)
        case "sphere":
            size = tuple(number_of(prim, "radius", 1.0) * scale)
            alike = float(np.ptp(scale)) <= 1e-4 * float(scale.max())
            kind, size = ("sphere", size[:1]) if alike else ("ellipsoid", size)
        case "cylinder" | "capsule" | "cone" if round_:
            half = number_of(prim, "height", 1.0 if kind == "capsule" else 2.0) / 2
            radius = number_of(prim, "radius", 0.5 if kind == "capsule" else 1.0)
            size = (float(radius * scale[0]), float(half * scale[2]))
        case "mesh":
            approximation = str(value_of(prim, "physics:approximation", "text") or "none")

            read = partial(_read_mesh, prim, local.rotation)
            place = Pose(local.position, np.eye(3))
            name, convex = prim.GetName(), approximation == "convexHull"
            return UsdShape(name, kind, place, (), collides, read, prim, own, convex)
        case _:
            kind = "plane" if prim.IsA(UsdGeom.Plane) else "other"
    return UsdShape(prim.GetName(), kind, pose, size, collides, prim=prim, scale=own)


def _read_mesh(prim: Any, turn: Array) -> Mesh | None:
    """Returns a mesh, its faces as triangles; without faces where they name other points."""
    points = np.array(value_of(prim, "points", "list") or (), dtype=float).reshape(-1, 3)
    counts = np.array(value_of(prim, "faceVertexCounts", "list") or (), dtype=int)
    indices = np.array(value_of(prim, "faceVertexIndices", "list") or (), dtype=int)
    if not len(points):
        return None
    known = counts.sum() == len(indices) and np.isin(indices, np.arange(len(points))).all()
    faces = [
        (indices[start], indices[start + k], indices[start + k + 1])
        for start, count in zip(np.cumsum(counts) - counts, counts, strict=True)
        for k in range(1, count - 1)
        if known
    ]
    return Mesh(points @ turn.T, np.array(faces, dtype=np.int64).reshape(-1, 3))


def _mesh_solid(shape: UsdShape) -> Solid | None:
    """Returns the volume and second moments of a mesh, or of its convex hull."""
    import trimesh  # slow to import; yourdfpy depends on it

    if shape.mesh is None or not np.isfinite(shape.mesh.vertices).all():
        return None
    try:
        mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces)
        mesh = mesh.convex_hull if shape.convex else mesh
        if not mesh.is_watertight or not abs(mesh.volume) > 0:
            return None
        if mesh.volume < 0:
            mesh.invert()
        mesh.density = 1.0
        return Solid(float(mesh.volume), np.array(mesh.center_mass), np.array(mesh.moment_inertia))
    except Exception:  # whatever a degenerate mesh makes qhull or trimesh raise
        return None
