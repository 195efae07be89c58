"""Limits of small mesh files that describe large meshes.

A glTF accessor without data consists of zeros, and primitives may share data. A COLLADA node may
contain two instances of a second node, and the second node two instances of a third node: 30 such
nodes describe 2^30 parts. The readers of trimesh would allocate all parts.
"""

from __future__ import annotations

import json
import struct
from typing import Final, NamedTuple

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose

MAX_MESH_BYTES: Final = 50_000_000
"""Maximum size [bytes] of a mesh file that is converted, and of a COLLADA file that is read. Chosen
above the files of published robots, for example 29 MB (trunk of Go1).
"""

MAX_MESH_VERTICES: Final = 1_000_000
"""Maximum number of vertices of a mesh in a format other than STL and OBJ. Chosen above the meshes
of published robots, for example 830,000 (trunk of Go1).
"""

MAX_MESH_PARTS: Final = 10_000
"""Maximum number of nodes and shapes of all scenes of a COLLADA file, each instance counted.
Chosen: a link of a robot has dozens."""

_MAX_INDICES: Final = 6 * MAX_MESH_VERTICES
"""Maximum number of vertex indices of a glTF file. Derived from two triangles per vertex."""

_GLB_HEADER: Final = struct.Struct("<4sIIII")
"""Format of the header of a glTF binary: magic number, version, length of the file; length and type
of the first chunk, which is JSON.
"""


def check_gltf(data: bytes) -> Diagnostic | None:
    """Check if a glTF binary describes too many vertices to be read.

    A shared accessor is counted once per primitive. A broken file raises an exception, for example
    `struct.error` or `KeyError`.

    Returns:
        Reason to refuse the file; None if the file is accepted.
    """
    size = int(_GLB_HEADER.unpack_from(data)[3])
    document = json.loads(data[_GLB_HEADER.size : _GLB_HEADER.size + size])
    accessors = document.get("accessors", [])
    counts = [max(int(accessor["count"]), 0) for accessor in accessors]
    empty = sum(
        count
        for accessor, count in zip(accessors, counts, strict=True)
        if "bufferView" not in accessor
    )
    primitives = [part for mesh in document.get("meshes", []) for part in mesh["primitives"]]
    vertices = sum(counts[part["attributes"]["POSITION"]] for part in primitives)
    indices = sum(counts[part["indices"]] for part in primitives if "indices" in part)
    if max(empty, vertices) > MAX_MESH_VERTICES or indices > _MAX_INDICES:
        return diagnose("mesh-has-too-many-vertices", most=MAX_MESH_VERTICES)
    return None


class _Extent(NamedTuple):
    """Number of parts of a COLLADA node, and length of their shapes' text, instances included."""

    parts: int
    length: int


class _ColladaScene:
    """Extents of the nodes of a COLLADA document, each computed once."""

    def __init__(self, root: etree._Element) -> None:
        self._nodes = {f"#{node.get('id')}": node for node in root.iter("{*}node")}
        self._lengths = {
            f"#{shape.get('id')}": sum(len(element.text or "") for element in shape.iter())
            for shape in root.iter("{*}geometry")
        }
        self._extents: dict[etree._Element, _Extent] = {}

    def extent(self, node: etree._Element) -> _Extent:
        """Count the parts of a COLLADA node, and the characters that describe the shapes.

        A node that contains itself gets more parts than allowed, so that the file is refused.
        """
        if node not in self._extents:
            self._extents[node] = _Extent(MAX_MESH_PARTS + 1, 0)
            urls = [str(instance.get("url")) for instance in node.iterfind("{*}instance_node")]
            children = [*node.iterfind("{*}node")]
            children += [self._nodes[url] for url in urls if url in self._nodes]
            shapes = [
                self._lengths.get(str(instance.get("url")), 0)
                for instance in node.iterfind("{*}instance_geometry")
            ]
            extents = [self.extent(child) for child in children]
            self._extents[node] = _Extent(
                1 + len(shapes) + sum(extent.parts for extent in extents),
                sum(shapes) + sum(extent.length for extent in extents),
            )
        return self._extents[node]


def check_collada(data: bytes) -> Diagnostic | None:
    """Check if a COLLADA file has more parts, or more text in its shapes, than may be read.

    The limits apply to the sum over all scenes, in which each instance of a node or shape counts:
    `MAX_MESH_PARTS` parts, and twice `MAX_MESH_BYTES` characters. A broken file raises an
    `etree.XMLSyntaxError`.

    Returns:
        Reason to refuse the file; None if the file is accepted.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)
    root = etree.fromstring(data, parser)
    scene = _ColladaScene(root)
    extents = [
        scene.extent(node)
        for visual_scene in root.iter("{*}visual_scene")
        for node in visual_scene.iterfind("{*}node")
    ]
    if sum(extent.parts for extent in extents) > MAX_MESH_PARTS:
        return diagnose("mesh-has-too-many-parts", most=MAX_MESH_PARTS)
    if sum(extent.length for extent in extents) > 2 * MAX_MESH_BYTES:
        return diagnose("mesh-instances-too-large", most=2 * MAX_MESH_BYTES // 10**6)
    return None
