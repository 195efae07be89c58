"""A robot of one file: the other model is made of it, and says the same."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.convert.load import read_pair
from pupper_analysis.pupper.variants import model_folder

URDF, MJCF = model_folder("urdf") / "pupper_v3.urdf", model_folder("mjcf") / "pupper_v3.xml"
FEET = {
    "FR": "leg_front_r_3_foot_site",
    "FL": "leg_front_l_3_foot_site",
    "RR": "leg_back_r_3_foot_site",
    "RL": "leg_back_l_3_foot_site",
}


@pytest.fixture(scope="module")
def both() -> pa.Robot:
    return pa.load_robot(URDF, MJCF, feet=FEET, self_check=False)


@pytest.fixture(scope="module")
def of_urdf() -> pa.Robot:
    return pa.load_robot(URDF, feet=FEET)


@pytest.fixture(scope="module")
def of_mjcf() -> pa.Robot:
    return pa.load_robot(MJCF, feet=FEET, self_check=False)


def bent(robot: pa.Robot) -> np.ndarray:
    """A configuration that no symmetry helps, with each joint by its name."""
    qpos = robot.neutral()
    qpos[3:7] = np.array([0.9, 0.2, -0.3, 0.1]) / np.linalg.norm([0.9, 0.2, -0.3, 0.1])
    for index, name in enumerate(robot.joint_names):
        side = 1.0 if "_l_" in name else -1.0
        qpos[robot.nq - robot.nu + index] = side * (0.1 * int(name[-1]) + 0.02 * ("back" in name))
    return qpos


@pytest.mark.parametrize("which", ["of_urdf", "of_mjcf"])
def test_each_file_alone_is_the_robot_of_both(
    which: str, both: pa.Robot, request: pytest.FixtureRequest
) -> None:
    """Both engines, by joint and foot: the made model has mass, com, inertia, axes and feet."""
    one: pa.Robot = request.getfixturevalue(which)
    assert one.total_mass == pytest.approx(both.total_mass, rel=1e-12)
    assert set(one.joint_names) == set(both.joint_names)
    there, here = pa.Configuration(both, bent(both)), pa.Configuration(one, bent(one))
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


def test_the_made_model_has_what_only_the_other_engine_reads(
    of_urdf: pa.Robot, of_mjcf: pa.Robot
) -> None:
    """MuJoCo's model of the URDF, and Pinocchio's of the MJCF: masses, by the bodies' names."""
    own = mujoco.MjModel.from_xml_path(str(MJCF))
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


def test_it_is_said_that_there_was_one_file(
    both: pa.Robot, of_urdf: pa.Robot, of_mjcf: pa.Robot
) -> None:
    assert both.description.converted == ""
    for robot, made, file in ((of_urdf, "mjcf", URDF), (of_mjcf, "urdf", MJCF)):
        assert robot.description.converted == made
        [told] = [note for note in robot.notes if note.code == "one-model-converted"]
        assert (told.values["made"], told.values["file"]) == (made.upper(), file.name)
        again = pickle.loads(pickle.dumps(robot))
        assert again.description.converted == made
        np.testing.assert_array_equal(
            pa.Configuration(again, again.neutral()).gravity(),
            pa.Configuration(robot, robot.neutral()).gravity(),
        )
    # An MJCF that was made was not published: there is nothing to be checked of it.
    assert of_urdf.published is None
    assert of_urdf.own_run is None


def test_a_verdict_says_so(of_mjcf: pa.Robot, both: pa.Robot) -> None:
    from pupper_analysis.analysis.stance import study_stance
    from pupper_analysis.report.verdict import in_words, verdict_word

    verdict = study_stance(of_mjcf, pa.StandTask()).verdict
    assert verdict.passed
    assert verdict_word(verdict).en == "HOLDS (from one file)"
    assert "(from one file) " in in_words(verdict)
    assert "one file" not in in_words(study_stance(both, pa.StandTask()).verdict)


