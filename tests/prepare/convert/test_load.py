"""A robot of one file: the second model is converted from the first and equals the model of the
pair.
"""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.prepare.convert.load import load_mjcf_robot, read_pair
from pupper_analysis.pupper.variants import find_model_folder
from tests.support.corpus import INERTIAL, LIMIT, format_joint, format_link, format_urdf
from tests.support.legged import quadruped, rewrite_file
from tests.support.robots import Part, mjcf_text

URDF, MJCF = (
    find_model_folder("urdf") / "pupper_v3.urdf",
    find_model_folder("mjcf") / "pupper_v3.xml",
)
FEET = {
    "FR": "leg_front_r_3_foot_site",
    "FL": "leg_front_l_3_foot_site",
    "RR": "leg_back_r_3_foot_site",
    "RL": "leg_back_l_3_foot_site",
}


@pytest.fixture(scope="module")
def both() -> pa.Robot:
    return pa.load_robot(URDF, MJCF, feet=FEET)


@pytest.fixture(scope="module")
def of_urdf() -> pa.Robot:
    return pa.load_robot(URDF, feet=FEET)


@pytest.fixture(scope="module")
def of_mjcf() -> pa.Robot:
    return pa.load_robot(MJCF, feet=FEET)


def bend_joints(robot: pa.Robot) -> np.ndarray:
    """Return a configuration without symmetry, in which a joint's angle depends on its name."""
    qpos = robot.neutral()
    qpos[3:7] = np.array([0.9, 0.2, -0.3, 0.1]) / np.linalg.norm([0.9, 0.2, -0.3, 0.1])
    for index, name in enumerate(robot.joint_names):
        side = 1.0 if "_l_" in name else -1.0
        qpos[robot.nq - robot.nu + index] = side * (0.1 * int(name[-1]) + 0.02 * ("back" in name))
    return qpos


@pytest.mark.slow
@pytest.mark.parametrize("which", ["of_urdf", "of_mjcf"])
def test_conversion_of_each_file_equals_the_original_model(
    which: str, both: pa.Robot, request: pytest.FixtureRequest
) -> None:
    """Reference: the robot of both files: mass, CoM, gravity torques, foot positions and limits in
    Pinocchio. `cross_check` compares Pinocchio with MuJoCo.
    """
    one: pa.Robot = request.getfixturevalue(which)
    assert one.total_mass == pytest.approx(both.total_mass, rel=1e-12)
    assert set(one.joint_names) == set(both.joint_names)
    there, here = pa.Configuration(both, bend_joints(both)), pa.Configuration(one, bend_joints(one))
    order = [one.joint_names.index(name) for name in both.joint_names]
    np.testing.assert_allclose(here.center_of_mass(), there.center_of_mass(), atol=1e-9)
    np.testing.assert_allclose(here.gravity()[6:][order], there.gravity()[6:], atol=1e-9)
    for foot, place in there.foot_positions().items():
        np.testing.assert_allclose(here.foot_positions()[foot], place, atol=1e-9)
    limits = [
        (robot.lower_limits, robot.upper_limits, robot.effort_limits) for robot in (one, both)
    ]
    for mine, theirs in zip(*limits, strict=True):
        np.testing.assert_allclose(np.asarray(mine)[order], theirs, atol=1e-9)
    assert pa.cross_check(one).passed  # Pinocchio against MuJoCo


@pytest.mark.slow
def test_converted_model_has_the_masses_of_the_other_engine(
    of_urdf: pa.Robot, of_mjcf: pa.Robot
) -> None:
    """MuJoCo's model of the URDF, and Pinocchio's of the MJCF: masses, by the bodies' names."""
    own = mujoco.MjModel.from_xml_path(str(MJCF))
    assert len(of_urdf.joint_names) == own.nu
    for name in of_urdf.joint_names:
        body = own.jnt_bodyid[own.joint(name).id]
        made = of_urdf.mj_model
        assert made.body_mass[made.jnt_bodyid[made.joint(name).id]] == pytest.approx(
            own.body_mass[body], rel=1e-9
        )
        index = of_mjcf.pin_model.getJointId(name)
        assert of_mjcf.pin_model.inertias[index].mass == pytest.approx(
            own.body_mass[body], rel=1e-9
        )


