"""Torque limits of motors: four attributes of two files may specify them, and the smallest counts.

MuJoCo's actuator forces and simulations are the references.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.attributes import MIN_UNSTATED_LIMIT
from pupper_analysis.models.efforts import find_null_efforts, resolve_effort_limit
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.transmission import Drive, classify_joint_drive
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare import judge
from pupper_analysis.prepare.drives import make_missing_servos
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.limits import describe_zero_torque_limits
from pupper_analysis.robot.build import rebuild_robot, with_efforts
from pupper_analysis.robot.robot import report_efforts
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.verdict import Outcome
from pupper_analysis.tools.stand.stance import study_stance
from tests.support.conversions import compile_file, convert_file, write_standing_urdf
from tests.support.engines import change_model
from tests.support.legged import Pair, biped, quadruped, rewrite_file
from tests.support.slips import standing
from tests.support.variants import load, stand_of

WAYS = ("forcerange", "actuatorfrcrange", "ctrlrange")
KP, KD = 20.0, 0.4


def limit_torque(way: str, limit: float, gear: float = 1.0) -> pa.Robot:
    """Return v3, whose URDF has an effort of 3 N m, with another limit [N m] in one attribute of
    its MJCF. With `ctrlrange` its actuators are torque motors.
    """
    spec = load("v3").description.mjcf.copy()
    for actuator in spec.actuators:
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        actuator.gear[0] = gear
        if way == "ctrlrange":
            actuator.set_to_motor()
            actuator.ctrlrange = (-limit / gear, limit / gear)
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        if way == "forcerange":
            actuator.forcerange = (-limit / gear, limit / gear)
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        if way == "actuatorfrcrange":
            joint = spec.joint(actuator.target)
            joint.actfrcrange, joint.actfrclimited = (-limit, limit), True
    return rebuild_robot(load("v3"), mjcf=spec)


def bare_height(robot: pa.Robot, seconds: float = 4.0) -> float:
    """Return the height of the base [m] in bare MuJoCo after some seconds; torque motors are
    commanded by a PD controller of the test.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    stand = stand_of("v3")
    robot.mj_convention.set_state(data, stand.qpos)
    joints, dofs = robot.mj_convention.qpos_index[7:], robot.mj_convention.qvel_index[6:]
    used = robot.mj_convention.actuator_index
    servo = model.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_AFFINE.value
    while data.time < seconds:
        torques = KP * (stand.qpos[7:] - data.qpos[joints]) - KD * data.qvel[dofs]
        data.ctrl[used] = stand.qpos[7:] if servo else torques
        mujoco.mj_step(model, data)
    return float(data.qpos[2])


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_weak_motors_are_reported_for_each_kind_of_limit(way: str) -> None:
    """v3's knees hold 0.46 N m. Bare MuJoCo collapses with 0.3, and keeps its height with 3."""
    stand, weak, strong = stand_of("v3"), limit_torque(way, 0.3), limit_torque(way, 3.0)
    assert bare_height(weak) < 0.6 * stand.qpos[2] < 0.9 * stand.qpos[2] < bare_height(strong)
    np.testing.assert_allclose(weak.effort_limits, 0.3, rtol=1e-15)
    assert {limit.origin.attribute for limit in weak.efforts if limit.origin} == {way}
    held = pa.stance.stand_statics(weak, stand)
    assert held.motor_utilisation.max() == pytest.approx(
        np.abs(held.joint_torques).max() / 0.3, rel=1e-12
    )
    assert held.motor_utilisation.max() > 1
    assert pa.payload_limit(weak, stand, kp=KP, kd=KD).motors.mass == 0
    assert not pa.verify_stand(weak, stand, kp=KP, kd=KD, duration=2.0).passed
    with pytest.raises(pa.NoEquilibriumError):
        pa.steady_state(weak, stand, kp=KP)
    assert pa.verify_stand(strong, stand, kp=KP, kd=KD, duration=2.0).passed


@pytest.mark.slow
def test_payload_is_equal_for_each_kind_of_limit() -> None:
    """Reference: the first of three equivalent statements of the same limit in the MJCF."""
    stand, masses = stand_of("v3"), []
    for way in WAYS:
        found = pa.payload_limit(limit_torque(way, 0.8), stand, (0, 0, 0.05), kp=40.0, kd=0.8)
        masses.append((found.mass, found.motors.mass, found.servos.mass))
    np.testing.assert_allclose(masses, np.tile(masses[0], (3, 1)), rtol=1e-9)
    assert 0 < masses[0][0] < 10