def test_of_two_files_one_can_be_taken(tmp_path: Path) -> None:
    """The URDF's numbers, and then the MJCF's, where they are of two robots."""
    urdf, mjcf = pa.pupper.write_variant("original", tmp_path)
    heavier = tmp_path / "heavier.urdf"
    weight = re.compile(r'mass value="[0-9.]+"')
    heavier.write_text(weight.sub('mass value="2.35"', urdf.read_text(), count=1))
    own, other = pa.load_robot(urdf, mjcf).total_mass, pa.load_robot(heavier).total_mass
    assert other != pytest.approx(own)
    for take, mass in (("urdf", other), ("mjcf", own)):
        robot = pa.load_robot(heavier, mjcf, take=take, self_check=False)
        assert robot.total_mass == pytest.approx(mass)
        assert robot.mj_model.body_subtreemass[0] == pytest.approx(mass)
        assert robot.description.converted == {"urdf": "mjcf", "mjcf": "urdf"}[take]


def test_files_come_in_any_order_and_by_either_word() -> None:
    pairs = [read_pair(URDF, MJCF), read_pair(MJCF, URDF), read_pair(URDF, mjcf=MJCF)]
    pairs.append(read_pair(urdf=URDF, mjcf=MJCF))
    for pair in pairs:
        assert (pair.urdf.path, pair.mjcf.path, pair.converted) == (URDF, MJCF, "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give one file, or a URDF and an MJCF"),
        ({"models": (URDF, URDF)}, "pupper_v3.urdf: give one file"),
        ({"models": (URDF,), "urdf": URDF}, "give one file"),
        ({"models": (5,)}, "5 is not a text or a path"),
        ({"urdf": URDF, "take": "mjcf"}, "take: there is no such file among those given: mjcf"),
        ({"mjcf": MJCF, "take": "both"}, "give .urdf. or .mjcf."),
        ({"models": (Path("no/such.urdf"),)}, "no/such.urdf: there is no such file"),
    ],
)
def test_what_is_no_robot_is_refused(given: dict[str, object], message: str) -> None:
    models = given.pop("models", ())
    with pytest.raises(pa.PupperAnalysisError, match=message):
        pa.load_robot(*models, **given)  # type: ignore[misc, arg-type]


ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="3"/></joint>
</robot>"""


def test_an_arm_keeps_its_base_in_the_world(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    robot = pa.load_robot(file)
    assert not robot.floating
    torque = pa.gravity_compensation(pa.Configuration(robot, np.array([0.5])), contacts=[])
    # A weight of 2 kg, 0.2 m from the axis, leaning forward: the motor holds it back.
    assert torque.joint_torques == pytest.approx([-2 * 9.81 * 0.2 * np.sin(0.5)], rel=1e-9)


def test_limbs_on_a_link_that_is_fixed_to_the_root_are_legs(tmp_path: Path) -> None:
    """As published: a root without mass, the trunk fixed to it, the legs on the trunk."""
    text = URDF.read_text()
    root = '<link name="root"/><joint name="to_root" type="fixed"><parent link="root"/>'
    root += '<child link="base_link"/></joint>'
    at = text.index(">", text.index("<robot")) + 1
    file = tmp_path / "rooted.urdf"
    file.write_text(text[:at] + root + text[at:].replace("../mjcf", str(MJCF.parent)))
    robot = pa.load_robot(file)
    assert robot.floating
    assert len(robot.feet) == 4


def test_a_file_under_the_other_ones_name_is_told(tmp_path: Path) -> None:
    with pytest.raises(pa.ModelError, match="it is an MJCF"):
        pa.load_robot(urdf=MJCF)
    with pytest.raises(pa.ModelError, match="it is a URDF"):
        pa.load_robot(mjcf=URDF)
    refused = tmp_path / "refused.xml"
    joint = '<worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
    refused.write_text(f'<mujoco>{joint}<actuator><motor joint="b"/></actuator></mujoco>')
    for files in ((refused,), (URDF, refused)):
        with pytest.raises(pa.ModelError, match="unknown transmission target 'b'"):
            pa.load_robot(*files)
