"""Reading URDF and MJCF files of any source: line numbers, includes, meshes, and refusals."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.conversion import pinocchio_from_urdf
from pupper_analysis.models.loading import read_as_mjcf, read_as_urdf, read_model
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.places import Place, shorten_message
from pupper_analysis.models.stated.mjcf import joint_name
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from tests.support import corpus
from tests.support.corpus import (
    INERTIAL,
    LIMIT,
    format_joint,
    format_link,
    format_mjcf,
    format_urdf,
)

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
EXPLICIT = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
MESH = '<asset><mesh name="k" file="k.obj"/></asset>'
WITH_MESH = f'<worldbody><body name="b">{EXPLICIT}<geom type="mesh" mesh="k"/></body></worldbody>'


def write(folder: Path, **files: str) -> Path:
    """Write files (``sub__part`` is sub/part.xml), and return the path of the first."""
    for name, text in files.items():
        path = folder / f"{name.replace('__', '/')}.xml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / f"{next(iter(files))}.xml"


def get_refusal(read: Callable[[], object]) -> str:
    """Return the message of the ModelError that a call raises; it must be one line."""
    with pytest.raises(ModelError) as caught:
        read()
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("read", [read_as_urdf, read_as_mjcf, read_model])
def test_number_in_place_of_a_path_is_refused(read: Callable[[object], object]) -> None:
    with pytest.raises(pa.ConfigurationError, match="path"):
        read(5)


@pytest.mark.parametrize("case", corpus.MALFORMED)
def test_malformed_model_is_refused_at_its_line(case: str, tmp_path: Path) -> None:
    content, line, says = corpus.MALFORMED[case]
    path = tmp_path / "model.xml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    message = get_refusal(lambda: read_model(path))
    assert says in message
    where = re.match(rf"{re.escape(str(path))}(?::(\d+))?: ", message)
    assert where
    assert where[1] == (None if line is None else str(line))


def test_missing_file_folder_and_pipe_are_refused_as_such(tmp_path: Path) -> None:
    assert "no such file" in get_refusal(lambda: read_model(tmp_path / "x.urdf"))
    assert "the path is a folder" in get_refusal(lambda: read_model(tmp_path))
    assert "no such file" in get_refusal(lambda: read_model("a\0\nb"))
    os.mkfifo(tmp_path / "pipe")
    assert "not a regular file" in get_refusal(lambda: read_model(tmp_path / "pipe"))


def test_file_of_the_other_format_is_named(tmp_path: Path) -> None:
    robot = write(tmp_path, r=format_urdf(format_link("a")))
    model = write(tmp_path, m=format_mjcf())
    assert "the file is a URDF" in get_refusal(lambda: read_mjcf(robot))
    assert "the file is an MJCF" in get_refusal(lambda: read_urdf(model))
    assert isinstance(read_model(robot), UrdfFile)
    assert isinstance(read_model(model), MjcfFile)


@pytest.mark.parametrize("seed", range(5))
def test_random_bytes_are_refused_in_one_line(seed: int, tmp_path: Path) -> None:
    random = np.random.default_rng(seed)
    path = tmp_path / "any.xml"
    for size in (0, 1, 20, 200):
        path.write_bytes(random.bytes(size))
        get_refusal(lambda: read_model(path))
        path.write_bytes(bytes(random.integers(32, 127, size, dtype=np.uint8)))
        get_refusal(lambda: read_model(path))


# ------------------------------------------------------------------------------------- URDF


def test_invalid_colour_of_a_urdf_is_refused_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(
        '<robot name="r">\n<material name="m"><color rgba="1,0,0,1"/></material>'
        '<link name="l"/></robot>'
    )
    message = get_refusal(lambda: read_urdf(path))
    assert message.startswith(f"{path}:2: material 'm': <color rgba=")


def test_mimic_of_a_missing_joint_is_a_note(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    joint = format_joint("j", "a", "b", LIMIT + '<mimic joint="x"/>')
    path.write_text(format_urdf(format_link("a"), format_link("b"), joint))
    (note,) = read_urdf(path).notes
    assert (note.code, note.values["leader"]) == ("mimic-of-no-joint", "x")


def test_second_origin_is_ignored_with_a_warning_as_pinocchio_ignores_it(tmp_path: Path) -> None:
    """The reference is Pinocchio (urdfdom) on the file as written; MuJoCo refuses that file."""
    origins = '<origin xyz="{0} 0 0" rpy="0 0 {0}"/><origin xyz="0 0 5"/>'
    shape = f"<collision>{origins.format(2)}<geometry><sphere radius='1'/></geometry></collision>"
    inertial = INERTIAL.replace("<mass", f"{origins.format(3)}<mass", 1)
    child = format_link("b", inertial + shape)
    joint = format_joint("j", "a", "b", origins.format(1) + LIMIT)
    path = tmp_path / "r.urdf"
    path.write_text(format_urdf(format_link("a"), child, joint))
    file = read_urdf(path)
    assert [note.code for note in file.notes] == ["origin-more-than-once"] * 3
    assert [note.values["tag"] for note in file.notes] == ["inertial", "collision", "joint"]
    assert "<origin xyz='0 0 5'" not in file.text.replace('"', "'")
    models = []
    for text in (path.read_text(), file.text):
        model = pin.buildModelFromXML(text)
        shapes = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
        models.append((model, shapes))
    for model, shapes in models:
        assert model.jointPlacements[1] == pin.SE3(pin.rpy.rpyToMatrix(0, 0, 1), np.eye(3)[0])
        assert model.inertias[1].lever.tolist() == [3, 0, 0]
        assert shapes.geometryObjects[0].placement.translation.tolist() == [2, 0, 0]
    with pytest.raises(ValueError, match="repeated element: 'origin'"):
        mujoco.MjModel.from_xml_path(str(path))
    assert mujoco.MjModel.from_xml_string(file.text).nbody >= 2


def test_meshes_of_a_package_are_found_through_symbolic_links(tmp_path: Path) -> None:
    """The name of the package is that of the folder, or that of a link to the folder."""
    folder = tmp_path / "src/robot_description"
    (folder / "meshes").mkdir(parents=True)
    mesh = folder / "meshes/a.stl"
    mesh.touch()
    (folder / "r.urdf").write_text(format_urdf(format_link("a")))
    (tmp_path / "models").symlink_to("src/robot_description")
    (tmp_path / "short").mkdir()
    (tmp_path / "short/robot").symlink_to("../src/robot_description")
    (tmp_path / "r.urdf").symlink_to("src/robot_description/r.urdf")
    for file in ("models/r.urdf", "short/robot/r.urdf", "r.urdf"):
        found = read_urdf(tmp_path / file).resolve_mesh("package://robot_description/meshes/a.stl")
        assert found is not None
        assert found.samefile(mesh)
    linked = read_urdf(tmp_path / "short/robot/r.urdf")
    assert linked.resolve_mesh("package://robot/meshes/a.stl")


def test_urdf_elements_have_line_numbers(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(
        '<robot name="r">\n<!-- two\nlines -->\n<link name="a">\n<inertial>\n<mass value="1"/>\n'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>\n'
        '<visual><geometry><sphere radius="1"/></geometry>\n<material name="m"/></visual></link>\n'
        + format_urdf(format_link("b"), format_joint("j", "a", "b")).partition("\n")[2]
    )
    robot = read_urdf(path)
    assert str(robot.place("link", "a")) == "r.urdf:4"
    assert robot.place("link", "a", "inertial") == Place(path, 5)
    assert robot.place("link", "a", "inertial/mass") == Place(path, 6)
    assert robot.place("link", "a", "inertial/origin") == Place(path, 5)
    assert robot.place("joint", "j", "limit") == Place(path, 11)
    assert robot.place("material", "m") == Place(path, 9)
    assert str(robot.place("link", "x")) == "r.urdf"
    assert robot.root.find("link") is not None


def test_pinocchio_reads_numbers_with_line_breaks(tmp_path: Path) -> None:
    """Line breaks and tabs in attributes; reference: placement [m] and effort of Pinocchio's
    model.
    """
    path = tmp_path / "r.urdf"
    content = '<origin xyz="1\n\t2 3"/><limit effort=" 5 " velocity="1"/>'
    path.write_text(
        format_urdf(format_link("a"), format_link("b"), format_joint("j", "a", "b", content))
    )
    robot = read_urdf(path)
    model = pinocchio_from_urdf(robot.text, path, floating=True)
    assert model.jointPlacements[2].translation.tolist() == [1, 2, 3]
    assert model.effortLimit[6] == 5
    assert robot.place("joint", "j", "limit").line == 5


def test_byte_order_mark_namespaces_and_gazebo_elements_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(
        '\ufeff<?xml version="1.0" encoding="iso-8859-1"?><!-- <!DOCTYPE x> -->\n'
        '<robot name="r" xmlns="http://drake.mit.edu" xmlns:xacro="http://ros.org/wiki/xacro">'
        f'{format_link("a")}<gazebo><limit effort="x"/></gazebo>'
        "</robot>"
    )
    robot = read_urdf(path)
    assert robot.place("link", "a").line == 2
    assert pin.buildModelFromXML(robot.text, pin.JointModelFreeFlyer()).njoints == 2


def test_shapes_unknown_to_pinocchio_are_handled(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Capsules, and materials without a name or with several colours (Go2), must not print errors.

    Two geometries in a <visual> are ambiguous and refused.
    """
    colours = "".join(f"<material{name}/>" for name in (' name="x"', ' name="y"', ""))
    shape = '<geometry><capsule radius="1" length="2"/></geometry>'
    path = tmp_path / "r.urdf"
    parts = format_link("a", f"<visual>{colours}{shape}</visual>"), format_link("b")
    path.write_text(format_urdf(*parts, format_joint("j", "a", "b", LIMIT)))
    robot = read_urdf(path)
    assert (robot.notes, robot.text) == ((), path.read_text())
    assert pinocchio_from_urdf(robot.text, path, floating=False).nv == 1
    assert capfd.readouterr() == ("", "")  # Pinocchio reports each element on standard error
    # Of two shapes, it is unknown which is meant.
    path.write_text(format_urdf(format_link("a", f"<visual>{shape}{shape}</visual>")))
    assert "<geometry> more than once" in get_refusal(lambda: read_urdf(path))


