"""Joints that an actuator drives through a fixed tendon: commands, limits and verdicts."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.transmission import (
    Drive,
    list_tendon_joints,
    measure_actuator_levers,
)
from pupper_analysis.prepare.limits import list_overloaded_joints
from pupper_analysis.prepare.own_run import get_published_model
from pupper_analysis.prepare.published_model import (
    PublishedModel,
    compute_hold_commands,
    place_published,
)
from pupper_analysis.simulation.verdict import Ending, VerdictCode
from tests.support.slips import standing

KNEE = r'<position joint="FL_knee" ([^>]*)/>'
"""Servo of the knee that a tendon drives instead."""

TENDON = (
    '<tendon><fixed name="cord"><joint joint="FL_pitch" coef="0.5"/>'
    '<joint joint="FL_knee" coef="2"/></fixed></tendon><actuator>'
)
"""Tendon of length 0.5 q_pitch + 2 q_knee."""


def with_tendon(
    folder: Path, stiffness: str = "", length: float = -2.1, pitch: str = "", tendon: str = ""
) -> pa.Robot:
    """Load a quadruped whose FL_knee is driven by the servo ``winch`` of a tendon.

    Args:
        folder: Folder of the files.
        stiffness: Further attributes of the servo. Default: the gains of the knee's servo.
        length: Commanded length of the tendon in the keyframe. The length in the pose of the
            keyframe is 0.5 * 0.6 - 2 * 1.2.
        pitch: Further attributes of the servo of FL_pitch.
        tendon: Further attributes of the tendon.
    """
    pair = standing(folder)
    text = pair.mjcf.read_text().replace("<actuator>", TENDON, 1)
    text, count = re.subn(
        KNEE,
        lambda found: f'<position name="winch" tendon="cord" {stiffness or found[1]}/>',
        text,
    )
    assert count == 1
    for element, more in (('<position joint="FL_pitch"', pitch), ('<fixed name="cord"', tendon)):
        assert text.count(element) == 1
        text = text.replace(element, f"{element} {more}")
    text = re.sub(r'ctrl="0 0.6 -1.2', f'ctrl="0 0.6 {length}', text)
    pair.mjcf.write_text(text)
    return pa.load_robot(pair.urdf, pair.mjcf)


@pytest.mark.slow
def test_the_servo_of_a_tendon_holds_its_joints_in_the_published_file(tmp_path: Path) -> None:
    """Reference: ``qfrc_actuator`` of bare MuJoCo at rest, with the computed commands.

    The servo at the tendon gives the torque of the knee, 2 F; the servo of the pitch joint gives
    the rest of its torque, tau - 0.5 F.
    """
    robot = with_tendon(tmp_path)
    assert [servo.instead_of for servo in robot.description.made_servos] == [Drive.TENDON]
    stand = pa.solve_stand_as_simulated(robot)
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    model = get_published_model(robot)
    assert model is not None
    published = PublishedModel.from_model(model, robot)
    data = place_published(published, robot, stand.qpos)
    assert data is not None
    targets = stand.joint_positions(robot)
    hold = compute_hold_commands(published, robot, data, torques, targets)
    assert not len(hold.external[0])
    data.ctrl[:] = hold.ctrl
    mujoco.mj_forward(model, data)
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in robot.joint_names]
    assert data.qfrc_actuator[dofs] == pytest.approx(torques, abs=1e-9)
    knee = robot.joint_names.index("FL_knee")
    assert abs(torques[knee]) > 0.1
    assert 2 * data.actuator("winch").force[0] == pytest.approx(torques[knee], abs=1e-9)
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert data.qfrc_actuator[dofs] == pytest.approx(torques, abs=0.01 * np.abs(torques).max())


@pytest.mark.slow
@pytest.mark.parametrize("length", [-2.1, 2.1])
def test_the_unmodified_file_decides_about_joints_at_tendons(tmp_path: Path, length: float) -> None:
    """Bare MuJoCo stands on the tendon's servo, and falls over if its command has the wrong sign.

    The prepared robot, with a servo at the joint, stands in both cases.
    """
    robot = with_tendon(tmp_path, length=length)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert verdict.with_feedforward is Ending.HOLDS
    assert verdict.passed is (length < 0)
    assert (verdict.code is VerdictCode.OWN_DRIVES_FAIL) is (length > 0)
    [remark] = [remark for remark in verdict.remarks if remark.code == "joints-at-tendons"]
    assert remark.values["joints"] == ("FL_knee",)
    assert remark.values["tendons"] == ("cord",)
    assert remark.values["actuators"] == ("winch",)
    assert remark.values["too_few"] is False
    assert verdict.published is not None
    assert [run.feedforward for run in verdict.published.runs] == [True]


@pytest.mark.slow
def test_the_force_range_of_a_tendon_limits_the_joint_that_it_drives_alone(tmp_path: Path) -> None:
    """Closed form: 3 N at the tendon are 6 N m at the knee, whose lever is 2."""
    robot = with_tendon(tmp_path, 'kp="40" kv="2" forcerange="-3 3"')
    limits = {limit.joint: limit for limit in robot.efforts}
    assert (limits["FL_knee"].lower, limits["FL_knee"].upper) == (-6.0, 6.0)
    assert limits["FL_knee"].origin is not None
    assert limits["FL_knee"].origin.name == "winch"
    assert limits["FL_pitch"].upper == limits["FR_pitch"].upper


@pytest.mark.slow
def test_the_force_range_of_a_tendon_itself_limits_its_joint(tmp_path: Path) -> None:
    """Reference: the torque that bare MuJoCo applies to the knee with a large command."""
    robot = with_tendon(tmp_path, tendon='actuatorfrcrange="-2 2"')
    model = get_published_model(robot)
    assert model is not None
    data = mujoco.MjData(model)
    data.ctrl[:] = 100.0
    mujoco.mj_forward(model, data)
    torque = float(data.qfrc_actuator[model.joint("FL_knee").dofadr[0]])
    (limit,) = (limit for limit in robot.efforts if limit.joint == "FL_knee")
    assert torque == pytest.approx(4.0)
    assert (limit.lower, limit.upper) == pytest.approx((-torque, torque))
    assert limit.origin is not None
    assert (limit.origin.element, limit.origin.name) == ("tendon", "cord")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pitch", "tendon", "overloaded"),
    [
        ('forcerange="-0.49 0.49"', "", ("FL_pitch",)),
        ('forcerange="-0.50 0.50"', "", ()),
        ("", 'actuatorfrcrange="-0.98 0.98"', ("FL_knee",)),
        ("", 'actuatorfrcrange="-0.99 0.99"', ()),
    ],
)
def test_motor_beside_a_tendon_exerts_the_remaining_torque(
    tmp_path: Path, pitch: str, tendon: str, overloaded: tuple[str, ...]
) -> None:
    """Closed form: the pitch motor exerts tau_pitch - tau_knee / 4, the tendon tau_knee / 2.

    The knee needs 1.976 N m, the pitch joint nothing: 0.494 N m and 0.988 N.
    """
    robot = with_tendon(tmp_path, pitch=pitch, tendon=tendon)
    stand = pa.solve_stand_as_simulated(robot)
    statics = pa.stance.stand_statics(robot, stand)
    positions = stand.joint_positions(robot)
    torques = dict(zip(statics.joint_names, statics.joint_torques.tolist(), strict=True))
    assert torques["FL_knee"] == pytest.approx(1.976, abs=1e-3)
    assert torques["FL_pitch"] == pytest.approx(0.0, abs=1e-9)
    assert list_overloaded_joints(robot, statics, positions) == overloaded


@pytest.mark.slow
def test_payload_is_limited_by_another_motor_that_the_tendon_overloads(tmp_path: Path) -> None:
    """Closed form: |tau_pitch - tau_knee / 4| = 1.2 N m at the limit.

    In bare MuJoCo the pitch joint stays within 1e-9 rad for 20 s with 97 % of this mass, and moves
    by 0.26 rad with 103 %. The servo at the knee alone would carry 12.4 kg.
    """
    robot = with_tendon(tmp_path, pitch='forcerange="-1.2 1.2"')
    limit = pa.payload_limit(robot)
    assert limit.failing_parts == ("FL_pitch",)
    torques = limit.torque_by_joint
    assert torques["FL_pitch"] - torques["FL_knee"] / 4 == pytest.approx(-1.2, rel=1e-5)
    assert limit.passed


@pytest.mark.slow
def test_a_tendon_at_coupled_joints_loads_no_motor_of_the_dependent_joint(tmp_path: Path) -> None:
    """Both front knees are coupled, and a tendon drives them; the dependent knee has no motor.

    Its torque limit of 1 N m has no effect, though the tendon exerts about 2 N m at each knee: in
    bare MuJoCo the file stands.
    """
    pair = standing(tmp_path)
    text = pair.mjcf.read_text()
    text, count = re.subn(r'<position joint="(FL|FR)_knee" [^>]*/>', "", text)
    assert count == 2
    cord = '<fixed name="cord"><joint joint="FL_knee" coef="1"/><joint joint="FR_knee" coef="1"/>'
    couple = '<equality><joint joint1="FR_knee" joint2="FL_knee"/></equality>'
    text = text.replace(
        "<actuator>",
        f"<tendon>{cord}</fixed></tendon>{couple}<actuator>"
        '<position name="winch" tendon="cord" kp="75" kv="2.5"/>',
        1,
    )
    text = re.sub(r' ctrl="[^"]*"', f' ctrl="-2.4 0 0.6 0 0.6 {"0 0.6 -1.2 " * 2}"', text)
    pair.mjcf.write_text(text)
    urdf = pair.urdf.read_text()
    begin = urdf.index('<joint name="FR_knee"')
    urdf = urdf[:begin] + urdf[begin:].replace('effort="80"', 'effort="1"', 1)
    pair.urdf.write_text(urdf)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    assert robot.closure is not None
    assert [servo.instead_of for servo in robot.description.made_servos] == [Drive.TENDON]
    stand = pa.solve_stand_as_simulated(robot)
    statics = pa.stance.stand_statics(robot, stand)
    positions = stand.joint_positions(robot)
    assert list_overloaded_joints(robot, statics, positions) == ()
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    height = float(data.qpos[2])
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert data.qpos[2] > 0.95 * height
    verdict = pa.judge_stand(robot, pa.solve_stand(robot))
    assert not verdict.overloaded_motors


SITES = (("FL_thigh", "-0.04 0 -0.08"), ("FL_calf", "-0.04 0 -0.05"))
"""Bodies and positions of the ends of a spatial tendon across FL_knee."""


def with_spatial_tendon(folder: Path, more: str = "") -> pa.Robot:
    """Load a quadruped whose FL_knee is driven by the servo ``winch`` of a spatial tendon.

    In the keyframe the tendon is commanded to its length.
    """
    folder.mkdir(exist_ok=True)
    pair = standing(folder)
    winch = f'<position name="winch" tendon="cord" kp="2e5" kv="400" {more}/>'
    text, count = re.subn(KNEE, winch, pair.mjcf.read_text())
    assert count == 1
    for body, place in SITES:
        tag = re.search(rf'<body name="{body}"[^>]*>', text)
        assert tag is not None
        text = text.replace(tag[0], f'{tag[0]}<site name="on_{body}" pos="{place}"/>')
    path = "".join(f'<site site="on_{body}"/>' for body, _ in SITES)
    text = text.replace(
        "<actuator>", f'<tendon><spatial name="cord">{path}</spatial></tendon><actuator>', 1
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    length = float(data.ten_length[0])
    text = re.sub(r'ctrl="0 0.6 -1.2', f'ctrl="0 0.6 {length!r}', text)
    pair.mjcf.write_text(text)
    return pa.load_robot(pair.urdf, pair.mjcf)


def test_joints_of_a_tendon_are_those_on_which_its_length_depends() -> None:
    """Reference: finite differences of the length."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="a"><joint name="one"/><geom size=".1"/>'
        '<site name="s"/><site name="v" pos=".1 0 0"/>'
        '<body pos=".3 0 0"><joint name="two" axis="0 1 0"/><geom size=".1"/>'
        '<site name="t" pos=".1 0 .05"/><body pos=".3 0 0"><joint name="three" axis="0 1 0"/>'
        '<geom name="g" size=".02" pos=".1 0 0"/><site name="u" pos=".2 0 .05"/></body></body>'
        "</body></worldbody><tendon>"
        '<spatial name="across"><site site="s"/><geom geom="g"/><site site="u"/></spatial>'
        '<spatial name="inside"><site site="t"/><site site="u"/><pulley divisor="2"/>'
        '<site site="s"/><site site="v"/></spatial>'
        '<fixed name="sum"><joint joint="one" coef="2"/><joint joint="three" coef="0"/></fixed>'
        "</tendon><actuator>"
        '<motor tendon="across"/><motor tendon="inside" gear="3"/><motor tendon="sum"/>'
        '<motor tendon="across" gear="0"/></actuator></mujoco>'
    )
    joints = {name: model.joint(name).id for name in ("one", "two", "three")}
    assert list_tendon_joints(model) == {
        0: {joints["two"], joints["three"]}, 1: {joints["three"]}, 2: {joints["one"]}, 3: set(),
    }  # fmt: skip
    qpos, step = np.array([0.3, -0.4, 0.7]), 1e-6
    _, levers = measure_actuator_levers(model, qpos, range(4))
    for joint in range(3):
        ends = [
            measure_actuator_levers(model, qpos + side * step * np.eye(3)[joint], range(4))[0]
            for side in (-1, 1)
        ]
        assert levers[:, joint] == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-8)


