"""Servos and visual meshes are created when they are first needed, and equal those created on
loading.
"""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare import passes
from pupper_analysis.prepare.convert import meshes
from pupper_analysis.prepare.convert.load import read_pair
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.prepare.passes import LoadRequest, prepare_robot
from pupper_analysis.robot.robot import rename_robot
from pupper_analysis.stance.stand import stand_statics
from tests.support.legged import quadruped

EARLY_NAMES = ("name", "floating", "base", "mj_base", "joint_names", "contact_points", "feet")


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the deferred passes that were applied, in order."""
    applied: list[str] = []
    run_passes = passes._run_passes

    def recorded(arguments: tuple[passes.Pass, ...], draft: passes.Draft) -> passes.Draft:
        applied.extend(step.name for step in arguments if step.deferred and step.applies(draft))
        return run_passes(arguments, draft)

    monkeypatch.setattr(passes, "_run_passes", recorded)
    return applied


def test_servos_are_not_made_for_pinocchio_model_and_joints(
    tmp_path: Path, runs: list[str]
) -> None:
    """Reference: the names of the deferred passes that were applied, before and after MuJoCo's
    model is read.
    """
    robot = pa.load_robot(*quadruped(tmp_path))
    assert robot.pin_model.nv == robot.nv == 18
    assert robot.total_mass > 0
    assert len(robot.feet) == 4
    assert "4 feet" in repr(robot)
    assert len(robot.lower_limits) == robot.nu
    assert not runs
    assert robot.mj_model.nu == robot.nu
    assert "add-servos" in runs
    count = len(runs)
    assert robot.notes
    assert robot.description.made_servos
    assert len(runs) == count


@pytest.mark.slow
def test_deferred_stages_keep_the_fields_that_were_read_before(tmp_path: Path) -> None:
    """Reference: the robot of which all passes are applied at once."""
    pair = quadruped(tmp_path)
    robot = pa.load_robot(*pair)
    early = {name: getattr(robot, name) for name in EARLY_NAMES}
    pin_model, nominal = robot.pin_model, robot.nominal
    complete, _ = prepare_robot(read_urdf(pair.urdf), read_mjcf(pair.mjcf), LoadRequest())
    assert early == {name: getattr(complete, name) for name in EARLY_NAMES}
    assert pin_model == complete.pin_model
    np.testing.assert_array_equal(pin_model.armature, complete.pin_model.armature)
    np.testing.assert_array_equal(nominal, complete.nominal)
    assert robot.stand_height == complete.stand_height
    assert robot.fingerprint == complete.fingerprint
    assert robot.notes == complete.notes
    assert robot.foot_geoms == complete.foot_geoms
    np.testing.assert_array_equal(robot.home, complete.home)
    assert robot.pin_model is pin_model


@pytest.mark.slow
def test_joint_order_with_a_coupled_joint_is_final_after_loading(tmp_path: Path) -> None:
    """Reference: the robot of which all passes are applied at once."""
    pair = quadruped(tmp_path)
    root = etree.parse(str(pair.mjcf)).getroot()
    actuators = root.find("actuator")
    follower, leader = (actuators[0].get("joint"), actuators[1].get("joint"))
    for _ in range(2):
        actuators.remove(actuators[0])
    equality = etree.SubElement(root, "equality")
    etree.SubElement(equality, "joint", joint1=follower, joint2=leader)
    pair.mjcf.write_bytes(etree.tostring(root))
    robot = pa.load_robot(*pair, fixed_base=True)
    order = robot.joint_names
    request = LoadRequest(fixed_base=True)
    complete, _ = prepare_robot(read_urdf(pair.urdf), read_mjcf(pair.mjcf), request)
    assert order == complete.joint_names == robot.joint_names
    assert order.index(leader) < order.index(follower)
    np.testing.assert_array_equal(
        robot.mj_convention.actuator_index, complete.mj_convention.actuator_index
    )


def test_robot_with_servos_at_all_independent_joints_gets_no_more(tmp_path: Path) -> None:
    """A coupled finger needs no servo: loading such a file raised a ValueError."""
    path = tmp_path / "gripper.xml"
    bodies = "".join(
        f'<body name="{name}"><joint name="{name}" type="slide" axis="0 {sign} 0" range="0 0.02"/>'
        '<geom size="0.01" mass="0.1"/></body>'
        for name, sign in (("left", 1), ("right", -1))
    )
    path.write_text(
        f'<mujoco><worldbody><body name="hand" pos="0 0 1"><geom size="0.05" mass="1"/>{bodies}'
        '</body></worldbody><equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/>'
        '</equality><actuator><position joint="left" kp="100"/></actuator></mujoco>'
    )
    robot = pa.load_robot(path)
    assert robot.joint_names == ("left", "right")
    assert robot.mj_model.nu == 1
    assert not robot.description.made_servos


@pytest.mark.slow
def test_servos_of_a_robot_with_coupled_joints_are_not_made_on_loading(
    tmp_path: Path, runs: list[str]
) -> None:
    """Reference: the robot of which all passes are applied at once."""
    path = quadruped(tmp_path).mjcf
    root = etree.parse(str(path)).getroot()
    trunk = root.find("worldbody/body")
    for side in ("left", "right"):
        finger = etree.SubElement(trunk, "body", name=side, pos="0.3 0 0.1")
        etree.SubElement(
            finger, "joint", name=f"{side}_slide", type="slide", axis="0 1 0", range="-0.02 0.02"
        )
        etree.SubElement(finger, "inertial", pos="0 0 0", mass="0.05", diaginertia="1e-4 1e-4 1e-4")
    equality = etree.SubElement(root, "equality")
    etree.SubElement(
        equality, "joint", joint1="right_slide", joint2="left_slide", polycoef="0 -1 0 0 0"
    )
    path.write_bytes(etree.tostring(root))
    robot = pa.load_robot(path)
    assert robot.floating
    order, contacts = robot.joint_names, robot.contact_points
    stand = pa.solve_stand(robot)
    assert "add-servos" not in runs
    pair = read_pair(path)
    complete, _ = prepare_robot(pair.urdf, pair.mjcf, LoadRequest())
    assert order == complete.joint_names == robot.joint_names
    assert contacts == complete.contact_points
    assert robot.closure is not None
    assert complete.closure is not None
    np.testing.assert_array_equal(robot.closure.dependent_joints, complete.closure.dependent_joints)
    assert robot.mj_model.nu == complete.mj_model.nu
    np.testing.assert_allclose(pa.solve_stand(complete).qpos, stand.qpos, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_changes_of_pinocchio_model_do_not_affect_deferred_stages(tmp_path: Path) -> None:
    """Reference: servos of the same robot without the change."""
    pair = quadruped(tmp_path)
    robot = pa.load_robot(*pair)
    robot.pin_model.effortLimit[:] = 0.1
    assert robot.description.made_servos == pa.load_robot(*pair).description.made_servos
    assert robot.pin_model.effortLimit.max() == 0.1


@pytest.mark.slow
def test_pickled_and_copied_robots_are_complete(tmp_path: Path) -> None:
    """Notes and both models equal those of the original robot."""
    pair = quadruped(tmp_path)
    complete = pa.load_robot(*pair)
    for robot in (
        pickle.loads(pickle.dumps(pa.load_robot(*pair))),
        copy.copy(pa.load_robot(*pair)),
    ):
        assert robot.notes == complete.notes
        assert robot.mj_model.nu == complete.mj_model.nu
        assert robot.pin_model == complete.pin_model


@pytest.mark.slow
def test_threads_read_one_model_of_a_robot(tmp_path: Path) -> None:
    robot = pa.load_robot(*quadruped(tmp_path))
    with ThreadPoolExecutor(4) as pool:
        models = list(pool.map(lambda _: robot.mj_model, range(4)))
    assert all(model is robot.mj_model for model in models)


@pytest.mark.slow
@pytest.mark.parametrize("loaded_first", [False, True])
def test_stands_and_statics_do_not_wait_for_servos(
    tmp_path: Path, runs: list[str], loaded_first: bool
) -> None:
    """Reference: the same robot of which all passes are applied first; equal to the last bit.

    The visual meshes of the complete model have other geom ids than the model before servos.
    """
    urdf = _with_visual_meshes(tmp_path)
    robot, complete = pa.load_robot(urdf), pa.load_robot(urdf)
    complete.complete_stages()
    assert complete.before_servos is complete
    runs.clear()
    if loaded_first:
        robot.complete_stages()
    stand = pa.solve_stand(robot)
    statics = stand_statics(robot, stand)
    again = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
    efforts, passive, weight = robot.efforts, robot.passive_joints, robot.weight
    posed, early_contacts = robot.before_servos, robot.contacts
    assert bool(runs) is loaded_first
    assert stand.own_robot is robot
    expected = pa.solve_stand(complete)
    np.testing.assert_array_equal(stand.qpos, expected.qpos)
    np.testing.assert_array_equal(
        statics.joint_torques, stand_statics(complete, expected).joint_torques
    )
    np.testing.assert_array_equal(again.joint_torques, statics.joint_torques)
    assert (efforts, passive, weight) == (
        complete.efforts,
        complete.passive_joints,
        complete.weight,
    )
    assert early_contacts == complete.contacts
    np.testing.assert_array_equal(posed.home, complete.home)
    assert robot.mj_model.nu == robot.nu
    assert robot.before_servos is robot
    np.testing.assert_array_equal(robot.home, posed.home)
    assert len(robot.shapes) == len(posed.shapes)
    assert {shape.geom for shape in robot.shapes} == {shape.geom for shape in complete.shapes}


@pytest.mark.slow
@pytest.mark.parametrize("used", [False, True])
def test_renamed_robot_has_its_name_before_and_after_the_servos(
    tmp_path: Path, runs: list[str], used: bool
) -> None:
    """The new name also replaces that of the robot without servos, if this robot was used."""
    robot = pa.load_robot(quadruped(tmp_path).urdf)
    if used:
        assert robot.before_servos.name == robot.name
    renamed = rename_robot(robot, "typed.urdf")
    assert renamed.before_servos.name == "typed.urdf"
    assert runs == []
    renamed.complete_stages()
    assert renamed.name == renamed.before_servos.name == "typed.urdf"
    assert robot.name == robot.before_servos.name != "typed.urdf"


def test_changes_of_pinocchio_model_enter_stands_before_servos(tmp_path: Path) -> None:
    """Reference: twice the gravity of all links needs twice the torque."""
    pair = quadruped(tmp_path)
    robot = pa.load_robot(*pair)
    torques = stand_statics(robot, pa.solve_stand(robot)).joint_torques
    changed = pa.load_robot(*pair)
    for inertia in changed.pin_model.inertias:
        inertia.mass *= 2
    heavy = stand_statics(changed, pa.solve_stand(changed)).joint_torques
    np.testing.assert_allclose(heavy, 2 * torques, atol=1e-9)


def test_unknown_attribute_raises_without_further_stages(tmp_path: Path, runs: list[str]) -> None:
    robot = pa.load_robot(*quadruped(tmp_path))
    with pytest.raises(AttributeError, match="no attribute 'mjmodel'"):
        _ = robot.mjmodel  # type: ignore[attr-defined]
    assert not runs


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{count}">{places}</float_array><technique_common>
<accessor source="#a" count="{points}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p>
</triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def _write_collada(path: Path, places: list[float], corners: list[int]) -> None:
    """Write a mesh with vertices (x, y, z, ...) [m] and triangles."""
    path.write_text(
        COLLADA.format(
            count=len(places),
            places=" ".join(map(str, places)),
            points=len(places) // 3,
            faces=len(corners) // 3,
            corners=" ".join(map(str, corners)),
        )
    )


TETRAHEDRON = [0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.1]
SIDES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]


def _with_visual_meshes(folder: Path) -> Path:
    """Return a URDF with spherical feet, and a valid and an invalid visual mesh in COLLADA."""
    pair = quadruped(folder)
    _write_collada(folder / "seen.dae", TETRAHEDRON, SIDES)
    _write_collada(folder / "flat.dae", TETRAHEDRON[:9], SIDES[:3])
    root = etree.parse(str(pair.urdf)).getroot()
    for link, file in zip(root.findall("link")[:2], ("seen.dae", "flat.dae"), strict=True):
        shape = etree.SubElement(link, "visual")
        etree.SubElement(etree.SubElement(shape, "geometry"), "mesh", filename=file)
    for joint in root.iterfind("joint[@type='revolute']"):
        [shank] = root.findall(f"link[@name='{joint.find('child').get('link')}']")
        if joint.get("name").endswith("knee"):
            foot = etree.SubElement(shank, "collision")
            etree.SubElement(foot, "origin", xyz="0 0 -0.2")
            etree.SubElement(etree.SubElement(foot, "geometry"), "sphere", radius="0.02")
    pair.urdf.write_bytes(etree.tostring(root))
    return pair.urdf


@pytest.mark.slow
def test_visual_meshes_are_converted_when_the_model_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: vertices of the file, and the same robot of a conversion that defers nothing."""
    urdf = _with_visual_meshes(tmp_path)
    converted = []
    convert = meshes._convert_content
    monkeypatch.setattr(
        meshes,
        "_convert_content",
        lambda *arguments: converted.append(arguments) or convert(*arguments),
    )
    robot = pa.load_robot(urdf)
    assert robot.pin_model.nv == 18
    assert not converted
    model = robot.mj_model
    assert len(converted) == 2
    [mesh] = [mesh for mesh in range(model.nmesh) if model.mesh(mesh).name == "seen"]
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    spans = np.sort(np.ptp(model.mesh_vert[first : first + count], axis=0))
    assert count == 4
    assert spans[-1] > 0.2  # the mesh is 0.3 m long, the placeholder 0.01 m
    left = [note for note in robot.notes if note.code == "visual-meshes-left"]
    assert [note.values["files"] for note in left] == [("flat.dae",)]
    pair = read_pair(urdf)
    complete, _ = prepare_robot(pair.urdf, pair.mjcf, LoadRequest())
    assert complete.mj_model.ngeom == model.ngeom
    np.testing.assert_array_equal(complete.mj_model.mesh_vert, model.mesh_vert)
    np.testing.assert_array_equal(complete.mj_model.body_mass, model.body_mass)
    assert [note.code for note in pair.add_source(complete).notes] == [
        note.code for note in robot.notes
    ]