def test_meshes_are_found_in_the_searched_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative, package://, model:// and file:// names; ROS_PACKAGE_PATH, parent folders and passed
    packages.
    """
    for name in ("ws/robot/meshes/a.stl", "ws/named/x/b.stl", "ros/other/c.stl", "else/d.stl"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}/nowhere{os.pathsep}{tmp_path}/ros")
    path = tmp_path / "ws/robot/urdf/r.urdf"
    path.parent.mkdir()
    path.write_text(format_urdf(format_link("a")))
    robot = read_urdf(path, packages={"mine": tmp_path / "else"})
    found = {
        "../meshes/a.stl": "ws/robot/meshes/a.stl",
        "package://robot/meshes/a.stl": "ws/robot/meshes/a.stl",
        "model://robot/meshes/a.stl": "ws/robot/meshes/a.stl",
        "package://named/x/b.stl": "ws/named/x/b.stl",
        "package://top/named/x/b.stl": "ws/named/x/b.stl",
        "package://other/c.stl": "ros/other/c.stl",
        "package://mine/d.stl": "else/d.stl",
        f"file://{tmp_path}/else/d.stl": "else/d.stl",
    }
    for name, file in found.items():
        mesh = robot.resolve_mesh(name)
        assert mesh is not None
        assert mesh.samefile(tmp_path / file)
    for name in ("", "x.stl", "package://robot", "package://x/a.stl", "http://x/a.stl", "a\0b"):
        assert robot.resolve_mesh(name) is None


@pytest.mark.parametrize("name", ["r.urdf", "r.xml"])
def test_git_lfs_pointer_as_a_model_is_reported(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(ModelError, match="Git LFS pointer, not the model; run git lfs pull"):
        read_model(path)


def test_pipe_in_place_of_a_mesh_does_not_block(tmp_path: Path) -> None:
    """Opening a named pipe for reading waits for a writer; the test would not end."""
    os.mkfifo(tmp_path / "k.stl")
    shape = '<visual><geometry><mesh filename="k.stl"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(format_urdf(format_link("a", shape)))
    (tmp_path / "r.xml").write_text(format_mjcf(MESH.replace("obj", "stl"), WITH_MESH))
    for name in ("r.urdf", "r.xml"):
        found = pa.audit_model(tmp_path / name).findings
        assert any("file 'k.stl' is missing" in finding.message for finding in found)


# ------------------------------------------------------------------------------------- MJCF


def test_mjcf_elements_have_line_numbers(tmp_path: Path) -> None:
    """Elements in the file, in an include and in an include of the include."""
    path = write(
        tmp_path,
        m=format_mjcf(
            '<default><default class="leg"/></default>',
            '<worldbody><body name="trunk">',
            "<freejoint/>",
            '<include file="sub/trunk.xml"/>',
            "</body></worldbody>",
            '<actuator><motor name="drive" joint="hip"/>',
            '<position joint="knee"/></actuator>',
            '<keyframe><key name="home"/></keyframe>',
        ),
        sub__trunk="<mujocoinclude>\n<include file='legs.xml'/>\n" + EXPLICIT + "</mujocoinclude>",
        sub__legs='<mujocoinclude>\n<body name="leg"><joint name="hip"/><joint name="knee"/>\n'
        '<geom name="shin" size="1"/></body></mujocoinclude>',
    )
    model = read_mjcf(path)
    trunk, legs = tmp_path / "sub/trunk.xml", tmp_path / "sub/legs.xml"
    assert model.files == (path, trunk, legs)
    assert model.place("body", "trunk") == Place(path, 3)
    assert model.place("body", "trunk", "inertial") == Place(trunk, 3)
    assert model.place("body", "trunk", "joint") == Place(path, 4)
    assert model.place("joint", "trunk") == model.place("freejoint", "trunk") == Place(path, 4)
    assert model.place("geom", "shin") == Place(legs, 3)
    assert model.place("body", "leg", "inertial") == Place(legs, 2)
    assert model.place("actuator", "drive") == model.place("actuator", "hip") == Place(path, 7)
    assert model.place("actuator", "knee") == model.place("position", "knee") == Place(path, 8)
    assert model.place("default", "leg") == Place(path, 2)
    assert model.place("key", "home") == Place(path, 9)
    assert model.place("site", "x") == Place(path)
    assert model.model.nv == 8


def test_place_of_a_joint_ignores_equalities_sensors_and_parts_of_tendons(tmp_path: Path) -> None:
    """Tags in these sections also name joints, tendons and contacts; lines are counted by hand."""
    path = tmp_path / "r.xml"
    lines = (
        "<mujoco>",
        '<equality><joint name="k" joint1="k" joint2="j"/>',
        '<tendon name="c" tendon1="c"/></equality>',
        '<tendon><fixed name="c"><joint joint="k" coef="1"/></fixed></tendon>',
        '<worldbody><body name="c"><geom size="1"/>',
        '<frame name="f"><joint axis="1 0 0"/></frame>',
        '<joint name="k" type="slide"/>',
        '<joint name="j" axis="0 1 0"/>',
        '<joint axis="0 0 1"/></body></worldbody></mujoco>',
    )
    path.write_text("\n".join(lines))
    file = read_mjcf(path)
    assert file.place("joint", "k") == Place(path, 7)
    assert file.place("equality", "k") == Place(path, 2)
    assert file.place("equality", "c") == Place(path, 3)
    assert file.place("tendon", "c") == Place(path, 4)
    assert file.place("joint", "c") == file.place("joint", "(c)") == Place(path, 6)
    assert file.place("joint", "(c #2)") == Place(path, 9)
    assert file.place("joint", "f") == Place(path)
    assert [joint_name(file.model, joint) for joint in range(4)] == ["(c)", "k", "j", "(c #2)"]


def test_include_beside_the_main_file_precedes_that_beside_the_including_file(
    tmp_path: Path,
) -> None:
    """Reference: MuJoCo's spec contains the geom of the read file."""
    part = '<mujocoinclude><worldbody><geom name="{}" size="1"/></worldbody></mujocoinclude>'
    path = write(
        tmp_path,
        m=format_mjcf('<include file="sub/a.xml"/>'),
        sub__a='<mujocoinclude><include file="b.xml"/></mujocoinclude>',
        sub__b=part.format("sub"),
        b=part.format("main"),
    )
    for name in ("main", "sub"):
        model = read_mjcf(path)
        assert [geom.name for geom in model.spec.geoms] == [name]
        assert model.place("geom", name).file == model.files[-1]
        (tmp_path / "b.xml").unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("part", "line"),
    [
        ('\n<body name="b"><joint name="j"/></body>', 2),
        ('\n\n\n<sensor><gyro site="nix"/></sensor>', 4),
    ],
    ids=["moving body without mass", "missing site"],
)
def test_error_of_mujoco_in_an_included_file_has_its_file_and_line(
    tmp_path: Path, part: str, line: int
) -> None:
    include = '<include file="a.xml"/>'
    content = f"<worldbody>{include}</worldbody>" if "<body" in part else include
    path = write(tmp_path, m=format_mjcf(content), a=f"<mujocoinclude>{part}</mujocoinclude>")
    message = get_refusal(lambda: read_mjcf(path))
    assert message.startswith(f"{tmp_path / 'a.xml'}:{line}: MuJoCo cannot ")