@pytest.mark.slow
def test_one_of_two_different_files_can_be_loaded(tmp_path: Path) -> None:
    """Reference: total mass of the heavier URDF alone, and of the unchanged pair."""
    urdf, mjcf = pa.pupper.write_variant("original", tmp_path)
    heavier = tmp_path / "heavier.urdf"
    weight = re.compile(r'mass value="[0-9.]+"')
    heavier.write_text(weight.sub('mass value="2.35"', urdf.read_text(), count=1))
    own, other = pa.load_robot(urdf, mjcf).total_mass, pa.load_robot(heavier).total_mass
    assert other != pytest.approx(own)
    for take, mass in (("urdf", other), ("mjcf", own)):
        robot = pa.load_robot(heavier, mjcf, take=take)
        assert robot.total_mass == pytest.approx(mass)
        assert robot.mj_model.body_subtreemass[0] == pytest.approx(mass)
        assert robot.description.converted == {"urdf": "mjcf", "mjcf": "urdf"}[take]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give one file, or a URDF and an MJCF"),
        ({"models": (URDF, URDF)}, "pupper_v3.urdf: give one file"),
        ({"models": (URDF,), "urdf": URDF}, "give one file"),
        *(
            (
                {"models": (junk,)},
                "is not a robot; give a path, a name .*mujoco.MjSpec.*yourdfpy.URDF",
            )
            for junk in (5, None, b"v3", [URDF], pa.Robot)
        ),
        ({"urdf": URDF, "take": "mjcf"}, "take: no mjcf is among the given files"),
        ({"mjcf": MJCF, "take": "both"}, "give .urdf. or .mjcf."),
        ({"models": (Path("no/such.urdf"),)}, "no/such.urdf: there is no such file"),
    ],
)
def test_invalid_combination_of_files_is_refused(given: dict[str, object], message: str) -> None:
    models = given.pop("models", ())
    with pytest.raises(pa.PupperAnalysisError, match=message):
        pa.load_robot(*models, **given)  # type: ignore[misc, arg-type]


def test_file_of_the_wrong_format_is_refused_by_its_format(tmp_path: Path) -> None:
    """A file that MuJoCo refuses is refused with MuJoCo's reason, alone and beside a URDF."""
    with pytest.raises(pa.ModelError, match="the file is an MJCF"):
        pa.load_robot(urdf=MJCF)
    with pytest.raises(pa.ModelError, match="the file is a URDF"):
        pa.load_robot(mjcf=URDF)
    refused = tmp_path / "refused.xml"
    joint = '<worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
    refused.write_text(f'<mujoco>{joint}<actuator><motor joint="b"/></actuator></mujoco>')
    for files in ((refused,), (URDF, refused)):
        with pytest.raises(pa.ModelError, match="unknown transmission target 'b'"):
            pa.load_robot(*files)


