"""Reading of mesh files with several parts, such as COLLADA, as one mesh.

Input is the content of a file in a format other than STL and OBJ. Files that are small, but
describe large meshes, are refused before they are read (`mesh_limits`).
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.mesh_limits import MAX_MESH_VERTICES, check_collada, check_gltf

if TYPE_CHECKING:
    import trimesh

_LIMIT_CHECKS: Final[Mapping[str, Callable[[bytes], Diagnostic | None]]] = {
    ".dae": check_collada,
    ".glb": check_gltf,
}
"""{suffix: function that rejects small files which describe large meshes}. In the other formats,
the number of vertices is bounded by the size of the file."""


class UnreadableError(Exception):
    """Error of a mesh file that cannot be used.

    Attributes:
        reason: Reason, equal for files with the same problem.
    """

    def __init__(self, reason: Diagnostic) -> None:
        self.reason = reason
        super().__init__(str(reason))


def read_merged_mesh(data: bytes, ending: str) -> trimesh.Trimesh:
    """Read all parts of a mesh file as one mesh, without materials.

    The unit of length that a COLLADA file states is applied, but not its up axis, as in RViz.

    Args:
        data: Content of the file.
        ending: Suffix of the file: .dae, .glb, .off or .ply.

    Raises:
        UnreadableError: If the mesh is broken, or exceeds a limit.
    """
    import trimesh  # comes with yourdfpy, and is slow to import

    try:
        reason = _LIMIT_CHECKS[ending](data) if ending in _LIMIT_CHECKS else None
        if reason is not None:
            raise UnreadableError(reason)
        with _no_trimesh_log():
            scene = trimesh.load_scene(io.BytesIO(data), file_type=ending[1:], skip_materials=True)
        count = sum(
            len(scene.geometry[scene.graph[node][1]].vertices)
            for node in scene.graph.nodes_geometry
        )
        _check_count(count, MAX_MESH_VERTICES)
        for shape in scene.geometry.values():
            shape.visual = None  # otherwise textures of all parts are merged: 200 MB per mesh
        mesh = scene.to_mesh()
        unit = read_collada_asset(data).unit if ending == ".dae" else 1.0
        return mesh if unit == 1 else mesh.apply_scale(unit)
    except UnreadableError:
        raise
    except Exception as error:  # the readers raise many types for broken files
        raise UnreadableError(diagnose("mesh-broken")) from error


@contextlib.contextmanager
def _no_trimesh_log() -> Iterator[None]:
    """Suppress the log of trimesh, which prints tracebacks about textures that nobody reads."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def _check_count(vertices: int, maximum: int) -> None:
    """Raise `UnreadableError` for a mesh with more than ``maximum`` vertices."""
    if vertices > maximum:
        raise UnreadableError(diagnose("mesh-has-too-many-vertices", most=maximum))


class ColladaAsset(NamedTuple):
    """Conventions that a COLLADA file states.

    Attributes:
        unit: Length of the unit [m].
        up_axis: Axis that points up, for example ``"Z_UP"``.
    """

    unit: float
    up_axis: str


def read_collada_asset(data: bytes) -> ColladaAsset:
    """Return the conventions of a COLLADA file; without a statement 1 m and Y_UP (COLLADA 1.4.1).

    Only the first <asset> counts, which precedes all meshes: the rest of the file is not parsed.

    Raises:
        ValueError: If the length of the unit is not a finite positive number, or the file is no
            valid XML up to the <asset>.
    """
    elements = etree.iterparse(
        io.BytesIO(data), tag="{*}asset", resolve_entities=False, no_network=True, huge_tree=True
    )
    try:
        asset = next((element for _, element in elements), None)
    except etree.XMLSyntaxError as error:
        raise ValueError(str(error)) from error
    if asset is None:
        return ColladaAsset(1.0, "Y_UP")
    unit = asset.find("{*}unit")
    meter = 1.0 if unit is None else float(unit.get("meter", "1"))
    if not 0 < meter < math.inf:
        raise ValueError(meter)
    return ColladaAsset(meter, str(asset.findtext("{*}up_axis") or "Y_UP").strip())