def test_cyclic_deep_and_too_many_includes_are_refused(tmp_path: Path) -> None:
    part = '<mujocoinclude><include file="{}.xml"/></mujocoinclude>'
    twice = part.format("d{0}").replace("><include", '><include file="d{0}.xml"/><include')
    cases: dict[str, dict[str, str]] = {
        f"{tmp_path / 'b.xml'}:1: 'a.xml' includes": {"a": part.format("b"), "b": part.format("a")},
        "deeper than": {f"c{i}": part.format(f"c{i + 1}") for i in range(100)},
        "more than 1000 includes": {
            **{f"d{i}": twice.format(i + 1) for i in range(25)},
            "d25": "<mujocoinclude/>",
        },
        "e.xml:1: the file has a DOCTYPE": {
            "e": '<!DOCTYPE x [<!ENTITY a "b">]>\n<mujocoinclude/>'
        },
    }
    for message, files in cases.items():
        path = write(tmp_path, m=format_mjcf(f'<include file="{next(iter(files))}.xml"/>'), **files)
        assert message in get_refusal(partial(read_mjcf, path))


def test_attached_models_are_loaded(tmp_path: Path) -> None:
    """Geom counts of MuJoCo's model with and without the mesh of the attached file; 2^20 attached
    bodies or files are refused.
    """
    child = format_mjcf(
        '<compiler meshdir="meshes"/>',
        MESH,
        WITH_MESH,
    )
    parent = format_mjcf(
        '<asset><model name="c" file="sub/c.xml"/></asset>',
        '<worldbody><frame><attach model="c" body="b" prefix="x-"/></frame></worldbody>',
    )
    path = write(tmp_path, m=parent, sub__c=child)
    model = read_mjcf(path)
    assert model.files == (path, tmp_path / "sub/c.xml")
    assert (model.model.ngeom, len(model.notes)) == (0, 1)
    (tmp_path / "sub/meshes").mkdir()
    (tmp_path / "sub/meshes/k.obj").write_text(TETRAHEDRON)
    model = read_mjcf(path)
    assert (model.model.ngeom, model.notes) == (1, ())
    # Each attaches the next twice: 2^20 bodies.
    attach = '<frame><attach model="c" body="b" prefix="{}"/></frame>'
    both = attach.format("x") + attach.format("y")
    double = format_mjcf(
        '<asset><model name="c" file="a{}.xml"/></asset>',
        f'<worldbody><body name="b">{both}</body></worldbody>',
    )
    files = {f"a{i}": double.format(i + 1) for i in range(20)}
    path = write(tmp_path, **files, a20=format_mjcf('<worldbody><body name="b"/></worldbody>'))
    assert "more than 10000 elements" in get_refusal(lambda: read_mjcf(path))
    # Each names the next twice: 2^20 files to read.
    double = format_mjcf(
        '<asset><model name="c" file="d{0}.xml"/><model name="d" file="d{0}.xml"/></asset>'
    )
    files = {f"d{i}": double.format(i + 1) for i in range(20)}
    path = write(tmp_path, **files, d20=format_mjcf())
    assert "more than 1000 includes" in get_refusal(lambda: read_mjcf(path))


