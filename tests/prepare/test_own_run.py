"""Simulation of the unmodified file from its keyframe: no verdict is better than this
simulation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic, Quantity
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare import own_run as own_run_module
from pupper_analysis.prepare import published_model
from pupper_analysis.prepare.judge import _report_distant_command, judge_stand
from pupper_analysis.prepare.own_run import (
    _is_ctrl_angles,
    _list_lifted_legs,
    _measure_lean_from_upright,
    own_run,
    settles_in_place,
)
from pupper_analysis.prepare.published_model import HoldCommands, PublishedModel
from pupper_analysis.prepare.self_check import name_remaining_cause
from pupper_analysis.present.verdict import (
    make_keyframe_run_clauses,
    split_verdict_lines,
    verdict_clauses,
)
from pupper_analysis.robot.as_published import JointOff, OwnCommands, OwnRun
from pupper_analysis.robot.fall import BodyMotion
from pupper_analysis.simulation.verdict import Ending, Verdict, VerdictCode
from tests.prepare.test_planted import stands
from tests.support.legged import biped, edited_by, rewrite_file
from tests.support.slips import standing

Slip = Callable[[str], str]

_CTRL = r' ctrl="[^"]*"(?=/></keyframe>)'


def _make_lying(text: str) -> str:
    """Return an MJCF that stands on bent legs: a reset to zero angles throws it on its back."""
    bent = text.replace(" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 1.3 -2.5"] * 4))
    return bent.replace('qpos="0 0 0.35 ', 'qpos="0 0 0.15 ')


def _add_option(words: str) -> Slip:
    return lambda text: text.replace('<option integrator="implicitfast"/>', f"<option {words}")


def load_slip(folder: Path, slip: Slip) -> pa.Robot:
    pair = standing(folder)
    edited_by(pair.mjcf, slip)
    return pa.load_robot(*pair)


def judge_nominal_stand(robot: pa.Robot) -> Verdict:
    return judge_stand(robot, pa.solve_stand(robot))


def codes(verdict: Verdict) -> list[str]:
    return [clause.message.code for clause in verdict_clauses(verdict)]


@pytest.mark.slow
def test_a_file_settles_in_place_only_if_the_motion_after_a_nudge_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: m dv/dt = c v, without gravity and contacts, grows by exp(c t / m), 100 in 2 s.

    Such a robot stays at rest for ever if it is not nudged. A robot without motor torques lies at
    rest on the ground after 6 s, 40 mm high, and has not settled in place.
    """
    robot = pa.load_robot(*standing(tmp_path))
    limp = copy(robot.mj_model)
    limp.actuator_gainprm[:] = limp.actuator_biasprm[:] = 0.0
    limp.opt.gravity[2], limp.dof_damping[6:] = -98.1, 2.0
    with monkeypatch.context() as longer:
        longer.setattr(own_run_module, "_SETTLING_TIME", 6.0)
        assert not settles_in_place(limp, robot, robot.home)
        longer.setattr(BodyMotion, "collapses", False)  # the speed alone does not show the fall
        assert settles_in_place(limp, robot, robot.home)
    model = copy(robot.mj_model)
    assert settles_in_place(model, robot, robot.home)
    model.opt.gravity[:] = 0.0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.dof_damping[:3] = -2.4 * robot.total_mass
    assert not settles_in_place(model, robot, robot.home)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
def test_a_keyframe_with_zero_commands_fails_if_the_file_falls(
    tmp_path: Path, stated: bool
) -> None:
    """Reference: MuJoCo with the unmodified file falls over with zero commands, stated or by
    default."""
    zeros = f' ctrl="{" ".join(["0"] * 12)}"' if stated else ""

    def slip(text: str) -> str:
        return re.sub(_CTRL, zeros, _make_lying(text))

    robot = load_slip(tmp_path, slip)
    assert not stands(tmp_path / "robot.xml")
    own = own_run(robot)
    assert own is not None
    assert own.falls
    assert own.commands is (OwnCommands.STATED if stated else OwnCommands.ABSENT)
    assert own.fails
    assert (own.held is None) is stated
    assert own.held is None or not own.held.falls
    verdict = judge_nominal_stand(robot)
    assert verdict.code is VerdictCode.OWN_DRIVES_FAIL
    expected = "keyframe-commands-another-pose" if stated else "keyframe-states-no-ctrl"
    assert expected in codes(verdict)


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "fails"), [(0.8, True), (0.65, False)])
def test_a_tilt_of_more_than_ten_degrees_fails(tmp_path: Path, angle: float, fails: bool) -> None:
    """The legs of one side are commanded to crouch; the tilt is compared with bare MuJoCo."""

    def slip(text: str) -> str:
        ctrl = " ".join([f"0 {angle} {-2 * angle}", "0 0.6 -1.2"] * 2)
        return text.replace(f'ctrl="{" ".join(["0 0.6 -1.2"] * 4)}"', f'ctrl="{ctrl}"')

    robot = load_slip(tmp_path, slip)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    tilt = math.acos(data.xmat[int(model.jnt_bodyid[0])][8])
    assert (tilt > math.radians(10.0)) is fails
    assert tilt < 0.5  # it has not fallen over
    own = own_run(robot)
    assert own is not None
    assert own.lean == pytest.approx(tilt, abs=0.02)
    assert own.is_tilted is fails
    assert judge_nominal_stand(robot).passed is not fails
    found = [found for found in _list_falls(tmp_path / "robot.xml") if found.values["tilted"]]
    assert bool(found) is fails  # audit reports the same event
    for message in found:
        assert message.values["causes"]
        lean = message.values["lean"]
        assert isinstance(lean, Quantity)
        assert lean.value == pytest.approx(tilt, abs=0.02)