ARM = """<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 1 0" {joint}/>
<geom size=".1" mass="1"/></body></worldbody><actuator>{motor}</actuator></mujoco>"""


def arm(motor: str, joint: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(motor=motor, joint=joint))


@pytest.mark.parametrize(
    ("motor", "joint", "effort", "expected", "attribute"),
    [
        ('<motor joint="turn" ctrlrange="-2 2" gear="3"/>', "", 7.0, (-6, 6), "ctrlrange"),
        ('<general joint="turn" gainprm="5" ctrlrange="-2 2"/>', "", None, (-10, 10), "ctrlrange"),
        ('<motor joint="turn" forcerange="-1 4" gear="-2"/>', "", 5.0, (-5, 2), "forcerange"),
        ('<motor joint="turn"/>', 'actuatorfrcrange="-2 3"', 9.0, (-2, 3), "actuatorfrcrange"),
        ('<position joint="turn" kp="5" ctrlrange="-2 2"/>', "", 4.0, (-4, 4), "effort"),
        ('<motor joint="turn" forcerange="-4 4"/>', "", 0.0, (0, 0), "effort"),
        ('<motor joint="turn" forcerange="-4 4"/>', "", -1.0, (0, 0), "effort"),
        ('<motor joint="turn" forcerange="-4 4"/>', "", MIN_UNSTATED_LIMIT, (-4, 4), "forcerange"),
        ('<motor joint="turn"/>', "", MIN_UNSTATED_LIMIT, None, None),
        ('<intvelocity joint="turn" kp="5" actrange="-1 1"/>', "", None, None, None),
        ('<motor joint="turn" ctrlrange="-4 4"/>', "", 4.0, (-4, 4), "effort"),
    ],
)
def test_effort_limit_is_the_smallest_stated_limit(
    motor: str,
    joint: str,
    effort: float | None,
    expected: tuple[float, float] | None,
    attribute: str | None,
) -> None:
    """Reference by hand: limits times gear [N m] per case, and the attribute that specifies the
    smallest.
    """
    limit = resolve_effort_limit(arm(motor, joint), 0, effort)
    assert (limit.lower, limit.upper) == (expected or (-math.inf, math.inf))
    assert (None if limit.origin is None else limit.origin.attribute) == attribute


def test_smaller_limit_counts_if_directions_differ() -> None:
    """Statics use the smaller limit, 0.5 N m.

    Reference of the servos: MuJoCo's `qfrc_actuator`, -0.9 and 0.5 N m.
    """
    spec = limit_torque("forcerange", 0.9).description.mjcf.copy()
    for actuator in spec.actuators:
        actuator.forcerange = (-0.9, 0.5)
    robot, stand = rebuild_robot(load("v3"), mjcf=spec), stand_of("v3")
    np.testing.assert_allclose(robot.effort_limits, 0.5)
    np.testing.assert_allclose(robot.effort_ranges, [(-0.9, 0.5)] * 12)
    drive = model_with_servos(robot, kp=100.0, kd=0.0)
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[:] = drive.command(robot, stand.qpos[7:] + np.tile([1.0, -1.0], 6))
    mujoco.mj_forward(drive.model, data)
    torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
    np.testing.assert_allclose(torques, np.tile([0.5, -0.9], 6), rtol=1e-12)
    assert any(note.code == "motors-uneven" for note in report_efforts(robot.efforts))


def test_limits_of_replaced_motors_are_kept_by_their_servos() -> None:
    """The origin of the limit stays the attribute of the file; a smaller force range counts."""
    robot = limit_torque("ctrlrange", 0.8)
    stated = {limit.joint: limit for limit in robot.efforts}
    servos = make_missing_servos(robot, np.full(12, 20.0), np.full(12, 0.4), 0.002)
    completed = robot.description.with_additions(*servos)
    made = rebuild_robot(robot, mjcf=completed.mjcf, added=completed.added, efforts=stated)
    np.testing.assert_allclose(made.effort_limits, 0.8, rtol=1e-15)
    assert [limit.origin for limit in made.efforts] == [limit.origin for limit in robot.efforts]
    assert made.efforts[0].origin is not None
    assert made.efforts[0].origin.attribute == "ctrlrange"
    half = made.description.mjcf.copy()
    for actuator in half.actuators:
        actuator.forcerange = np.array(actuator.forcerange) / 2
    scaled = rebuild_robot(made, mjcf=half)
    np.testing.assert_allclose(scaled.effort_limits, 0.4, rtol=1e-15)


