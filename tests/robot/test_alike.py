"""A limb without foot is reported if equal limbs have feet, and the verdict fails."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.robot.alike import list_limbs, report_limbs_without_feet, sibling_joints
from pupper_analysis.simulation.verdict import VerdictCode
from tests.support.conversions import write_standing_urdf
from tests.support.legged import edited_by


def write_slip(folder: Path, old: str, new: str) -> Path:
    """Return a quadruped with an edit in its last leg only."""
    return edited_by(write_standing_urdf(folder), lambda text: new.join(text.rsplit(old, 1)))


def test_shared_joint_has_the_siblings_of_all_its_limbs() -> None:
    """The waist moves a short and a long arm; each is similar to another limb."""

    def limb(name: str, *lengths: float) -> str:
        arms = "".join(
            f'<body name="{name}_{number}" pos="0 0 {length}"><joint name="{name}_{number}"/>'
            f'<geom size="0.01" mass="{length}"/></body>'
            for number, length in enumerate(lengths)
        )
        return f'<body name="{name}"><joint name="{name}"/><geom size="0.01"/>{arms}</body>'

    bodies = limb("waist", 0.1, 0.3) + limb("short", 0.1) + limb("long", 0.3)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>{bodies}</body>'
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    robot: Any = SimpleNamespace(mj_model=model, mj_base="base", compute_kinematics=lambda: data)
    siblings = sibling_joints(robot)
    assert siblings["waist"] == ("short", "long")
    assert siblings["waist_0"] == ("short_0",)
    assert siblings["long"] == ("waist",)


@pytest.mark.slow
def test_four_equal_legs_with_feet_give_no_report(tmp_path: Path) -> None:
    assert report_limbs_without_feet(pa.load_robot(write_standing_urdf(tmp_path))) == ()


@pytest.mark.slow
def test_leg_with_a_misplaced_calf_is_reported_and_the_verdict_fails(tmp_path: Path) -> None:
    """One digit, -0.2 -> -0.02, leaves a robot that stands on three feet."""
    path = write_slip(tmp_path, 'xyz="0.0 0.0 -0.2"', 'xyz="0.0 0.0 -0.02"')
    robot = pa.load_robot(path)
    [message] = report_limbs_without_feet(robot)
    assert (message.values["feet"], message.values["alike"]) == (3, 4)
    verdict = judge_stand(robot, pa.solve_stand(robot))
    assert verdict.code is VerdictCode.LIMB_WITHOUT_FOOT
    assert not verdict.passed
    assert verdict.remarks[0] == message
    converted = pa.convert_model(path, tmp_path / "slipped.xml")
    assert message.code in {failure.code for failure in converted.failures}
    assert not converted.passed
    assert pa.convert_model(write_standing_urdf(tmp_path), tmp_path / "sound.xml").passed


def test_leg_without_a_foot_shape_is_named(tmp_path: Path) -> None:
    robot = pa.load_robot(write_slip(tmp_path, '<sphere radius="0.02"/>', ""))
    [message] = report_limbs_without_feet(robot)
    assert "RR_calf has no foot" in str(message)


@pytest.mark.slow
def test_limbs_of_different_masses_are_similar_by_their_dimensions(tmp_path: Path) -> None:
    """The calves have 0.2, 0.3, 0.4 and 0.5 kg, and equal lengths; the last leg has no foot."""
    path = write_slip(tmp_path, '<sphere radius="0.02"/>', "")
    before, *legs = path.read_text().split('_calf">')
    calves = [leg.replace('mass value="0.2"', f'mass value="{0.2 + 0.1 * number}"', 1)
              for number, leg in enumerate(legs)]  # fmt: skip
    path.write_text('_calf">'.join([before, *calves]))
    robot = pa.load_robot(path)
    assert len({round(float(limb.masses[-1]), 3) for limb in list_limbs(robot)}) == 4
    [message] = report_limbs_without_feet(robot)
    assert (message.values["feet"], message.values["alike"]) == (3, 4)


@pytest.mark.slow
def test_named_feet_are_used_without_a_report(tmp_path: Path) -> None:
    robot = pa.load_robot(write_standing_urdf(tmp_path), feet=["FL_calf", "FR_calf", "RL_calf"])
    assert len(robot.feet) == 3
    assert report_limbs_without_feet(robot) == ()
