"""Mesh files of conversions: instances, archives, size limits, folders.

Volumes, face counts and MuJoCo's compiled models are the references.
"""

from __future__ import annotations

import io
import json
import os
import resource
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.models import mesh_scenes
from pupper_analysis.models.urdf_file import urdf_from
from pupper_analysis.models.xml import parse_text
from pupper_analysis.prepare.convert import meshes
from pupper_analysis.prepare.convert.meshes import UnreadableError, convert_to_obj
from pupper_analysis.tools.convert import Conversion
from tests.support.conversions import compile_file, format_shape
from tests.support.legged import edited_by, quadruped
from tests.support.robots import arm, urdf_text

BOX = trimesh.creation.box((0.1, 0.2, 0.3))


def write_glb(document: dict[str, object], data: bytes = b"") -> bytes:
    """Return a glTF binary with a JSON chunk and a chunk of data."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def claim_vertices(count: int) -> bytes:
    """Return a glTF binary with an accessor without data: zeros, of 12 bytes per vertex."""
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    document = {"asset": {"version": "2.0"}, "accessors": [accessor], "bufferViews": []}
    return write_glb({**document, "meshes": [mesh], "nodes": [{"mesh": 0}]})


def share_triangles(primitives: int) -> bytes:
    """Return a glTF binary whose primitives share 100,000 triangles."""
    points = struct.pack("<9f", 0, 0, 0, 0.1, 0, 0, 0, 0.1, 0)
    data = points + bytes([0, 1, 2]) * 100_000
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 36}]
    views += [{"buffer": 0, "byteOffset": 36, "byteLength": 300_000}]
    accessors = [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]
    accessors += [{"bufferView": 1, "componentType": 5121, "count": 300_000, "type": "SCALAR"}]
    part = {"attributes": {"POSITION": 0}, "indices": 1}
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data)}]}
    document |= {"bufferViews": views, "accessors": accessors, "nodes": [{"mesh": 0}]}
    return write_glb({**document, "meshes": [{"primitives": [part] * primitives}]}, data)


def nest_nodes(levels: int, *, shape: trimesh.Trimesh = BOX) -> str:
    """Return a COLLADA file with 2^levels boxes: each node contains two instances of the next."""
    file = trimesh.exchange.dae.export_collada(shape).decode()
    url = file[file.index("<instance_geometry") :].split('"')[1]
    nodes = f'<node id="n0"><instance_geometry url="{url}"/></node>'
    for level in range(levels):
        instances = 2 * f'<instance_node url="#n{level}"/>'
        nodes += f'<node id="n{level + 1}">{instances}</node>'
    begin = file.index("<library_visual_scenes")
    scene = f'<node id="root"><instance_node url="#n{levels}"/></node>'
    return (
        f"{file[:begin]}<library_nodes>{nodes}</library_nodes><library_visual_scenes>"
        f'<visual_scene id="s">{scene}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def write_hostile_meshes(folder: Path) -> dict[str, str]:
    """Write hostile mesh files, and return {file: reason for leaving it out}."""
    BOX.export(folder / "box.obj")
    with zipfile.ZipFile(folder / "box.zip", "w") as archive:
        archive.write(folder / "box.obj", "box.obj")
    BOX.export(folder / "box.3mf")
    with (folder / "large.stl").open("wb") as file:
        file.truncate(meshes.MAX_MESH_BYTES + 1)
    (folder / "broken.dae").write_text("<COLLADA/>")
    (folder / "text.ply").write_text("no mesh")
    (folder / "claims.glb").write_bytes(claim_vertices(10**9))
    (folder / "shared.glb").write_bytes(share_triangles(2000))
    (folder / "nested.dae").write_text(nest_nodes(30))
    sphere = trimesh.creation.icosphere(subdivisions=4)  # 0.2 MB as text
    (folder / "instances.dae").write_text(nest_nodes(11, shape=sphere))
    os.mkfifo(folder / "pipe.dae")
    return {
        "box.zip": "formats are not supported",
        "box.3mf": "formats are not supported",
        "large.stl": "larger than",
        "broken.dae": "broken",
        "text.ply": "broken",
        "claims.glb": "vertices",
        "shared.glb": "vertices",
        "nested.dae": "parts",
        "instances.dae": "each instance counted",
        "pipe.dae": "no such file",
    }


def with_shapes(folder: Path, shapes: str) -> Conversion:
    """Convert an arm with the given shapes on its base."""
    path = folder / "arm.urdf"
    path.write_text(urdf_text(arm(), ()).replace("</link>", f"{shapes}</link>", 1))
    return pa.convert_model(path, folder / "arm.xml", force=True)


def test_archives_and_oversized_meshes_are_left_out(tmp_path: Path) -> None:
    """Hostile files, such as a zip of 780 kB that unpacks to 11.5 GB, are left out with a reason;
    the valid mesh is converted."""
    expected = write_hostile_meshes(tmp_path)
    shapes = "".join(
        format_shape("visual", f'<mesh filename="{name}"/>', "0 0 0")
        for name in (*expected, "box.obj")
    )
    found = with_shapes(tmp_path, shapes)
    for name, why in expected.items():
        (message,) = [text for text in map(str, found.not_converted) if name in text]
        assert why in message
    assert compile_file(tmp_path / "arm.xml").nmesh == 1  # box.obj


def test_each_instance_of_a_mesh_is_converted_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten instances of a box have ten times its faces, and exceed a limit of nine times its
    vertices.
    """
    scene = trimesh.Scene()
    for number in range(10):
        scene.add_geometry(
            BOX,
            geom_name="box",
            transform=trimesh.transformations.translation_matrix([number, 0, 0]),
        )
    scene.export(tmp_path / "many.glb")
    converted = trimesh.load(io.BytesIO(convert_to_obj(tmp_path / "many.glb")), file_type="obj")
    assert len(converted.faces) == 10 * len(BOX.faces)
    monkeypatch.setattr(mesh_scenes, "MAX_MESH_VERTICES", 9 * len(BOX.vertices))
    with pytest.raises(UnreadableError, match="vertices"):
        convert_to_obj(tmp_path / "many.glb")


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        ("claims.glb", "mesh-has-too-many-vertices"),
        ("shared.glb", "mesh-has-too-many-vertices"),
        ("nested.dae", "mesh-has-too-many-parts"),
        ("instances.dae", "mesh-instances-too-large"),
    ],
)
def test_small_files_with_large_meshes_are_refused_before_memory_is_allocated(
    tmp_path: Path, file: str, reason: str
) -> None:
    """12 GB of zeros, 6e8 indices, 2^30 boxes and 2048 spheres; the limit is 100 MB more memory."""
    write_hostile_meshes(tmp_path)
    (tmp_path / "eight.dae").write_text(nest_nodes(3))
    convert_to_obj(tmp_path / "eight.dae")  # imports the readers
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UnreadableError) as error:
        convert_to_obj(tmp_path / file)
    assert error.value.reason.code == reason
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB on Linux


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_instances_of_collada_nodes_are_all_converted_to_metres(
    tmp_path: Path, unit: float
) -> None:
    """Reference: eight times the volume of the box, in the unit that the file states [m]."""
    stated = f'<unit name="u" meter="{unit}"/><up_axis>'
    (tmp_path / "eight.dae").write_text(nest_nodes(3).replace("<up_axis>", stated))
    converted = trimesh.load(io.BytesIO(convert_to_obj(tmp_path / "eight.dae")), file_type="obj")
    assert converted.volume == pytest.approx(8 * BOX.volume * unit**3)


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "1e400"])
def test_a_collada_unit_without_a_finite_positive_length_is_refused(
    tmp_path: Path, unit: str
) -> None:
    stated = f'<unit name="u" meter="{unit}"/><up_axis>'
    (tmp_path / "eight.dae").write_text(nest_nodes(3).replace("<up_axis>", stated))
    with pytest.raises(UnreadableError, match="broken"):
        convert_to_obj(tmp_path / "eight.dae")