@pytest.mark.parametrize(
    ("compiler", "file", "there"),
    [
        ("", "k.obj", "k.obj"),
        ('meshdir="d"', "k.obj", "d/k.obj"),
        ('assetdir="d"', "e/k.obj", "d/e/k.obj"),
        ('meshdir="d" strippath="true"', "e/k.obj", "d/k.obj"),
        ('meshdir="d"', "{}/e/k.obj", "e/k.obj"),
    ],
)
def test_mesh_folders_equal_those_of_mujoco(
    compiler: str, file: str, there: str, tmp_path: Path
) -> None:
    """Reference: MuJoCo compiles the mesh if it is in this folder."""
    asset = f'<asset><mesh name="k" file="{file.format(tmp_path)}"/></asset>'
    path = write(tmp_path, m=format_mjcf(f"<compiler {compiler}/>", asset, WITH_MESH))
    missing = read_mjcf(path)
    assert missing.model.ngeom == 0
    assert missing.notes[0].values["files"] == (file.format(tmp_path),)
    (tmp_path / there).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / there).write_text(TETRAHEDRON)
    model = read_mjcf(path)
    assert (model.model.ngeom, model.notes) == (1, ())


PLATE = 'vertex="0 0 0 1 0 0 0 1 0 1 1 0" face="0 1 2 1 3 2"'