@pytest.mark.parametrize("feedforward", [False, True])
def test_steady_state_is_predicted_if_ctrlrange_clips_a_command(feedforward: bool) -> None:
    """Reference: simulation.

    Knees with clipped commands hold v3 higher; clipped feed-forward lets v3 sag.
    """
    stand, plain = stand_of("v3"), load("v3")
    knees = [index for index, name in enumerate(plain.joint_names) if name.endswith("_3")]
    lead = np.sign(pa.stance.stand_statics(plain, stand).joint_torques[knees])
    shares = (-1.0, 0.04) if feedforward else (0.04, 1.0)  # rad, beyond the stand's angles

    def change(model: mujoco.MjModel) -> None:
        cut = plain.mj_convention.actuator_index[knees]
        model.actuator_ctrllimited[cut] = 1
        ends = stand.qpos[7:][knees][:, None] + lead[:, None] * np.array(shares)
        model.actuator_ctrlrange[cut] = np.sort(ends, axis=1)
        model.dof_frictionloss[:] = 0
        model.geom_condim[:] = 3

    robot = change_model(plain, change)
    pose = pa.steady_state(robot, stand, feedforward=feedforward)
    assert pose.failures == ()
    free = pa.steady_state(plain, stand, feedforward=feedforward)
    assert abs(pose.height_loss - free.height_loss) > 2e-3
    run = pa.verify_stand(robot, stand, feedforward=feedforward, duration=4, nudged=0)
    assert pose.height_loss == pytest.approx(run.height_loss, abs=1e-4)


KNEE = 'lower="-2.6" upper="-0.4" effort="80"'


@pytest.mark.parametrize(
    ("limit", "free"),
    [
        ('effort="80"', True),
        ('lower="0" upper="0" effort="0"', True),
        ('lower="0.0" upper="-0" effort="0e0"', True),
        ('lower="0" upper="0"', True),  # the reader completes the effort
        ('lower="0" upper="0" effort="80"', False),  # with an effort, the joint may be locked
        ('upper="0" effort="80"', False),
        ('lower="-1" effort="0"', False),
    ],
)
def test_hinge_has_no_range_if_its_limit_states_none(
    limit: str, free: bool, tmp_path: Path
) -> None:
    """All knees; `audit` still reports the range of the file as empty."""
    urdf = rewrite_file(quadruped(tmp_path).urdf, (KNEE, limit))
    notes = [note for note in read_urdf(urdf).notes if note.code == "range-unstated"]
    assert bool(notes) is free
    if free:
        assert notes[0].values["names"] == ("FL_knee", "FR_knee", "RL_knee", "RR_knee")
    # `audit` reports the range of the file as written, unless the lower limit is below the upper.
    found = [finding for finding in pa.audit_model(urdf).findings if finding.rule == "range-empty"]
    assert bool(found) is ('lower="-1"' not in limit)


def test_slide_stays_locked_if_its_limit_states_no_range(tmp_path: Path) -> None:
    urdf = rewrite_file(
        quadruped(tmp_path).urdf,
        (KNEE, 'effort="80"'),
        ('_knee" type="revolute"', '_knee" type="prismatic"'),
    )
    assert read_urdf(urdf).notes == ()


@pytest.mark.slow
def test_mjcf_range_counts_if_the_urdf_has_none(tmp_path: Path) -> None:
    """Reference: -2.6 to -0.4 rad of the MJCF.

    The comparison reports the limits unless the MJCF has none either.
    """
    pair = quadruped(tmp_path)
    rewrite_file(pair.urdf, (KNEE, 'effort="80"'))
    robot = pa.load_robot(*pair)
    knees = [robot.joint_names.index(f"{leg}_knee") for leg in ("FL", "FR", "RL", "RR")]
    np.testing.assert_allclose(robot.lower_limits[knees], -2.6)
    np.testing.assert_allclose(robot.upper_limits[knees], -0.4)
    found = pa.verify_stand(robot, pa.solve_stand(robot))
    assert found.passed, found.failures
    differing = pa.compare_models(pair.urdf, pair.mjcf).differences
    assert {difference.kind for difference in differing} == {"lower limit", "upper limit", "effort"}
    # If neither file states a range, the files agree.
    rewrite_file(
        pair.mjcf, (' range="-2.6 -0.4"', ""), ('ctrlrange="-30 30"', 'ctrlrange="-80 80"')
    )
    assert pa.compare_models(pair.urdf, pair.mjcf).agree