def test_a_collada_node_that_contains_itself_is_refused(tmp_path: Path) -> None:
    text = nest_nodes(3).replace('<node id="n0">', '<node id="n0"><instance_node url="#n3"/>')
    (tmp_path / "endless.dae").write_text(text)
    with pytest.raises(UnreadableError, match="parts"):
        convert_to_obj(tmp_path / "endless.dae")


def test_conversion_fails_if_a_collision_mesh_is_left_out(tmp_path: Path) -> None:
    """An STL whose header states five more triangles than the file contains cannot be read."""
    stl = BOX.export(file_type="stl")
    for claimed, passes in ((len(BOX.faces), True), (len(BOX.faces) + 5, False)):
        content = stl[:80] + struct.pack("<I", claimed) + stl[84:]
        file = f"{claimed}.stl"  # another name, since MuJoCo caches files of the same second
        (tmp_path / file).write_bytes(content)
        shape = format_shape("collision", f'<mesh filename="{file}"/>', "0 0 0")
        found = with_shapes(tmp_path, shape)
        assert found.agree
        assert found.passed == passes
        assert [message.code for message in found.failures] == ["collision-meshes-lost"] * (
            not passes
        )


def test_flat_visual_mesh_is_converted_as_a_shell(tmp_path: Path) -> None:
    """MuJoCo cannot compute a volume inertia of a plate without thickness; the compiled MJCF
    contains the mesh.
    """
    plate = trimesh.Trimesh(
        [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]], [[0, 1, 2], [1, 3, 2]]
    )
    plate.export(tmp_path / "plate.stl")
    shape = format_shape("visual", '<mesh filename="plate.stl"/>', "0 0 0")
    found = with_shapes(tmp_path, shape)
    assert found.passed
    assert not [text for text in map(str, found.not_converted) if "mesh" in text]
    assert compile_file(tmp_path / "arm.xml").nmesh == 1


