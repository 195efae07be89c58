"""Verified stands, compared with a plain MuJoCo loop of the test and with mechanics."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import INTEGRATOR_TYPES, model_with_servos
from pupper_analysis.simulation import growth, verify
from pupper_analysis.simulation.rollout import full_state, place_on_ground
from pupper_analysis.simulation.verify import describe_deviations, describe_model_mismatch
from tests.support.engines import change_model
from tests.support.legged import edited_by
from tests.support.slips import standing
from tests.support.variants import NAMES, SKELETON_NAMES, load, stand_of

GRAVITY = 9.81
SERVOS = {"v3": (5.0, 0.1), "skeleton": (60.0, 1.0)}


@cache
def verify_variant(name: str, feedforward: bool = True) -> pa.simulation.StandVerification:
    return pa.verify_stand(load(name), stand_of(name), feedforward=feedforward)


def even_balance(robot: pa.Robot, stand: pa.Stand) -> pa.statics.GravityCompensation:
    return pa.gravity_compensation(
        pa.Configuration(robot, stand.qpos),
        distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL,
    )


@cache
def verify_briefly(name: str, feedforward: bool = True) -> pa.simulation.StandVerification:
    """Verify the nominal stand of a variant in a simulation of 2 s without nudges."""
    robot, stand = load(name), stand_of(name)
    return pa.verify_stand(robot, stand, feedforward=feedforward, duration=2.0, nudged=0)


def plain_run(
    model: mujoco.MjModel, qpos: np.ndarray, ctrl: np.ndarray, duration: float
) -> mujoco.MjData:
    """Return the data after MuJoCo's own loop, with evaluated contacts."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    data.ctrl[:] = ctrl
    mujoco.mj_step(model, data, round(duration / model.opt.timestep))
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.slow
def test_stand_of_each_variant_is_verified_to_the_stated_accuracy(variant: str) -> None:
    """Reference: the static prediction: 1e-3 rad, and 1 % of torque and force."""
    result = verify_variant(variant)
    assert result.passed, result.failures
    assert result.failures == ()
    assert result.feedforward
    assert result.joint_error < 1e-3
    assert result.torque_error < 1e-2
    assert result.force_error < 1e-2
    assert result.height_deviation < 5e-5
    assert result.mujoco_residual < 1e-9
    assert result.tilt < 1e-3
    assert max(result.foot_slip.values()) < 1e-3
    expected = even_balance(load(variant), stand_of(variant))
    np.testing.assert_array_equal(result.predicted_torques, expected.joint_torques)
    gap = np.abs(result.joint_torques - expected.joint_torques).max()
    assert result.torque_error == pytest.approx(gap / np.abs(expected.joint_torques).max())
    for foot, force in expected.contact_forces.items():
        np.testing.assert_array_equal(result.predicted_forces[foot], force)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3"])
@pytest.mark.parametrize("feedforward", [True, False])
def test_settled_state_equals_a_plain_mujoco_simulation(name: str, feedforward: bool) -> None:
    """Reference: MuJoCo's own loop, from a drop of 3 mm instead of a start in balance."""
    robot, stand, result = load(name), stand_of(name), verify_variant(name, feedforward)
    kp = SERVOS["v3" if name == "v3" else "skeleton"][0]
    model = robot.description.mjcf.copy().compile()
    boost = result.predicted_torques / kp if feedforward else 0.0
    data = plain_run(model, stand.qpos + 3e-3 * np.eye(19)[2], stand.qpos[7:] + boost, 5.0)
    # The joints' dry friction lets a joint rest anywhere within its 0.01 or 0.002 N m / kp.
    assert data.qpos[2] == pytest.approx(result.base_height, abs=3e-4)
    sunk = -float(np.mean(data.contact.dist))
    assert data.ncon == 4
    assert result.contact_sag == pytest.approx(sunk, rel=0.03)
    assert result.servo_sag == pytest.approx(stand.qpos[2] - data.qpos[2] - sunk, abs=3e-4)


