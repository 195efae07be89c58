"""Each error of `audit` stops a robot on loading, or appears in each verdict of the robot."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity
from pupper_analysis.prepare import judge
from pupper_analysis.prepare.judge import (
    describe_frictionless_feet,
    describe_impossible_inertias,
    judge_stand,
    list_file_remarks,
)
from pupper_analysis.prepare.limits import describe_unknown_limits
from pupper_analysis.prepare.self_check import report_ties
from pupper_analysis.present.verdict import format_verdict, verdict_clauses
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.trial import Failure, NudgeTrial
from pupper_analysis.simulation.verdict import IMPOSSIBLE_CODES, Ending, Outcome, VerdictCode
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import stand_statics
from tests.prepare.test_imported import four_legs, verdict_of
from tests.support import arm, features, random_legged, slips
from tests.support.legged import edited_by, quadruped, rewrite_file, with_arm
from tests.support.repository import ROOT

Slip = Callable[[str], str]


def _add_shape(geometry: str) -> Slip:
    shape = f'<link name="trunk"><collision><geometry>{geometry}</geometry></collision>'
    return lambda text: text.replace('<link name="trunk">', shape)


def _state_inertial(word: str, value: str) -> Slip:
    """Return an edit that replaces a number of FL_thigh's inertial."""
    found = re.compile(rf'(<link name="FL_thigh">.*?{word}=")[^"]*', re.DOTALL)
    return lambda text: found.sub(rf"\g<1>{value}", text, count=1)


# (edit of the file, text in the verdict); None if the robot is refused.
SLIPS: dict[str, tuple[Slip, str | None]] = {
    "mass-not-positive": (_state_inertial("mass value", "-0.5"), "no positive mass is stated"),
    "triangle-inequality": (
        _state_inertial("ixx", "0.02"),
        "inertia of link 'FL_thigh' was repaired",
    ),
    "inertia-not-positive-definite": (
        _state_inertial("ixx", "-0.002"),
        "inertia of link 'FL_thigh' was repaired",
    ),
    "range-empty": (
        lambda text: text.replace('lower="-0.8" upper="0.8"', 'lower="0.8" upper="-0.8"', 1),
        None,
    ),
    "geometry-empty": (_add_shape(""), "the <collision> of link 'trunk' has no geometry"),
    "mesh-unreadable": (_add_shape('<mesh filename="bad.stl"/>'), "mesh file left out"),
    "value-impossible": (
        lambda text: text.replace("<limit", '<dynamics damping="-1"/><limit', 1),
        "negative damping accelerates FL_roll",
    ),
}


def write_slip(folder: Path, slip: Slip) -> Path:
    (folder / "bad.stl").write_text("no mesh")
    return edited_by(four_legs(folder), slip)


@pytest.mark.slow
@pytest.mark.parametrize("rule", SLIPS)
def test_audit_errors_appear_in_the_verdict(tmp_path: Path, rule: str) -> None:
    """One defect per case, which is the only error of `audit`; limits that exclude each other are
    refused on loading.
    """
    slip, message = SLIPS[rule]
    urdf = write_slip(tmp_path, slip)
    errors = {found.rule for found in pa.audit_model(urdf).findings if found.severity == "error"}
    assert errors == {rule}
    if message is None:
        with pytest.raises(pa.PupperAnalysisError, match=r"lower limit 0\.8 rad above"):
            verdict_of(pa.load_robot(urdf))
        return
    verdict = verdict_of(pa.load_robot(urdf))
    report = format_verdict(verdict)
    assert message in report
    if rule == "mass-not-positive":  # no verdict holds for a made-up mass
        assert verdict.code is VerdictCode.MASSES_UNKNOWN
        assert not verdict.passed
    else:
        assert "on files with defects (audit lists them): " in report


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0, 0.0001])
def test_negative_mass_of_a_fixed_link_is_not_a_known_mass(tmp_path: Path, moment: float) -> None:
    """MuJoCo 4.0.0 ignores such a mass on import, Pinocchio subtracts it: two different robots."""
    inertia = f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
    tip = (
        f'<link name="bar"><inertial><mass value="-0.1"/>{inertia}</inertial></link>'
        '<joint name="bar" type="fixed"><parent link="fore"/><child link="bar"/></joint></robot>'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF.replace("</robot>", tip))
    robot = pa.load_robot(path, fixed_base=True)
    remark = describe_missing_masses(robot)
    assert remark is not None
    assert "negative mass of link bar" in str(remark)
    verdict = pa.hold_posture(robot).verdict
    assert verdict.code is VerdictCode.MASSES_UNKNOWN
    assert not verdict.passed


