"""Meshes in files."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.tools import format_of
from pupper_analysis.models.places import one_line
from pupper_analysis.models.shapes import Mesh


def mesh_hull(path: Path) -> Mesh | None:
    """Returns an STL or OBJ file's convex hull; None if it cannot be read.

    Other kinds (COLLADA) carry units and poses of their own and are not read.
    """
    if path.suffix.lower() not in (".stl", ".obj"):
        return None
    found = _read(path, path.stat().st_mtime_ns)
    return None if isinstance(found, Diagnostic) else found


def mesh_problem(path: Path) -> Diagnostic | None:
    """Says what keeps a file from being a mesh; None if nothing does, or it is not read here.

    STL and OBJ are read, of COLLADA the start. A file of more than ``LARGEST_MESH`` bytes is not
    opened.
    """
    ending = path.suffix.lower()
    if ending not in _FORMATS and format_of(path) is None:
        return diagnose("mesh-of-no-format", ending=ending)
    if path.stat().st_size > LARGEST_MESH:
        return None
    if ending == ".dae":
        with path.open("rb") as file:
            start = file.read(_PROLOGUE)
        return None if b"COLLADA" in start else diagnose("mesh-no-collada")
    if ending not in (".stl", ".obj"):
        return None
    found = _read(path, path.stat().st_mtime_ns)
    return found if isinstance(found, Diagnostic) else None


_FORMATS = (
    ".stl", ".obj", ".msh", ".dae", ".ply", ".off", ".glb", ".gltf", ".fbx", ".3ds", ".mesh",
    ".wrl", ".iv",
)  # fmt: skip
"""Endings of meshes that MuJoCo, Gazebo, Bullet, Drake or RViz read; whole formats have theirs."""

_PROLOGUE = 4096
"""Bytes of an XML before its first element, with comments."""

LARGEST_MESH = 200_000_000
"""Bytes: the greatest meshes that are published have a quarter of it."""


@lru_cache(maxsize=256)
def _read(path: Path, _changed: int) -> Mesh | Diagnostic:
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
