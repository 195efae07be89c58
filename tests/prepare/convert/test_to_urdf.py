"""Conversion of an MJCF to a URDF: couplings that a URDF can express, and extraction of one robot
from a scene.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.prepare.convert.to_urdf import with_one_robot

FINGERS = """
<mujoco><compiler angle="radian"/>
<default><joint axis="0 1 0" range="-1 1" actuatorfrcrange="-3 3"/></default>
<worldbody><body name="palm">
  <geom size="0.05"/>
  <body name="one" pos="0.1 0 0"><joint name="first"/>
    <geom size="0.02" pos="0.1 0 0"/></body>
  <body name="two" pos="-0.1 0 0"><joint name="second"/>
    <geom size="0.02" pos="-0.1 0 0"/></body>
</body></worldbody><equality>{}</equality></mujoco>
"""


def convert_equality(folder: Path, equality: str) -> tuple[list[ElementTree.Element], list[str]]:
    """Return the joints of the URDF with a mimic, and the codes of elements that were not
    converted.
    """
    source, out = folder / "fingers.xml", folder / "fingers.urdf"
    source.write_text(FINGERS.format(equality))
    result = pa.convert_model(source, out)
    joints = ElementTree.parse(out).getroot().iter("joint")
    return [joint for joint in joints if joint.find("mimic") is not None], [
        left.code for left in result.not_converted
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "equality",
    [
        '<joint joint1="second" joint2="first" polycoef="0 1 0 0 0.5"/>',
        '<joint joint1="second" polycoef="0.1 0 0 0 0"/>',
        '<joint joint1="second" joint2="first" active="false"/>',
        '<weld body1="one" body2="two" active="true"/>',
    ],
)
def test_equality_that_is_no_mimic_is_left_out_with_a_note(tmp_path: Path, equality: str) -> None:
    """A fourth-order polynomial, a fixed joint, an inactive coupling and a weld."""
    mimics, left = convert_equality(tmp_path, equality)
    assert mimics == []
    assert left == ["equality-not-in-urdf"]


@pytest.mark.slow
def test_each_link_of_the_urdf_states_its_mass(tmp_path: Path) -> None:
    """PyBullet assumes 1 kg for a link without mass. Reference: total mass [kg] in MuJoCo."""
    source, out = tmp_path / "fingers.xml", tmp_path / "fingers.urdf"
    text = FINGERS.format("").replace(
        '<joint name="first"/>', '<joint name="first"/><site name="tip"/>'
    )
    source.write_text(text)
    pa.convert_model(source, out)
    links = list(ElementTree.parse(out).getroot().iter("link"))
    assert "tip" in {link.get("name") for link in links}
    masses = [link.find("inertial/mass") for link in links]
    assert None not in masses
    total = sum(float(mass.get("value", "nan")) for mass in masses if mass is not None)
    expected = mujoco.MjModel.from_xml_string(text).body_mass.sum()
    assert total == pytest.approx(expected, rel=1e-9)


ARM = """<body name="{name}" pos="0 {y} 1"><joint name="{name}_1" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
  <body name="{name}_end" pos="0.3 0 0"><joint name="{name}_2" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/><site name="{name}_tip"/>
  </body></body>"""
CUBE = '<body name="cube" pos="2 0 0.6"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>'
TABLE = '<body name="table" pos="2 0 0.5"><geom type="box" size="0.5 0.5 0.02"/></body>'
REST = """<actuator>
  <position name="own" joint="left_2" kp="9"/><position joint="right_2" kp="8"/>
  <position joint="left_1" kp="7"/></actuator>