@pytest.mark.parametrize("stated", [False, True])
def test_mass_that_only_the_compiler_sets_is_not_a_known_mass(
    tmp_path: Path, *, stated: bool
) -> None:
    """``boundmass`` gives 1 g to shanks without inertial; MuJoCo compiles and simulates the file.

    A shank that states 1 g itself has the same mass, and this mass is known.
    """
    mjcf = quadruped(tmp_path).mjcf
    inertial = '<inertial pos="0 0 -0.1" mass="0.2" diaginertia="8e-4 8e-4 5e-5"/>'
    light = inertial.replace("0.2", "0.001").replace("8e-4 8e-4 5e-5", "1e-6 1e-6 1e-6")
    massless = light.replace("0.001", "0")
    text = mjcf.read_text()
    compiler = '<compiler boundmass="0.001" inertiafromgeom="false"/>'
    text = text.replace(inertial, light if stated else massless)
    mjcf.write_text(re.sub(r"(<mujoco[^>]*>)", rf"\1{compiler}", text, count=1))
    masses = mujoco.MjModel.from_xml_path(str(mjcf)).body_mass
    assert np.count_nonzero(masses == 0.001) == 4  # bare MuJoCo
    robot = pa.load_robot(mjcf)
    remark = describe_missing_masses(robot)
    if stated:
        assert remark is None
        return
    assert remark is not None
    assert len(remark.values["bounded"]) == 4  # type: ignore[arg-type]
    assert remark.values["bound"].value == 0.001  # type: ignore[union-attr]
    rules = [finding.rule for finding in pa.audit_model(mjcf).findings]
    assert rules.count("moving-body-without-mass") == 4


@pytest.mark.slow
@pytest.mark.parametrize(("gravity", "named"), [("0 0 -3.71", True), ("0 0 -9.81", False)])
def test_verdict_states_a_gravity_other_than_the_earths(
    tmp_path: Path, gravity: str, named: bool
) -> None:
    """Mars has 3.71 m/s^2."""
    pair = quadruped(tmp_path, floor=True)
    option = f'<option gravity="{gravity}"/><worldbody>'
    edited_by(pair.mjcf, lambda text: text.replace("<worldbody>", option))
    robot = pa.load_robot(*pair)
    codes = {remark.code for remark in list_file_remarks(robot)}
    assert ("gravity-not-the-earths" in codes) is named


@pytest.mark.parametrize(("factor", "named"), [("0.5", True), ("-1", False), ("0", False)])
def test_verdict_states_the_weight_that_gravcomp_bears(
    tmp_path: Path, factor: str, named: bool
) -> None:
    """Reference: vertical forces of bare MuJoCo, which ignores gravcomp if no value is positive."""
    pair = quadruped(tmp_path, floor=True)
    edited_by(pair.mjcf, lambda text: text.replace("<body ", f'<body gravcomp="{factor}" ', 1))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    borne = data.qfrc_gravcomp[2] / 9.81
    robot = pa.load_robot(*pair)
    remarks = {remark.code: remark for remark in list_file_remarks(robot)}
    assert ("weight-is-compensated" in remarks) is named is bool(borne > 0)
    if named:
        values = remarks["weight-is-compensated"].values
        assert values["mass"].value == pytest.approx(borne)  # type: ignore[union-attr]
        assert values["total"].value == pytest.approx(model.body_mass.sum())  # type: ignore[union-attr]