def _list_falls(path: Path) -> list[Diagnostic]:
    """Return the messages of the audit rule keyframe-falls."""
    findings = pa.audit_model(path).findings
    return [found.diagnostic for found in findings if found.rule == "keyframe-falls"]


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [0.02, 0.05])
def test_audit_reports_a_slide_of_more_than_half_the_height(tmp_path: Path, gravity: float) -> None:
    """Reference: bare MuJoCo, in which the feet creep on ice, and the robot stays upright."""
    pair = standing(tmp_path)
    ice = ('type="plane"', 'priority="1" friction="0.01" type="plane"')
    rewrite_file(pair.mjcf, ("<option ", f'<option gravity="{gravity} 0 -9.81" '), ice)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    start = data.subtree_com[1].copy()
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    mujoco.mj_forward(model, data)
    away = float(np.linalg.norm((data.subtree_com[1] - start)[:2]))
    fails = bool(away > 0.5 * start[2])
    assert fails is (gravity > 0.03)
    run = own_run(pa.load_robot(mjcf=pair.mjcf))
    assert run is not None
    assert run.away == pytest.approx(away, abs=5e-3)
    assert not run.collapses
    found = _list_falls(pair.mjcf)
    assert [message.values["moved"] for message in found] == [True] * fails


@pytest.mark.parametrize(
    ("pose", "tilt"),
    [("0 0 0.05 0 1 0 0", math.pi), ("0 0 0.4 0.9921977 0 0.1246747 0", 0.0)],
    ids=["on its back", "pitched by 0.25 rad"],
)
def test_tilt_of_a_tilted_keyframe_is_that_from_the_upright_start_pose(
    tmp_path: Path, pose: str, tilt: float
) -> None:
    """Bare MuJoCo: the first robot rests on its back; the second falls on its feet, level."""
    robot = load_slip(
        tmp_path, lambda text: text.replace('qpos="0 0 0.35 1 0 0 0', f'qpos="{pose}')
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert math.acos(data.xmat[int(model.jnt_bodyid[0])][8]) == pytest.approx(tilt, abs=0.03)
    own = own_run(robot)
    assert own is not None
    assert own.lean == pytest.approx(tilt, abs=0.03)
    assert own.fails is own.collapses is (tilt > 0)
    verdict = judge_nominal_stand(robot)
    assert verdict.passed is (tilt == 0)
    assert ("keyframe-not-upright" in codes(verdict)) is (tilt > 0)


@pytest.mark.parametrize(
    ("pitch", "lies", "lean"),
    [(0.6, False, 0.0), (0.6, True, 0.6), (0.4, True, 0.0), (3.0, False, 3.0)],
    ids=["bent forward", "on its trunk", "on a stone", "upside down"],
)
def test_a_robot_that_rests_bent_forward_on_its_feet_has_not_fallen(
    tmp_path: Path, pitch: float, lies: bool, lean: float
) -> None:
    """The base has the same pitch at reset and at the end; by hand, the tilt is 0 or the pitch."""
    robot = pa.load_robot(mjcf=biped(tmp_path).mjcf)
    end = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(end, robot.home)
    mujoco.mju_axisAngle2Quat(end.qpos[3:7], [0.0, 1.0, 0.0], pitch)
    published = PublishedModel.from_model(robot.mj_model, robot)
    motion = BodyMotion(5.0, 0.5, 0.5, 0.0, 0.0, False, lies=lies)
    found = _measure_lean_from_upright(published, robot, motion, end)
    assert found.lean == pytest.approx(lean, abs=1e-9)


@pytest.mark.slow
def test_a_leg_that_its_ctrl_lifts_from_the_ground_fails(tmp_path: Path) -> None:
    """The robot stands on three legs, since a weight is behind the fourth. Reference: bare MuJoCo,
    in which the robot stays upright, and the foot is far above the ground.
    """
    pair = standing(tmp_path)
    place = 'pos="-0.12 -0.06 0" contype="0" conaffinity="0"'
    weight = f'<freejoint/><geom type="sphere" size="0.03" mass="9" {place}/>'
    bent = ('ctrl="0 0.6 -1.2 ', 'ctrl="0 0.6 -2.4 ')
    rewrite_file(pair.mjcf, ("<freejoint/>", weight), bent)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(5 / model.opt.timestep))
    assert data.body("trunk").xmat[8] > math.cos(math.radians(10))
    tip = data.body("FL_calf").xpos + data.body("FL_calf").xmat.reshape(3, 3) @ [0, 0, -0.2]
    assert tip[2] > 0.04
    run = own_run(pa.load_robot(mjcf=pair.mjcf))
    assert run is not None
    assert not run.falls
    assert not run.is_tilted
    assert run.lifted_leg is not None
    assert run.lifted_leg.joint == "FL_knee"
    assert run.redirected == run.lifted_leg
    assert run.has_left_stance
    assert run.fails
    (found,) = _list_falls(pair.mjcf)
    assert found.values["leg"] == "FL_knee"
    (cause,) = found.values["causes"]  # type: ignore[misc]
    assert isinstance(cause, Diagnostic)
    assert cause.code == "keyframe-commands-another-pose"


