"""Ties of an arm to the world in a study of heat: same verdict and words as `hold`."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.present.document import get_english
from pupper_analysis.tools.heat.document import heat_document
from pupper_analysis.tools.heat.heat import HeatStudy, study_heat

ARM = """<mujoco><option integrator="implicitfast"/><worldbody><body name="base" pos="0 0 1">
<inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/><body name="link">
<joint name="hinge" axis="0 1 0" damping="1"/>
<inertial pos=".3 0 0" mass="1" diaginertia=".01 .01 .01"/></body></body></worldbody>
<equality><weld name="bolt" body1="world" body2="link" relpose="0 0 1 1 0 0 0"/></equality>
<actuator><position joint="hinge" kp="{kp}" kv="5"/></actuator>
<keyframe><key name="home" qpos="{angle}" ctrl="{angle}"/></keyframe></mujoco>"""


def study_arm(folder: Path, kp: float, angle: float, *, tied: bool = True) -> HeatStudy:
    """Return the heat of an arm of 1 kg, 0.3 m from a horizontal hinge."""
    text = ARM.format(kp=kp, angle=angle)
    (folder / "arm.xml").write_text(text if tied else text.replace("<weld", '<weld active="false"'))
    robot = pa.load_robot(folder / "arm.xml")
    motor = Motor("strong", "bench", peak_torque=20.0, continuous_torque=10.0)
    task = pa.StandTask(contacts={"base": pa.Weld()})
    return study_heat(robot, task, {"hinge": motor})


@pytest.mark.parametrize(
    ("kp", "angle", "word", "codes"),
    [
        (200.0, 0.0, "COOL", ["link-tied"]),
        (200.0, 0.2, "DISAGREES", ["keyframe-violates-constraints", "link-tied"]),
        (2.0, 0.0, "FAILS", ["link-tied"]),
    ],
    ids=["tied", "keyframe beside the tie", "soft servo"],
)
def test_tie_of_the_arm_is_named(
    tmp_path: Path, kp: float, angle: float, word: str, codes: list[str]
) -> None:
    """The servo of 2 N m/rad alone deflects by more than 1 rad under m g l = 2.9 N m.

    The servo commanded to 0.2 rad presses against the tie with 40 N m, which the torque does not
    contain.
    """
    study = study_arm(tmp_path, kp, angle)
    assert [tie.code for tie in study.ties] == codes
    assert abs(study.motors[0].torque) == pytest.approx(9.81 * 0.3, rel=1e-3)
    assert study.passed is (word == "COOL")
    document = heat_document(study)
    assert document.verdict is not None
    assert get_english(document.verdict) == word
    shown = document.findings[1] if study.passed else document.failures[0]
    assert "bolt" in shown.short
    assert "bolt" in shown.zh


def test_arm_without_an_active_tie_has_no_message(tmp_path: Path) -> None:
    study = study_arm(tmp_path, 200.0, 0.0, tied=False)
    assert study.ties == ()
    assert study.passed