@pytest.mark.slow
def test_negative_dry_friction_appears_in_the_verdict(tmp_path: Path) -> None:
    _, mjcf = features.write_files(tmp_path, features.FEATURES["frictionloss -1"])
    report = format_verdict(verdict_of(pa.load_robot(mjcf)))
    assert "negative dry friction is read as 0 at FL_knee, FR_knee, RL_knee" in report


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slip", "message"),
    [
        (
            lambda text: text.replace('effort="80"', 'effort="-80"', 1),
            "effort limit -80 N m of joint 'FL_roll' is negative",
        ),
        (_add_shape('<sphere radius="0"/>'), "collision spheres of radius 0"),
    ],
)
def test_impossible_values_appear_in_the_verdict(tmp_path: Path, slip: Slip, message: str) -> None:
    """A negative effort limit, and a sphere of radius 0."""
    urdf = write_slip(tmp_path, slip)
    (found,) = (finding for finding in pa.audit_model(urdf).findings if finding.severity == "error")
    assert found.rule in ("value-impossible", "effort-negative")
    assert f"audit lists them): {message}" in format_verdict(verdict_of(pa.load_robot(urdf)))


@pytest.mark.slow
def test_a_robot_without_friction_fails_and_slides_in_mujoco(tmp_path: Path) -> None:
    """Reference: bare MuJoCo, in which the robot still slides at more than 0.01 m/s, 10 s after a
    nudge of 0.05 m/s.
    """
    pair = slips.standing(tmp_path)
    rewrite_file(pair.mjcf, ('<geom type="plane"', '<geom condim="1" priority="1" type="plane"'))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    data.qvel[0] += 0.05
    mujoco.mj_step(model, data, round(10.0 / model.opt.timestep))
    assert data.qvel[0] > 0.01
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert not verdict.passed
    codes = [failure.code for failure in verdict.failures]
    assert codes[:2] == ["feet-without-friction", "nudge-does-not-decay"]


@pytest.mark.slow
def test_a_stand_that_needs_feedforward_is_nudged_from_all_sides(tmp_path: Path) -> None:
    """The contacts of this random robot with twice its mass rest, and chatter after a nudge.

    In bare MuJoCo with the commands of the stand, the robot moves by more than 0.1 m in 20 s after
    a vertical nudge of 0.01 m/s.
    """
    drawn = replace(
        random_legged.draw_robot(690000), base="free", keyframe=True, floor=True, motors="position"
    )
    pair = random_legged.write_robot(drawn, tmp_path)
    moving = [link for link in drawn.links if link.where != "urdf" and link.effort]
    commands = " ".join(f"{drawn.gear * link.home:.9g}" for link in moving)
    rewrite_file(pair.mjcf, ('"/></keyframe>', f'" ctrl="{commands}"/></keyframe>'))
    loaded = with_payload(pa.load_robot(pair.urdf, pair.mjcf), 65.053)
    stand = pa.solve_stand(loaded)
    held = make_stand_start(loaded, solve_stand_as_simulated(loaded, stand))
    model, data = held.drive.model, mujoco.MjData(held.drive.model)
    mujoco.mj_setState(model, data, held.start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    data.ctrl[:] = held.ctrl
    start = data.qpos[:2].copy()
    data.qvel[2] = -0.01
    mujoco.mj_step(model, data, round(20.0 / model.opt.timestep))
    assert math.dist(data.qpos[:2], start) > 0.1
    verdict = pa.judge_stand(loaded, stand)
    assert not verdict.passed
    assert [failure.code for failure in verdict.failures] == ["upset-by-nudge"]


def test_unknown_limit_of_a_lift_is_given_as_a_force() -> None:
    """A vertical slide carries 2 kg: 19.62 N, not N m."""
    robot = pa.load_robot(
        """<mujoco><worldbody><body name="base"><geom size=".1" mass="1"/><body name="carriage">
        <joint name="lift" type="slide" axis="0 0 1" range="0 1"/><geom size=".1" mass="2"/></body>
        </body></worldbody><actuator><position joint="lift" kp="5000" kv="200"/></actuator>
        </mujoco>"""
    )
    statics = pa.gravity_compensation(pa.Configuration(robot, [0.5]), contacts=[])
    message = describe_unknown_limits(robot, statics)
    assert message is not None
    assert "up to 19.6 N (lift)" in str(message)


@pytest.mark.slow
def test_audit_errors_appear_in_the_verdict_of_a_held_posture(tmp_path: Path) -> None:
    slip, message = SLIPS["triangle-inequality"]
    robot = pa.load_robot(write_slip(tmp_path, slip), fixed_base=True)
    assert str(message) in format_verdict(pa.hold_posture(robot).verdict)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale_mass", "code"), [(1.0, "inertia-beyond-robot"), (1e6, "mass-beyond-metal")]
)
def test_impossible_mass_or_inertia_comes_first_in_a_bad_verdict(
    scale_mass: float, code: str, tmp_path: Path
) -> None:
    """Reference: the masses of the other file, compiled by bare MuJoCo.

    Such links are in a file that many SpotMicro repositories have copied: 1000 kg m^2 at 50 g.
    """
    text = (ROOT / "urdf/pupper_skeleton.urdf").read_text()

    def change(match: re.Match[str]) -> str:
        inertial = re.sub(
            r'mass value="([^"]*)"',
            lambda mass: f'mass value="{scale_mass * float(mass[1])}"',
            match[0],
        )
        return re.sub(r'(ixx|iyy|izz)="[^"]*"', r'\1="1000"', inertial)

    urdf = tmp_path / "robot.urdf"
    urdf.write_text(re.sub(r'(?s)<link name=".._thigh">.*?</inertial>', change, text))
    robot = pa.load_robot(urdf=urdf)
    remarks = {remark.code: remark for remark in list_file_remarks(robot)}
    message = remarks[code]
    model = mujoco.MjModel.from_xml_path(str(ROOT / "mjcf/pupper_skeleton.xml"))
    mass = model.body(str(message.values["worst"])).mass[0] * scale_mass
    assert message.values["count"] == 4
    assert message.values["mass"].value == pytest.approx(mass)  # type: ignore[union-attr]
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert not verdict.passed
    assert verdict_clauses(verdict)[0].message.code == code


