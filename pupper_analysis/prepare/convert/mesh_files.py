"""Mesh files in formats that MuJoCo does not read, written as OBJ, within limits."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Final

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_input

READABLE: Final = (".stl", ".obj", ".msh")
"""Endings of the mesh files that MuJoCo reads."""

_CONVERTIBLE: Final = (".dae", ".glb", ".gltf", ".off", ".ply")
"""Endings of those that are read here: no archives, whose content may be of any size and kind."""

_PICTURES: Final = (".bmp", ".gif", ".jpeg", ".jpg", ".png", ".tga", ".tif", ".tiff", ".webp")
"""Endings of what a mesh may be painted with."""

MOST_BYTES: Final = 200_000_000
"""Largest mesh file that is read: ten times the largest of a published robot that was seen."""

MOST_VERTICES: Final = 1_000_000
"""Most vertices of a mesh: MuJoCo takes 5 s and 2 GB to compile so many, each time it does. The
most of a published robot that was seen are 830,000, three for each triangle (Go1's trunk)."""

MOST_TOUCHING: Final = 300_000
"""Most vertices of a mesh that touches: each time it is compiled, its hull takes MuJoCo as long."""

MOST_TRIANGLES: Final = 500_000
"""Most triangles of a mesh. MuJoCo takes 200,000 of an STL file, and names no limit of an OBJ."""

MOST_PARTS: Final = 10_000
"""Most places of a file's scene in which a part stands: a robot's link has dozens, at most."""

_GLB: Final = struct.Struct("<4sIIII")
"""Magic number, version, length; length and kind of the first chunk, which is JSON."""


_MSH: Final = struct.Struct("<4i")
"""Counts of vertices, normals, texture coordinates and triangles, at the start of MuJoCo's own."""


class UnreadableError(Exception):
    """A mesh file is not taken.

    Attributes:
        reason: Why, of several files.
    """

    def __init__(self, reason: Diagnostic) -> None:
        self.reason = reason
        super().__init__(str(reason))


def obj_of(path: Path) -> bytes:
    """Returns a mesh as OBJ, all its parts in one.

    Raises:
        UnreadableError: If it is in no format that is read, or too large, or broken.
    """
    ending = path.suffix.lower()
    if ending not in _CONVERTIBLE:
        formats = (*READABLE, *_CONVERTIBLE)
        raise UnreadableError(diagnose("mesh-format-not-read", formats=formats))
    import trimesh  # comes with yourdfpy, and is slow to import

    data = read_mesh(path)
    try:
        if ending in (".glb", ".gltf"):
            _check_gltf(data)
        if ending == ".dae":
            _check_collada(data)
        scene = trimesh.load_scene(io.BytesIO(data), file_type=ending[1:], resolver=_Beside(path))
        count = sum(
            len(scene.geometry[scene.graph[node][1]].vertices)
            for node in scene.graph.nodes_geometry
        )
        _check_count(count, MOST_VERTICES)
        for shape in scene.geometry.values():
            shape.visual = None  # else pictures are put together for all parts: 200 MB a mesh
        text: str = trimesh.exchange.obj.export_obj(
            scene.to_mesh(), include_color=False, include_texture=False, include_normals=False
        )
        return text.encode()
    except UnreadableError:
        raise
    except Exception as error:  # whatever the many readers raise of broken files
        raise UnreadableError(diagnose("mesh-broken")) from error


def read_mesh(path: Path) -> bytes:
    """Returns the content of a mesh file that is no larger than any mesh of a robot.

    Raises:
        UnreadableError: If it is, or cannot be read.
    """
    try:
        return read_input(path, MOST_BYTES)
    except InputError as error:
        if error.cause.code == "file-too-large":
            raise UnreadableError(diagnose("mesh-too-large", most=MOST_BYTES // 10**6)) from error
        raise UnreadableError(diagnose("mesh-broken")) from error


def check_detail(data: bytes, ending: str, *, touches: bool) -> None:
    """Refuses an OBJ or MSH file of more detail than MuJoCo compiles in seconds.

    Of an STL file MuJoCo itself refuses more than 200,000 triangles.

    Args:
        data: The file's content.
        ending: Its name's, in small letters.
        touches: Whether it is for collisions, whose hull MuJoCo works out.

    Raises:
        UnreadableError: If so.
    """
    most = MOST_TOUCHING if touches else MOST_VERTICES
    vertices, triangles = 0, 0
    if ending == ".msh" and len(data) >= _MSH.size:
        vertices, _, _, triangles = _MSH.unpack_from(data)
    elif ending == ".obj":
        for line in io.BytesIO(data):
            words = line.split(None, MOST_TRIANGLES + 3)  # a polygon of many corners is many
            vertices += words[:1] == [b"v"]
            triangles += max(len(words) - 3, 0) if words[:1] == [b"f"] else 0
    _check_count(vertices, most)
    if triangles > MOST_TRIANGLES:
        raise UnreadableError(diagnose("mesh-has-too-many-triangles", most=MOST_TRIANGLES))


def _check_count(vertices: int, most: int) -> None:
    if vertices > most:
        raise UnreadableError(diagnose("mesh-has-too-many-vertices", most=most))


def _check_gltf(data: bytes) -> None:
    """Looks how many numbers a glTF file claims: what no buffer has is zero, and needs no file."""
    if data[:4] == b"glTF":
        size = int(_GLB.unpack_from(data)[3])
        data = data[_GLB.size : _GLB.size + size]
    counts = [int(accessor.get("count", 0)) for accessor in json.loads(data).get("accessors", ())]
    most = max(MOST_VERTICES, 3 * MOST_TRIANGLES)  # a triangle's corners are counted, too
    _check_count(max(counts, default=0), most)


def _check_collada(data: bytes) -> None:
    """Counts the parts of a COLLADA scene, without making them.

    A node may stand in another twice, and that one twice in a third: thirty lines make a thousand
    million parts.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    root = etree.fromstring(data, parser)
    nodes = {f"#{node.get('id')}": node for node in root.iter("{*}node")}
    counts: dict[etree._Element, int] = {}

    def parts(node: etree._Element) -> int:
        if node not in counts:
            counts[node] = MOST_PARTS + 1  # where it stands in itself, there is no end
            inner = [*node.iterfind("{*}node")]
            inner += [
                nodes[url]
                for use in node.iterfind("{*}instance_node")
                if (url := str(use.get("url"))) in nodes
            ]
            shapes = sum(1 for _ in node.iterfind("{*}instance_geometry"))
            counts[node] = 1 + shapes + sum(map(parts, inner))
        return counts[node]

    scenes = root.iter("{*}visual_scene")
    if any(sum(map(parts, scene.iterfind("{*}node"))) > MOST_PARTS for scene in scenes):
        raise UnreadableError(diagnose("mesh-has-too-many-parts", most=MOST_PARTS))


class _Beside:
    """Finds the files that a mesh names, for trimesh: regular ones, beside it, not too large.

    Pictures are none: shapes are all that is written.
    """

    def __init__(self, path: Path) -> None:
        self.folder = path.parent.resolve()

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def get(self, name: str) -> bytes:
        """Returns a file's content."""
        file = (self.folder / name).resolve()
        if not file.is_relative_to(self.folder) or file.suffix.lower() in _PICTURES:
            raise FileNotFoundError(name)
        return read_mesh(file)