@pytest.mark.slow
def test_a_robot_that_a_weld_hoists_is_lifted_and_the_weld_is_named(tmp_path: Path) -> None:
    """By hand: the weld holds the base 0.3 m above the keyframe, without tilt."""
    weld = '<equality><weld body1="trunk" relpose="0 0 -0.65 1 0 0 0"/></equality>'
    robot = load_slip(tmp_path, lambda text: text.replace("</mujoco>", f"{weld}</mujoco>"))
    own = own_run(robot)
    assert own is not None
    assert own.is_lifted
    verdict = judge_nominal_stand(robot)
    assert not verdict.passed
    assert verdict.with_feedforward is Ending.LIFTED
    messages = [str(clause.message) for clause in verdict_clauses(verdict)]
    assert messages[0].startswith("is LIFTED in MuJoCo: foot")
    lines = (tmp_path / "robot.xml").read_text().splitlines()
    line = next(number for number, text in enumerate(lines, 1) if "<weld " in text)
    assert messages[1].endswith(f"trunk and world (line {line})")  # a weld without a name
    assert "COLLAPSES" not in " ".join(messages)
    assert sum("is LIFTED" in message for message in messages) == 3  # prepared robot and two runs


@pytest.mark.slow
def test_servos_that_are_too_soft_are_the_named_cause(tmp_path: Path) -> None:
    """Reference: the simulations of the file with four times the stiffness, which keeps the height,
    and with the stated stiffness, which falls.
    """

    def with_gains(scale: float) -> Slip:
        return lambda text: re.sub('kp="150" kv="5"', f'kp="{10 * scale:g}" kv="{scale:g}"', text)

    robot = load_slip(tmp_path, with_gains(1.0))
    own = own_run(robot)
    assert own is not None
    assert own.falls
    named, _ = name_remaining_cause(robot, own, None)
    assert named is not None
    assert [cause.code for cause in named.causes] == ["soft-servos"]
    stiffer = own_run(load_slip(tmp_path, with_gains(4.0)))
    assert stiffer is not None
    assert not stiffer.falls


@pytest.mark.slow
def test_zero_ctrl_of_torque_motors_is_no_command(tmp_path: Path) -> None:
    """A torque of zero and an angle of zero are written alike, so they are no evidence."""

    def slip(text: str) -> str:
        text = re.sub(_CTRL, f' ctrl="{" ".join(["0"] * 12)}"', text)
        return re.sub(r'<position (joint="[^"]*")[^>]*/>', r"<motor \g<1>/>", text)

    own = own_run(load_slip(tmp_path, slip))
    assert own is not None
    assert own.limp
    assert not own.fails


@pytest.mark.slow
def test_angles_as_ctrl_of_torque_motors_are_the_named_cause(tmp_path: Path) -> None:
    """The keyframe commands angles, which MuJoCo's motors apply as torques."""
    motors = r"<motor \g<1>/>"
    robot = load_slip(
        tmp_path, lambda text: re.sub(r'<position (joint="[^"]*")[^>]*/>', motors, text)
    )
    assert "motors-commanded-angles" in codes(judge_nominal_stand(robot))


