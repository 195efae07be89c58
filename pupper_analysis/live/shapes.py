"""A robot's shapes as triangles, each on its body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arrays import rotation_from_quaternion
from pupper_analysis.report.html.scene import SHAPES, coarser, shown_geoms

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Colour = tuple[int, int, int]

MOST_FACES = 40_000
"""Of all meshes of a robot together: half a megabyte, which is sent when a page opens."""

_COARSEST = 512  # cells along a mesh's longest side at first, when it is made coarser


@dataclass(frozen=True, eq=False)
class Part:
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


def parts_of(model: mujoco.MjModel) -> list[Part]:
    """Returns a robot's shapes, those of one body and colour together."""
    geoms = shown_geoms(model)
    kind = int(mujoco.mjtGeom.mjGEOM_MESH)
    meshes = {int(model.geom_dataid[geom]) for geom in geoms if model.geom_type[geom] == kind}
    total = sum(int(model.mesh_facenum[mesh]) for mesh in meshes)
    share = min(1.0, MOST_FACES / max(total, 1))
    thinned = {mesh: _mesh(model, mesh, share) for mesh in meshes}
    found: dict[tuple[int, Colour], list[tuple[Array, Integers]]] = {}
    for geom in geoms:
        name = SHAPES[int(model.geom_type[geom])]
        if name == "mesh":
            vertices, faces = thinned[int(model.geom_dataid[geom])]
        else:
            vertices, faces = primitive(name, model.geom_size[geom])
        turn = rotation_from_quaternion(model.geom_quat[geom])
        key = int(model.geom_bodyid[geom]), _colour(model, geom)
        found.setdefault(key, []).append((vertices @ turn.T + model.geom_pos[geom], faces))
    return [Part(body, *_joined(shapes), colour) for (body, colour), shapes in found.items()]


def _joined(shapes: list[tuple[Array, Integers]]) -> tuple[Array, Integers]:
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    faces = [faces + first for (_, faces), first in zip(shapes, firsts, strict=False)]
    return np.concatenate([vertices for vertices, _ in shapes]), np.concatenate(faces)


def _colour(model: mujoco.MjModel, geom: int) -> Colour:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue = (round(255 * float(value)) for value in rgba[:3])
    return red, green, blue


def _mesh(model: mujoco.MjModel, mesh: int, share: float) -> tuple[Array, Integers]:
    """Returns a mesh with about ``share`` of its faces."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + count], dtype=float)
    faces = np.asarray(model.mesh_face[start : start + number], dtype=np.int64)
    wanted, cells = max(int(share * number), 100), _COARSEST
    while len(faces) > wanted and cells > 4:
        vertices, faces = coarser(vertices, faces, cells)
        cells = int(0.75 * cells)
    return vertices, faces


def primitive(name: str, size: Array) -> tuple[Array, Integers]:
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
