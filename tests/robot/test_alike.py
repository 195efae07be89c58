"""A limb without a foot, where those that are alike have one, is in the verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.robot.alike import structure
from pupper_analysis.simulation.verdict import VerdictCode
from tests.support.conversions import standing_urdf
from tests.support.legged import edited_by


def slipped(folder: Path, old: str, new: str) -> Path:
    """The quadruped with something changed in its last leg alone."""
    return edited_by(standing_urdf(folder), lambda text: new.join(text.rsplit(old, 1)))


def test_four_legs_that_are_alike_are_no_news(tmp_path: Path) -> None:
    assert structure(pa.load_robot(standing_urdf(tmp_path))) == ()


def test_a_calf_that_is_elsewhere_is_named_with_its_gap(tmp_path: Path) -> None:
    """One digit, -0.2 -> -0.02, and the robot stands on three feet: that is no HOLDS."""
    path = slipped(tmp_path, 'xyz="0.0 0.0 -0.2"', 'xyz="0.0 0.0 -0.02"')
    robot = pa.load_robot(path)
    [message] = structure(robot)
    assert (message.values["feet"], message.values["alike"]) == (3, 4)
    assert message.values["gap"].value == pytest.approx(0.18, abs=1e-6)
    verdict = judge_stand(robot, pa.solve_stand(robot))
    assert verdict.code is VerdictCode.LIMB_WITHOUT_FOOT
    assert not verdict.passed
    assert verdict.remarks[0] == message
    held = pa.hold_posture(pa.load_robot(path, fixed_base=True))
    assert "RR_calf is 180 mm from where the others" in " ".join(map(str, held.verdict.remarks))
    converted = pa.convert_model(path, tmp_path / "slipped.xml")
    assert message.code in {one.code for one in converted.failures}
    assert not converted.passed
    assert pa.convert_model(standing_urdf(tmp_path), tmp_path / "sound.xml").passed


def test_a_calf_that_is_elsewhere_is_named_though_it_has_a_foot(tmp_path: Path) -> None:
    """With -0.19 in place of -0.2 all four feet are on the ground."""
    path = slipped(tmp_path, 'xyz="0.0 0.0 -0.2"', 'xyz="0.0 0.0 -0.19"')
    robot = pa.load_robot(path)
    [message] = structure(robot)
    [finding] = message.values["findings"]
    assert (len(robot.feet), finding.subject.name) == (4, "RR_calf")
    assert finding.values["gap"].value == pytest.approx(0.01, abs=1e-6)
    assert message in judge_stand(robot, pa.solve_stand(robot)).remarks
    assert message in pa.convert_model(path, tmp_path / "slipped.xml").notes


def test_a_sole_without_a_shape_is_named(tmp_path: Path) -> None:
    robot = pa.load_robot(slipped(tmp_path, '<sphere radius="0.02"/>', ""))
    [message] = structure(robot)
    assert message.values["gap"] is None
    assert "no collision shape" in str(message)


def test_feet_that_are_named_are_as_they_are_meant(tmp_path: Path) -> None:
    robot = pa.load_robot(standing_urdf(tmp_path), feet=["FL_calf", "FR_calf", "RL_calf"])
    assert len(robot.feet) == 3
    assert structure(robot) == ()


@pytest.mark.parametrize(
    ("slip", "said"),
    [
        ('effort="8"', "RR_knee has effort 8, FL_knee 80"),
        ('upper="-1.8"', "RR_knee has range 0.8, FL_knee 2.2"),
    ],
)
def test_a_joint_with_another_number_than_its_like_is_in_the_verdict(
    slip: str, said: str, tmp_path: Path
) -> None:
    old = 'effort="80"' if "effort" in slip else 'upper="-0.4"'
    robot = pa.load_robot(slipped(tmp_path, old, slip))
    *_, message = structure(robot)  # one of half the range has no foot where the others stand
    assert said in str(message)
    assert message in judge_stand(robot, pa.solve_stand(robot)).remarks


def test_a_joint_without_the_limits_of_its_like_has_an_infinite_range() -> None:
    robot = pa.load_variant("v3")
    robot.mj_model.jnt_limited[robot.mj_model.joint("leg_back_l_3").id] = 0
    [message] = structure(robot)
    assert "leg_back_l_3 has range inf" in str(message)