def test_flat_meshes_become_shells_if_massless(tmp_path: Path) -> None:
    """MuJoCo 4 refuses a flat mesh even if the body has an <inertial>; without <inertial>, the file
    is refused."""
    seen = '<geom type="mesh" mesh="{}" contype="0" conaffinity="0"/>'
    assets = "".join(f'<mesh name="{name}" {PLATE}/>' for name in ("a plate", "other"))
    bodies = f"<body>{EXPLICIT}{seen.format('a plate')}{seen.format('other')}</body>"
    path = write(
        tmp_path, m=format_mjcf(f"<asset>{assets}</asset>", f"<worldbody>{bodies}</worldbody>")
    )
    with pytest.raises(ValueError, match="mesh volume is too small"):
        mujoco.MjSpec.from_file(str(path)).compile()
    file = read_mjcf(path)
    assert file.model.ngeom == 2
    assert file.spec.copy().compile().ngeom == 2
    assert file.refusal is None
    assert file.as_it_is is not None
    # `audit` reports that MuJoCo refuses the file as written.
    assert "mujoco-refuses" in {found.rule for found in pa.audit_model(path).findings}
    path.write_text(path.read_text().replace(EXPLICIT, ""))
    with pytest.raises(ModelError, match="mesh volume is too small"):
        read_mjcf(path)