<equality><joint joint1="left_1" joint2="right_1"/></equality>
<sensor><framepos objtype="site" objname="right_tip"/><jointpos joint="left_1"/></sensor>"""


def scene(folder: Path, *bodies: str, rest: str = "", key: str = "") -> Path:
    file = folder / "scene.xml"
    keyframe = f'<keyframe><key name="home" {key}/></keyframe>' if key else ""
    world = "".join(bodies)
    file.write_text(f"<mujoco><worldbody>{world}</worldbody>{rest}{keyframe}</mujoco>")
    return file


LEFT, RIGHT = ARM.format(name="left", y=0), ARM.format(name="right", y=1)


def test_extracted_robot_keeps_all_its_elements(tmp_path: Path) -> None:
    """Of two arms, a cube and a table: joints, actuators in their order, keyframe positions and
    commands, one sensor, and no equality with the other arm. The file itself is unchanged.
    """
    key = 'qpos="2 0 0.6 1 0 0 0 0.1 0.2 0.3 0.4" ctrl="0.2 0.4 0.1"'
    file = read_mjcf(scene(tmp_path, CUBE, TABLE, LEFT, RIGHT, rest=REST, key=key))
    for body in ("left", "left_end"):
        model = with_one_robot(file, body).model
        assert [model.joint(index).name for index in range(model.njnt)] == ["left_1", "left_2"]
        # Actuators and keyframe values of this robot, in the order of the file.
        joints = [model.joint(index).name for index in model.actuator_trnid[:, 0]]
        assert joints == ["left_2", "left_1"]
        np.testing.assert_array_equal(model.key_qpos, [[0.1, 0.2]])
        np.testing.assert_array_equal(model.key_ctrl, [[0.2, 0.1]])
        assert (model.neq, model.nsensor) == (0, 1)
        assert model.body("table").id > 0
    assert file.model.njnt == 5  # the file is as it was
    [message] = [
        note for note in with_one_robot(file, "right").notes if note.code == "others-left-out"
    ]
    assert list(message.values["bodies"]) == ["cube", "left"]


def test_objects_beside_an_arm_do_not_change_its_torques(tmp_path: Path) -> None:
    """Reference: the arm without the table and the cube with a free joint."""
    alone = pa.load_robot(scene(tmp_path, LEFT))
    eye = '<camera name="eye" mode="targetbodycom" target="cube"/>'
    robot = pa.load_robot(scene(tmp_path, CUBE, TABLE, eye, LEFT))
    qpos = np.array([0.4, -0.3])
    torques = [
        pa.gravity_compensation(pa.Configuration(model, qpos), contacts=[]).joint_torques
        for model in (alone, robot)
    ]
    np.testing.assert_allclose(*torques, atol=1e-12)
    assert robot.joint_names == ("left_1", "left_2")


def test_floating_robot_takes_precedence_over_hinged_objects(tmp_path: Path) -> None:
    """A walker beside a door on a hinge."""
    box = '<body name="door"><joint name="hinge"/><geom size="0.4"/></body>'
    walker = LEFT.replace('<joint name="left_1"', '<freejoint name="root"/><joint name="left_1"', 1)
    walker = walker.replace('<joint name="left_1" axis="0 1 0"/>', "")
    model = with_one_robot(read_mjcf(scene(tmp_path, box, walker))).model
    assert [model.joint(index).name for index in range(model.njnt)] == ["root", "left_2"]
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE


@pytest.mark.parametrize(
    ("bodies", "body", "message"),
    [
        ((CUBE, LEFT), "cube", "body 'cube' carries no hinge or slide joint"),
        ((TABLE, LEFT), "table", "body 'table' carries no hinge or slide joint"),
        ((LEFT,), "middle", "no body 'middle'"),
        ((TABLE,), None, "the robot has no joints"),
        ((CUBE, CUBE.replace("cube", "ball")), None, "several free bodies"),
    ],
)
def test_scene_without_a_single_robot_is_refused(
    tmp_path: Path, bodies: tuple[str, ...], body: str | None, message: str
) -> None:
    with pytest.raises(pa.PupperAnalysisError, match=message):
        pa.load_robot(scene(tmp_path, *bodies), body=body)


def test_body_option_is_refused_for_a_urdf() -> None:
    from pupper_analysis.pupper.variants import find_model_folder

    with pytest.raises(pa.ConfigurationError, match="selects a body of an MJCF"):
        pa.load_robot(find_model_folder("urdf") / "pupper_v3.urdf", body="base_link")


@pytest.mark.slow
def test_contact_parameters_and_options_that_a_urdf_cannot_state_are_listed(
    tmp_path: Path,
) -> None:
    """Contact parameters of a geom without contact are not listed."""
    text = FINGERS.format("").replace(
        "<default>",
        '<option impratio="7" integrator="RK4"/><default><geom friction="0.6 0.1 0.2" condim="6"/>',
    )
    seen = '<geom size="0.01" friction="0.1" contype="0" conaffinity="0"/></body>\n</body>'
    source, urdf = tmp_path / "r.xml", tmp_path / "r.urdf"
    source.write_text(text.replace("</body>\n</body>", seen, 1))
    listed = {
        str(part.values["what"]): part.values["values"]
        for part in pa.convert_model(source, urdf).not_converted
        if part.code in ("contact-number-not-in-urdf", "option-not-in-urdf")
    }
    assert listed == {
        "friction": ("0.6 0.1 0.2",),
        "condim": ("6",),
        "impratio": ("7",),
        "integrator": ("1",),
    }
    assert not any(word in urdf.read_text() for word in listed)


@pytest.mark.slow
def test_linear_equality_of_joints_becomes_a_mimic(tmp_path: Path) -> None:
    """Reference: second = 0.1 - 2 first."""
    (joint,), left = convert_equality(
        tmp_path, '<joint joint1="second" joint2="first" polycoef="0.1 -2 0 0 0"/>'
    )
    assert left == []
    assert joint.get("name") == "second"
    mimic = joint.find("mimic")
    assert mimic is not None
    assert mimic.get("joint") == "first"
    assert float(mimic.get("multiplier", "1")) == -2
    assert float(mimic.get("offset", "0")) == pytest.approx(0.1)


def test_mjcf_with_several_robots_requires_a_name(tmp_path: Path) -> None:
    left, right = ARM.format(name="left", y=0), ARM.format(name="right", y=1)
    file = scene(tmp_path, left, right)
    with pytest.raises(pa.ModelError, match=r"several robots, .*'left' with 2 joints, 'right' .*"):
        pa.load_robot(file)
    assert pa.load_robot(file, body="right").joint_names == ("right_1", "right_2")


def test_several_robots_with_free_bases_have_no_fixed_base(tmp_path: Path) -> None:
    """Each arm is on a body with a free joint."""
    arms = (ARM.format(name=name, y=y) for name, y in (("left", 0), ("right", 1)))
    free = (f'<body><freejoint/><geom size="0.1"/>{arm}</body>' for arm in arms)
    with pytest.raises(pa.ModelError, match="several robots") as error:
        pa.load_robot(scene(tmp_path, *free))
    assert "fixed base" not in str(error.value)


@pytest.mark.parametrize(("body", "severity"), [(None, "warning"), ("right", "note")])
def test_objects_that_are_left_out_are_a_warning_unless_the_robot_is_selected(
    tmp_path: Path, body: str | None, severity: str
) -> None:
    """Objects may touch the robot: the file may collapse although the robot alone stands."""
    file = read_mjcf(scene(tmp_path, CUBE, ARM.format(name="right", y=1)))
    (note,) = (n for n in with_one_robot(file, body).notes if n.code == "others-left-out")
    assert note.severity == severity


@pytest.mark.parametrize(
    ("ends", "effort", "noted"), [("-9 4", 4.0, True), ("0 9", 9.0, True), ("-9 9", 9.0, False)]
)
def test_effort_permits_no_torque_beyond_the_range_of_two_directions(
    tmp_path: Path, ends: str, effort: float, noted: bool
) -> None:
    """Reference: the stated ends. A range of one direction has no effort that both models share."""
    mjcf = tmp_path / "arm.xml"
    mjcf.write_text(
        '<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 1 0" range="-60 60"/>'
        '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body></worldbody>'
        f'<actuator><position joint="turn" kp="90" forcerange="{ends}"/></actuator></mujoco>'
    )
    result = pa.convert_model(mjcf, tmp_path / "arm.urdf")
    assert f'effort="{effort:g}"' in (tmp_path / "arm.urdf").read_text()
    assert ("range-becomes-effort" in {left.code for left in result.not_converted}) is noted