def test_sound_robots_have_no_impossible_mass_or_inertia() -> None:
    """Two variants: v3, and long-leg of the skeleton."""
    for name in ("v3", "long-leg"):
        codes = {remark.code for remark in list_file_remarks(pa.load_robot(name))}
        assert not codes & set(IMPOSSIBLE_CODES)


@pytest.mark.slow
def test_files_that_differ_are_named_before_the_foot_that_carries_nothing(tmp_path: Path) -> None:
    """A hexapod with a knee axis reversed in the MJCF unloads a foot, and stands in bare MuJoCo.

    The predicted torque of the knee has the opposite sign in MuJoCo, so that the foot lifts. Bare
    MuJoCo simulates the file from its keyframe, and the stand with five feet, for 10 s each.
    """
    drawn = random_legged.draw_robot(754504)
    drawn = replace(drawn, base="free", keyframe=True, floor=True, motors="position")
    pair = random_legged.write_robot(drawn, tmp_path)
    axis = 'name="rob_j_5_2" axis="'
    rewrite_file(pair.mjcf, (f"{axis}0.0 1.0 0.0", f"{axis}0 -1 0"))
    robot = pa.load_robot(*pair)
    stand = pa.solve_stand(robot)
    verdict = pa.judge_stand(robot, stand)
    assert verdict.with_feedforward is Ending.DISAGREES
    codes = [failure.code for failure in verdict.failures]
    assert codes[:2] == ["files-of-two-robots", "foot-idle"]
    first, second = [clause.message for clause in verdict_clauses(verdict)][:2]
    assert "the files describe different robots" in str(first)
    assert "foot" not in str(first)
    assert "joint rob_j_5_2: axis reversed" in str(second)

    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    for key in (True, False):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        torques = dict.fromkeys(robot.joint_names, 0.0)
        if not key:
            torques = dict(
                zip(robot.joint_names, stand_statics(robot, stand).joint_torques, strict=True)
            )
            data.qpos[:] = robot.compute_kinematics(stand.qpos).qpos
        for actuator in range(model.nu):
            joint = model.joint(model.actuator_trnid[actuator, 0])
            gear, kp = model.actuator_gear[actuator, 0], model.actuator_gainprm[actuator, 0]
            position = gear * data.qpos[joint.qposadr[0]]
            data.ctrl[actuator] = position + torques[joint.name] / (gear * kp)
        mujoco.mj_forward(model, data)
        height = float(data.subtree_com[1][2])
        mujoco.mj_step(model, data, round(10 / model.opt.timestep))
        assert data.subtree_com[1][2] > 0.95 * height
        assert np.abs(data.qvel).max() < 1e-3