@pytest.mark.slow
@pytest.mark.parametrize("below", [0.0, 0.6])
def test_base_frame_below_the_ground_is_no_fall(tmp_path: Path, below: float) -> None:
    """The base body is at the same place; only its frame is moved below the ground."""
    pair = standing(tmp_path)
    text = pair.mjcf.read_text()
    text = re.sub(r'(<body name="\w+_hip" pos="\S+ \S+) \S+"', rf'\g<1> {below}"', text)
    text = text.replace('<inertial pos="0 0 0" mass="4"', f'<inertial pos="0 0 {below}" mass="4"')
    text = text.replace('size="0.2 0.1 0.04"', f'size="0.2 0.1 0.04" pos="0 0 {below}"')
    text = text.replace('qpos="0 0 0.35 ', f'qpos="0 0 {0.35 - below} ')
    pair.mjcf.write_text(text)
    own = own_run(pa.load_robot(pair.mjcf))
    assert own is not None
    assert not own.falls
    assert own.height == pytest.approx(0.305, abs=0.01)
    assert own.end_height == pytest.approx(0.304, abs=0.01)


@pytest.mark.slow
def test_robot_with_sleeping_enabled_is_judged(tmp_path: Path) -> None:
    """MuJoCo does not differentiate steps of models with sleeping bodies; a note reports this."""
    asleep = _add_option('integrator="implicitfast"><flag sleep="enable"/></option>')
    robot = load_slip(tmp_path, asleep)
    assert judge_nominal_stand(robot).code is VerdictCode.HOLDS
    assert "sleep-not-differentiated" in {note.code for note in robot.notes}


@pytest.mark.slow
def test_own_run_does_not_depend_on_the_welds_of_the_task(tmp_path: Path) -> None:
    """A welded foot has no contact force in the task, but collides in the published file."""

    def with_motors(text: str) -> str:
        text = re.sub(_CTRL, "", text)
        motor = r'<motor \g<1> ctrlrange="-90 90" ctrllimited="true"/>'
        return re.sub(r'<position (joint="[^"]*")[^>]*/>', motor, text)

    robot = load_slip(tmp_path, with_motors)
    for contacts in ({}, {next(iter(robot.feet)): pa.Weld()}):
        stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=contacts))
        verdict = judge_stand(robot, stand)
        assert verdict.passed, codes(verdict)
        assert "on-servos-made-up" in codes(verdict)


@pytest.mark.slow
def test_the_run_of_a_file_that_mujoco_refuses_names_the_missing_meshes(tmp_path: Path) -> None:
    """MuJoCo itself raises an error for the missing file."""

    def slip(text: str) -> str:
        text = text.replace("<worldbody>", '<asset><mesh file="gone.stl"/></asset><worldbody>', 1)
        geom = '<geom type="mesh" mesh="gone" contype="0" conaffinity="0"/>'
        return text.replace("<inertial", f"{geom}<inertial", 1)

    robot = load_slip(tmp_path, slip)
    with pytest.raises(ValueError, match=r"gone\.stl"):
        mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    own = own_run(robot)
    assert own is not None
    assert own.missing == ("gone.stl",)
    verdict = judge_nominal_stand(robot)
    messages = [str(clause.message) for clause in verdict_clauses(verdict)]
    assert any("MuJoCo refuses the file" in line and "gone.stl" in line for line in messages)
    short, _ = split_verdict_lines(verdict)
    assert any("MuJoCo refuses the file" in str(line) for line in short)


@pytest.mark.parametrize(
    ("ctrl", "are_angles"),
    [
        ("0.6 -1.2 0.05", True),
        ("0.62 -1.25 0.05", True),
        ("34.3775 -68.7549 0.05", True),
        ("34.38 -68.76 0.05", True),  # factor 57.3
        ("34.3775 -68.7549 2.86479", False),  # a slide has no degrees
        ("35 -68.7549 0.05", False),
        ("-34.3775 68.7549 0.05", False),
    ],
)
def test_torques_that_equal_joint_angles_in_radians_or_degrees_are_angles(
    ctrl: str, are_angles: bool
) -> None:
    """Reference: the angles of the keyframe times 180 / pi; the third joint is a slide."""
    kinds = ("hinge", "hinge", "slide")
    bodies = "".join(
        f'<body><joint name="{place}" type="{kind}"/><geom size="0.1"/></body>'
        for place, kind in enumerate(kinds)
    )
    motors = "".join(f'<motor joint="{place}"/>' for place in range(3))
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator>"
        f'<keyframe><key qpos="0.6 -1.2 0.05" ctrl="{ctrl}"/></keyframe></mujoco>'
    )
    assert _is_ctrl_angles(model, 0) is are_angles