def height_on(feet: np.ndarray) -> float:
    """Return the distance of the base from the plane through the foot centres [m], shape (n, 3) in
    the base frame.
    """
    plane = np.linalg.lstsq(np.c_[np.ones(len(feet)), feet[:, :2]], feet[:, 2], rcond=None)[0]
    return float(-plane[0] / math.hypot(1, *plane[1:]))


@pytest.mark.slow
def test_servo_sag_follows_from_torque_over_stiffness(variant: str) -> None:
    """Closed form: each servo yields by tau / kp [rad]; the base height [m] follows from forward
    kinematics.
    """
    robot, stand, result = load(variant), stand_of(variant), verify_variant(variant, False)
    assert not result.feedforward
    assert result.height_loss == pytest.approx(stand.qpos[2] - result.base_height, abs=1e-12)
    assert result.servo_sag + result.contact_sag == pytest.approx(result.height_loss, abs=1e-12)
    assert result.servo_sag > 0
    assert result.contact_sag > 0
    sunk = np.concatenate([robot.neutral()[:7], stand.qpos[7:] - result.joint_torques / result.kp])
    assert result.joint_error == pytest.approx(
        np.abs(sunk - stand.qpos)[7:].max(), rel=0.02, abs=1e-6
    )
    feet = pa.Configuration(robot, sunk).foot_positions()
    lower = stand.qpos[2] - (height_on(np.array(list(feet.values()))) + robot.contact_radius["FR"])
    assert result.servo_sag == pytest.approx(lower, rel=0.03)


def test_verification_uses_gains_per_joint_and_leaves_the_model_unchanged() -> None:
    """Reference: the given arrays, and the gains of the model before."""
    robot, kp = load("original"), np.linspace(40, 95, 12)
    before = robot.mj_model.actuator_gainprm.copy()
    result = pa.verify_stand(robot, stand_of("original"), kp=kp, kd=np.full(12, 2.0))
    np.testing.assert_array_equal(robot.mj_model.actuator_gainprm, before)
    np.testing.assert_array_equal(result.kp, kp)
    np.testing.assert_array_equal(result.kd, np.full(12, 2.0))
    assert result.passed, result.failures
    assert result.joint_error < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATOR_TYPES)
def test_integrator_is_reported_and_does_not_change_the_settled_height(integrator: str) -> None:
    """Reference: the height with the default integrator."""
    result = pa.verify_stand(load("v3"), stand_of("v3"), integrator=integrator)
    assert result.integrator == integrator
    assert result.passed, result.failures
    assert result.base_height == pytest.approx(verify_variant("v3").base_height, abs=1e-4)
    drive = model_with_servos(load("v3"), integrator=integrator)
    assert mujoco.mjtIntegrator(drive.model.opt.integrator).name == f"mjINT_{integrator.upper()}"


