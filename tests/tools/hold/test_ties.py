"""Postures of robots with a fixed base whose links are tied to the world by constraints."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.prepare.judge import describe_violated_keyframe
from pupper_analysis.prepare.own_run import simulate_fixed_base
from pupper_analysis.prepare.self_check import report_posture_ties
from pupper_analysis.simulation.verdict import VerdictCode
from pupper_analysis.stance.posture import find_posture
from pupper_analysis.tools.hold.document import hold_document
from pupper_analysis.tools.hold.hold import hold_posture
from tests.support import arm
from tests.support.commands import answer
from tests.support.legged import rewrite_file


def _simulate_bare(path: Path, *, tied: bool = True) -> tuple[NDArray[np.float64], mujoco.MjData]:
    """Simulate a file from its keyframe for 5 s; return the joint displacements and the state."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.eq_active[:] = tied
    start = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    return data.qpos - start, data


@pytest.mark.parametrize("kind", ["weld", "connect"])
@pytest.mark.parametrize("ctrl", [True, False])
@pytest.mark.parametrize("offset", [0.0, 0.2, 0.8])
def test_keyframe_that_violates_a_tie_is_not_held(
    tmp_path: Path, kind: str, ctrl: bool, offset: float
) -> None:
    """Reference: displacement of the joints from the keyframe in bare MuJoCo, and motor torques."""
    robot = arm.write_tied_arm(tmp_path, kind, {"a_turn": offset}, ctrl=ctrl)
    joints = find_posture(robot).qpos
    message = describe_violated_keyframe(robot, joints)
    (tie,) = report_posture_ties(robot, joints)
    assert tie.values["names"] == ("bolt",)
    assert tie.values["line"] is not None
    assert tie.severity == "warning"
    if not ctrl:
        assert (message is not None) is (offset > 0)
        return
    moved, data = _simulate_bare(tmp_path / "arm.xml")
    run = simulate_fixed_base(robot, joints)
    assert run is not None
    assert run.keyframe == "home"
    assert run.worst is not None
    assert abs(run.worst.off) == pytest.approx(np.abs(moved).max(), abs=5e-3)
    assert run.fails is bool(np.abs(moved).max() > 0.5)
    assert (message is not None) is (offset > 0)
    if message is None:
        assert np.abs(moved).max() < 0.02
        return
    # In bare MuJoCo, the servos press against the tie: no torque of the judged posture.
    judged = arm.holding_torques(*(joints[robot.joint_names.index(name)] for name in arm.ANCHOR))
    torque = data.actuator_force[arm.ORDER.index("a_turn")]
    pressing = offset * arm.STIFFNESS["a_turn"]
    assert torque - judged["a_turn"] == pytest.approx(pressing, rel=0.1)
    assert message.values["bonds"] == (f"{kind} bolt",)


@pytest.mark.parametrize("kind", ["weld", "connect"])
@pytest.mark.parametrize(
    ("offset", "code"),
    [
        (0.0, VerdictCode.HOLDS),
        (0.2, VerdictCode.DISAGREES),
        (0.8, VerdictCode.OWN_DRIVES_FAIL),
    ],
)
def test_verdict_of_a_tied_arm_names_the_tie(
    tmp_path: Path, kind: str, offset: float, code: VerdictCode
) -> None:
    hold = hold_posture(arm.write_tied_arm(tmp_path, kind, {"a_turn": offset}))
    verdict = hold.verdict
    document = hold_document(hold)
    shown = document.findings if document.passed else document.failures
    for language in ("en", "zh"):
        assert any("bolt" in getattr(line, language, "") for line in shown[:2])
    failing = {VerdictCode.OWN_DRIVES_FAIL, VerdictCode.FAILS}
    assert verdict.code in (failing if code in failing else {code})
    assert "link-tied" in [remark.code for remark in verdict.remarks]


def test_stand_with_a_welded_base_simulates_the_keyframe_of_a_tied_arm(tmp_path: Path) -> None:
    """Reference: bare MuJoCo moves a joint of the arm by 0.8 rad from the keyframe."""
    arm.write_tied_arm(tmp_path, "weld", {"a_turn": 0.8})
    path = tmp_path / "arm.xml"
    assert np.abs(_simulate_bare(path)[0]).max() > 0.7
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    rewrite_file(path, ('<body name="base">', f'<body name="base">{inertial}'))
    result = answer("stand", str(path), "--contact", "base=weld", folder=tmp_path)
    assert result.returncode == 1
    assert result.stdout.startswith("FAILS")
    assert "tied to the world by bolt" in result.stdout


