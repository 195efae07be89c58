"""A robot's shapes as triangles, each on its body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.present.scene import shapes_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Colour = tuple[int, int, int]

MOST_FACES = 40_000
"""Of all meshes of a robot together: half a megabyte, which is sent when a page opens."""


@dataclass(frozen=True, eq=False)
class ShapePart:
    """All of a body's shapes that have one colour.

    Attributes:
        body: Number of the body in MuJoCo's model.
        vertices: (n, 3) in the body's frame (m).
        faces: (m, 3) numbers of vertices.
        colour: Red, green, blue, 0 to 255.
    """

    body: int
    vertices: Array
    faces: Integers
    colour: Colour


def parts_of(model: mujoco.MjModel) -> list[ShapePart]:
    """Returns a robot's shapes, those of one body and colour together."""
    shapes, meshes = shapes_of(model, MOST_FACES)
    found: dict[tuple[int, Colour], list[tuple[Array, Integers]]] = {}
    for shape in shapes:
        if shape.mesh is None:
            vertices, faces = mesh_of_primitive(shape.kind, shape.size)
        else:
            vertices, faces = meshes[shape.mesh].vertices, meshes[shape.mesh].faces
        turn = rotation_from_quaternion(shape.quaternion)
        red, green, blue = (round(255 * float(value)) for value in shape.colour[:3])
        placed = vertices @ turn.T + shape.position, faces
        found.setdefault((shape.body, (red, green, blue)), []).append(placed)
    return [ShapePart(body, *_joined(parts), colour) for (body, colour), parts in found.items()]


def _joined(shapes: list[tuple[Array, Integers]]) -> tuple[Array, Integers]:
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    faces = [faces + first for (_, faces), first in zip(shapes, firsts, strict=False)]
    return np.concatenate([vertices for vertices, _ in shapes]), np.concatenate(faces)


def mesh_of_primitive(name: str, size: Array) -> tuple[Array, Integers]:
    """Returns a shape of MuJoCo's as triangles, along z about its centre.

    Args:
        name: ``sphere``, ``capsule``, ``ellipsoid``, ``cylinder`` or ``box``.
        size: (3,) MuJoCo's ``geom_size`` (m).
    """
    from trimesh import creation  # comes with viser

    a, b, c = (float(value) for value in size)
    made: Any
    if name == "box":
        made = creation.box(extents=(2 * a, 2 * b, 2 * c))
    elif name == "cylinder":
        made = creation.cylinder(radius=a, height=2 * b, sections=24)
    elif name == "capsule":
        made = creation.capsule(radius=a, height=2 * b, count=(16, 16))
    else:
        made = creation.icosphere(subdivisions=2)
        made.apply_scale((a, a, a) if name == "sphere" else (a, b, c))
    return np.asarray(made.vertices, dtype=float), np.asarray(made.faces, dtype=np.int64)