@pytest.mark.slow
def test_converted_hinge_has_no_limits_without_a_range(tmp_path: Path) -> None:
    """Reference: `jnt_limited` of MuJoCo's compiled model."""
    urdf = rewrite_file(
        write_standing_urdf(tmp_path), ('lower="-0.8" upper="0.8" effort', "effort")
    )
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert not any(left.code == "empty-range-left" for left in found.not_converted)
    model = compile_file(mjcf)
    assert not model.jnt_limited[model.joint("FL_roll").id]


@pytest.mark.parametrize(
    ("effort", "code"),
    [
        (80.0, "stated"),
        (1e-4, "stated"),  # of the smallest geared motors
        (1e-9, "zero"),
        (0.0, "zero"),
        (-1.0, "negative"),
        (None, "unknown"),
        (2e9, "unknown"),
    ],
)
def test_code_of_a_limit_names_zero_negative_and_unknown(effort: float | None, code: str) -> None:
    limit = resolve_effort_limit(arm('<motor joint="turn"/>'), 0, effort)
    assert limit.code == code
    assert limit.without_torque is (code in ("zero", "negative"))
    assert limit.to_dict()["code"] == code


@pytest.mark.parametrize(
    ("actuator", "joint", "code"),
    [
        ('<position joint="turn" kp="9" forcerange="0 0"/>', "", "zero"),
        ('<position joint="turn" kp="9" forcerange="5 -5"/>', "", "negative"),
        ('<position joint="turn" kp="9" forcerange="0 0" forcelimited="false"/>', "", "unknown"),
        ('<motor joint="turn" ctrlrange="0 0"/>', "", "zero"),
        ('<position joint="turn" kp="9" ctrlrange="0 0"/>', "", "unknown"),  # of angles
        ('<motor joint="turn"/>', 'actuatorfrcrange="0 0"', "zero"),
        ('<motor joint="turn"/>', "", "unknown"),
        ('<motor joint="turn" forcerange="-2 2"/>', "", "stated"),
    ],
)
def test_motor_has_no_torque_if_its_range_is_zero(
    actuator: str, joint: str, code: str, tmp_path: Path
) -> None:
    """Reference: ``mj_forward`` shows that MuJoCo ignores such a range; it is read as a motor
    without torque."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(motor=actuator, joint=joint))
    robot = pa.load_robot(path, fixed_base=True, as_is=True)
    assert robot.efforts[0].code == code
    data = mujoco.MjData(robot.mj_model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(robot.mj_model, data)
    assert data.qfrc_actuator[0] != 0  # MuJoCo applies no limit of zero


def _without_effort(pair: Pair, effort: str = "") -> Pair:
    rewrite_file(pair.urdf, ('effort="80" velocity="20"', effort))
    return pair


def test_smaller_of_two_limits_counts_with_its_file(tmp_path: Path) -> None:
    """80 N m in the URDF, motors of 30 N m in the MJCF."""
    notes = pa.load_robot(*quadruped(tmp_path)).notes
    (note,) = (note for note in notes if note.code == "effort-limits-differ")
    (first, *_) = note.values["joints"]
    assert [first.values[word] for word in ("file", "least", "unused")] == [
        "MJCF",
        Quantity(30.0, "N m"),
        Quantity(80.0, "N m"),
    ]


@pytest.mark.parametrize(
    ("effort", "is_reported"), [("80", False), ("0", False), (None, True), ("1e9", True)]
)
def test_effort_that_is_missing_or_a_placeholder_is_reported_as_missing(
    tmp_path: Path, effort: str | None, is_reported: bool
) -> None:
    """An effort of zero is a motor without torque. Its note must not be that of a missing limit."""
    pair = quadruped(tmp_path)
    stated = "" if effort is None else f'effort="{effort}" velocity="20"'
    robot = pa.load_robot(*_without_effort(pair, stated))
    notes = {note.code: note for note in robot.notes}
    assert ("effort-unstated" in notes) is is_reported
    if is_reported:
        assert list(notes["effort-unstated"].values["joints"]) == list(robot.joint_names)
        assert "effort is 0" not in str(notes["effort-unstated"])


@pytest.mark.slow
def test_effort_is_read_from_the_mjcf_if_the_urdf_has_none(tmp_path: Path) -> None:
    """Reference: ctrlrange of the motors, 30 N m, and |torque| / 30 as motor utilisation; without
    ctrlrange the utilisation is unknown.
    """
    pair = _without_effort(quadruped(tmp_path))
    robot = pa.load_robot(*pair)
    np.testing.assert_array_equal(robot.effort_limits, 30.0)  # its motors' ctrlrange
    np.testing.assert_array_equal(robot.velocity_limits, np.inf)
    assert any(note.code == "effort-unstated" for note in robot.notes)
    assert not any(note.code == "motors-uneven" for note in robot.notes)  # -30 to 30
    stand = pa.solve_stand(robot)
    held = pa.stance.stand_statics(robot, stand)
    np.testing.assert_allclose(held.motor_utilisation, np.abs(held.joint_torques) / 30, rtol=1e-12)
    rewrite_file(pair.mjcf, (' ctrlrange="-30 30"', ""))
    robot = pa.load_robot(*pair)
    assert {limit.code for limit in robot.efforts} == {"unknown"}
    assert np.isnan(pa.stance.stand_statics(robot, stand).motor_utilisation).all()


@pytest.mark.slow
def test_urdf_effort_of_zero_fails_and_names_the_mjcf_limit(tmp_path: Path) -> None:
    """In MuJoCo with the forces clamped to zero the robot falls; the MJCF states 30 N m."""
    pair = _without_effort(quadruped(tmp_path), 'effort="0" velocity="0"')
    robot = pa.load_robot(*pair)
    assert {limit.code for limit in robot.efforts} == {"zero"}
    stand = pa.solve_stand(robot)
    drive = model_with_servos(robot)
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[:] = drive.command(robot, stand.qpos[7:])
    while data.time < 1.0:
        mujoco.mj_step(drive.model, data)
    assert data.qpos[2] < 0.6 * stand.qpos[2]
    verdict = judge_stand(robot, stand)
    assert not verdict.passed
    (cause,) = verdict.failures
    assert cause.code == "motors-without-torque"
    assert cause.values["joints"] == robot.joint_names
    assert cause.values["other"] == Quantity(30.0, "N m")
    assert cause.values["other_file"] == "MJCF"
    assert judge_stand(with_efforts(robot, dict.fromkeys(robot.joint_names, 30.0)), stand).passed


def test_effort_of_zero_is_reported_with_the_effort_of_a_sibling_limb(tmp_path: Path) -> None:
    """One hip of four has no effort; the others have 80 N m."""
    pair = quadruped(tmp_path)
    rewrite_file(pair.urdf, ('effort="80"', 'effort="0"'), count=1)
    robot = pa.load_robot(pair.urdf)
    cause = describe_zero_torque_limits(robot)
    assert cause is not None
    assert cause.values["joints"] == ("FL_roll",)
    assert cause.values["other"] == Quantity(80.0, "N m")
    assert cause.values["other_name"] in ("FR_roll", "RL_roll", "RR_roll")


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 12])
def test_other_failures_stay_if_a_motor_without_torque_holds_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """A time step that is too long was reported as a motor without torque, at an idle joint.

    If most motors have no torque, they are the first cause: in bare MuJoCo an upright arm without
    torque falls after any nudge.
    """
    pair = quadruped(tmp_path)
    rewrite_file(pair.urdf, ('effort="80"', 'effort="0"'), count=count)
    robot = pa.load_robot(*pair)
    stand, statics = pa.solve_stand(robot), pa.stance.stand_statics
    monkeypatch.setattr(judge, "explain_own_run", lambda _: None)
    monkeypatch.setattr(judge, "compare_as_published", lambda *_: None)
    fed = Outcome(passed=False, failures=(diagnose("posture-left"),), duration=12.0)
    held = statics(robot, stand)
    idle = replace(held, joint_torques=np.zeros(robot.nu))
    for prediction, expected in (
        (idle, ["posture-left", "motors-without-torque"][:: 1 if count == 1 else -1]),
        (held, ["motors-without-torque"]),
    ):
        verdict = judge.judge_simulation(robot, stand, fed, statics=prediction)
        assert [failure.code for failure in verdict.failures] == expected


@pytest.mark.slow
@pytest.mark.parametrize("servos", [True, False])
def test_a_gear_of_zero_is_a_motor_without_torque(tmp_path: Path, servos: bool) -> None:
    """Reference: bare MuJoCo, in which no command of the actuator exerts a torque."""
    pair = standing(tmp_path)
    text = pair.mjcf.read_text()
    begin = text.index('joint="FL_knee"')
    text = text[:begin] + text[begin:].replace('joint="FL_knee"', 'joint="FL_knee" gear="0"', 1)
    if not servos:
        text = re.sub(r'<position ([^>]*?) kp="[^"]*" kv="[^"]*"', r"<motor \1", text)
    pair.mjcf.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[model.joint("FL_knee").dofadr[0]] == 0.0
    robot = pa.load_robot(*pair)
    knee = robot.joint_names.index("FL_knee")
    assert robot.efforts[knee].code == "zero"
    origin = robot.efforts[knee].origin
    assert origin is not None
    assert origin.attribute == "gear"
    null = describe_zero_torque_limits(robot)
    assert null is not None
    assert null.values["value"] == "0"  # one number in the file, not a range
    assert list(np.flatnonzero(robot.effort_limits == 0.0)) == [knee]
    for drive in (model_with_servos(robot), model_with_servos(robot, 200.0, 10.0)):
        assert np.isfinite(drive.model.actuator_gainprm).all()
        data = mujoco.MjData(drive.model)
        data.ctrl[:] = 1.0
        mujoco.mj_forward(drive.model, data)
        assert data.qfrc_actuator[drive.model.joint("FL_knee").dofadr[0]] == 0.0
    rules = [finding.rule for finding in pa.audit_model(pair.mjcf).findings]
    assert "actuator-without-effect" in rules
    assert "effort-or-velocity-zero" not in rules  # MuJoCo does not ignore a gear of zero


@pytest.mark.parametrize(
    ("gear", "is_empty"), [("0 0 1", False), ("0 -2", False), ("1", False), ("0 0 0 1", True)]
)
def test_a_motor_at_a_ball_joint_has_three_gears(gear: str, is_empty: bool, tmp_path: Path) -> None:
    """Reference: the generalised forces of the motor in bare MuJoCo."""
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="ball" type="ball"/><geom size="0.1"/></body>'
        f'</worldbody><actuator><motor joint="ball" gear="{gear}"/></actuator></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert (not data.qfrc_actuator.any()) is is_empty
    assert (set(find_null_efforts(read_mjcf(path))) == {"ball"}) is is_empty


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [0.0, 200.0])
def test_a_spring_at_a_motor_without_torque_holds_the_robot_otherwise_than_predicted(
    tmp_path: Path, stiffness: float
) -> None:
    """Reference: the file without these motors in bare MuJoCo; only with springs, it stands.

    The motors of the knees have no effort; the springs deflect by the torques of the knees.
    """
    pair, knees = standing(tmp_path), [f"{leg}_knee" for leg in ("FL", "FR", "RL", "RR")]
    urdf = pair.urdf.read_text()
    for knee in knees:
        begin = urdf.index(f'<joint name="{knee}"')
        urdf = urdf[:begin] + urdf[begin:].replace('effort="80"', 'effort="0"', 1)
    pair.urdf.write_text(urdf)
    springs = [
        f'<joint name="{knee}" stiffness="{stiffness}" damping="5" springref="-1.176"'
        for knee in knees
    ]
    rewrite_file(
        pair.mjcf,
        *((f'<joint name="{knee}"', new) for knee, new in zip(knees, springs, strict=True)),
    )
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    at_knees = [model.actuator(place).id for place in (2, 5, 8, 11)]
    model.actuator_gainprm[at_knees] = model.actuator_biasprm[at_knees] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    height = float(data.qpos[2])
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert bool(data.qpos[2] > 0.9 * height) is bool(stiffness)
    robot = pa.load_robot(*pair)
    stand = pa.solve_stand(robot)
    verdict = judge_stand(robot, stand)
    assert verdict.failures[0].code == "motors-without-torque"
    assert (verdict.code.value == "fails") is not bool(stiffness)
    assert not verdict.passed
    off = [failure.code for failure in verdict.failures[1:]]
    assert ("joint-off" in off) is bool(stiffness)


@pytest.mark.slow
def test_stand_fails_if_the_urdf_effort_is_too_small(tmp_path: Path) -> None:
    """The MJCF has no force limit, so servos get the effort of the URDF; without effort in the
    URDF, the stand passes."""
    pair = biped(tmp_path)
    rewrite_file(pair.urdf, ('effort="80"', 'effort="1"'))
    rewrite_file(pair.mjcf, (' ctrlrange="-80 80"', ' kp="800" kv="40"'), ("<motor ", "<position "))
    robot = pa.load_robot(*pair)
    result = study_stance(robot, pa.StandTask())
    assert not result.verification.passed
    assert np.abs(result.verification.joint_torques).max() < 1 + 1e-9
    assert result.overloaded_motors
    assert not result.passed
    pair = _without_effort(biped(tmp_path))  # neither file states an effort
    rewrite_file(pair.mjcf, (' ctrlrange="-80 80"', ' kp="800" kv="40"'), ("<motor ", "<position "))
    result = study_stance(pa.load_robot(*pair), pa.StandTask())
    assert result.passed
    assert not result.overloaded_motors


def classify_drive(actuators: str) -> Drive:
    """Return the drive type of a hinge with the completed actuator elements."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1"/></body></worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )
    return classify_joint_drive(model, 0)


