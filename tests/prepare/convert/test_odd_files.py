"""Conversion of unusual files: reserved names, meshes with equal names, couplings, elements around
the robot.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

import pupper_analysis as pa
from tests.support import arm
from tests.support.conversions import (
    compare_dynamics,
    compile_file,
    convert_file,
    format_shape,
    simulate_from_keyframe,
    write_standing_urdf,
)
from tests.support.legged import rewrite_file


def _write_changed(folder: Path, *changes: tuple[str, str]) -> Path:
    return rewrite_file(write_standing_urdf(folder), *changes)


def _measure_drift(mjcf: Path, but: str = "") -> float:
    """Return the largest displacement of the joints (except `but`) and of the base height,
    orientation included, after 3 s of bare MuJoCo from the keyframe.
    """
    model = compile_file(mjcf)
    data, start = simulate_from_keyframe(model)
    gone = np.abs(data.qpos - start)
    gone[:2] = 0
    if but:
        gone[model.joint(but).qposadr] = 0
    return float(gone.max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (('"FR_pitch"', '"universe"'), "Pinocchio reserves this name"),
        (('"FR_pitch"', '"root_joint"'), "Pinocchio reserves this name"),
        (('"FR_pitch"', '"trunk"'), "has the name of its base, 'trunk'"),
        (('"FR_thigh"', '"world"'), "reserves this name for the fixed world"),
        (('"FR_pitch"', '"%s"'), "interprets % as a format"),
        (('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>'), "axis has no direction"),
    ],
)
def test_refusal_of_a_conversion_names_the_source_file(
    change: tuple[str, str], problem: str, tmp_path: Path
) -> None:
    """The first three made the search endless, or wrote beyond arrays."""
    with pytest.raises(pa.ModelError, match=problem) as caught:
        pa.convert_model(_write_changed(tmp_path, change), tmp_path / "new.xml")
    assert "draft" not in str(caught.value)


def test_a_link_named_world_that_is_fixed_to_the_base_of_an_arm_is_converted(
    tmp_path: Path,
) -> None:
    """It was refused as if it moved. Reference: masses of all links, height of the turntable."""
    inertial = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    above = (
        f'<link name="bench"/><link name="world">{inertial}</link><joint name="top" type="fixed">'
        '<parent link="bench"/><child link="world"/><origin xyz="0 0 0.7"/></joint>'
        '<joint name="foot" type="fixed"><parent link="world"/><child link="base"/></joint></robot>'
    )
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm.URDF.replace("</robot>", above), encoding="utf-8")
    mjcf, found = convert_file(urdf, "new.xml")
    assert found.passed, found.failures
    model = compile_file(mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.body("turn").xpos == pytest.approx([0.0, 0.0, 1.2])
    assert model.body_mass.sum() == pytest.approx(1 + sum(arm.MASSES.values()))


def test_free_base_is_refused_if_its_root_link_is_named_world(tmp_path: Path) -> None:
    urdf = _write_changed(tmp_path, ('"trunk"', '"world"'))
    with pytest.raises(pa.ModelError, match="reserves this name for the fixed world"):
        pa.convert_model(urdf, tmp_path / "new.xml", fixed_base=False)


@pytest.mark.slow
def test_meshes_with_equal_names_stay_distinct(tmp_path: Path) -> None:
    """Reference: lengths of the boxes [m], whose DAE files have equal names in two folders and are
    rewritten.
    """
    for folder, size in (("a", 0.1), ("b", 0.3)):
        (tmp_path / folder).mkdir()
        trimesh.creation.box((size, 0.02, 0.02)).export(tmp_path / folder / "part.dae")
    shapes = "".join(
        format_shape("visual", f'<mesh filename="{folder}/part.dae"/>', "0 0 0") for folder in "ab"
    )
    path = rewrite_file(write_standing_urdf(tmp_path), ("</link>", f"{shapes}</link>"), count=1)
    mjcf, _ = convert_file(path, "quad.xml")
    model = compile_file(mjcf)
    lengths = []
    for mesh in range(model.nmesh):
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        lengths.append(np.ptp(model.mesh_vert[start : start + count], axis=0).max())
    np.testing.assert_allclose(sorted(lengths), [0.1, 0.3], rtol=1e-5)
    mjcf.unlink()
    written = {file: file.read_bytes() for file in tmp_path.rglob("*.obj")}
    assert len(written) == 2
    pa.convert_model(path, mjcf)  # own meshes are written again
    assert {file: file.read_bytes() for file in written} == written
    next(iter(written)).write_text("# another's\nv 0 0 0\n")
    with pytest.raises(pa.OutputError):
        pa.convert_model(path, tmp_path / "quad.xml")


def _with_arm(folder: Path, mimic: str) -> Path:
    """Return a URDF with two links in series on the trunk; the joint of the second has the given
    mimic.
    """
    arm = ""
    for number, (parent, extra) in enumerate((("trunk", ""), ("a1", mimic)), start=1):
        arm += (
            f'<link name="a{number}"><inertial><origin xyz="0.2 0 0"/><mass value="0.2"/><inertia '
            'ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="arm{number}" type="revolute"><origin xyz="0.1 0 0.1"/><parent '
            f'link="{parent}"/><child link="a{number}"/><axis xyz="0 1 0"/><limit lower="-1" '
            f'upper="1" effort="9" velocity="5"/>{extra}</joint>'
        )
    return _write_changed(folder, ("</robot>", f"{arm}</robot>"))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, -0.5])
def test_keyframe_of_a_robot_with_a_mimic_joint_holds_in_mujoco(
    factor: float, tmp_path: Path
) -> None:
    """Reference: drift in MuJoCo.

    By virtual work, the servo of the leading joint bears the load of the following joint as well.
    """
    urdf = _with_arm(tmp_path, f'<mimic joint="arm1" multiplier="{factor}"/>')
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert _measure_drift(mjcf, but="arm2") < 1e-5  # MuJoCo's couplings are soft: it sags by 3 mrad


@pytest.mark.slow
@pytest.mark.parametrize("leader", ["nowhere", "arm2"])
def test_mimic_of_an_unknown_joint_is_left_out_with_a_note(leader: str, tmp_path: Path) -> None:
    """The joint keeps a motor of its own, and the keyframe drifts by less than 1e-4 in 3 s of
    MuJoCo.
    """
    mjcf, found = convert_file(_with_arm(tmp_path, f'<mimic joint="{leader}"/>'), "quad.xml")
    assert any(f"joint 'arm2' mimics '{leader}'" in text for text in map(str, found.not_converted))
    assert not found.agree
    assert compile_file(mjcf).nu == 14
    assert _measure_drift(mjcf) < 1e-4


# ---------------------------------------------------------------------------- an MJCF as a URDF

_INERTIAL = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.02 0.025"/>'


def _write_mjcf(
    folder: Path, *, before: str = "", geoms: str = "", world: str = "", after: str = ""
) -> Path:
    path = folder / "two.xml"
    path.write_text(
        f"""<mujoco model="two">{before}<worldbody>{world}<body name="base"><freejoint/>{_INERTIAL}
        {geoms}<body name="one">{_INERTIAL}<joint name="j1" axis="0 1 0" range="-1 1"/><body
        name="two" pos="0 0 0.2">{_INERTIAL}<joint name="j2" axis="1 0 0" range="-1 1"/></body>
        </body></body></worldbody>{after}</mujoco>"""
    )
    return path


def test_elements_around_the_robot_are_reported(tmp_path: Path) -> None:
    """A floor, a table, a mocap body, a camera, a site motor and gravity: none of them exists in a
    URDF.
    """
    world = (
        '<geom type="plane" size="1 1 1"/><camera name="eye"/><body name="table"><geom size="0.1"/>'
        '</body><body name="goal" mocap="true"/>'
    )
    source = _write_mjcf(
        tmp_path,
        before='<option gravity="0 0 -3"/>',
        world=world,
        geoms='<site name="s"/>',
        after='<actuator><motor site="s"/></actuator>',
    )
    _, found = convert_file(source, "two.urdf")
    assert {
        "bodies that are not part of the robot: 'table', 'goal'",
        "geoms of the world and of these bodies: 2",
        "cameras: 1",
        "actuators: 1",
        "gravity (0, 0, -3) m/s^2",
    } <= {*map(str, found.not_converted)}


def test_active_joint_coupling_becomes_a_mimic(tmp_path: Path) -> None:
    """An inactive coupling, and the second of two couplings of one joint, are reported as not
    converted.
    """
    line = '<joint joint1="j2" joint2="j1" polycoef="0.3 2 0 0 0" {}/>'
    inactive = 'active="false"'
    off = _write_mjcf(tmp_path, after=f"<equality>{line.format(inactive)}</equality>")
    urdf, found = convert_file(off, "off.urdf")
    assert found.agree
    assert "<mimic" not in urdf.read_text()
    assert "equality constraint 1 (joint)" in map(str, found.not_converted)
    twice = _write_mjcf(tmp_path, after=f"<equality>{2 * line.format('')}</equality>")
    urdf, found = convert_file(twice, "twice.urdf")
    assert urdf.read_text().count("<mimic") == 1
    assert "equality constraint 2 (joint)" in map(str, found.not_converted)


def test_scaled_mesh_keeps_its_position(tmp_path: Path) -> None:
    """Reference: vertices [m] of MuJoCo's model of the source; Pinocchio reads the URDF with its
    mirrored scale. A `refpos` is reported.
    """
    trimesh.creation.box((0.1, 0.06, 0.04)).apply_translation((0.01, 0.02, 0.03)).export(
        tmp_path / "part.stl"
    )
    source = _write_mjcf(
        tmp_path,
        before='<asset><mesh name="m" file="part.stl" scale="1 -2 3"/></asset>',
        geoms='<geom type="mesh" mesh="m" pos="0.1 0.2 0.3" euler="10 20 30"/>',
    )
    urdf, _ = convert_file(source, "two.urdf")
    model = compile_file(source)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    theirs = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    shapes = pin.buildGeomFromUrdf(
        pin.buildModelFromUrdf(str(urdf)),
        str(urdf),
        pin.GeometryType.VISUAL,
        package_dirs=[str(tmp_path)],
    )
    shape = shapes.geometryObjects[0]
    mine = np.array(trimesh.load(tmp_path / "part.stl").vertices) * shape.meshScale
    mine = mine @ shape.placement.rotation.T + shape.placement.translation
    apart = np.linalg.norm(theirs[:, None] - mine[None], axis=2)
    assert max(apart.min(0).max(), apart.min(1).max()) < 1e-6  # m
    source.write_text(source.read_text().replace("scale=", 'refpos="0.1 0.2 0.3" scale='))
    _, found = convert_file(source, "three.urdf")
    assert "mesh-moved" in {loss.code for loss in found.not_converted}


def test_unconverted_mesh_of_an_attached_model_is_named(tmp_path: Path) -> None:
    """The attached model has a mesh folder of its own."""
    (tmp_path / "sub" / "parts").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.06, 0.04)).export(tmp_path / "sub" / "parts" / "hand.stl")
    (tmp_path / "sub" / "hand.xml").write_text(
        f"""<mujoco model="hand"><compiler meshdir="parts"/><asset><mesh file="hand.stl"/></asset>
        <worldbody><body name="hand">{_INERTIAL}<geom type="mesh" mesh="hand"/></body></worldbody>
        </mujoco>"""
    )
    source = _write_mjcf(
        tmp_path,
        before='<asset><model name="h" file="sub/hand.xml"/></asset>',
        geoms='<attach model="h" body="hand" prefix="left_"/>',
    )
    _, found = convert_file(source, "two.urdf")
    assert found.agree
    assert "mesh 'left_hand': mesh file 'hand.stl' is not in the MJCF's folder for meshes" in (
        map(str, found.not_converted)
    )


@pytest.mark.slow
def test_shapes_of_size_zero_are_left_out_with_a_note(tmp_path: Path) -> None:
    """Robots have boxes of size 0 as markers (Upkie's base), which MuJoCo refuses."""
    marker = '<visual><geometry><box size="0 0 0"/></geometry></visual></link>'
    output, result = convert_file(_write_changed(tmp_path, ("</link>", marker)), "marked.xml")
    compile_file(output)
    messages = " ".join(map(str, (*result.notes, *result.not_converted)))
    assert "size 0 0 0 was left out" in messages


@pytest.mark.slow
def test_shapes_of_massless_links_touch_at_the_height_of_the_foot(tmp_path: Path) -> None:
    """Toe massless links, with a sphere of radius 0 (as in Drake's Atlas), which the conversion
    must keep; otherwise the feet sink by 20 mm (Kuavo)."""
    ball = format_shape("collision", '<sphere radius="0.02"/>', "0 0 -0.2")
    point = '<sphere radius="0.0"/>'
    toes = "".join(
        f'<link name="{leg}_toe">{format_shape("collision", point, "0.01 0 -0.02")}</link>'
        f'<joint name="{leg}_on" type="fixed"><parent link="{leg}_calf"/><child link="{leg}_toe"/>'
        '<origin xyz="0 0 -0.2" rpy="0 1.5707963267948966 0"/></joint>'
        for leg in ("FL", "FR", "RL", "RR")
    )
    urdf = _write_changed(tmp_path, (ball, ""), ("</robot>", f"{toes}</robot>"))
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert any("massless links" in str(note) and "FL_toe" in str(note) for note in found.notes)
    assert "collision spheres of radius 0 (points) were given a radius of 1 mm" in map(
        str, found.not_converted
    )
    model = compile_file(mjcf)
    calf = model.body("FL_calf").id
    point = model.geom("FL_toe_collision")
    assert model.geom_bodyid[point.id] == calf
    assert model.geom_size[point.id, 0] == 0.001
    # Turned by 90 degrees about y, (x, z) is (z, -x) in the calf.
    np.testing.assert_allclose(point.pos, (-0.02, 0.0, -0.2 - 0.01), atol=1e-9)
    np.testing.assert_allclose(model.body("FL_toe").pos, (0, 0, -0.2), atol=1e-12)


@pytest.mark.slow
def test_a_base_that_floats_in_the_link_world(tmp_path: Path) -> None:
    """As in Centauro's URDF, the root link is the world, and not a moving body."""
    floating = (
        '<link name="world"/><joint name="reference" type="floating"><parent link="world"/>'
        '<child link="trunk"/><origin xyz="0 0 0.9"/></joint></robot>'
    )
    urdf = _write_changed(tmp_path, ("</robot>", floating))
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert compile_file(mjcf).body("trunk").parentid == 0


@pytest.mark.slow
def test_feet_are_found_if_legs_are_horizontal_at_zero_angles(tmp_path: Path) -> None:
    """At zero angles the legs end at the height of the base, one slightly lower than the others."""
    urdf = write_standing_urdf(tmp_path)
    text = urdf.read_text()
    for leg, turn, out in (("F", -1.57, 0.05), ("R", 1.57, 0.05)):
        for side, sign in (("L", 1), ("R", -1)):
            name = f'name="{leg}{side}_pitch"'
            start = text.index(name)
            old = f'<origin xyz="0.0 {sign * out!r} 0.0"/>'
            at = text.index(old, start)
            new = f'<origin xyz="0 {sign * out!r} 0" rpy="0 {turn - 0.01 * sign!r} 0"/>'
            text = text[:at] + new + text[at + len(old) :]
    text = text.replace('lower="-1.5" upper="2.5"', 'lower="-2.6" upper="2.6"')
    urdf.write_text(text.replace('lower="-2.6" upper="-0.4"', 'lower="-2.6" upper="2.6"'))
    _, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    note = next(str(note) for note in found.notes if note.code == "feet-found")
    assert note.count("_calf_collision") == 4


@pytest.mark.slow
def test_fixed_joint_with_the_name_of_the_base_is_converted(tmp_path: Path) -> None:
    """PlaCo finds frames by their names alone. Reference: total mass [kg]."""
    head = (
        '<link name="head"><inertial><mass value="0.3"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="trunk" type="fixed"><origin '
        'xyz="0.1 0 0.05"/><parent link="trunk"/><child link="head"/></joint></robot>'
    )
    mjcf, found = convert_file(_write_changed(tmp_path, ("</robot>", head)), "quad.xml")
    assert found.passed, found.failures
    assert compile_file(mjcf).body_subtreemass[0] == pytest.approx(4 + 4 * 1.1 + 0.3)


@pytest.mark.slow
def test_material_and_shape_with_the_name_of_the_floor_are_kept(tmp_path: Path) -> None:
    red = '<material name="floor"><color rgba="1 0 0 1"/></material>'
    shapes = format_shape("visual", '<box size="0.1 0.1 0.1"/>', "0 0 0").replace(
        "</visual>", f"{red}</visual>"
    ) + format_shape("collision", '<box size="0.1 0.1 0.01"/>', "0 0 0").replace(
        "<collision>", '<collision name="floor">'
    )
    path = write_standing_urdf(tmp_path)
    path.write_text(path.read_text().replace("</link>", f"{shapes}</link>", 1))
    mjcf, found = convert_file(path, "quad.xml")
    assert found.passed, found.failures
    model = compile_file(mjcf)
    assert model.geom("floor").type == mujoco.mjtGeom.mjGEOM_PLANE.value
    np.testing.assert_allclose(model.material("floor_2").rgba, [1, 0, 0, 1])


@pytest.mark.slow
def test_names_of_the_free_joint_floor_and_world_are_accepted(tmp_path: Path) -> None:
    """The new MJCF uses ``root`` and ``floor`` itself; ``universe`` is Pinocchio's world."""
    changes = ('"FR_pitch"', '"root"'), ('"FR_thigh"', '"floor"'), ('"trunk"', '"universe"')
    urdf = _write_changed(tmp_path, *changes)
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert compare_dynamics(urdf, mjcf) < 1e-9


@pytest.mark.slow
def test_negative_effort_gazebo_and_velocity_limits_are_not_converted(tmp_path: Path) -> None:
    changes = ('effort="80"', 'effort="-80"'), ("</robot>", '<gazebo reference="trunk"/></robot>')
    _, found = convert_file(_write_changed(tmp_path, *changes), "quad.xml")
    texts = [*map(str, found.not_converted)]
    assert any("effort limit -80" in text for text in texts)
    assert "1 <gazebo>" in texts
    assert any(text.startswith("velocity limits of 12 joints") for text in texts)
    assert not found.passed


@pytest.mark.slow
def test_light_finger_is_not_moved_by_its_servo_after_a_nudge(tmp_path: Path) -> None:
    """Reference: MuJoCo after a nudge of 1e-3 rad/s. H1's finger with a leg's servo: 33 mrad."""
    light = (
        ('"0.2 0 0"/><mass value="0.2"', '"0.02 0 0"/><mass value="0.005"'),
        ('ixx="1e-3" iyy="1e-3" izz="1e-3"', 'ixx="7e-7" iyy="7e-7" izz="7e-7"'),
        ('xyz="0.1 0 0.1"/><parent link="a1"', 'xyz="0.04 0 0"/><parent link="a1"'),
    )
    urdf = rewrite_file(_with_arm(tmp_path, '<mimic joint="arm1" multiplier="2.4"/>'), *light)
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    model = compile_file(mjcf)
    data, joint = mujoco.MjData(model), model.joint("arm2")
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start, largest = data.qpos[joint.qposadr[0]], 0.0
    data.qvel[:] = 1e-3 * np.random.default_rng(0).uniform(-1, 1, model.nv)
    while data.time < 0.2:
        mujoco.mj_step(model, data)
        largest = max(largest, abs(float(data.qpos[joint.qposadr[0]] - start)))
    assert largest < 5e-3