@pytest.mark.parametrize(
    ("compiler", "inertial", "geom", "needed"),
    [
        ("", "", "", True),
        ("", "", 'mass="2" density="0"', True),
        ("", "", 'mass="0"', False),
        ("", "", 'density="0"', False),
        ("", EXPLICIT, "", False),
        ('inertiafromgeom="true"', EXPLICIT, "", True),
        ('inertiagrouprange="0 1"', "", 'group="2"', False),
        ('inertiagrouprange="0 2"', "", 'group="2"', True),
        ("", "", 'class="visual"', False),
    ],
)
def test_missing_mesh_is_refused_if_it_defines_mass(
    compiler: str, inertial: str, geom: str, needed: bool, tmp_path: Path
) -> None:
    """Without the mesh the mass of the body would be wrong; it defines no mass if the body has an
    inertial or the geom a mass of zero, for example.
    """
    path = write(
        tmp_path,
        m=format_mjcf(
            f"<compiler {compiler}/>" + MESH,
            '<default><default class="visual"><geom density="0"/></default></default>',
            f'<worldbody><body name="trunk">{inertial}',
            f'<geom name="g" type="mesh" mesh="k" {geom}/><geom size="1"/></body></worldbody>',
        ),
    )
    if needed:
        message = get_refusal(lambda: read_mjcf(path))
        assert message.startswith(f"{path}:4: body 'trunk' takes its mass from geom 'g'")
        assert "'k.obj'" in message
    else:
        assert read_mjcf(path).model.ngeom == 1