def write_package_urdf(folder: Path) -> Path:
    """Write a URDF with a mesh in a folder beside its own, as packages publish them."""
    for place in ("robot/urdf", "robot/meshes"):
        (folder / place).mkdir(parents=True)
    BOX.export(folder / "robot/meshes/box.stl")
    shape = format_shape("visual", '<mesh filename="../meshes/box.stl"/>', "0 0 0")
    path = folder / "robot/urdf/arm.urdf"
    path.write_text(urdf_text(arm(), ()).replace("</link>", f"{shape}</link>", 1))
    return path


def test_mesh_is_found_after_the_common_folder_is_moved(tmp_path: Path) -> None:
    """MuJoCo compiles the moved MJCF: paths to meshes are relative."""
    urdf = write_package_urdf(tmp_path)
    (tmp_path / "robot/mjcf").mkdir()
    pa.convert_model(urdf, tmp_path / "robot/mjcf/arm.xml")
    (tmp_path / "robot").rename(tmp_path / "elsewhere")
    assert compile_file(tmp_path / "elsewhere/mjcf/arm.xml").nmesh == 1


def test_linked_mesh_is_found_after_its_folder_is_moved(tmp_path: Path) -> None:
    """The package contains symbolic links to a store, as colcon installs it."""
    urdf = write_package_urdf(tmp_path)
    (tmp_path / "store").mkdir()
    (tmp_path / "robot/meshes/box.stl").rename(tmp_path / "store/1f3a.stl")
    (tmp_path / "robot/meshes/box.stl").symlink_to(tmp_path / "store/1f3a.stl")
    pa.convert_model(urdf, tmp_path / "robot/urdf/arm.xml")
    (tmp_path / "robot").rename(tmp_path / "elsewhere")
    assert compile_file(tmp_path / "elsewhere/urdf/arm.xml").nmesh == 1