@pytest.mark.slow
def test_ctrl_of_a_keyframe_that_moves_an_arm_is_reported(tmp_path: Path) -> None:
    """The ctrl of an elbow has the wrong sign; the robot stands. Reference: bare MuJoCo."""
    pair = with_arm(slips.standing(tmp_path))
    ctrl = " ".join(["0 0.6 -1.2"] * 4)
    rewrite_file(pair.mjcf, (f'ctrl="{ctrl}"', f'ctrl="{ctrl} 0 -0.9 -1.3"'))
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(5 / model.opt.timestep))
    turned = abs(float(data.joint("arm_elbow").qpos[0]) - 1.3)
    assert turned > 2
    robot = pa.load_robot(*pair)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert verdict.passed
    (remark,) = [
        remark for remark in verdict.remarks if remark.code == "keyframe-commands-elsewhere"
    ]
    assert remark.values["joint"] == "arm_elbow"
    moved = remark.values["off"]
    assert isinstance(moved, Quantity)
    assert moved.value == pytest.approx(turned, rel=1e-3)


@pytest.mark.parametrize(("ratio", "impossible"), [(0.95, False), (1.05, True)])
def test_radius_of_gyration_is_at_most_the_size_of_the_robot(
    ratio: float, impossible: bool
) -> None:
    """By hand: around a sphere of 0.1 m radius the box has a diagonal of 0.2 sqrt(3) m."""
    moment = 2.0 * (ratio * 0.2 * math.sqrt(3)) ** 2
    inertial = f'<inertial pos="0 0 0" mass="2" diaginertia="{moment} {moment} {moment}"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="ball"><freejoint/>{inertial}<geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    assert (describe_impossible_inertias(model) is not None) is impossible


@pytest.mark.parametrize(
    ("friction", "welds", "is_fixed", "slippery"),
    [
        ((0.0, 0.0), (), False, True),
        ((0.0, 0.6), (), False, False),
        ((0.0, 0.0), ("hand",), False, False),
        ((0.0, 0.0), (), True, False),
    ],
)
def test_feet_without_friction_are_reported_unless_the_robot_is_held(
    friction: tuple[float, float], welds: tuple[str, ...], is_fixed: bool, slippery: bool
) -> None:
    contacts = {
        name: SimpleNamespace(sliding_friction=value)
        for name, value in zip(("a", "b"), friction, strict=True)
    }
    robot: Any = SimpleNamespace(contacts=contacts, fixed_parts=welds, is_base_fixed=is_fixed)
    assert (describe_frictionless_feet(robot, ("a", "b")) is not None) is slippery
    assert describe_frictionless_feet(robot, ()) is None


ROPE = (
    '<tendon><spatial name="rope"{limit}><site site="hook"/><site site="eye"/></spatial></tendon>'
)
TIES = {
    "weld": '<equality><weld name="tie" body1="trunk"/></equality>',
    "connect": '<equality><connect name="tie" body1="trunk" anchor="0 0 0"/></equality>',
    "mocap": '<equality><weld name="tie" body1="trunk" body2="hand"/></equality>',
    "part of mocap": '<equality><weld name="tie" body1="trunk" body2="finger"/></equality>',
    "sites": '<equality><connect name="tie" site1="eye" site2="hook"/></equality>',
    "rope": ROPE.format(limit="") + '<equality><tendon tendon1="rope"/></equality>',
    "limited rope": ROPE.format(limit=' limited="true" range="0 0.3"'),
}