RODS = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>
<geom size="0.1" mass="2"/><body name="leg"><joint name="hip" axis="0 1 0" damping="0.1"/>
<geom size="0.1" mass="1" pos="0 0 -0.3"/>
<body name="rod" pos="0 0 -0.3"><joint name="ball" type="ball"/>
<geom size="0.03" mass="0.5" pos="0.1 0 0"/></body></body></body></worldbody></mujoco>"""


def test_ball_joint_of_a_lone_mjcf_is_fixed_with_a_note(tmp_path: Path) -> None:
    """Closed form of the gravity torque about the hip [N m], with the rod at rest; and the
    cross-check of both engines.
    """
    file = tmp_path / "rods.xml"
    file.write_text(RODS)
    robot = pa.load_robot(file, feet=[])
    assert robot.joint_names == ("hip",)
    assert "ball-joints-fixed" in {note.code for note in robot.notes}
    # At rest: 1 kg 0.3 m below the hip, and the rod's 0.5 kg, 0.1 m beside that.
    config = pa.Configuration(robot, np.array([0, 0, 1, 0, 0, 0, 1, 0.3]))
    lever = 1.5 * 0.3 * np.sin(0.3) - 0.5 * 0.1 * np.cos(0.3)
    assert abs(config.gravity()[6]) == pytest.approx(9.81 * lever, rel=1e-9)
    assert pa.cross_check(robot).passed


GRIPPER = """<mujoco><worldbody><body name="base"><geom size="0.05"/>
<body name="arm" pos="0 0 0.1"><joint name="lift" axis="0 1 0" range="-100 100" damping="0.1"/>
<geom size="0.03" mass="1" pos="0.3 0 0"/>
<body name="jaw" pos="0.4 0 0"><joint name="slide" type="slide" axis="0 0 1" range="0 0.04"
damping="1"/><geom size="0.01" mass="0.1"/></body></body></body></worldbody>
<tendon><fixed name="string"><joint joint="slide" coef="1"/></fixed></tendon>
<actuator><position joint="lift" kp="500" kv="20"/>
<general tendon="string" gainprm="2" biastype="affine" biasprm="1 -400 -5"/></actuator></mujoco>"""


def test_tendon_servo_is_commanded_to_its_current_length(tmp_path: Path) -> None:
    """A command of 0 would close the gripper."""
    file = tmp_path / "gripper.xml"
    file.write_text(GRIPPER)
    arm = pa.load_robot(file)
    assert "motors-commanded-zero" in {note.code for note in arm.notes}
    held = pa.hold_posture(arm, {"lift": 0.2, "slide": 0.03})
    assert held.passed
    # 1 kg at 0.3 m and 0.1 kg at 0.4 m, 0.03 m off the arm's line.
    lift = 0.3 * np.cos(0.2) + 0.1 * (0.4 * np.cos(0.2) + 0.03 * np.sin(0.2))
    torque = held.statics.joint_torques[arm.joint_names.index("lift")]
    assert torque == pytest.approx(-9.81 * lift, rel=1e-9)


def _make_chain(first: str) -> str:
    """Return a URDF of two hinges in series, with the given inertial of the first link."""
    joints = format_joint("one", "base", "a", AXIS), format_joint("two", "a", "b", AXIS)
    return format_urdf(
        format_link("base", ""), format_link("a", first), format_link("b", ""), *joints
    )


AXIS = f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{LIMIT}'


def test_robot_without_any_mass_is_refused(tmp_path: Path) -> None:
    """A robot with a single massless link is accepted: the link gets 1 g, with a note."""
    path = tmp_path / "chain.urdf"
    path.write_text(_make_chain(""))
    with pytest.raises(pa.ModelError, match="the mass of all links is 0 kg"):
        pa.load_robot(path)
    path.write_text(_make_chain(INERTIAL))
    robot = pa.load_robot(path)
    assert [note.subject.name for note in robot.notes if note.code == "mass-given"] == ["b"]


def test_stand_of_an_arm_with_a_gripper_is_refused(tmp_path: Path) -> None:
    """The coupled fingers are not taken for a closed loop or a leg; the message names the fixed
    base."""
    place = {"axis": (0.0, 1.0, 0.0), "upper": 0.04, "lower": 0.0, "mass": 0.1}
    fingers = {
        name: Part(name, "palm", name, "prismatic", (0.0, y, 0.05), **place)  # type: ignore[arg-type]
        for name, y in (("left", 0.02), ("right", -0.02))
    }
    parts = {"base": Part("base"), "palm": Part("palm", "base", "wrist"), **fingers}
    path = tmp_path / "hand.xml"
    equality = '<equality><joint joint1="left" joint2="right"/></equality>'
    path.write_text(mjcf_text(parts, free=False, extra=equality))
    robot = pa.load_robot(path)
    with pytest.raises(pa.ConfigurationError, match="fixed base and cannot stand") as caught:
        pa.solve_stand(robot)
    assert "; pa.hold_posture computes" in str(caught.value)
    assert "a pa.StandTask with contacts={'base': pa.Weld()}" in str(caught.value)
    assert "--contact" not in str(caught.value)
    pa.solve_stand(robot, pa.StandTask(contacts={"base": pa.Weld()}))


def test_missing_meshes_of_feet_are_refused_with_the_required_files(tmp_path: Path) -> None:
    """The message contains mesh and --package option once, and does not mention a fixed base."""
    path = quadruped(tmp_path).urdf
    mesh = "package://all/robots/quad/foot.stl"
    shape = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
    rewrite_file(path, ("</link>", shape))
    with pytest.raises(pa.ConfigurationError) as refused:
        pa.solve_stand(pa.load_robot(path))
    message = str(refused.value)
    assert "cannot stand: no feet were found; a mesh file is missing" in message
    assert (message.count(mesh.rpartition("/")[2]), message.count("--package all=DIR")) == (1, 1)
    assert "fixed base" not in message


def test_ascii_meshes_of_feet_are_not_called_missing(tmp_path: Path) -> None:
    """As simple_humanoid's box.stl: the file exists, but MuJoCo reads binary STL only."""
    path = quadruped(tmp_path).urdf
    (tmp_path / "foot.stl").write_text("solid foot\nendsolid foot\n" + " " * 200)
    shape = '<collision><geometry><mesh filename="foot.stl"/></geometry></collision></link>'
    rewrite_file(path, ("</link>", shape))
    with pytest.raises(pa.ConfigurationError) as refused:
        pa.solve_stand(pa.load_robot(path))
    message = str(refused.value)
    assert "no feet were found; a mesh file was left out, because" in message
    assert "foot.stl" in message
    assert "missing" not in message
    assert "git lfs" not in message