@pytest.mark.parametrize(("ctrl", "are_angles"), [("-0.6", True), ("0.6", False)])
def test_commands_of_geared_motors_are_compared_with_the_actuator_length(
    ctrl: str, are_angles: bool
) -> None:
    """The length of an actuator at a joint is gear * angle: here -1 * 0.6 rad."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hip"/><geom size="0.1"/></body></worldbody>'
        '<actuator><motor joint="hip" gear="-1"/></actuator>'
        f'<keyframe><key qpos="0.6" ctrl="{ctrl}"/></keyframe></mujoco>'
    )
    assert _is_ctrl_angles(model, 0) is are_angles


@pytest.mark.parametrize(("ctrl", "are_angles"), [("0.6 0 0 -1.2 0 0", True), ("0.6 -1.2", False)])
def test_commands_of_several_controls_are_compared_by_their_first(
    ctrl: str, are_angles: bool
) -> None:
    """A dcmotor with the inputs pos, vel and ff has three controls; the first is a position."""
    joints = "".join(
        f'<body><joint name="{name}"/><geom size="0.1"/></body>' for name in ("hip", "knee")
    )
    motors = "".join(
        f'<dcmotor joint="{name}" motorconst="0.5" resistance="1" input="pos vel ff"/>'
        for name in ("hip", "knee")
    )
    padded = " ".join([*ctrl.split(), *["0"] * (6 - len(ctrl.split()))])
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{joints}</worldbody><actuator>{motors}</actuator>"
        f'<keyframe><key qpos="0.6 -1.2" ctrl="{padded}"/></keyframe></mujoco>'
    )
    assert _is_ctrl_angles(model, 0) is are_angles


def compile_geared_hinge(attributes: str) -> mujoco.MjModel:
    """Compile a hinge without gravity, with an actuator of 6 N m per unit of ctrl."""
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0"/>
          <worldbody>
            <body><joint name="turn" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
          </worldbody>
          <actuator>
            <general joint="turn" gear="2" gainprm="3" {attributes}/>
          </actuator>
        </mujoco>""")


def test_an_external_servo_compensates_the_constant_torque_of_an_actuator() -> None:
    """Without gravity a hinge rests at its target, with no torque: closed form."""
    model = compile_geared_hinge('biastype="affine" biasprm="0.4 0 0"')
    data = mujoco.MjData(model)
    motor_laws = {0: published_model._measure_command_law(model, data, 0, [0])}
    assert motor_laws[0] == pytest.approx((0, 6.0, 0.8))
    external = (np.array([0]), *np.array([[20.0], [2.0], [0.3], [0.0]]))
    hold = HoldCommands(np.zeros(1), np.zeros(0), external, motor_laws)
    published = SimpleNamespace(model=model)
    low, high = published_model.simulate_published(published, data, hold, 5.0)
    assert data.qpos[0] == pytest.approx(0.3, abs=1e-6)
    assert low[0] == pytest.approx(0.0, abs=1e-5)
    assert high[0] == pytest.approx(0.0, abs=1e-5)