@pytest.mark.slow
def test_the_servo_of_a_spatial_tendon_holds_its_joint_in_the_published_file(
    tmp_path: Path,
) -> None:
    """Reference: bare MuJoCo, which stands from the keyframe for 5 s, and ``qfrc_actuator``."""
    robot = with_spatial_tendon(tmp_path)
    assert [servo.instead_of for servo in robot.description.made_servos] == [Drive.TENDON]
    stand = pa.solve_stand(robot)
    verdict = pa.judge_stand(robot, stand)
    assert verdict.passed
    [remark] = [remark for remark in verdict.remarks if remark.code == "joints-at-tendons"]
    assert remark.values["joints"] == ("FL_knee",)
    assert remark.values["spatial"] == ("winch",)
    held = pa.solve_stand_as_simulated(robot, stand)
    torques = pa.stance.stand_statics(robot, held).joint_torques
    model = get_published_model(robot)
    assert model is not None
    published = PublishedModel.from_model(model, robot)
    data = place_published(published, robot, held.qpos)
    assert data is not None
    hold = compute_hold_commands(published, robot, data, torques, held.joint_positions(robot))
    assert not len(hold.external[0])
    data.ctrl[:] = hold.ctrl
    mujoco.mj_forward(model, data)
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in robot.joint_names]
    assert data.qfrc_actuator[dofs] == pytest.approx(torques, abs=1e-9)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert data.xmat[published.base_body, 8] > np.cos(np.radians(2.0))


@pytest.mark.slow
def test_force_range_of_a_spatial_tendon_is_compared_at_the_stand(tmp_path: Path) -> None:
    """Closed form: the knee's torque of 1.976 N m divided by the lever of the tendon."""
    robot = with_spatial_tendon(tmp_path)
    stand = pa.solve_stand_as_simulated(robot)
    statics = pa.stance.stand_statics(robot, stand)
    positions = stand.joint_positions(robot)
    knee = robot.joint_names.index("FL_knee")
    first, second = np.array([-0.04, -0.08]), np.array([-0.04, -0.05])  # x, z; calf at (0, -0.2)
    angle = positions[knee]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    end = np.array([0.0, -0.2]) + turn @ second
    along = (end - first) / np.linalg.norm(end - first)
    arm = end - np.array([0.0, -0.2])
    lever = arm[1] * along[0] - arm[0] * along[1]
    force = float(abs(statics.joint_torques[knee] / lever))
    for share, overloaded in ((1.01, ()), (0.99, ("FL_knee",))):
        limited = with_spatial_tendon(
            tmp_path / str(share), f'forcerange="{-share * force!r} {share * force!r}"'
        )
        assert list_overloaded_joints(limited, statics, positions) == overloaded