def test_copied_mesh_is_found_after_the_new_folder_is_moved(tmp_path: Path) -> None:
    """With `copy_meshes` MuJoCo compiles the MJCF without the folder of the URDF."""
    urdf = write_package_urdf(tmp_path)
    (tmp_path / "new").mkdir()
    found = pa.convert_model(urdf, tmp_path / "new/arm.xml", copy_meshes=True)
    written = ("arm_meshes/box.stl", "arm.xml")
    assert found.written == tuple(str(tmp_path / "new" / name) for name in written)
    (tmp_path / "robot").rename(tmp_path / "gone")
    (tmp_path / "new").rename(tmp_path / "elsewhere")
    assert compile_file(tmp_path / "elsewhere/arm.xml").nmesh == 1


def test_missing_collision_mesh_is_a_failure_and_a_missing_visual_mesh_is_not(
    tmp_path: Path,
) -> None:
    for kind, codes in (("visual", []), ("collision", ["collision-meshes-lost"])):
        found = with_shapes(tmp_path, format_shape(kind, '<mesh filename="gone.stl"/>', "0 0 0"))
        assert [message.code for message in found.failures] == codes


def test_mesh_that_is_visual_and_collides_is_compiled_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo caches a mesh as it first occurs; without a hull, each later model computes one."""
    file = tmp_path / "tetrahedron.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    compiled: list[tuple[str, bool]] = []
    compile_mesh = meshes._test_compile

    def record(content: Any, path: Path, scale: str, *, touches: bool, shell: bool) -> None:
        compiled.append((path.name, touches))
        compile_mesh(content, path, scale, touches=touches, shell=shell)

    monkeypatch.setattr(meshes, "_test_compile", record)
    element = f"<mesh filename='{file}'/>"
    root = parse_text(
        f"<robot name='r'><link name='a'><collision><geometry>{element}</geometry></collision>"
        "</link></robot>"
    )
    made = meshes.MeshFiles(urdf_from(file, "", root, None), file)
    names = [made.register_mesh(etree.fromstring(element), touches=way) for way in (False, True)]
    assert names[0] == names[1]
    assert compiled == [(file.name, True)]


@pytest.mark.parametrize("name", [None, "a part"])
@pytest.mark.parametrize("count", [0, 3, 200])
def test_obj_text_equals_that_of_trimesh(name: str | None, count: int) -> None:
    """Reference: trimesh's export, also of small, large and negative numbers and of no mesh."""
    random = np.random.default_rng(3)
    vertices = random.normal(size=(count, 3)) * 10.0 ** random.integers(-9, 4, (count, 3))
    faces = random.integers(0, max(count, 1), (count and 2 * count, 3))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if name is not None:
        mesh.metadata["name"] = name
    expected = trimesh.exchange.obj.export_obj(
        mesh, include_color=False, include_texture=False, include_normals=False
    )
    assert meshes.format_obj(mesh.vertices, mesh.faces, name) == expected.encode()


@pytest.mark.parametrize(("shape", "severity"), [("visual", "warning"), ("collision", "error")])
@pytest.mark.parametrize("name", ["", "  "])
def test_empty_filename_of_a_mesh_is_named_with_its_link_and_line(
    shape: str, severity: str, name: str, tmp_path: Path
) -> None:
    """The message was "file '' is missing", and the note had no name at all."""
    mesh = f'<{shape}><geometry><mesh filename="{name}"/></geometry></{shape}></link>'
    urdf = quadruped(tmp_path).urdf
    edited_by(urdf, lambda text: text.replace("</link>", mesh))
    findings = [
        finding for finding in pa.audit_model(urdf).findings if finding.rule == "mesh-missing"
    ]
    assert {finding.diagnostic.code for finding in findings} == {"mesh-without-filename"}
    assert {finding.severity for finding in findings} == {severity}
    assert [finding.element for finding in findings][:2] == ["link 'trunk'", "link 'FL_hip'"]
    assert [finding.line for finding in findings][:2] == [2, 3]
    assert len(findings) == 13
    robot = pa.load_robot(urdf, fixed_base=True)
    (note,) = [note for note in robot.notes if note.code == "meshes-left"]
    assert note.values["why"].code == "mesh-filename-empty"
    assert note.values["files"][0] == "trunk (robot.urdf:2)"