@pytest.mark.slow
def test_limbs_on_a_link_fixed_to_a_massless_root_are_legs(tmp_path: Path) -> None:
    text = URDF.read_text()
    root = '<link name="root"/><joint name="to_root" type="fixed"><parent link="root"/>'
    root += '<child link="base_link"/></joint>'
    at = text.index(">", text.index("<robot")) + 1
    file = tmp_path / "rooted.urdf"
    file.write_text(text[:at] + root + text[at:].replace("../mjcf", str(MJCF.parent)))
    robot = pa.load_robot(file)
    assert robot.floating
    assert len(robot.feet) == 4


def test_scene_without_joints_is_no_robot(tmp_path: Path) -> None:
    """A drone: its only joint is the free joint."""
    file = tmp_path / "drone.xml"
    file.write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(pa.ModelError, match="the robot has no joints"):
        pa.load_robot(file)


def test_visual_shapes_with_mass_count(tmp_path: Path) -> None:
    """Reference: masses of MuJoCo's compiled model. As in Gym's Ant, ``inertiafromgeom`` gives mass
    to shapes without contacts.
    """
    leg = (
        '<body pos="{0} {1} 0"><joint name="hip{2}" axis="0 1 0" range="-1 1" limited="true"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" contype="0" conaffinity="0"/>'
        '<geom size="0.02" pos="0 0 -0.2"/></body>'
    )
    legs = "".join(leg.format(x, y, f"{x}{y}") for x in (-0.2, 0.2) for y in (-0.1, 0.1))
    path = tmp_path / "ant.xml"
    path.write_text(
        '<mujoco><compiler inertiafromgeom="true" angle="radian"/><worldbody>'
        f'<body name="trunk" pos="0 0 0.3"><freejoint/><geom type="box" size="0.2 0.1 0.05"/>{legs}'
        "</body></worldbody></mujoco>"
    )
    mass = float(mujoco.MjModel.from_xml_path(str(path)).body_mass.sum())
    robot = pa.load_robot(path, fixed_base=True, as_is=True)
    assert robot.total_mass == pytest.approx(mass)


def test_urdf_of_an_arm_keeps_its_base_fixed(tmp_path: Path) -> None:
    """Closed form: a mass of 2 kg, 0.2 m from the axis, at 0.5 rad."""
    file = tmp_path / "arm.urdf"
    file.write_text("""<robot name="arm"><link name="base"/>
      <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
        <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
        <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="9" velocity="3"/></joint></robot>""")
    robot = pa.load_robot(file)
    assert not robot.floating
    statics = pa.gravity_compensation(pa.Configuration(robot, np.array([0.5])), contacts=[])
    assert statics.joint_torques == pytest.approx([-2 * 9.81 * 0.2 * np.sin(0.5)], rel=1e-9)


def test_pair_is_read_in_any_order_and_by_keyword() -> None:
    for pair in (
        read_pair(URDF, MJCF),
        read_pair(MJCF, URDF),
        read_pair(URDF, mjcf=MJCF),
        read_pair(urdf=URDF, mjcf=MJCF),
    ):
        assert (pair.urdf.path, pair.mjcf.path, pair.converted) == (URDF, MJCF, "")


def test_absent_files_in_the_arguments_of_a_robot_count_as_not_given(tmp_path: Path) -> None:
    pair = quadruped(tmp_path)
    files = RobotFiles.from_arguments(urdf=str(pair.urdf), mjcf=None, name="dog")
    assert dict(files.options) == {"urdf": str(pair.urdf), "name": "dog"}
    assert str(files) == pair.urdf.name
    assert files.load().name == "dog"


def test_robot_of_a_read_mjcf_is_that_of_its_path(tmp_path: Path) -> None:
    path = quadruped(tmp_path).mjcf
    first, second = load_mjcf_robot(read_mjcf(path)), pa.load_robot(mjcf=path, visuals=False)
    assert first.joint_names == second.joint_names
    assert first.feet == second.feet
    assert first.published is not None
    assert first.published.file is not None
    np.testing.assert_array_equal(first.home, second.home)
    assert [note.code for note in first.notes] == [note.code for note in second.notes]