@pytest.mark.slow
def test_verdict_without_visual_meshes_equals_the_verdict_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the same robot with converted visual meshes, one of which MuJoCo refuses."""
    urdf = _with_visual_meshes(tmp_path)
    complete = pa.load_robot(urdf)
    expected = [note for note in complete.notes if note.code != "visual-meshes-left"]
    assert len(expected) == len(complete.notes) - 1
    monkeypatch.setattr(meshes, "_convert_content", _refuse_conversion)
    robot = pa.load_robot(urdf, visuals=False)
    assert [*robot.notes] == expected
    for field in ("body_mass", "body_inertia", "body_ipos", "actuator_gainprm"):
        np.testing.assert_array_equal(
            getattr(robot.mj_model, field), getattr(complete.mj_model, field)
        )
    assert list_file_remarks(robot) == list_file_remarks(complete)


def _refuse_conversion(*_: object) -> bytes:
    """Represent the conversion of a mesh that must not be converted."""
    raise AssertionError


def test_visual_meshes_of_a_fixed_base_with_coupled_joints_are_deferred(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the robot of which all passes are applied at once."""
    urdf = _with_visual_meshes(tmp_path)
    root = etree.parse(str(urdf)).getroot()
    follower, leader = root.findall("joint[@type='revolute']")[:2]
    etree.SubElement(follower, "mimic", joint=leader.get("name"))
    urdf.write_bytes(etree.tostring(root))
    converted = []
    convert = meshes._convert_content
    monkeypatch.setattr(
        meshes,
        "_convert_content",
        lambda *arguments: converted.append(arguments) or convert(*arguments),
    )
    robot = pa.load_robot(urdf, fixed_base=True)
    order, pin_model = robot.joint_names, robot.pin_model
    joints = np.full(robot.nq, 0.2)
    statics = pa.gravity_compensation(pa.Configuration(robot, joints), contacts=())
    assert not converted
    pair = read_pair(urdf)
    complete, _ = prepare_robot(pair.urdf, pair.mjcf, LoadRequest(fixed_base=True))
    expected = pa.gravity_compensation(pa.Configuration(complete, joints), contacts=())
    assert np.abs(statics.joint_torques).max() > 0.01
    np.testing.assert_array_equal(statics.joint_torques, expected.joint_torques)
    assert order == complete.joint_names == robot.joint_names
    assert pin_model == complete.pin_model
    assert robot.mj_model.ngeom == complete.mj_model.ngeom
    np.testing.assert_array_equal(robot.mj_model.mesh_vert, complete.mj_model.mesh_vert)
    np.testing.assert_array_equal(
        robot.mj_convention.actuator_index, complete.mj_convention.actuator_index
    )
