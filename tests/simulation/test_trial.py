"""Nudge trials of a stand: motions that count as failures, and motions that do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare import judge
from pupper_analysis.prepare.judge import _fail_if_upset, list_file_remarks
from pupper_analysis.simulation import trial as trial_module
from pupper_analysis.simulation.rollout import make_stand_start
from pupper_analysis.simulation.trial import (
    BASE_NUDGE_SPEED,
    Failure,
    NudgeTrial,
    _find_failure_limits,
    is_near_limit,
    make_nudge_velocities,
    simulate_large_nudges,
    simulate_nudges,
)
from pupper_analysis.simulation.verdict import Outcome
from pupper_analysis.stance.stand import stand_statics
from tests.support.legged import quadruped, quadruped_with_slides, rewrite_file
from tests.support.variants import load, stand_of


@pytest.mark.slow
@pytest.mark.parametrize(("limits", "rests"), [("0 1", True), ("-1e-9 1", True), ("-1 1", False)])
def test_joint_at_its_limit_from_the_start_is_no_failure(
    limits: str, rests: bool, tmp_path: Path
) -> None:
    """For example a closed gripper.

    A joint at its limit in the stand has no lower limit in the trial; other joints have.
    """
    path = quadruped(tmp_path, head=True).mjcf
    head = '<joint name="nod" axis="0 1 0" range="{0}"/>'
    text = path.read_text()
    assert head.format("-1 1") in text
    path.write_text(text.replace(head.format("-1 1"), head.format(limits)))
    robot = pa.load_robot(path)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    trial = simulate_nudges(robot, stand, duration=2.0)
    assert (trial.survived, trial.failure, trial.failing_parts) == (True, None, ())
    lower, upper = _find_failure_limits(robot, stand)
    nod = robot.joint_names.index("nod")
    assert np.isneginf(lower[nod]) == rests
    legs = np.arange(robot.nu) != nod
    assert np.array_equal(lower[legs], robot.lower_limits[legs])
    assert np.array_equal(upper, robot.upper_limits)


@pytest.mark.slow
def test_leg_joint_at_its_limit_from_the_start_is_no_failure(tmp_path: Path) -> None:
    """In bare MuJoCo the stand rests after nudges of 50 mm/s in six directions, at the soft limit.

    The knee is stretched to the end of its range; each nudge moved it beyond, and the stand failed.
    """
    pair = quadruped(tmp_path, actuators="position", floor=True)
    free = pa.load_robot(pair.mjcf)
    place = free.joint_names.index("FL_knee")
    limit = float(pa.solve_stand_as_simulated(free).joint_positions(free)[place])
    knee = 'name="FL_knee" axis="0 1 0" range="-2.6 {0!r}"'
    rewrite_file(pair.mjcf, (knee.format(-0.4), knee.format(limit)))
    robot = pa.load_robot(pair.mjcf)
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(height=free.base_height))
    assert stand.joint_positions(robot)[place] == pytest.approx(limit, abs=1e-6)
    assert is_near_limit(robot, stand, stand_statics(robot, stand))
    trial = simulate_nudges(robot, stand, duration=2.0)
    assert (trial.survived, trial.failure, trial.failing_parts) == (True, None, ())


@pytest.mark.slow
def test_joint_whose_range_permits_no_motion_is_named_and_has_no_limits_in_the_trial(
    tmp_path: Path,
) -> None:
    """In bare MuJoCo the pair stands after each nudge: the MJCF has a range of 1.6 rad.

    The trial failed after 0 s, since the URDF has a range of 0 to 0.
    """
    pair = quadruped(tmp_path)
    rewrite_file(pair.urdf, ('lower="-0.8" upper="0.8"', 'lower="0" upper="0"'), count=1)
    robot = pa.load_robot(*pair)
    lower, upper = _find_failure_limits(robot, pa.solve_stand(robot))
    roll = robot.joint_names.index("FL_roll")
    assert (lower[roll], upper[roll]) == (-np.inf, np.inf)
    legs = np.arange(robot.nu) != roll
    assert np.isfinite(lower[legs]).all()
    (remark,) = (found for found in list_file_remarks(robot) if found.code == "rests-on-made-up")
    (finding,) = remark.values["findings"]
    assert (finding.code, finding.values["joints"]) == ("joints-locked-by-range", ("FL_roll",))


def _write_quadruped_with_antenna(folder: Path, mass: float) -> Path:
    """Write an MJCF of a quadruped whose head is an antenna of ``mass`` [kg], 0.1 m long.

    The position servo of the antenna has no damping: 16 Hz in bare MuJoCo, whatever the mass.
    """
    path = quadruped(folder, actuators="position", floor=True, head=True).mjcf
    tensor = " ".join([f"{1e-3 * mass}"] * 3)
    return rewrite_file(
        path,
        (
            '<inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>',
            f'<inertial pos="0.1 0 0" mass="{mass}" diaginertia="{tensor}"/>',
        ),
        ('<position joint="nod"/>', f'<position joint="nod" kp="{100 * mass}"/>'),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "shakes"), [(5e-4, True), (0.03, False)])
def test_shaking_is_a_failure_if_it_does_not_decay(
    mass: float, shakes: bool, tmp_path: Path
) -> None:
    """Reference: largest joint speed in a plain MuJoCo loop after a downward nudge of 10 mm/s.

    A heavy antenna moves the trunk, whose servos and contacts damp the oscillation.
    """
    robot = pa.load_robot(_write_quadruped_with_antenna(tmp_path, mass))
    stand = pa.solve_stand_as_simulated(robot)
    held = make_stand_start(robot, stand)
    model, data = held.drive.model, mujoco.MjData(held.drive.model)
    mujoco.mj_setState(model, data, held.start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    data.ctrl[:], data.qvel[2] = held.ctrl, -BASE_NUDGE_SPEED
    speeds = []
    for _ in range(4):
        second = []
        for _ in range(round(1.0 / model.opt.timestep)):
            mujoco.mj_step(model, data)
            second.append(float(np.abs(data.qvel).max()))
        speeds.append(max(second))
    assert (speeds[3] > 0.9 * speeds[1]) == shakes
    trial = simulate_nudges(robot, stand, duration=4.0)
    assert trial.survived != shakes
    assert trial.failure is (Failure.SHAKING if shakes else None)
    if shakes:
        assert (trial.failing_parts, trial.shaking_unit) == (("nod",), "rad/s")
        assert trial.time == pytest.approx(4.0)
        assert trial.shaking_speed == pytest.approx(speeds[3], rel=0.2)
    large = simulate_large_nudges(robot, stand)
    assert (large.survived, large.failure) == (not shakes, trial.failure)
    assert (large.failing_parts, large.nudges) == ((("nod",), 1) if shakes else ((), 5))


def test_divergence_after_a_large_nudge_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stub reports the divergence, since the robot does not diverge."""
    monkeypatch.setattr(trial_module.monitor, "has_diverged", lambda *_: True)
    trial = simulate_large_nudges(load("original"), stand_of("original"))
    assert (trial.survived, trial.failure, trial.time) == (False, Failure.BUCKLING, 0.0)
    assert trial.shaking_speed is None