def test_initial_state_of_a_verification_is_in_balance(robot: pa.Robot, stand: pa.Stand) -> None:
    """Reference: the vertical constraint force of MuJoCo equals the weight."""
    drive = model_with_servos(robot)
    prediction = even_balance(robot, stand)
    ctrl = drive.command(robot, stand.joint_positions(robot), prediction.joint_torques)
    state = place_on_ground(robot, drive, stand, prediction.joint_torques)
    data = mujoco.MjData(drive.model)
    mujoco.mj_setState(drive.model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data.ctrl[:] = ctrl
    mujoco.mj_forward(drive.model, data)
    weight = drive.model.body_subtreemass[0] * 9.81
    assert data.qfrc_constraint[2] == pytest.approx(weight, rel=1e-6)
    assert 0 < stand.qpos[2] - data.qpos[2] < 0.02
    np.testing.assert_array_equal(data.qpos[3:], stand.qpos[3:])


@pytest.mark.slow
def test_resting_on_the_thighs_is_a_failure() -> None:
    """With weak servos the base sinks level, and rests."""
    result = pa.verify_stand(
        load("v3-heavy"), stand_of("v3-heavy"), feedforward=False, kp=0.5, kd=0.1
    )
    assert not result.passed
    assert any(
        str(reason).startswith("leg_front_r_2 touches the ground") for reason in result.failures
    )
    assert result.base_height < 0.6 * stand_of("v3-heavy").qpos[2]
    # At the end no deviation grows. The start is no equilibrium: two simulations that differ by
    # 0.1 mrad fall alike, so no mode is the cause.
    assert not result.stability.modes_growing_within()
    assert result.stability.refuted_modes


def test_fall_is_a_failure_of_the_verification() -> None:
    """The robot starts upside down and stays on its back."""
    robot, stand = load("original"), stand_of("original")
    qpos = stand.qpos.copy()
    qpos[3:7] = 0, 1, 0, 0
    result = pa.verify_stand(robot, replace(stand, qpos=qpos), feedforward=False)
    assert not result.passed
    assert str(result.failures[0]).startswith("the robot fell over: tilt 180 deg")
    assert any(str(reason).startswith("base_link touches the ground") for reason in result.failures)


def test_recorded_motion_has_the_recorded_heights_and_ends_at_rest() -> None:
    """Reference: the recorded height at the same times, and the joints of the stand."""
    robot, stand = load("original"), stand_of("original")
    report = pa.verify_stand(robot, stand, duration=2.0, nudged=0)
    assert report.motion.shape == (len(report.motion_time), robot.nq)
    assert np.diff(report.motion_time) == pytest.approx(0.1)
    at = np.searchsorted(report.time, report.motion_time - 1e-9)
    assert report.time[at] == pytest.approx(report.motion_time)
    assert report.motion[:, 2] == pytest.approx(report.height[at], abs=1e-6)
    assert np.linalg.norm(report.motion[:, 3:7], axis=1) == pytest.approx(1.0)
    assert report.motion[-1, 7:] == pytest.approx(stand.qpos[7:], abs=report.joint_error + 1e-6)


def test_lifted_foot_is_named() -> None:
    """A bent knee lifts one of four feet in the simulation; the statics load all four."""
    robot, stand = load("original"), stand_of("original")
    qpos = stand.qpos.copy()
    qpos[7 + 3 * robot.contact_points.index("FL") + 2] -= 0.6
    result = pa.verify_stand(robot, replace(stand, qpos=qpos))
    assert not result.passed
    assert any(str(reason).startswith("foot FL carries no load") for reason in result.failures)
    assert result.force_error is not None
    assert result.force_error > 0.5


@pytest.mark.slow
def test_verification_fails_if_motors_cannot_give_the_torque() -> None:
    """Force range of 0.3 N m: the joints deviate, and both joint and torque deviations are
    reported."""
    robot, stand = load("v3"), stand_of("v3")
    weak = replace(robot, mj_model=robot.description.mjcf.copy().compile())
    weak.mj_model.actuator_forcerange[:] = [-0.3, 0.3]
    result = pa.verify_stand(weak, stand)
    assert not result.passed
    assert any(failure.code == "joint-off" for failure in result.failures)
    assert any(failure.code == "motor-torque-off" for failure in result.failures)
    assert np.abs(result.joint_torques).max() <= 0.3 + 1e-9


def test_stand_whose_com_is_outside_is_refused() -> None:
    """The thighs are turned by 1.2 rad, so that no contact forces balance the robot."""
    stand = stand_of("original")
    qpos = load("original").neutral()
    qpos[8::3] = 1.2
    with pytest.raises(pa.StaticsInfeasibleError):
        pa.verify_stand(load("original"), replace(stand, qpos=qpos))


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"kp": 0}, "kp"),
        ({"kp": "stiff"}, "kp"),
        ({"kp": [1, 2]}, "kp"),
        ({"kd": -0.1}, "kd"),
        ({"integrator": "euler"}, "integrator"),
        ({"duration": 1.0}, "duration"),
        ({"duration": 1e9}, "duration"),
    ],
)
def test_verification_refuses_invalid_arguments(arguments: dict[str, object], field: str) -> None:
    """The message names the argument."""
    with pytest.raises(pa.ConfigurationError, match=field):
        pa.verify_stand(load("v3"), stand_of("v3"), **arguments)  # type: ignore[arg-type]