def _write_tied(folder: Path, tie: str, kp: float) -> Path:
    """Write a quadruped with a trunk that is tied to the world at its height in the keyframe."""
    path = slips.standing(folder).mjcf
    world = '<site name="hook" pos="0 0 0.65"/><body name="hand" mocap="true" pos="0 0 0.35">'
    world += '<body name="finger"/></body>'
    if tie == "sites":
        world = world.replace("0.65", "0.35")
    rewrite_file(
        path, ("<worldbody>", "<worldbody>" + world), ("</mujoco>", TIES[tie] + "</mujoco>")
    )
    rewrite_file(path, ("<freejoint/>", '<freejoint/><site name="eye"/>'))
    text, count = re.subn(r'kp="[^"]*"', f'kp="{kp}"', path.read_text())
    assert count
    path.write_text(text)
    return path


def _keeps_height(path: Path, *, tied: bool) -> bool:
    """Return True if the CoM keeps 70 % of its height for 5 s in bare MuJoCo, without collapse."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    height = float(data.subtree_com[model.body("trunk").id][2])
    if not tied:
        data.eq_active[:] = 0
        model.tendon_limited[:] = 0
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    return bool(data.subtree_com[model.body("trunk").id][2] > 0.7 * height)


@pytest.mark.slow
@pytest.mark.parametrize("tie", TIES)
@pytest.mark.parametrize("kp", [150.0, 3.0])
def test_a_tie_of_the_base_to_the_world_is_reported_with_its_effect(
    tmp_path: Path, tie: str, kp: float
) -> None:
    """Reference: bare MuJoCo with and without the tie. Servos of 3 N m/rad do not carry the robot;
    a tie does."""
    path = _write_tied(tmp_path, tie, kp)
    assert _keeps_height(path, tied=True)
    robot = pa.load_robot(mjcf=path)
    (message,) = report_ties(robot)
    assert message.values["names"] == ("rope" if "rope" in tie else "tie",)
    assert message.values["line"] is not None
    falls = not _keeps_height(path, tied=False)
    assert falls is (kp < 10)
    assert message.values["falls"] is falls
    assert message.severity == ("error" if falls else "warning")


@pytest.mark.slow
def test_stand_and_analyze_agree_on_a_robot_with_a_weak_tie(tmp_path: Path) -> None:
    """The tie carries less than 0.1 % of the weight: bare MuJoCo stands with and without it.

    ``analyze`` failed the MJCF alone, because no URDF expresses the tie: "the files disagree".
    """
    path = _write_tied(tmp_path, "connect", 150.0)
    weak = 'name="tie" solref="2 1" solimp="0.01 0.01 0.001"'
    rewrite_file(path, ('name="tie"', weak))
    assert _keeps_height(path, tied=True)
    assert _keeps_height(path, tied=False)
    analysis = pa.analyze_variant(pa.load_robot(mjcf=path))
    assert analysis.verdict.passed
    assert "base-tied" in [remark.code for remark in analysis.verdict.remarks]
    assert analysis.verified
    assert analysis.check.passed


def test_a_robot_without_a_tie_has_no_message_about_ties(tmp_path: Path) -> None:
    path = slips.standing(tmp_path).mjcf
    off = '<equality><weld body1="trunk" active="false"/></equality></mujoco>'
    rewrite_file(path, ("</mujoco>", off))
    assert not report_ties(pa.load_robot(mjcf=path))


@pytest.mark.slow
def test_unknown_torque_limits_matter_as_soon_as_the_robot_carries_more(tmp_path: Path) -> None:
    """The MJCF states no torque limit. A stand holds without payload; unknown with payload."""
    robot = pa.load_robot(mjcf=slips.standing(tmp_path).mjcf)
    loaded = with_payload(robot, 0.2, (0.0, 0.0, 0.0))
    found = [judge_stand(model, pa.solve_stand(model)) for model in (robot, loaded)]
    assert [verdict.code for verdict in found] == [VerdictCode.HOLDS, VerdictCode.LIMITS_UNKNOWN]
    assert [verdict.passed for verdict in found] == [True, False]


def _make_outcome(**values: Any) -> Outcome:
    """Return the result of a simulation of 12 s that passed, unless ``values`` state otherwise."""
    return Outcome(**{"passed": True, "failures": (), "duration": 12.0, "stays": True, **values})


def test_stand_that_a_nudge_upsets_does_not_count_as_standing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A robot that tips after 3 s has fallen, whatever the simulation without nudge shows."""
    tipped = NudgeTrial(
        survived=False,
        failure=Failure.TIPPING,
        failing_parts=("FL",),
        time=3.0,
        failed_nudges=2,
        nudges=12,
        duration=12.0,
        simulated=144.0,
        shaking_speed=None,
        shaking_unit="m/s",
    )
    rest: Any = (SimpleNamespace(), SimpleNamespace())
    found = judge._fail_if_upset(
        rest[0], rest[1], _make_outcome(), rest[0], tipped, None, None, fragile=False
    )
    assert not found.passed
    assert not found.stays
    (failure,) = found.failures
    assert failure.code == "upset-by-nudge"
    assert failure.values["fell"] == 2
    # A stand that is not near a limit gets all nudges only if it fails without feed-forward.
    robot: Any = SimpleNamespace(is_base_fixed=False)
    statics: Any = SimpleNamespace(com_margin=0.1)
    calls: list[str] = []
    survived = replace(tipped, survived=True, failure=None)
    monkeypatch.setattr(judge, "solve_stand_as_simulated", lambda *_: None)
    monkeypatch.setattr(judge, "is_near_limit", lambda *_: False)
    monkeypatch.setattr(judge, "saturates_after_nudge", lambda *_: False)
    for name in ("simulate_nudges", "simulate_large_nudges"):
        monkeypatch.setattr(
            judge, name, lambda *_, name=name, **__: (calls.append(name), survived)[1]
        )
    for fragile in (False, True):
        judge._fail_if_upset(
            robot, rest[1], _make_outcome(), statics, None, None, None, fragile=fragile
        )
    assert calls == ["simulate_large_nudges", "simulate_nudges"]