def test_elements_with_missing_files_are_omitted(tmp_path: Path) -> None:
    """Counts of geoms, meshes, textures, materials, sensors and tuples in MuJoCo's model; a contact
    pair that refers to an omitted geom is refused.
    """
    lines = [
        '<asset><mesh name="k" file="k.obj"/>',
        '<texture name="t" type="2d" file="t.png"/><material name="m" texture="t"/>',
        '<texture name="c" type="cube" fileup="up.png"/></asset>',
        '<worldbody><geom name="s" size="1" material="m"/>',
        f'<body name="b">{EXPLICIT}<joint/><geom name="g" type="mesh" mesh="k"/>',
        '<geom name="fit" type="capsule" mesh="k"/></body></worldbody>',
        '<sensor><framepos objtype="geom" objname="s"/></sensor>',
        '<custom><tuple name="u"><element objtype="geom" objname="g"/></tuple></custom>',
    ]
    model = read_mjcf(write(tmp_path, m=format_mjcf(*lines)))
    compiled = model.model
    counts = {
        kind: getattr(compiled, f"n{kind}")
        for kind in ("geom", "mesh", "tex", "mat", "sensor", "tuple")
    }
    left = {"geom": 1, "mat": 1, "sensor": 1}
    assert counts == {kind: left.get(kind, 0) for kind in counts}
    notes = " ".join(map(str, model.notes))
    assert all(file in notes for file in ("(k.obj)", "(t.png, up.png)"))
    path = write(tmp_path, m=format_mjcf(*lines, '<contact><pair geom1="g" geom2="s"/></contact>'))
    assert "m.xml:10: MuJoCo cannot compile the MJCF: " in get_refusal(lambda: read_mjcf(path))


def test_note_names_the_missing_file_of_a_cube_texture(tmp_path: Path) -> None:
    """Faces of the cube, in MuJoCo's order: right, left, up, down, front, back."""
    (tmp_path / "there.png").write_bytes(b"")
    cube = '<texture name="c" type="cube" fileright="there.png" fileleft="gone.png"/>'
    path = write(tmp_path, m=format_mjcf(f"<asset>{cube}</asset>"))
    file = read_mjcf(path)
    assert file.missing_files == ("gone.png",)
    assert file.model.ntex == 0