def test_external_servo_leaves_no_damping_in_the_model_after_a_fatal_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: the damping before the simulation. A stub raises the error of MuJoCo."""
    model = compile_geared_hinge("")
    external = (np.array([0]), *np.array([[20.0], [2.0], [0.3], [0.0]]))
    hold = HoldCommands(np.zeros(1), np.zeros(0), external, {})

    def fail(*_: object, **__: object) -> None:
        raise mujoco.FatalError("stub")

    monkeypatch.setattr(published_model.mujoco, "mj_step", fail)
    with pytest.raises(mujoco.FatalError):
        published_model.simulate_published(
            SimpleNamespace(model=model), mujoco.MjData(model), hold, 5.0
        )
    assert model.dof_damping.tolist() == [0.0]


@pytest.mark.parametrize("ctrlrange", ["-1 0", "0 1", "0.5 1", "-1 1"])
def test_lever_of_a_motor_is_independent_of_its_ctrlrange(ctrlrange: str) -> None:
    """Closed form: gear times gain = 6 N m per unit, also if the range excludes 0 or 1e-6."""
    model = compile_geared_hinge(f'ctrllimited="true" ctrlrange="{ctrlrange}"')
    flags = model.opt.disableflags
    law = published_model._measure_command_law(model, mujoco.MjData(model), 0, [0])
    assert law == pytest.approx((0, 6.0, 0.0))
    assert model.opt.disableflags == flags


@pytest.mark.parametrize(
    ("off", "commanded", "explained"),
    [
        (0.4, 0.3, True),
        (-0.4, -0.3, True),
        (0.4, -0.3, False),
        (-0.4, 0.3, False),
        (0.4, 0.1, False),
    ],
)
def test_a_command_explains_only_displacements_in_its_direction(
    off: float, commanded: float, explained: bool
) -> None:
    assert JointOff("knee", off, Drive.SERVO, commanded).commanded_away is explained


@pytest.mark.parametrize(("away", "fails"), [(0.51, True), (0.49, False)])
def test_travel_of_more_than_half_of_the_height_leaves_the_stance(away: float, fails: bool) -> None:
    """The CoM is 1 m high, and remains so. A fixed base and a free fall are other failures."""
    run = OwnRun(5.0, 1.0, 1.0, 0.0, away, False, keyframe="home", stance_travel=away)
    assert not run.falls
    assert run.has_left_stance is fails
    assert not replace(run, stance_travel=0.0).has_left_stance  # an arm alone moves the CoM
    assert run.fails is fails
    assert run.keeps_stance is not fails
    (clause,) = make_keyframe_run_clauses(run)
    stated = "moves sideways by 510 mm" if fails else "1000 mm to 1000 mm"
    assert stated in clause.message.short
    (clause,) = make_keyframe_run_clauses(replace(run, lean=0.4))
    assert "tilt 23 deg" in clause.message.short  # the tilt matters more than the move
    lifted = replace(run, lifted_leg=JointOff("knee", 0.9, Drive.SERVO))
    (clause,) = make_keyframe_run_clauses(lifted)
    assert "a leg leaves the ground (knee)" in clause.message.short
    assert not replace(run, standing=False).has_left_stance
    assert not replace(run, limp=True).fails


def test_the_reported_command_is_not_that_of_the_joint_with_the_largest_displacement() -> None:
    """A soft ankle gives way by 0.9 rad; the ctrl moves an elbow by 0.7 rad."""
    ankle = JointOff("ankle", 0.9, Drive.SERVO, 0.0)
    elbow = JointOff("elbow", -0.7, Drive.SERVO, -0.7)
    run = OwnRun(5.0, 1.0, 1.0, 0.0, 0.0, False, keyframe="home", worst=ankle, redirected=elbow)
    (remark,) = _report_distant_command(run)
    assert remark.values["joint"] == "elbow"
    assert not _report_distant_command(replace(run, redirected=replace(elbow, off=-0.49)))
    assert not _report_distant_command(replace(run, redirected=None))
    assert not _report_distant_command(replace(run, commands=OwnCommands.ABSENT))


@pytest.mark.parametrize(
    ("begin", "lift", "off", "lifted"),
    [
        (0.0, 0.0, 0.9, False),
        (0.0, 0.05, 0.9, True),
        (0.05, 0.05, 0.9, True),  # the clearance at reset does not count
        (0.0, 0.05, 0.4, True),  # the norm of two joints is 0.57
        (0.0, 0.05, 0.28, False),  # 0.49
    ],
)
def test_a_leg_with_a_flat_sole_is_lifted_if_no_part_of_it_touches(
    tmp_path: Path, begin: float, lift: float, off: float, lifted: bool
) -> None:
    """A sole has four contact points, which are no names of feet. The base is moved upward."""
    robot = pa.load_robot(mjcf=biped(tmp_path).mjcf)
    assert not set(robot.feet) & set(robot.contacts)
    start, end = (mujoco.MjData(robot.mj_model) for _ in range(2))
    for data, height in ((start, begin), (end, lift)):
        robot.mj_convention.set_state(data, robot.home)
        data.qpos[2] += height - 1e-4  # the soles press on the ground
    published = PublishedModel.from_model(robot.mj_model, robot)
    offsets = {"left_pitch": off, "left_ankle": 0.4}
    joints = [JointOff(name, offsets.get(name, 0.0), Drive.SERVO) for name in robot.joint_names]
    assert offsets.keys() <= {joint.joint for joint in joints}
    motion = BodyMotion(5.0, 0.5, 0.5, 0.0, 0.0, False, clearance=begin)
    found = _list_lifted_legs(published, robot, joints, start, end, motion)
    assert {joint.joint.partition("_")[0] for joint in found} == ({"left"} if lifted else set())


def test_a_leg_that_touches_the_ground_with_a_link_above_its_foot_is_not_lifted(
    tmp_path: Path,
) -> None:
    """As a heel behind a toe joint: a peg of the left shank reaches the ground below the sole."""
    pair = biped(tmp_path)
    robot = pa.load_robot(mjcf=pair.mjcf)
    rewrite_file(pair.mjcf, ("<worldbody>", '<worldbody><geom type="plane" size="0 0 1"/>'))
    peg = '<joint name="left_knee"'
    bar = f'<geom type="capsule" fromto="0.2 0 0 0.2 0 -0.5" size="0.01"/>{peg}'
    found = []
    for text in (peg, bar):
        model = mujoco.MjModel.from_xml_string(pair.mjcf.read_text().replace(peg, text))
        published = PublishedModel.from_model(model, robot)
        start = published_model.place_published(published, robot, robot.home)
        assert start is not None
        end = copy(start)
        end.qpos[model.joint("left_ankle").qposadr] += 0.6
        end.qpos[2] += 0.1
        joints = [JointOff("left_ankle", 0.6, Drive.SERVO)] + [
            JointOff(name, 0.0, Drive.SERVO) for name in robot.joint_names if name != "left_ankle"
        ]
        motion = BodyMotion(5.0, 0.5, 0.5, 0.0, 0.0, False)
        found.append(bool(_list_lifted_legs(published, robot, joints, start, end, motion)))
    assert found == [True, False]


def test_a_free_body_beside_the_robot_stays_at_its_place(tmp_path: Path) -> None:
    """Reference: the ball's place in the file. It was put into the robot's base."""
    pair = biped(tmp_path)
    robot = pa.load_robot(mjcf=pair.mjcf)
    ball = '<body name="ball" pos="2 0 0.1"><freejoint/><geom size="0.1" mass="1"/></body>'
    text = pair.mjcf.read_text().replace("</worldbody>", f"{ball}</worldbody>")
    model = mujoco.MjModel.from_xml_string(text)
    data = published_model.place_published(
        PublishedModel.from_model(model, robot), robot, robot.home
    )
    assert data is not None
    assert data.body("ball").xpos == pytest.approx([2.0, 0.0, 0.1])
    assert data.qpos[:3] == pytest.approx(robot.home[:3], abs=1e-6)


def test_a_leg_that_the_keyframe_itself_lifts_may_move(tmp_path: Path) -> None:
    """At reset the right sole is 0.1 m above the ground; at the end also, with another knee."""
    robot = pa.load_robot(mjcf=biped(tmp_path).mjcf)
    start = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(start, robot.home)
    published = PublishedModel.from_model(robot.mj_model, robot)
    joints = [JointOff(name, 0.9, Drive.SERVO) for name in robot.joint_names]
    motion = BodyMotion(5.0, 0.5, 0.5, 0.0, 0.0, False)
    start.qpos[robot.mj_model.joint("right_pitch").qposadr] += 0.8
    end = copy(start)
    end.qpos[robot.mj_model.joint("right_pitch").qposadr] += 0.2
    assert not _list_lifted_legs(published, robot, joints, start, end, motion)
    start.qpos[robot.mj_model.joint("right_pitch").qposadr] -= 0.8
    found = _list_lifted_legs(published, robot, joints, start, end, motion)
    assert {joint.joint for joint in found} == {
        name for name in robot.joint_names if name.startswith("right")
    }


@pytest.mark.slow
def test_an_arm_whose_ctrl_moves_the_com_leaves_the_robot_in_its_stance(tmp_path: Path) -> None:
    """Reference: bare MuJoCo, in which the four feet stay within 2 cm of their places."""
    pair = standing(tmp_path)
    arm = (
        '<body name="arm" pos="0 0 0.06"><joint name="swing" axis="0 1 0" range="-3 3"/>'
        '<inertial pos="0.45 0 0" mass="2" diaginertia="0.01 0.01 0.01"/></body>'
    )
    rewrite_file(
        pair.mjcf,
        ('<body name="FL_hip"', f'{arm}<body name="FL_hip"'),
        ("<actuator>", '<actuator><position joint="swing" kp="200" kv="150"/>'),
        ("1 0 0 0 0 0.6", "1 0 0 0 -0.2 0 0.6"),
        ('ctrl="', 'ctrl="-2.9 '),
    )
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    feet = [model.body(f"{leg}_calf").id for leg in ("FL", "FR", "RL", "RR")]
    com, places = data.subtree_com[1].copy(), data.xpos[feet]
    mujoco.mj_step(model, data, round(5 / model.opt.timestep))
    assert np.linalg.norm((data.subtree_com[1] - com)[:2]) > 0.5 * com[2]
    assert np.abs(data.xpos[feet] - places).max() < 0.02
    run = own_run(pa.load_robot(mjcf=pair.mjcf))
    assert run is not None
    assert run.away > 0.3 * run.height
    assert run.redirected is not None
    assert run.redirected.joint == "swing"
    assert not run.fails


@pytest.mark.slow
def test_heights_without_ground_below_count_from_the_level_plane(tmp_path: Path) -> None:
    """By hand: the plane is 0.8 m high and touches nothing; the robot floats without gravity, with
    its feet on the plane. The CoM is 0.307 m above the plane."""
    path = standing(tmp_path).mjcf
    raised = ('type="plane"', 'type="plane" pos="0 0 0.8" contype="0" conaffinity="0"')
    floating = ("<option ", '<option gravity="0 0 0" ')
    edits = (raised, floating, ('qpos="0 0 0.35 ', 'qpos="0 0 1.15 '))
    robot = pa.load_robot(mjcf=path)
    rewrite_file(path, *edits)
    model = mujoco.MjModel.from_xml_path(str(path))
    published = PublishedModel.from_model(model, robot)
    run = own_run_module._simulate_key(published, robot, 0)
    assert run.clearance == 0.0
    assert run.height == pytest.approx(0.307, abs=1e-3)
    assert run.end_height == pytest.approx(0.307, abs=5e-3)
    known = []
    measure = own_run_module.initial_height
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            own_run_module,
            "initial_height",
            lambda *arguments: (known.append(arguments[-1]), measure(*arguments))[1],
        )
        settles_in_place(model, robot, robot.home)
    assert known == [pytest.approx(0.8)]


@pytest.mark.parametrize(("com", "base", "travel"), [(0.4, 0.0, 0.0), (0.1, 0.4, 0.1)])
def test_travel_of_a_stance_is_that_of_the_com_or_base_that_moves_less(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, com: float, base: float, travel: float
) -> None:
    """An arm moves the CoM alone, and a base that leans moves the base alone: no step."""
    robot = pa.load_robot(mjcf=standing(tmp_path).mjcf)
    model = robot.compute_once(own_run_module.get_published_model)
    assert model is not None

    def simulate(_: object, start: mujoco.MjData, *__: object) -> tuple[BodyMotion, mujoco.MjData]:
        end = copy(start)
        end.qpos[0] += base
        return BodyMotion(5.0, 0.3, 0.3, 0.0, com, False), end

    monkeypatch.setattr(own_run_module, "simulate_keyframe", simulate)
    run = own_run_module._simulate_key(PublishedModel.from_model(model, robot), robot, 0)
    assert run.away == com
    assert run.stance_travel == pytest.approx(travel)


@pytest.mark.parametrize(("speed", "rests"), [(4e-3, True), (6e-3, False), (-6e-3, False)])
def test_model_is_at_rest_below_five_millimetres_per_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, speed: float, rests: bool
) -> None:
    """Feet that creep move at 1e-3 m/s or rad/s, joints that shake at 2e-2 or more."""
    robot = pa.load_robot(mjcf=standing(tmp_path).mjcf)
    model = robot.compute_once(own_run_module.get_published_model)
    assert model is not None

    def simulate(_: object, data: mujoco.MjData, *__: object, **___: object) -> None:
        data.qvel[-1] = speed

    monkeypatch.setattr(own_run_module, "nudge_velocity", lambda model: np.zeros(model.nv))
    monkeypatch.setattr(own_run_module, "simulate_published", simulate)
    assert settles_in_place(model, robot, robot.home) is rests


@pytest.mark.parametrize(("gear", "ctrl", "expected"), [(1.0, 0.6, 0.5), (2.0, 0.6, 0.2)])
def test_commanded_position_of_a_geared_servo_is_ctrl_over_gear(
    gear: float, ctrl: float, expected: float
) -> None:
    """By hand: kp (ctrl - gear q) is zero at q = ctrl / gear; the joint is at 0.1 rad."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="knee"/><geom size="0.1"/></body></worldbody>'
        f'<actuator><position joint="knee" kp="10" gear="{gear}"/></actuator></mujoco>'
    )
    published = SimpleNamespace(model=model)
    offset = own_run_module._command_offset(published, "knee", np.array([ctrl]), 0.1)  # type: ignore[arg-type]
    assert offset == pytest.approx(expected)


@pytest.mark.parametrize(("servos", "found"), [(6, []), (7, ["j11"])])
def test_joint_without_servo_gives_way_only_if_most_joints_have_servos(
    servos: int, found: list[str]
) -> None:
    """Twelve joints, of which the last is displaced by 0.3 rad. A file with torque motors at half
    of its joints leaves them to a controller."""
    robot = SimpleNamespace(description=SimpleNamespace(made_servos=()))
    joints = [
        JointOff(
            f"j{number}", 0.3 * (number == 11), Drive.SERVO if number < servos else Drive.MOTOR
        )
        for number in range(12)
    ]
    unheld = own_run_module._find_unheld_joints(SimpleNamespace(), robot, joints)  # type: ignore[arg-type]
    assert [joint.joint for joint in unheld] == found
