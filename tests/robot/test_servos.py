"""Actuators of several types (pid, dcmotor, filters, gears): commands and limits against MuJoCo's
simulation.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.robot import servos
from pupper_analysis.robot.servos import (
    command_ranges,
    integrate_servo_damping,
    model_with_servos,
    read_torque_ranges,
    with_options,
    write_position_servos,
)
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from tests.support.arm import MJCF, STIFFNESS, load_arm
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.legged import Pair, quadruped, rewrite_file
from tests.support.variants import load, stand_of

MOTOR = re.compile(r'<motor joint="(\w+)" ctrlrange="-30 30"/>')

PID = (
    '<pid name="{0}" joint="{0}" kp="150" kv="5" input="pos vel" forcelimited="true" '
    'forcerange="-30 30"/>'
)
DC = '<dcmotor name="{0}" joint="{0}" motorconst="0.5" resistance="1" input="pos vel ff"/>'
IN_PARENT = '<motor jointinparent="{0}" ctrlrange="-30 30"/>'


def with_motors(pair: Pair, element: str, joints: str = "") -> Pair:
    """Replace the motors of 30 N m at joints whose names begin with `joints` by another element."""

    def other(match: re.Match[str]) -> str:
        return element.format(match[1]) if match[1].startswith(joints) else match[0]

    pair.mjcf.write_text(MOTOR.sub(other, pair.mjcf.read_text()))
    pair.urdf.write_text(pair.urdf.read_text().replace('effort="80"', 'effort="30"'))
    return pair


def test_servo_after_an_actuator_with_several_outputs_keeps_its_gear() -> None:
    """MuJoCo's array of gears has a row per output. References: the stated gains, and the force of
    the rewritten servo, kp times the error of the joint.
    """
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="ball" type="ball"/><geom size="0.1"/>
    <body pos="0 0 1"><joint name="hinge"/><geom size="0.1"/></body></body></worldbody>
    <actuator>
    <general joint="ball" gaintype="so3" biastype="so3" gainprm="1" biasprm="0 -1 0"/>
    <position joint="hinge" kp="10" gear="7"/>
    </actuator></mujoco>""")
    gain, _, gear, is_servo = servos._read_actuator_gains(model, np.array([1]))
    assert (gain[0], gear[0], is_servo[0]) == (490.0, 7.0, True)
    write_position_servos(model, np.array([1]), 20.0, 1.0)
    data = mujoco.MjData(model)
    data.qpos[model.joint("hinge").qposadr[0]] = 0.1
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[model.joint("hinge").dofadr[0]] == pytest.approx(-2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("element", "controls"), [(PID, 15), (DC, 18)])
def test_motors_of_several_controls_are_read(element: str, controls: int, tmp_path: Path) -> None:
    """Reference: counts of MuJoCo's model, with more controls than actuators."""
    pair = with_motors(quadruped(tmp_path), element, "FL")
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    assert (model.nu, model.nactuator) == (controls, 12)
    differences = pa.compare_models(pair.urdf, pair.mjcf).differences
    lost = {"FL_roll", "FL_pitch", "FL_knee"} if element == DC else set()
    assert {(found.kind, found.element) for found in differences} == {
        ("effort", name) for name in lost
    }
    assert pa.audit_model(pair.mjcf).passed
    assert pa.diff_models(pair.mjcf, pair.mjcf).same


def stand_printed(pair: Pair) -> tuple[int, str]:
    """Return the exit status and the printed lines of ``stand -v``."""
    done = CliRunner().invoke(
        cli.group, ["stand", "--urdf", str(pair.urdf), "--mjcf", str(pair.mjcf), "-v"]
    )
    return done.exit_code, done.output