def test_verification_refuses_fixed_bases_and_stands_of_other_robots(tiny: pa.Robot) -> None:
    """The message names the reason, and the robot."""
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        pa.verify_stand(load("v3", fixed_base=True), stand_of("v3"))
    with pytest.raises(pa.ConfigurationError, match="solve a stand for tiny"):
        pa.verify_stand(tiny, stand_of("v3"))


def test_servos_of_a_joint_without_motor_are_refused(tiny: pa.Robot) -> None:
    """The message names the joint."""
    with pytest.raises(pa.ModelError, match="'turn' has no actuator"):
        model_with_servos(tiny)


@pytest.mark.slow
def test_stability_of_each_sweep_cell_equals_stand_stability() -> None:
    """Reference: ``stand_stability`` with the gains of each cell that comes to rest."""
    robot, stand = load("original"), stand_of("original")
    result = pa.simulation.sweep_gains(robot, stand, kp=[1.5, 20.0], kd=[0.2, 0.5], duration=2.0)
    for row, column in np.ndindex(2, 2):
        gains = {"kp": float(result.kp[row]), "kd": float(result.kd[column])}
        if row:  # the servos of the first row are too soft, and the robot does not rest
            found = pa.simulation.stand_stability(
                robot, stand, feedforward=False, integrator="implicitfast", **gains
            )
            assert found.is_stable_for()
    assert result.lasts.tolist() == [[False, False], [True, True]]


@pytest.mark.slow
def test_default_grid_of_gains_contains_the_gains_of_the_model() -> None:
    """Reference: a sweep of the single cell with the gains of the model."""
    robot, stand = load("v3"), stand_of("v3")
    result = pa.simulation.sweep_gains(robot, stand)
    np.testing.assert_allclose(result.kp, [1.25, 2.5, 5, 10, 20])
    shape = (len(result.kp), len(result.kd))
    assert result.height_deviation.shape == result.fell.shape == result.lasts.shape == shape
    assert np.isfinite(result.height_deviation[~result.fell]).all()
    assert (result.amplitude, result.frequency, result.duration) == (2.0, 1.2, pytest.approx(4.0))
    assert result.integrator == "implicitfast"
    alone = pa.simulation.sweep_gains(robot, stand, kp=[5.0], kd=[0.1])  # the model's own
    cell = result.kp.tolist().index(5.0), result.kd.tolist().index(0.1)
    found = result.height_deviation[cell]
    assert alone.height_deviation[0, 0] == pytest.approx(found, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kp", "kd"), [("original", 30.0, 0.5), ("v3", 10.0, 0.5)])
def test_gain_sweep_equals_a_loop_of_single_steps(name: str, kp: float, kd: float) -> None:
    """Reference: one cell of the sweep with gains and disturbance set by hand, and ``mj_step`` in a
    loop."""
    robot, stand = load(name), stand_of(name)
    cells = pa.simulation.sweep_gains(
        robot, stand, kp=[5.0, kp], kd=[0.3, kd], amplitude=3.0, frequency=1.5
    )
    model = robot.description.mjcf.copy().compile()
    model.actuator_gainprm[:, 0] = kp
    model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -kp, -kd
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST.value
    data = mujoco.MjData(model)
    torques = even_balance(robot, stand).joint_torques
    start = place_on_ground(robot, model_with_servos(robot, kp, kd, "implicitfast"), stand, torques)
    mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data.ctrl[:] = stand.qpos[7:]
    heights = []
    while data.time < 4.0 - model.opt.timestep / 2:
        data.xfrc_applied[1, 2] = 3.0 * math.sin(2 * math.pi * 1.5 * data.time)
        mujoco.mj_step(model, data)
        heights.append(data.qpos[2])
    deviation = np.std(heights[-round(1 / model.opt.timestep) :])
    assert cells.height_deviation[1, 1] == pytest.approx(deviation, rel=1e-6)


@pytest.mark.slow
def test_each_variant_stands_on_stiff_servos_in_a_sweep() -> None:
    """With kp = 30 N m/rad and kd = 1 N m s/rad the height deviates by less than 5 mm."""
    for name in NAMES:
        result = pa.simulation.sweep_gains(
            load(name), stand_of(name), kp=[30], kd=[1], duration=2.0
        )
        assert not result.fell.any()
        assert result.height_deviation[0, 0] < 5e-3


def test_sweep_marks_falls_also_if_the_robot_rests() -> None:
    """Lying on the thighs is a fall; so is a throw by a force of ten times the weight."""
    weak, stand = load("v3-heavy"), stand_of("v3-heavy")
    result = pa.simulation.sweep_gains(weak, stand, kp=[0.3, 20], kd=[0.5])
    np.testing.assert_array_equal(result.fell, [[True], [False]])
    assert result.height_deviation[0, 0] == math.inf
    robot, stand = load("original"), stand_of("original")
    thrown = {"amplitude": 300, "frequency": 0.4}
    result = pa.simulation.sweep_gains(robot, stand, kp=[10, 60], kd=[0.5], **thrown)
    assert result.fell.all()
    assert result.lasts.all()  # undisturbed
    assert result.to_dict()["height_deviation"] == [[None], [None]]


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"kp": []}, "kp"),
        ({"kd": []}, "kd"),
        ({"kp": [0.0]}, "kp"),
        ({"kd": [-1.0]}, "kd"),
        ({"amplitude": math.nan}, "amplitude"),
        ({"frequency": math.inf}, "frequency"),
        ({"duration": 0.5}, "duration"),
        ({"integrator": "magic"}, "integrator"),
    ],
)
def test_gain_sweep_refuses_invalid_arguments(arguments: dict[str, object], field: str) -> None:
    """The message names the argument."""
    with pytest.raises(pa.ConfigurationError, match=field):
        pa.simulation.sweep_gains(load("v3"), stand_of("v3"), **arguments)  # type: ignore[arg-type]