def test_requested_joint_does_not_hide_that_a_keyframe_violates_a_tie(tmp_path: Path) -> None:
    """The slide is requested; the connect turns the arm by 0.2 rad from the keyframe."""
    robot = arm.write_tied_arm(tmp_path, "connect", {"a_turn": 0.2})
    verdict = hold_posture(robot, {"b_slide": 0.05}).verdict
    assert verdict.code is VerdictCode.DISAGREES
    (message,) = verdict.failures
    assert message.code == "keyframe-violates-constraints"
    assert message.values["joint"] == "a_turn"
    # The requested joints are the ones that the keyframe would place elsewhere.
    assert hold_posture(robot, arm.ANCHOR).verdict.passed


def test_posture_that_only_a_tie_holds_does_not_pass(tmp_path: Path) -> None:
    """Reference: bare MuJoCo with and without the tie; the servos of 2 N m/rad are too soft."""
    robot = arm.write_tied_arm(tmp_path, "weld", {}, arm.SOFT_SERVOS)
    path = tmp_path / "arm.xml"
    assert np.abs(_simulate_bare(path)[0]).max() < 0.05
    assert np.abs(_simulate_bare(path, tied=False)[0]).max() > 0.5
    verdict = hold_posture(robot).verdict
    assert verdict.code is VerdictCode.TIED
    (tie,) = [remark for remark in verdict.remarks if remark.code == "link-tied"]
    assert tie.values["leaves"] is True


FOUR_BAR = """<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
<body name="base"><geom size=".05" mass="1" contype="0" conaffinity="0"/>
<body name="crank"><joint name="crank" axis="0 -1 0" range="-1.2 1.2"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".5" contype="0" conaffinity="0"/>
<body name="rod" pos=".1 0 0"><joint name="rod" axis="0 -1 0" range="-3 3" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .1 0 .23" size=".01" mass=".4" contype="0" conaffinity="0"/>
<body name="rocker" pos=".1 0 .23"><joint name="rocker" axis="0 -1 0" range="-3 3" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .1 0 -.23" size=".01" mass=".3" contype="0" conaffinity="0"/>
</body></body></body></body></worldbody>
<equality><connect body1="rocker" body2="{}" anchor=".1 0 -.23"/></equality>
<actuator><position joint="crank" kp="100" kv="2" forcerange="-5 5"/></actuator>
<keyframe><key name="home" qpos="{}" ctrl="{}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("anchor", ["base", "world"])
@pytest.mark.parametrize("followers", ["0 0", "-0.31 0.02"])
def test_four_bar_with_a_pivot_in_the_base_has_no_tie(
    tmp_path: Path, anchor: str, followers: str
) -> None:
    """The crank turns by 0.3 rad in the keyframe, whose other two joints do not close the loop.

    Reference: bare MuJoCo from the keyframe, in which the servo keeps the angle of the crank.
    """
    path = tmp_path / "bar.xml"
    path.write_text(FOUR_BAR.format(anchor, f"0.3 {followers}", 0.3))
    robot = pa.load_robot(path, fixed_base=True)
    assert robot.closure is not None
    assert robot.closure.num_restrained_motions == 0
    joints = find_posture(robot).qpos
    moved, data = _simulate_bare(path)
    positions = dict(zip(robot.joint_names, joints.tolist(), strict=True))
    assert positions["crank"] == 0.3
    assert abs(moved[0]) < 0.02
    for name in ("rod", "rocker"):
        assert positions[name] == pytest.approx(float(data.joint(name).qpos[0]), abs=0.02)
    assert not report_posture_ties(robot, joints)
    assert describe_violated_keyframe(robot, joints) is None
    run = simulate_fixed_base(robot, joints)
    assert run is not None
    assert run.keyframe == "home"
    assert not run.fails
    assert run.worst is not None
    assert math.isclose(abs(run.worst.off), 0.0, abs_tol=0.02)


def test_four_bar_with_a_pivot_in_the_world_holds(tmp_path: Path) -> None:
    path = tmp_path / "bar.xml"
    path.write_text(FOUR_BAR.format("world", "0.3 0 0", 0.3))
    verdict = hold_posture(pa.load_robot(path, fixed_base=True)).verdict
    assert verdict.passed
    assert "link-tied" not in [remark.code for remark in verdict.remarks]


def test_arm_without_actuators_is_refused_if_a_tie_determines_its_joints(tmp_path: Path) -> None:
    """Reference: the weld of six equations has the rank of all joints of the arm."""
    robot = arm.write_tied_arm(tmp_path, "weld", {}, servos="", ctrl=False)
    assert robot.closure is not None
    assert len(robot.closure.dependent_joints) == robot.nu
    with pytest.raises(ModelError, match="weld bolt alone determines all joint positions"):
        hold_posture(robot)