POSITIONS = " ".join(["0 0 0.6 0 -1.2 0"] * 4)
"""Commands of ``pid`` actuators: position [rad] and velocity [rad/s] of the joints of each leg."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("element", "ctrl"), [(PID, f' ctrl="{POSITIONS}"'), (DC, ""), (IN_PARENT, "")]
)
def test_stand_holds_on_pid_dc_and_parent_frame_actuators(
    element: str, ctrl: str, tmp_path: Path
) -> None:
    """Reference: simulation.

    Torque motors without ctrl in the keyframe do not decide; ``pid`` holds the keyframe.
    """
    pair = with_motors(quadruped(tmp_path), element)
    rewrite_file(pair.mjcf, ('"/></keyframe>', f'"{ctrl}/></keyframe>'))
    status, printed = stand_printed(pair)
    assert "HOLDS in MuJoCo for" in printed, printed
    assert status == 0, printed


@pytest.mark.slow
def test_a_robot_fails_whose_pid_actuators_are_commanded_to_zero(tmp_path: Path) -> None:
    """Reference: the unmodified file in bare MuJoCo. ``pid`` holds a position; ctrl states 0."""
    pair = with_motors(quadruped(tmp_path), PID)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    height = data.qpos[2]
    mujoco.mj_step(model, data, nstep=round(3 / model.opt.timestep))
    assert data.qpos[2] < height / 2
    status, printed = stand_printed(pair)
    assert printed.splitlines()[0].startswith("FAILS"), printed
    assert "an actuator with another control law" in printed
    assert status == 1


BOTH = '<position name="p_{0}" joint="{0}" kp="150"/><velocity name="v_{0}" joint="{0}" kv="5"/>'
BRAKED = '<motor joint="{0}" gear="2"/><damper joint="{0}" kv="3" ctrlrange="0 1"/>'
LAGGING = '<position joint="{0}" kp="150" kv="5" timeconst="0.05"/>'
BIASED = (
    '<general joint="{0}" gainprm="150" biastype="affine" biasprm="4 -150 -5" '
    'forcerange="-30 30" forcelimited="true"/>'
)
SPEED = '<intvelocity joint="{0}" kp="150" kv="5" actrange="-3 3"/>'


def load_pair(pair: Pair) -> pa.Robot:
    return pa.load_robot(*pair)


def verify_held_stand(robot: pa.Robot) -> None:
    """Assert that MuJoCo holds the stand on soft ground, with a relative torque error below
    1e-5.
    """
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    found = pa.verify_stand(robot, stand)
    assert found.passed, found.failures
    assert found.torque_error < 1e-5


@pytest.mark.parametrize("element", [BOTH, BRAKED])
def test_several_motors_at_a_joint_are_refused(element: str, tmp_path: Path) -> None:
    with pytest.raises(pa.ModelError, match="FL_roll, FL_pitch, FL_knee and 9 more have sev"):
        load_pair(with_motors(quadruped(tmp_path), element))


@pytest.mark.slow
@pytest.mark.parametrize("element", [LAGGING, BIASED, SPEED])
def test_stand_holds_on_motors_with_filter_bias_or_velocity_feedback(
    element: str, tmp_path: Path
) -> None:
    """Reference: simulation.

    The filter starts at rest; an actuator with a constant force is no servo, so servos are added.
    """
    robot = load_pair(with_motors(quadruped(tmp_path), element))
    lagging = element is LAGGING
    assert any(note.code == "servos-added" for note in robot.notes) != lagging
    verify_held_stand(robot)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "pulls"), [("motor", False), ("position", True)])
def test_motor_of_a_tendon_exerts_no_force_and_gives_a_note(
    kind: str, pulls: bool, tmp_path: Path
) -> None:
    """The stand holds in simulation; commands of several postures at once equal those of single
    postures, and vary only for a position servo.
    """
    pair = quadruped(tmp_path)
    rope = (
        '<tendon><fixed name="rope"><joint joint="FL_knee" coef="1"/>'
        '<joint joint="FL_pitch" coef="1"/></fixed></tendon><actuator>'
        f'<{kind} name="winch" tendon="rope"/>'
    )
    rewrite_file(pair.mjcf, ("<actuator>", rope))
    robot = pa.load_robot(*pair)
    (message,) = [note for note in robot.notes if note.code == "motors-commanded-zero"]
    assert message.values["motors"] == ("winch",)
    verify_held_stand(robot)
    drive, rows = model_with_servos(robot), robot.home[7:] + np.array([[0.0], [0.1], [-0.2]])
    one_by_one = [drive.command(robot, row, row) for row in rows]
    np.testing.assert_array_equal(drive.command(robot, rows, rows), one_by_one)
    assert bool(np.ptp([row[0] for row in one_by_one]) > 0.1) is pulls
    plain = quadruped(tmp_path)
    notes = pa.load_robot(*plain).notes
    assert not [note for note in notes if note.code == "motors-commanded-zero"]


def test_requested_contact_options_are_simulated_with_a_note() -> None:
    """Cone and impratio are in the model and its description; the original robot is unchanged."""
    plain = load_variant("v3")
    robot = with_options(plain, cone="elliptic", impratio=50.0)
    assert robot.mj_model.opt.impratio == robot.description.mjcf.option.impratio == 50.0
    assert robot.mj_model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC.value
    assert plain.mj_model.opt.impratio != 50.0
    [message] = [note for note in robot.notes if note.code == "contacts-as-asked"]
    assert message.values["own_impratio"] == plain.mj_model.opt.impratio
    assert with_options(plain) is plain


def test_a_requested_time_step_is_simulated_with_a_note() -> None:
    """Reference: the time of MuJoCo's data after one step."""
    plain = load_variant("v3")
    robot = with_options(plain, timestep=5e-4)
    data = mujoco.MjData(model_with_servos(robot).model)
    mujoco.mj_step(model_with_servos(robot).model, data)
    assert data.time == robot.description.mjcf.option.timestep == 5e-4
    assert plain.mj_model.opt.timestep != 5e-4
    [message] = [note for note in robot.notes if note.code == "timestep-as-requested"]
    assert message.values["own"].value == plain.mj_model.opt.timestep


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"timestep": 0.0}, "timestep: 0 s is not between"),
        ({"timestep": 1.0}, "timestep: 1 s is not between"),
        ({"timestep": 1e-5}, "timestep: 1e-05 s is not between"),
        ({"cone": "round"}, "valid: elliptic, pyramidal"),
        ({"impratio": -1.0}, "must be positive and at most 100000"),
        ({"impratio": 1.01e5}, "must be positive and at most 100000"),
        ({"impratio": math.nan}, "must be positive and at most 100000"),
    ],
)
def test_invalid_simulation_options_are_refused(asked: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        with_options(load_variant("v3"), **asked)


GEARS = np.array([2.0, -1.5, 0.4] * 4)
"""Gears of the joints of each leg; one is negative."""


def add_gears(name: str, *, force: float | None = None) -> pa.Robot:
    """Load a variant with gears; the other numbers of the actuators are not changed."""
    robot = load(name)
    actuators = robot.mj_convention.actuator_index

    def change(model: mujoco.MjModel) -> None:
        model.actuator_gear[actuators, 0] = GEARS
        if force is not None:
            model.actuator_forcelimited[:] = 1
            model.actuator_forcerange[:] = -force, force

    return change_model(robot, change)


@pytest.mark.parametrize("name", ["v3", "original"])
def test_servo_torque_follows_from_random_gains_per_joint(name: str) -> None:
    """Reference: MuJoCo's ``qfrc_actuator``, kp (q* - q) + feed-forward - kd dq/dt."""
    robot, random = load(name), np.random.default_rng(0)
    kp, kd = random.uniform(1, 9, 12), random.uniform(0.1, 1, 12)
    drive = model_with_servos(robot, kp, kd)
    qpos, rates = stand_of(name).qpos, random.uniform(-1, 1, 12)
    wanted, torque = random.uniform(-0.2, 0.2, 12), random.uniform(-0.5, 0.5, 12)
    data = evaluate_mujoco(robot, qpos, np.r_[np.zeros(6), rates], drive.model)
    data.ctrl[:] = drive.command(robot, qpos[7:] + wanted, torque)
    mujoco.mj_forward(drive.model, data)
    np.testing.assert_allclose(
        data.qfrc_actuator[6:], kp * wanted + torque - kd * rates, atol=1e-12
    )


@pytest.mark.parametrize("gains", [{}, {"kp": 7.0, "kd": 0.3}])
def test_servo_torque_at_the_joint_equals_mujocos_actuator_force(gains: dict[str, float]) -> None:
    """Reference: MuJoCo's ``qfrc_actuator``, kp (q* - q) + feed-forward - kd dq/dt, with the file's
    or the requested gains."""
    robot, name = add_gears("v3"), "v3"
    drive = model_with_servos(robot, **gains)
    actuators = robot.mj_convention.actuator_index
    own = (load(name).mj_model.actuator_gainprm[actuators, 0] * GEARS**2, 0.1 * GEARS**2)
    for found, given, file in ((drive.kp, "kp", own[0]), (drive.kd, "kd", own[1])):
        np.testing.assert_allclose(found, gains.get(given, file), rtol=1e-12)
    random = np.random.default_rng(2)
    rates, wanted, torque = (random.uniform(-size, size, 12) for size in (0.5, 0.1, 0.05))
    qpos = stand_of(name).qpos
    data = evaluate_mujoco(robot, qpos, np.r_[np.zeros(6), rates], drive.model)
    model = drive.model
    model.actuator_forcelimited[:] = 0
    model.actuator_ctrllimited[:] = 0
    data.ctrl[:] = drive.command(robot, qpos[7:] + wanted, torque)
    mujoco.mj_forward(model, data)
    joints = np.array([model.joint(name).dofadr[0] for name in robot.joint_names])
    np.testing.assert_allclose(
        data.qfrc_actuator[joints], drive.kp * wanted + torque - drive.kd * rates, atol=1e-12
    )


def test_a_servo_saturates_at_its_force_range_times_the_gear() -> None:
    """Reference: MuJoCo's ``qfrc_actuator``, 1 rad from the command; the static model must saturate
    at the same torque."""
    robot = add_gears("v3", force=0.9)
    drive, stand = model_with_servos(robot, kp=50.0, kd=0.0), stand_of("v3")
    data = evaluate_mujoco(robot, stand.qpos, model=drive.model)
    drive.model.actuator_ctrllimited[:] = 0
    for sign in (1, -1):
        data.ctrl[:] = drive.command(robot, stand.qpos[7:] + sign * 1.0)
        mujoco.mj_forward(drive.model, data)
        joints = np.array([drive.model.joint(name).dofadr[0] for name in robot.joint_names])
        np.testing.assert_allclose(data.qfrc_actuator[joints], sign * 0.9 * np.abs(GEARS))
        system = SagEquilibrium(robot, stand, 50.0, "pinned")
        away = np.r_[stand.qpos[:7], system.target - sign * 1.0]
        np.testing.assert_allclose(system.torques(away), sign * 0.9 * np.abs(GEARS), rtol=1e-12)


def test_force_ranges_are_narrowed_at_each_end_alone() -> None:
    """An effort of -5 to 20 N m and a forcerange of -10 to 10 N m leave -5 to 10 N m."""
    from pupper_analysis.robot.servos import _narrow_force_ranges

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody><actuator>'
        '<position joint="j" kp="1" forcerange="-10 10"/><position joint="j" kp="1"/>'
        "</actuator></mujoco>"
    )
    efforts = np.array([[-5.0, 20.0], [-3.0, 4.0]])
    _narrow_force_ranges(model, np.array([0, 1]), np.array([1.0, -2.0]), efforts)
    np.testing.assert_allclose(model.actuator_forcerange, [[-5.0, 10.0], [-2.0, 1.5]])
    assert model.actuator_forcelimited.all()