def position(kp: float, gear: float = 1.0) -> str:
    return f'<position joint="hinge" kp="{kp}" gear="{gear}"/>'


@pytest.mark.parametrize("gear", [1.0, 3.0, -3.0, 0.1])
def test_drive_type_is_independent_of_the_gear(gear: float) -> None:
    """Both the force and the length of an actuator are taken times the gear."""
    assert classify_drive(position(10, gear)) is Drive.SERVO
    assert classify_drive(position(-10, gear)) is Drive.WRONG_SIGN
    assert classify_drive(position(0, gear)) is Drive.NO_STIFFNESS
    assert classify_drive(f'<motor joint="hinge" gear="{gear}"/>') is Drive.MOTOR


def test_stiffer_of_two_servos_determines_the_drive_type() -> None:
    """Closed form: stiffness is kp times gear squared."""
    assert classify_drive(position(10) + position(-10, 2)) is Drive.WRONG_SIGN  # 10 - 40 N m/rad
    assert classify_drive(position(10, 2) + position(-10)) is Drive.SERVO


@pytest.mark.parametrize(("coefficient", "expected"), [(1.0, Drive.TENDON), (0.0, Drive.NONE)])
def test_joint_has_an_actuator_if_its_tendon_is_driven(coefficient: float, expected: Drive) -> None:
    """MuJoCo: the tendon's actuator turns the joint, by ``qfrc_actuator``."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/><body pos="1 0 0">'
        '<joint name="b"/><geom size="0.1"/></body></body></worldbody><tendon><fixed name="t">'
        f'<joint joint="a" coef="1"/><joint joint="b" coef="{coefficient}"/></fixed></tendon>'
        '<actuator><motor joint="a"/><position tendon="t" kp="5"/></actuator></mujoco>'
    )
    data = mujoco.MjData(model)
    data.ctrl[1] = 1.0
    mujoco.mj_forward(model, data)
    assert bool(data.qfrc_actuator[1]) is (expected is Drive.TENDON)
    assert classify_joint_drive(model, 1) is expected
    assert classify_joint_drive(model, 0) is Drive.MOTOR


@pytest.mark.parametrize("way", WAYS)
def test_simulated_torque_is_at_most_the_smallest_limit(way: str) -> None:
    """Commands are 1 rad away: MuJoCo applies 3 N m of the URDF, or 0.7 N m behind a gear of 2."""
    stand, signs = stand_of("v3"), np.tile([1.0, -1.0], 6)
    for limit, most in ((50.0, 3.0), (0.7, 0.7)):
        robot = limit_torque(way, limit, gear=2.0)
        drive = model_with_servos(robot, kp=100.0, kd=0.0)
        data = mujoco.MjData(drive.model)
        robot.mj_convention.set_state(data, stand.qpos)
        data.ctrl[:] = drive.command(robot, stand.qpos[7:] + signs)
        mujoco.mj_forward(drive.model, data)
        torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        np.testing.assert_allclose(torques, most * signs, rtol=1e-12)


def test_affine_bias_that_opposes_the_servo_reduces_its_stiffness() -> None:
    """Closed form: kp minus the bias coefficient of the position, 30 - 40 and 50 - 40 N m/rad."""
    away = '<general joint="hinge" gainprm="40" biastype="affine" biasprm="0 40 0"/>'
    assert classify_drive(position(30) + away) is Drive.WRONG_SIGN
    assert classify_drive(position(50) + away) is Drive.SERVO


def test_limits_of_a_file_alone_are_in_this_file(tmp_path: Path) -> None:
    """The URDF that is generated from the MJCF states the same limits, and is in no folder."""
    pair = quadruped(tmp_path, floor=True, actuators="position")
    rewrite_file(pair.mjcf, ('kp="150"', 'kp="150" forcerange="-20 20"'))
    for files, file in (((pair.mjcf,), "MJCF"), ((pair.urdf,), "URDF")):
        robot = pa.load_robot(*files)
        origins = [limit.origin for limit in robot.efforts]
        assert {origin.file for origin in origins if origin is not None} == {file}
        assert np.isfinite(robot.effort_limits).all()


@pytest.mark.parametrize("tag", ["motor", "general", "position"])
def test_empty_force_range_in_the_default_of_another_actuator_tag_is_found(
    tag: str, tmp_path: Path
) -> None:
    """Reference: the compiled model with a range that is not empty has this range."""
    text = ARM.format(motor='<position joint="turn" kp="9"/>', joint="")
    text = text.replace("<worldbody>", f'<default><{tag} forcerange="RANGE"/></default><worldbody>')
    inherited = mujoco.MjModel.from_xml_string(text.replace("RANGE", "-2 2"))
    assert inherited.actuator_forcerange[0].tolist() == [-2, 2]
    path = tmp_path / "arm.xml"
    path.write_text(text.replace("RANGE", "0 0"))
    robot = pa.load_robot(path, fixed_base=True, as_is=True)
    assert robot.efforts[0].code == "zero"
    other = text.replace(f"<{tag} forcerange", "<joint actuatorfrcrange").replace("RANGE", "-2 2")
    path.write_text(other)
    assert read_mjcf(path).find_attribute("actuator", "turn", ("forcerange",)) is None


@pytest.mark.parametrize(
    "attributes",
    [
        '<joint name="j"/>|<motor joint="j" forcerange="-1e9 1e9"/>',
        '<joint name="j"/>|<motor joint="j" ctrlrange="-1e9 1e9"/>',
        '<joint name="j"/>|<motor joint="j" gear="-0.1" forcerange="-2e9 1e9"/>',
        '<joint name="j" actuatorfrcrange="-1e9 1e9"/>|<motor joint="j"/>',
        '<joint name="j"/>|<motor joint="j" forcerange="-1e9 1e9"/><motor joint="j"/>',
    ],
)
def test_range_from_the_number_that_states_no_limit_is_unknown(
    tmp_path: Path, attributes: str
) -> None:
    """1e9 N m is the number for an unknown limit in both formats, and no motor has it."""
    joint, motors = attributes.split("|")
    limit = resolve_effort_limit(_compile_pendulum(joint, motors), 0)
    assert limit.code == "unknown"
    assert limit.symmetric_torque == math.inf


@pytest.mark.parametrize(
    ("joint", "motor"),
    [
        ('<joint name="j" actuatorfrcrange="-3 1e9"/>', '<motor joint="j"/>'),
        ('<joint name="j"/>', '<motor joint="j" forcerange="-3 1e9"/>'),
        ('<joint name="j"/>', '<motor joint="j" gear="-2" forcerange="-1e9 1.5"/>'),
    ],
)
def test_limit_of_one_direction_counts(joint: str, motor: str) -> None:
    """Reference: the joint torques of MuJoCo for commands of -10 and 10."""
    model = _compile_pendulum(joint, motor)
    data = mujoco.MjData(model)
    torques = []
    for command in (-10.0, 10.0):
        data.ctrl[0] = command
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_actuator[0]))
    limit = resolve_effort_limit(model, 0)
    assert limit.lower == min(torques) == -3.0
    assert limit.symmetric_torque == 3.0


def _compile_pendulum(joint: str, motors: str) -> mujoco.MjModel:
    """Return a pendulum with the joint "j" and motors, as XML elements."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="b">{joint}<geom size="0.1"/></body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