@pytest.mark.parametrize(("ratio", "buried"), [(0.9, False), (1.1, True), (1.9, True)])
def test_foot_that_sinks_by_more_than_its_radius_is_reported(ratio: float, buried: bool) -> None:
    """Reference: the force at which the penetration is a multiple of the radius, by bisection."""
    robot = pa.load_variant("v3")
    stand = pa.solve_stand(robot)
    foot = robot.contact_points[0]
    law, radius = GroundLaw.of_contact(robot, foot), robot.contact_radius[foot]
    low, high = 0.0, 1e9
    for _ in range(200):
        force = (low + high) / 2
        low, high = (force, high) if law.depth(force) < ratio * radius else (low, force)
    assert law.depth(high) == pytest.approx(ratio * radius, rel=1e-6)
    statics: Any = SimpleNamespace(contact_forces={foot: high * stand.normals[foot]})
    messages = judge._report_buried_foot(robot, stand, statics)
    assert [message.code for message in messages] == ["foot-buried"] * buried


@pytest.mark.parametrize(("joints", "first"), [(6, False), (7, True)])
def test_motors_without_torque_are_the_first_cause_if_most_joints_have_one(
    monkeypatch: pytest.MonkeyPatch, joints: int, first: bool
) -> None:
    """A failed simulation of a robot with 12 joints, none of which loads such a motor."""
    names = tuple(f"j{number}" for number in range(joints))
    null = SimpleNamespace(values={"joints": names})
    monkeypatch.setattr(judge, "describe_zero_torque_limits", lambda _: null)
    monkeypatch.setattr(judge, "loads_motor_without_torque", lambda *_: False)
    other: Any = SimpleNamespace()
    fed = _make_outcome(passed=False, failures=(other,))
    robot: Any = SimpleNamespace(nu=12)
    found, alone, message = judge._apply_zero_torque_limits(robot, fed, None, other)
    assert found.failures == ((null, other) if first else (other, null))
    assert alone is None
    assert message is None
    fed = _make_outcome()
    assert judge._apply_zero_torque_limits(robot, fed, None, other) == (fed, None, null)