DANGLING = {
    "gyro": '<sensor><gyro site="nix"/></sensor>',
    "joint sensor": '<sensor><jointpos joint="nix"/></sensor>',
    "actuator": '<actuator><motor joint="nix"/></actuator>',
    "actuator of a tendon": '<actuator><motor tendon="nix"/></actuator>',
    "exclude": '<contact><exclude body1="b" body2="nix"/></contact>',
    "pair": '<contact><pair geom1="g" geom2="nix"/></contact>',
    "joint equality": '<equality><joint joint1="j" joint2="nix"/></equality>',
    "weld": '<equality><weld body1="b" body2="nix"/></equality>',
    "connect": '<equality><connect body1="b" body2="nix" anchor="0 0 0"/></equality>',
    "fixed tendon": '<tendon><fixed><joint joint="nix" coef="1"/></fixed></tendon>',
    "spatial tendon": '<tendon><spatial><site site="s"/><site site="nix"/></spatial></tendon>',
    "tuple": '<custom><tuple name="t"><element objtype="body" objname="nix"/></tuple></custom>',
    "camera target": '<worldbody><camera mode="targetbody" target="nix"/></worldbody>',
}

BODY = '<worldbody><body name="b"><joint name="j"/><geom name="g" size="1"/><site name="s"/>'


@pytest.mark.parametrize("missing_mesh", [False, True], ids=["", "with a missing mesh"])
@pytest.mark.parametrize("kind", DANGLING)
def test_reference_to_a_missing_element_is_refused_at_its_line(
    kind: str, missing_mesh: bool, tmp_path: Path
) -> None:
    """MuJoCo omits the element in a copy of the spec, and compiles the copy."""
    drawn = '<geom type="mesh" mesh="k" mass="0"/>' if missing_mesh else ""
    text = format_mjcf(
        MESH if missing_mesh else "", f"{BODY}{drawn}</body></worldbody>", DANGLING[kind]
    )
    path = write(tmp_path, m=text)
    message = get_refusal(lambda: read_mjcf(path))
    assert message.startswith(f"{path}:4: MuJoCo cannot compile the MJCF: ")
    assert "'nix'" in message or kind == "camera target"  # MuJoCo does not name this target
    file = read_model(path)
    assert isinstance(file, MjcfFile)
    assert file.refusal is not None
    assert get_refusal(lambda: file.model) == message
    if not missing_mesh and kind != "camera target":
        assert mujoco.MjSpec.from_string(text).copy().compile().nbody == 2


def test_place_of_an_actuator_by_number_in_a_model_without_text_is_the_file() -> None:
    file = MjcfFile(Path("m.xml"), mujoco.MjSpec())
    assert file.place_by_number("actuator", 0) == Place(Path("m.xml"))


def test_body_with_a_missing_mesh_and_a_missing_texture_is_listed_once(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        m=format_mjcf(
            '<asset><mesh name="k" file="k.obj"/>'
            '<texture name="t" type="2d" file="t.png"/><material name="c" texture="t"/></asset>',
            f'<worldbody><body name="b">{EXPLICIT}<geom type="mesh" mesh="k"/>'
            '<geom size="1" material="c"/></body></worldbody>',
        ),
    )
    file = read_mjcf(path)
    assert [note.code for note in file.notes].count("files-missing") == 2
    assert file.bodies_with_missing_meshes == ("b",)


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (
            "Error: unknown element 'foo' in equality constraint 0 Element name '', id 0, line 3",
            "unknown element 'foo' in equality constraint 0",
        ),
        (
            "Error: mass must be positive Element name 'hip', id 4, line 12",
            "mass must be positive (hip)",
        ),
        ("XML Error: missing tag", "XML Error: missing tag"),
    ],
)
def test_messages_of_mujoco_are_shortened_to_cause_and_element(message: str, cause: str) -> None:
    """Reference: messages of MuJoCo's compiler; the line is stated by the report itself."""
    assert shorten_message(message) == cause
