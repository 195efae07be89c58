"""Verdicts of held postures contain the simulation of the unmodified file, as those of stands."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.present.verdict import format_verdict
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from pupper_analysis.tools.hold.hold import hold_posture
from tests.prepare.test_own_run import codes
from tests.prepare.test_planted import causes, is_cause_right
from tests.support import arm, arm_features, features


def _make_servos(gain: float, bias: float) -> str:
    return "".join(
        f'<general joint="{name}" gainprm="{gain * kp}" biastype="affine" '
        f'biasprm="{bias} -{kp} -20"/>'
        for name, kp in arm.STIFFNESS.items()
    )


_ELBOW = '<position joint="elbow" kp="300.0" kv="20"/>'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("servos", "code", "joint"),
    [
        (arm._SERVOS, VerdictCode.HOLDS, None),
        (_make_servos(1.0, 5.0), VerdictCode.DIFFERS_AS_PUBLISHED, None),
        (_make_servos(1.1, 0.0), VerdictCode.DIFFERS_AS_PUBLISHED, None),
        (
            arm._SERVOS.replace(_ELBOW, '<velocity joint="elbow" kv="20"/>'),
            VerdictCode.OWN_DRIVES_FAIL,
            "elbow",
        ),
        (
            arm._SERVOS.replace(_ELBOW, '<motor joint="elbow"/>'),
            VerdictCode.OWN_DRIVES_FAIL,
            "elbow",
        ),
        (arm._SERVOS.replace(_ELBOW, ""), VerdictCode.OWN_DRIVES_FAIL, "elbow"),
    ],
    ids=["sound", "a bias", "a gain", "velocity", "motor", "none"],
)
def test_posture_verdict_follows_the_unmodified_file(
    tmp_path: Path, servos: str, code: VerdictCode, joint: str | None
) -> None:
    """One actuator of the MJCF is changed per case; the joint that nothing holds is named."""
    robot = arm.load_arm(tmp_path, mjcf=arm.MJCF.replace(arm._SERVOS, servos))
    verdict = hold_posture(robot, {"shoulder": -0.5, "elbow": 1.0}).verdict
    assert verdict.code is code, format_verdict(verdict)
    assert "own-run" in codes(verdict)
    assert verdict.keyframe_run is not None
    assert (verdict.keyframe_run.unheld and verdict.keyframe_run.unheld.joint) == joint


def test_arm_verdict_includes_the_mujoco_import(tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    inertial = (
        '<inertial><origin xyz="0.2 0 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    urdf.write_text(
        f'<robot name="arm"><link name="base"/><link name="arm">{inertial}</link>'
        '<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="5"/></joint></robot>'
    )
    verdict = hold_posture(pa.load_robot(urdf), {"shoulder": 0.5}).verdict
    assert verdict.passed, format_verdict(verdict)
    assert verdict.keyframe_run is not None
    assert verdict.keyframe_run.imported
    assert "MuJoCo's import of the URDF" in format_verdict(verdict)


@pytest.mark.slow
@pytest.mark.parametrize("gravity", ["0 0 -1.62", "0 0 0"])
def test_gravity_that_is_not_the_earths_stands_in_the_verdict(tmp_path: Path, gravity: str) -> None:
    """Without gravity the motors hold any mass, which is not true on the ground."""
    _, mjcf = features.write_files(tmp_path, features.make_option_edit(f'gravity="{gravity}"'))
    text = format_verdict(hold_posture(pa.load_robot(mjcf, fixed_base=True)).verdict)
    assert f"gravity is taken from the MJCF: ({gravity.replace(' ', ', ')}) m/s^2" in text


def judge_posture(urdf: Path, mjcf: Path) -> Verdict:
    """Return the verdict of the arm's posture with a bent shoulder and elbow."""
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
    return hold_posture(robot, {"shoulder": -0.5, "elbow": 1.0}).verdict


ODD = {
    "a bias of 20": ("servos-are-biased",),
    "a gain of half": ("gain-is-no-stiffness", "own-run"),
    "an affine gain": ("gain-is-not-fixed", "own-run"),
    "one motor": ("own-run",),
    "one velocity servo": ("own-run",),
    "kp -800 at a joint": ("own-servos-fail", "own-run"),
    "servos in a disabled group": ("actuators-disabled",),
    "timeconst 10": ("timeconst-too-long",),
    "forcerange 5": ("motors-overloaded", "forcerange-cuts-off"),
    "ctrlrange": ("ctrlrange-cuts-off",),
    "joint damping -30": ("joints-damped-negatively", "rests-on-made-up"),
    "a thruster": ("motors-elsewhere-push",),
}
"""{feature of an arm: codes of causes that may be reported}."""


@pytest.mark.slow
@pytest.mark.parametrize("feature", ODD)
def test_planted_fault_of_an_arm_is_named(tmp_path: Path, feature: str) -> None:
    """The first reported causes are those of `ODD`; see `is_cause_right`."""
    urdf, mjcf = arm_features.files(tmp_path, arm_features.FEATURES[feature])
    assert is_cause_right(urdf, mjcf, ODD[feature], judge_posture)
    if feature == "forcerange 5":  # the overloaded motor, then the range that limits the motor
        assert causes(judge_posture(urdf, mjcf))[:2] == list(ODD[feature])