def test_force_error_of_an_unloaded_foot_is_relative_to_the_weight() -> None:
    """Reference: the foot force / (0.05 weight).

    The CoM is placed so that RR has no predicted load; soft ground gives RR some.
    """
    robot = load("v3")
    report = pa.verify_stand(robot, pa.solve_stand(robot, pa.StandTask(com=(0.037, 0.045))))
    assert report.predicted_forces["RR"][2] == pytest.approx(0, abs=1e-4)
    weight = robot.total_mass * GRAVITY
    assert report.force_error == pytest.approx(
        report.foot_forces["RR"][2] / (0.05 * weight), rel=1e-3
    )
    assert not report.passed


@pytest.mark.parametrize("act", ["verify", "sweep"])
def test_divergence_is_reported_without_a_log_file(
    act: str, mujoco_log: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """MuJoCo would print warnings and write MUJOCO_LOG.TXT."""
    mujoco_log.unlink(missing_ok=True)

    def stiff(model: mujoco.MjModel) -> None:
        model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_EULER, 0.02
        model.actuator_gainprm[:, 0] *= 1e9
        model.actuator_biasprm[:, 1] *= 1e9

    robot = change_model(load("original"), stiff)
    stand = pa.solve_stand(robot)
    if act == "verify":
        assert pa.verify_stand(robot, stand).failures[0].code == "simulation-diverged"
    else:
        swept = pa.simulation.sweep_gains(
            robot, stand, kp=[1e9], kd=[0.0], duration=2.0, integrator="Euler"
        )
        assert swept.fell.all()
    assert not mujoco_log.exists()
    assert "WARNING" not in capfd.readouterr().err


def test_stand_fails_if_soft_ground_takes_a_tenth_of_the_height(tmp_path: Path) -> None:
    """Legs too short for the penetration of their feet; the reference is a loop of MuJoCo alone."""
    soft = '<geom priority="1" solref="0.17 1" type="plane"'
    pair = standing(tmp_path)
    edited_by(pair.mjcf, lambda text: text.replace('<geom type="plane"', soft))
    robot = pa.load_robot(*pair)
    stand = pa.solve_stand_as_simulated(robot)
    result = pa.verify_stand(robot, stand, duration=6.0, nudged=0.0)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    torques = even_balance(robot, stand).joint_torques
    ctrl = stand.qpos[7:] + torques / model.actuator_gainprm[:, 0]
    lost = stand.qpos[2] - plain_run(model, stand.qpos, ctrl, 5.5).qpos[2]
    assert lost > 0.1 * pa.Configuration(robot, stand.qpos).center_of_mass()[2]
    assert result.height_loss == pytest.approx(lost, abs=1e-4)
    assert [failure.code for failure in result.failures] == ["height-lost"]
    assert result.stays


@pytest.mark.parametrize(("unit", "text"), [("m", "50 mm"), ("rad", "2.9 deg")])
def test_joint_deviation_is_given_in_the_unit_of_the_joint(unit: str, text: str) -> None:
    [message] = describe_deviations(0.05, 0.0, unit=unit)
    assert str(message).endswith(text)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_verification_records_servos_integrator_and_duration(name: str) -> None:
    """Reference: gains and integrator of the files, and the requested 2 s."""
    robot, result = load(name), verify_briefly(name)
    kp, kd = SERVOS[pa.VARIANTS[name].base]
    np.testing.assert_array_equal(result.kp, np.full(12, kp))
    np.testing.assert_array_equal(result.kd, np.full(12, kd))
    assert result.integrator == ("Euler" if name == "v3" else "implicitfast")
    assert result.timestep == robot.mj_model.opt.timestep
    assert result.duration == pytest.approx(2.0)
    assert result.time.shape == result.height.shape
    assert (np.diff(result.time) > 0).all()
    assert result.height[-1] == pytest.approx(result.base_height, abs=1e-6)


@pytest.mark.parametrize("feedforward", [True, False])
@pytest.mark.parametrize("name", ["original", "v3"])
def test_simulated_foot_forces_add_up_to_the_weight(name: str, feedforward: bool) -> None:
    """Reference: the total mass times 9.81 m/s^2, vertical."""
    result = verify_briefly(name, feedforward)
    total = sum(result.foot_forces.values(), np.zeros(3))
    weight = load(name).total_mass * GRAVITY
    np.testing.assert_allclose(total, [0, 0, weight], atol=2e-3 * weight)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_feedforward_removes_the_servo_sag_and_keeps_the_contact_sag(name: str) -> None:
    """Reference: the verification without feed-forward."""
    with_it, without = verify_briefly(name), verify_briefly(name, False)
    assert without.servo_sag > 0
    assert abs(with_it.servo_sag) < 0.02 * without.servo_sag
    assert with_it.contact_sag == pytest.approx(without.contact_sag, rel=0.15)


@pytest.mark.parametrize("name", SKELETON_NAMES)
def test_small_servo_sag_equals_the_virtual_work_of_the_torques(name: str) -> None:
    """Closed form: weight x sag = sum of tau^2 / kp, with Pinocchio's torques.

    The weight of the legs does not sink with the base: only the torques of the foot forces do work.
    """
    robot, config = load(name), pa.Configuration(load(name), stand_of(name).qpos)
    torques = even_balance(robot, stand_of(name)).joint_torques
    hanging = pa.gravity_compensation(config, []).joint_torques
    lever = (torques - hanging) / (robot.total_mass * GRAVITY)
    sag = lever @ torques / SERVOS["skeleton"][0]
    assert verify_briefly(name, False).servo_sag == pytest.approx(sag, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gains"), [("v3", (5, 10, 20, 40)), ("original", (30, 60, 120))])
def test_servo_sag_decreases_with_stiffness(name: str, gains: tuple[float, ...]) -> None:
    """Closed form: on stiff servos the sag is nearly in inverse proportion to the stiffness."""
    results = [
        pa.verify_stand(
            load(name), stand_of(name), feedforward=False, kp=kp, integrator="implicitfast",
            duration=2.0, nudged=0,
        )
        for kp in gains
    ]  # fmt: skip
    for kp, result in zip(gains, results, strict=True):
        np.testing.assert_array_equal(result.kp, np.full(12, kp))
    sags = [result.servo_sag for result in results]
    assert sags == sorted(sags, reverse=True)
    product = [kp * sag for kp, sag in zip(gains, sags, strict=True)]
    assert product[-2] == pytest.approx(product[-1], rel=0.2)


def test_verification_with_other_gains_and_integrator_leaves_the_model_unchanged() -> None:
    """Reference: gains and integrator of the model before."""
    robot = load("v3")
    gains, bias = robot.mj_model.actuator_gainprm.copy(), robot.mj_model.actuator_biasprm.copy()
    pa.verify_stand(robot, stand_of("v3"), kp=50, kd=1, integrator="RK4", duration=2.0, nudged=0)
    np.testing.assert_array_equal(robot.mj_model.actuator_gainprm, gains)
    np.testing.assert_array_equal(robot.mj_model.actuator_biasprm, bias)
    assert robot.mj_model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER.value


@pytest.mark.slow
def test_repeated_sweep_and_verification_are_equal_to_the_last_bit() -> None:
    robot, stand = load("v3"), stand_of("v3")
    first, second = (
        pa.simulation.sweep_gains(robot, stand, kp=[5, 9], kd=[0.2], duration=2.0) for _ in range(2)
    )
    np.testing.assert_array_equal(first.height_deviation, second.height_deviation)
    again = pa.verify_stand(robot, stand, duration=2.0, nudged=0)
    np.testing.assert_array_equal(again.joint_torques, verify_briefly("v3").joint_torques)
    np.testing.assert_array_equal(again.height, verify_briefly("v3").height)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_stand_that_passes_with_sag_also_passes_in_10_s(name: str) -> None:
    """Reference: a verification of 10 s. A stand that still sinks must not pass the default
    duration."""
    robot, stand = load(name), stand_of(name)
    later = pa.verify_stand(robot, stand, feedforward=False, duration=10.0)
    assert later.passed or not verify_variant(name, False).passed, later.failures


def test_height_deviation_of_a_sweep_decreases_with_stiffness() -> None:
    """Closed form: well below resonance, the response to a force is the force over the stiffness.

    Damping of 5 N m s/rad alone would hold the robot; the sweep has at most 2.
    """
    result = pa.simulation.sweep_gains(
        load("original"), stand_of("original"), kp=(10, 30, 60, 120), kd=(0.5, 2.0)
    )
    assert (np.diff(result.height_deviation, axis=0) < 0).all()


def test_height_deviation_of_a_sweep_is_proportional_to_the_force() -> None:
    """Reference: half the force; and no force, of which less than 5 % of the deviation remains."""
    robot, stand = load("original"), stand_of("original")
    zero, half, full = (
        pa.simulation.sweep_gains(robot, stand, kp=[60], kd=[2], amplitude=force).height_deviation
        for force in (0.0, 2.0, 4.0)
    )
    np.testing.assert_allclose(full / half, 2.0, rtol=0.1)
    assert zero < 0.05 * half


@pytest.mark.slow
def test_growing_modes_are_not_simulated_until_failure_if_the_nudge_decides(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stand that buckles with 1.2 N m/rad; reference: the complete verification."""
    robot, stand = load("v3"), stand_of("v3")
    simulated: list[float] = []
    simulate, measure = growth.simulate_growth, verify.measure_response

    def count_simulations(*arguments: Any, **named: Any) -> growth.GrowthTrial:
        simulated.append(1.0)
        return simulate(*arguments, **named)

    monkeypatch.setattr(growth, "simulate_growth", count_simulations)
    complete = pa.verify_stand(robot, stand, kp=1.2)
    brief = pa.verify_stand(robot, stand, kp=1.2, until_failure=True)
    assert len(simulated) == 2  # the response to the nudge decides nothing
    assert [failure.code for failure in brief.failures] == ["mode-buckles"]
    monkeypatch.setattr(
        verify,
        "measure_response",
        lambda *arguments, **named: replace(measure(*arguments, **named), decayed=False, left=0.1),
    )
    brief = pa.verify_stand(robot, stand, kp=1.2, until_failure=True)
    assert len(simulated) == 2
    assert (brief.passed, brief.stays) == (complete.passed, complete.stays) == (False, False)


def test_creep_of_a_slide_is_a_speed_and_that_of_a_hinge_a_rate() -> None:
    """Closed form: in 2 s, a slide moves by 4 mm and a hinge by 1 mrad. A stub has both joints."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="lift" type="slide"/><joint name="turn"/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    state = full_state(model, mujoco.MjData(model))
    states = np.array([state, state])
    states[1, :3] += 2.0, 4e-3, 1e-3
    robot: Any = SimpleNamespace(
        nu=2,
        floating=False,
        joint_names=("lift", "turn"),
        contact_places={},
        mj_convention=SimpleNamespace(qpos_index=np.arange(2)),
        before_servos=SimpleNamespace(mj_model=model),
    )
    stand: Any = SimpleNamespace(stance_feet=())
    creep = verify.measure_creep(robot, stand, model, states)
    assert creep.speed == pytest.approx(2e-3)
    assert creep.rate == pytest.approx(5e-4)


@pytest.mark.parametrize(
    ("loss", "feedforward", "collapses", "has_failures", "codes"),
    [
        (0.005, True, False, False, []),
        (0.02, True, False, False, ["height-lost"]),
        (0.04, True, True, False, ["height-lost"]),
        (0.04, True, True, True, []),
        (0.02, False, False, False, []),
        (0.04, False, True, False, ["sags-too-far"]),
        (0.04, False, True, True, []),
    ],
)
def test_a_robot_that_loses_much_height_fails(
    loss: float, feedforward: bool, collapses: bool, has_failures: bool, codes: list[str]
) -> None:
    """A loss of 0.04 m of 0.1 m is a collapse (above 30 %), but no fall (above 50 %). Without
    feed-forward, servos sag, and a smaller loss is no failure.
    """
    result: Any = SimpleNamespace(
        height_loss=loss, contact_sag=loss, collapses=collapses, feedforward=feedforward
    )
    failures = describe_deviations(1.0, 0.0) if has_failures else []
    found = verify._describe_height_loss(result, 0.1, failures)
    assert [message.code for message in found] == codes


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.01, 0.05])
def test_feet_that_leave_the_ground_when_the_robot_is_released_do_not_fail(
    tmp_path: Path, friction: float
) -> None:
    """Without feed-forward the robot drops by its sag. Reference: bare MuJoCo, in which a front
    foot leaves the ground for some milliseconds, and the robot comes to rest.
    """
    pair = standing(tmp_path)
    loss = (' axis="0 1 0" range', f' frictionloss="{friction}" axis="0 1 0" range')
    edited_by(pair.mjcf, lambda text: text.replace(*loss))
    robot = pa.load_robot(mjcf=pair.mjcf)
    stand = pa.solve_stand(robot)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = stand.qpos[2]
    num_feet = []
    while data.time < 5.0:
        mujoco.mj_step(model, data)
        num_feet.append(data.ncon)
    assert min(num_feet[10:100]) < 4
    assert set(num_feet[1000:]) == {4}
    assert np.abs(data.qvel).max() < 1e-4
    assert pa.verify_stand(robot, stand, feedforward=False).passed


@pytest.mark.parametrize(("residual", "named"), [(0.0, False), (1.0, True), (math.nan, True)])
def test_forces_that_do_not_balance_or_are_no_number_are_reported(
    residual: float, named: bool
) -> None:
    robot = pa.load_variant("v3")
    codes = [
        message.code for message in describe_model_mismatch(robot, residual, robot.usual_weight)
    ]
    assert codes == ["files-of-two-robots"] * named