@pytest.mark.parametrize("shakes", [True, False])
def test_stand_far_from_limits_fails_if_a_large_nudge_makes_it_shake(
    shakes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stub replaces the nudged simulation: v3 does not shake."""
    robot, stand = load("v3"), stand_of("v3")
    shaking = NudgeTrial(
        survived=False,
        failure=Failure.SHAKING,
        failing_parts=("leg_front_r_1",),
        time=12.0,
        failed_nudges=1,
        nudges=3,
        duration=12.0,
        simulated=15.0,
        shaking_speed=0.4,
        shaking_unit="rad/s",
    )
    if shakes:
        monkeypatch.setattr(judge, "simulate_large_nudges", lambda *_arguments, **_gains: shaking)
    fed = Outcome(passed=True, failures=(), duration=12.0)
    statics = stand_statics(robot, stand)
    judged = _fail_if_upset(robot, stand, fed, statics, None, None, None, fragile=False)
    assert judged.passed != shakes
    if shakes:
        (failure,) = judged.failures
        assert "the robot shakes without decay after a nudge of 50 mm/s: leg_front_r_1" in str(
            failure
        )


@pytest.mark.parametrize(("kp", "passes"), [(5.0, True), (1e5, False)])
def test_stiff_servos_near_saturation_get_large_nudges_too(
    kp: float, passes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand: a limit of 3 N m minus the load, divided by 1e5 N m/rad, is below 0.001 rad.

    Stubs replace both nudged simulations; the stand survives the small nudges only.
    """
    robot, stand = load("v3"), stand_of("v3")
    calm = NudgeTrial(
        survived=True,
        failure=None,
        failing_parts=(),
        time=None,
        failed_nudges=0,
        nudges=12,
        duration=12.0,
        simulated=15.0,
        shaking_speed=None,
        shaking_unit="rad/s",
    )
    shaking = replace(
        calm,
        survived=False,
        failure=Failure.SHAKING,
        failing_parts=("leg_front_r_1",),
        time=12.0,
        failed_nudges=1,
        shaking_speed=0.4,
    )
    monkeypatch.setattr(judge, "simulate_nudges", lambda *_arguments, **_gains: calm)
    monkeypatch.setattr(judge, "simulate_large_nudges", lambda *_arguments, **_gains: shaking)
    fed = Outcome(passed=True, failures=(), duration=12.0)
    statics = stand_statics(robot, stand)
    # A fragile stand gets the small nudges in both cases; `payload` passes their result.
    for trial in (None, calm):
        judged = _fail_if_upset(robot, stand, fed, statics, trial, kp, 0.1, fragile=True)
        assert judged.passed is passes


def test_shaking_after_a_nudge_is_reported_with_its_speed() -> None:
    """Reference: the numbers of a trial that is set by hand."""
    trial = NudgeTrial(
        survived=False,
        failure=Failure.SHAKING,
        failing_parts=("nod",),
        time=12.0,
        failed_nudges=8,
        nudges=12,
        duration=12.0,
        simulated=100.0,
        shaking_speed=0.05,
        shaking_unit="rad/s",
    )
    robot, stand = load("v3"), stand_of("v3")
    fed = Outcome(passed=True, failures=(), duration=12.0)
    statics = stand_statics(robot, stand)
    failed = _fail_if_upset(robot, stand, fed, statics, trial, None, None, fragile=False)
    (failure,) = failed.failures
    assert (failed.passed, failure.code) == (False, "shakes-after-nudge")
    assert "nod at 0.05 rad/s after 12 s; in 8 of 12 directions" in str(failure)
    assert "(now 2 ms)" in str(failure)


def test_foot_with_negligible_load_may_lift_without_failure() -> None:
    """Minimum tangential forces on unequal slopes leave two of four feet nearly unloaded."""
    robot, upset = load("v3"), {}
    for tilt in (0.0, 0.15):
        task = pa.StandTask(contacts={"FL": pa.Contact(pa.Slope(tilt))} if tilt else {})
        stand = pa.solve_stand_as_simulated(robot, task)
        upset[tilt] = is_near_limit(robot, stand, stand_statics(robot, stand))
    assert upset == {0.0: False, 0.15: True}


def test_nudges_of_the_base_enclose_a_circle_of_the_stated_speed() -> None:
    """Closed form: the octagon of the velocities along the ground has an inscribed circle of 10
    mm/s; up, down and both rotations follow, and all joints rest."""
    robot, stand = load("v3"), stand_of("v3")
    speeds = make_nudge_velocities(robot, stand)
    assert speeds.shape == (12, robot.nv)
    sides = (speeds[:8, :2] + np.roll(speeds[:8, :2], 1, axis=0)) / 2
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1), BASE_NUDGE_SPEED)
    angles = np.sort(np.arctan2(speeds[:8, 1], speeds[:8, 0]))
    np.testing.assert_allclose(np.diff(angles), np.pi / 4)
    np.testing.assert_array_equal(speeds[8:10, 2], [BASE_NUDGE_SPEED, -BASE_NUDGE_SPEED])
    height = pa.Configuration(robot, stand.qpos).center_of_mass()[2]
    np.testing.assert_allclose(speeds[10:, 5] * height, [BASE_NUDGE_SPEED, -BASE_NUDGE_SPEED])
    np.testing.assert_allclose(speeds.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_array_equal(speeds[:, 6:], 0.0)


def test_servo_that_a_small_deviation_saturates_counts_as_near_a_limit(tmp_path: Path) -> None:
    """A hip without static torque gives at most 1 uN m; bare MuJoCo overturns after a nudge.

    The linearised servo has stiffness, and the static torque is within the limit.
    """
    mjcf = quadruped_with_slides(tmp_path)
    hip = 'joint="FL_roll" kp="1500" forcerange="-{0} {0}"'
    rewrite_file(mjcf, ('pos="0 0.05 0"', 'pos="0 0 0"'), ('pos="0 -0.05 0"', 'pos="0 0 0"'))
    strong = pa.load_robot(mjcf)
    stand = pa.solve_stand_as_simulated(strong)
    assert not is_near_limit(strong, stand, stand_statics(strong, stand))
    rewrite_file(mjcf, (hip.format(60), hip.format(1e-6)))
    weak = pa.load_robot(mjcf)
    stand = pa.solve_stand_as_simulated(weak)
    statics = stand_statics(weak, stand)
    assert is_near_limit(weak, stand, statics)
    assert is_near_limit(weak, stand, statics, kp=1500.0)
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    data.qpos[:] = weak.compute_kinematics(stand.qpos).qpos
    data.ctrl[:] = stand.joint_positions(weak) + statics.joint_torques / 1500
    data.qvel[1] = BASE_NUDGE_SPEED
    mujoco.mj_step(model, data, nstep=round(20 / model.opt.timestep))
    assert data.qpos[3] < 0.99  # tilted by more than 16 deg
    assert "upset-by-nudge" in {failure.code for failure in pa.judge_stand(weak, stand).failures}


@pytest.mark.parametrize(
    ("change", "near"),
    [
        ({}, False),
        ({"motor_utilisation": np.array([0.1, 0.91])}, True),
        ({"motor_utilisation": np.array([0.1, 0.89])}, False),
        ({"friction_utilisation": {"FL": 0.91}}, True),
        ({"friction_utilisation": {"FL": 0.89}}, False),
        ({"loads": (10.0, 10.0, 10.0, 0.14)}, True),  # 2 % of the mean load is 0.151 N
        ({"loads": (10.0, 10.0, 10.0, 0.16)}, False),
        ({"com_margin": 0.0053}, True),
        ({"com_margin": 0.0083}, False),
        ({"com_margin": None, "loads": (10.0, 0.0, 0.0, 0.0)}, False),
    ],
)
def test_stand_is_near_a_limit_by_any_of_its_criteria(
    monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], near: bool
) -> None:
    """By hand: a nudge of 10 mm/s moves the CoM at 0.16 m by 10 sqrt(0.16 / 9.81) = 1.3 mm; the
    least margin is five times as large, 6.4 mm."""
    robot, stand = load("v3"), stand_of("v3")
    monkeypatch.setattr(trial_module, "saturates_after_nudge", lambda *_: False)
    monkeypatch.setattr(trial_module, "com_height_above_contacts", lambda *_: 0.16)
    change = dict(change)
    loads = change.pop("loads", (10.0,) * 4)
    feet = {
        foot: SimpleNamespace(force=newtons * stand.normals[points[0]])
        for (foot, points), newtons in zip(robot.feet.items(), loads, strict=True)
    }
    values = {
        "com_margin": 0.05,
        "foot_loads": feet,
        "motor_utilisation": np.array([0.1, 0.2]),
        "friction_utilisation": {},
    }
    statics: Any = SimpleNamespace(**{**values, **change})
    assert is_near_limit(robot, stand, statics) is near