@pytest.mark.slow
def test_symmetric_robot_does_not_stand_on_servos_beyond_their_stability_limit(
    tmp_path: Path,
) -> None:
    """Equal on all sides, it rests in an exact balance unless it is nudged: Euler's step of 2 ms is
    unstable with kp = 3000 N m/rad and kd = 40 N m s/rad."""
    pair = quadruped(tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    assert pa.verify_stand(robot, stand, kp=100.0, kd=5.0).passed
    shaking = pa.verify_stand(robot, stand, kp=3000.0, kd=40.0, integrator="Euler")
    assert not shaking.passed
    assert "mode-shakes" in {failure.code for failure in shaking.failures}


def test_effort_limit_is_the_force_range_times_the_gear() -> None:
    robot = add_gears("v3", force=0.9)
    expected = np.minimum(0.9 * np.abs(GEARS), load("v3").effort_limits)
    np.testing.assert_allclose(robot.effort_limits, expected, rtol=1e-12)


@pytest.mark.slow
def test_robot_with_gears_stands_as_without_for_equal_gains_at_the_joints() -> None:
    stand = stand_of("v3")
    plain, geared = (
        pa.verify_stand(robot, stand, kp=8.0, kd=0.2, feedforward=False, duration=2.0)
        for robot in (load("v3"), add_gears("v3"))
    )
    np.testing.assert_allclose(geared.joint_torques, plain.joint_torques, atol=1e-7)
    assert geared.base_height == pytest.approx(plain.base_height, abs=1e-8)
    sag = [pa.steady_state(robot, stand, kp=8.0) for robot in (load("v3"), add_gears("v3"))]
    np.testing.assert_allclose(sag[1].qpos, sag[0].qpos, atol=1e-10)


@pytest.mark.slow
def test_motor_in_the_parent_frame_has_the_limit_of_its_joint(tmp_path: Path) -> None:
    pair = with_motors(quadruped(tmp_path), IN_PARENT)
    robot = load_pair(pair)
    assert robot.effort_limits[robot.joint_names.index("RL_knee")] == 30
    assert pa.compare_models(pair.urdf, pair.mjcf).agree


def test_diff_compares_the_range_of_each_control_of_a_motor(tmp_path: Path) -> None:
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    text = with_motors(quadruped(tmp_path), PID, "FL").mjcf.read_text()
    old.write_text(text)
    new.write_text(text.replace('ctrlrange="-30 30"', 'ctrlrange="-30 40"', 1))
    (change,) = (c for c in pa.diff_models(old, new).changes if c.kind == "motor")
    assert change.message.startswith("motor #3: ctrlrange (-30, 30) in the old file")


def test_rewritten_servo_with_a_filter_follows_its_control() -> None:
    """Reference: a servo without filter, with the same gains, in MuJoCo."""
    text = (
        "<mujoco><worldbody><body><joint name='hinge' axis='0 1 0'/>"
        "<geom size='0.1' pos='0.3 0 0' mass='1'/></body></worldbody>"
        "<actuator><position joint='hinge' kp='{}' kv='{}' {}/></actuator></mujoco>"
    )
    filtered = mujoco.MjModel.from_xml_string(text.format(20, 1, "timeconst='0.05'"))
    write_position_servos(filtered, np.array([0]), 200.0, 10.0)
    angles = []
    for model in (filtered, mujoco.MjModel.from_xml_string(text.format(200, 10, ""))):
        data = mujoco.MjData(model)
        data.ctrl[0] = 0.5
        mujoco.mj_step(model, data, 1000)
        angles.append(float(data.qpos[0]))
    assert angles[0] == pytest.approx(angles[1], abs=1e-12)
    assert angles[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("clamped", [True, False])
def test_command_range_is_that_to_which_mujoco_clips(tmp_path: Path, *, clamped: bool) -> None:
    """Reference: MuJoCo's actuator force for a command of 2 rad beyond the ``ctrlrange``."""
    mjcf = MJCF.replace('<position joint="shoulder"', '<position joint="shoulder" ctrlrange="-1 1"')
    flag = "" if clamped else '<flag clampctrl="disable"/>'
    mjcf = mjcf.replace('integrator="implicitfast"/>', f'integrator="implicitfast">{flag}</option>')
    robot = load_arm(tmp_path, mjcf=mjcf)
    joint = robot.joint_names.index("shoulder")
    high = command_ranges(robot)[joint, 1]
    data = mujoco.MjData(robot.mj_model)
    actuator = robot.mj_convention.actuator_index[joint]
    data.ctrl[robot.mj_model.actuator_ctrladr[actuator]] = 3.0
    mujoco.mj_forward(robot.mj_model, data)
    assert data.actuator_force[actuator] == pytest.approx(STIFFNESS["shoulder"] * min(3.0, high))


def test_torques_of_a_saturated_servo_are_those_of_the_engine() -> None:
    """Reference: inertia times change of velocity in bare ``mj_step``, divided by the time step.

    The servo has an asymmetric range, and saturates in the first steps only.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/><worldbody>'
        '<body><joint name="j"/><inertial mass="1" pos="0 0 0" diaginertia="0.1 0.1 0.1"/></body>'
        '</worldbody><actuator><position joint="j" kp="100" kv="5" forcerange="-2 3"/></actuator>'
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    data.ctrl[0], kd = 0.05, np.array([5.0])
    torques, speeds = list[float](), [0.0]
    for _ in range(200):
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_actuator[0]))
        mujoco.mj_step(model, data)
        speeds.append(float(data.qvel[0]))
    ranges = read_torque_ranges(model, np.array([0]))
    np.testing.assert_array_equal(ranges, [[-2.0, 3.0]])
    columns = np.array(torques)[:, None], np.array(speeds)[:, None]
    applied = integrate_servo_damping(model, kd, *columns, ranges)
    assert torques[0] == 3.0
    assert min(torques) < -0.1
    expected = 0.1 * np.diff(speeds) / 0.002
    np.testing.assert_allclose(applied[:, 0], expected, atol=1e-9)
