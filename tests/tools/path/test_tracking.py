"""Paths in MuJoCo: deviations of the servos, and failures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import split_verdict_lines
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.rollout import STATE_SPEC, full_state, simulate_commands
from pupper_analysis.simulation.verdict import Question, Verdict
from pupper_analysis.tools.path import tracking
from pupper_analysis.tools.path.plan import stance_path
from pupper_analysis.tools.path.tracking import path_commands, study_path, track_path
from tests.prepare.test_imported import four_legs
from tests.prepare.test_own_run import codes, load_slip
from tests.support.commands import check_refusal, run_command
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.legged import biped
from tests.support.repository import benchmark
from tests.support.variants import load, stand_of
from tests.tools.path.test_plan import path_of, stances

# Deviations measured in MuJoCo, plus about 50 %: joint [rad], height [m], base [rad].
# v3's servos are soft (5 N m/rad), and a foot that rolls has no grip left: it creeps.
BOUNDS = {
    ("v3", "squat"): (0.01, 1.0e-3, 0.01),
    ("v3", "sway"): (0.01, 1.0e-3, 0.01),
    ("v3", "circle"): (0.01, 1.0e-3, 0.01),
    ("v3", "lift"): (0.012, 1.0e-3, 0.015),
    ("original", "squat"): (0.0025, 2e-4, 1e-4),
    ("original", "sway"): (0.002, 5e-5, 5e-4),
    ("original", "circle"): (0.0035, 5e-5, 1.5e-3),
    ("original", "lift"): (0.0025, 1e-4, 1.2e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), list(BOUNDS))
def test_mujoco_tracks_a_path(name: str, kind: str) -> None:
    """Largest deviations of joints [rad], height [m] and base orientation [rad] below the measured
    bounds, and less than 5 % in torque.
    """
    tracking = track_path(load(name), path_of(name, kind))
    assert tracking.passed, tracking.failures
    joint, height, angle = BOUNDS[name, kind]
    assert 0 < tracking.joint_error < joint
    assert tracking.height_error < height
    assert tracking.orientation_error < angle
    assert max(tracking.foot_slip.values()) < (6e-3 if name == "v3" else 1e-3)
    assert tracking.torque_error < 0.05
    assert tracking.to_dict()["passed"] is True


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.6, 1.0, 4.0])
@pytest.mark.parametrize("name", ["v3", "original"])
def test_torques_in_motion_are_confirmed_at_any_speed(name: str, seconds: float) -> None:
    """Reference: MuJoCo.

    In the fast path, the share of inertia in the torques is more than twice the torque error.
    """
    robot = load(name)
    path = stance_path(robot, stances(name, "squat"), seconds, rate=50 / seconds)
    tracking = track_path(robot, path)
    assert tracking.passed, tracking.failures
    assert tracking.joint_error < (0.008 if name == "v3" else 0.001)
    still = stance_path(robot, stances(name, "squat"), 1e3, rate=50 / 1e3)
    inertia = np.abs(path.torques - still.torques).max() / np.abs(path.torques).max()
    if seconds < 1.0:
        assert inertia > 2 * tracking.torque_error


@pytest.mark.slow
def test_time_step_of_tracking_is_reduced_for_an_inexact_integrator() -> None:
    """The skeleton's implicit steps of 4 ms suffice for a stand, not for a fast path."""
    robot = load("original")
    path = stance_path(robot, stances("original", "sway"), 3.0, rate=50)
    fine, coarse = track_path(robot, path), track_path(robot, path, timestep=4e-3)
    assert coarse.timestep == 4e-3
    assert fine.timestep == pytest.approx(2.5e-4)
    assert fine.torque_error < 0.7 * coarse.torque_error
    explicit = track_path(robot, path, integrator="Euler")
    assert explicit.torque_error == pytest.approx(fine.torque_error, abs=2e-3)


@pytest.mark.slow
def test_time_step_of_tracking_suits_the_damping_of_the_servos() -> None:
    """Reference: time step times kd over the smallest joint inertia, by MuJoCo's mass matrix.

    For A1, with 13 N m s/rad, the ratio was one half, and the fastest squat lost the ground.
    """
    robot, share = load("original"), []
    path = stance_path(robot, [pa.StandTask(), pa.StandTask(height=0.98 * robot.stand_height)], 0.4)
    matrix = np.zeros((robot.nv, robot.nv))
    mujoco.mj_fullM(robot.mj_model, evaluate_mujoco(robot, path.qpos[0]), matrix)
    inertia = np.diag(matrix)[robot.mj_convention.qvel_index[6:]]
    for kd in (1.0, 5.0, 20.0):
        plan = path_commands(robot, path, lambda there, kd=kd: model_with_servos(there, 50.0, kd))
        share.append(plan.drive.model.opt.timestep * kd / inertia.min())
    assert share[0] == pytest.approx(2.5e-4 / inertia.min())
    assert share[1:] == pytest.approx([share[1]] * 2, rel=1e-2)  # the stand is sunk by 0.7 mm
    assert 0.9 * share[0] < share[1] < 0.1


@pytest.mark.slow
def test_commands_include_the_foot_depth_on_soft_ground() -> None:
    """Reference: MuJoCo at rest with the first command. v3's feet are 4 mm in the ground, which
    changes the knee torques by 3 %."""
    robot = benchmark("sag").change_model(load("v3"), benchmark("sag").remove_dry_friction)
    lower = pa.StandTask(height=0.99 * robot.stand_height)
    path = stance_path(robot, [pa.StandTask(), lower], 9.0, rate=5)
    plan, joints = path_commands(robot, path), robot.mj_convention.qvel_index[6:]
    model, largest = plan.drive.model, np.abs(path.torques).max()
    model.opt.timestep = 1e-3
    last = simulate_commands(model, plan.start, np.tile(plan.ctrl[0], (1000, 1)))[-1]
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, last, STATE_SPEC)
    data.ctrl[:] = plan.ctrl[0]
    mujoco.mj_forward(model, data)
    held = data.qfrc_actuator[joints]
    np.testing.assert_allclose(plan.torques[0], held, atol=3e-3 * largest)
    assert np.abs(path.torques[0] - held).max() > 0.01 * largest


@pytest.mark.slow
def test_tracking_failures_are_reported() -> None:
    robot = load("v3")
    path = path_of("v3", "lift")
    limp = track_path(robot, path, kp=0.3, kd=0.01)
    assert not limp.passed
    assert any(failure.code == "joint-off-path" for failure in limp.failures)
    sway = path_of("v3", "sway")  # as fast as no contact forces allow
    fast = track_path(robot, replace(sway, time=0.35 / 3.0 * sway.time))
    assert "foot-idle" in {failure.code for failure in fast.failures}
    weak = track_path(robot, path, kp=5.0, kd=0.1, integrator="implicitfast")
    assert weak.integrator == "implicitfast"
    with pytest.raises(pa.ConfigurationError, match="timestep"):
        track_path(robot, path, timestep=0.0)
    with pytest.raises(pa.ConfigurationError, match="path"):
        track_path(load("original"), path)
    with pytest.raises(pa.ConfigurationError, match="integrator"):
        track_path(robot, path, integrator="magic")


def fast_sway() -> pa.stance.StancePath:
    """v3's sway nearly as fast as friction allows by a minimum-jerk law."""
    robot = load("v3")
    sides = [pa.StandTask(com=(0.0, y)) for y in (0.02, -0.02)]
    return stance_path(robot, [pa.StandTask(), *sides, pa.StandTask()], 0.85, rate=100)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motor_saturates_at_either_end_of_its_range(sign: float) -> None:
    """Reference: a range from -1 to 2 N m, and a command 10 N m beyond either end."""
    stand, motor = stand_of("v3"), int(load("v3").mj_convention.actuator_index[4])

    def limit_torque(model: mujoco.MjModel) -> None:
        model.actuator_forcerange[motor] = (-1.0, 2.0)

    robot = change_model(load("v3"), limit_torque)
    drive = model_with_servos(robot)
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos, np.zeros(robot.nv))
    start = full_state(drive.model, data)
    goal = stand.joint_positions(robot).copy()
    goal[4] += sign * 10 / drive.kp[4]
    torques = np.zeros((3, robot.nu))
    torques[:, 4] = 2.0 if sign > 0 else -1.0
    plan = SimpleNamespace(
        drive=drive,
        robot=robot,
        start=start,
        ctrl=np.tile(drive.command(robot, goal), (3, 1)),
        time=np.array([0.1, 0.2, 0.3]),
        torques=torques,
        path=SimpleNamespace(torques=torques),
    )
    simulated = tracking._compute_torques(plan, np.tile(start, (3, 1)))  # type: ignore[arg-type]
    (event,), error = tracking._compare_torques(plan, *simulated)  # type: ignore[arg-type]
    assert robot.joint_names[4] in str(event)
    assert error < 1e-9


@pytest.mark.slow
def test_tangential_and_rolling_friction_share_one_cone() -> None:
    """Reference: MuJoCo's contact forces, which are on the edge of the cone while a foot is pushed
    and rolls; those of the path must be within.

    Moments that ignore the tangential force would exceed the cone by 0.64.
    """
    robot, path = load("v3"), fast_sway()
    plan = path_commands(robot, path)
    states, model = simulate_commands(plan.drive.model, plan.start, plan.ctrl), plan.drive.model
    slide, _, spin, roll, _ = robot.contacts["FR"].friction
    axes, data = (slide, slide, spin, roll, roll), mujoco.MjData(model)
    for share in (0.4, 0.42, 0.6, 0.62):
        index, wrench, pushed = int(share * len(states)), np.zeros(6), []
        mujoco.mj_setState(model, data, states[index], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        data.ctrl[:] = plan.ctrl[index + 1]
        mujoco.mj_forward(model, data)
        for number in range(data.ncon):
            mujoco.mj_contactForce(model, data, number, wrench)
            taken = np.linalg.norm(wrench[1:] / axes) / wrench[0]
            assert taken == pytest.approx(1.0, abs=0.01)
            pushed.append(np.linalg.norm(wrench[1:3]) / slide / wrench[0])
        assert max(pushed) > 0.5
    up = path.forces[..., 2]
    parts = [np.linalg.norm(path.forces[..., :2], axis=-1) / slide, path.moments[..., 2] / spin]
    parts.append(np.linalg.norm(path.moments[..., :2], axis=-1) / roll)
    # The tangential force is that of the previous iteration (`inverse_dynamics`).
    assert (np.linalg.norm(parts, axis=0) / up).max() < 1.05
    assert (parts[0] / up).max() > 0.7


@pytest.mark.slow
def test_a_biped_on_flat_feet_tracks_a_squat(tmp_path: Path) -> None:
    """Reference: MuJoCo. Each foot has four contact points."""
    robot = pa.load_robot(*biped(tmp_path))
    squat = [pa.StandTask(), pa.StandTask(height=robot.stand_height - 0.05), pa.StandTask()]
    tracking = track_path(robot, stance_path(robot, squat, 1.5))
    assert tracking.passed, tracking.failures


@pytest.mark.slow
def test_every_point_of_a_lifted_sole_has_the_planned_clearance(tmp_path: Path) -> None:
    """Reference: the height that the task states for the foot. A foot has four points."""
    robot = pa.load_robot(*biped(tmp_path))
    [foot] = [name for name in robot.feet if name.startswith("left")]
    shifted = pa.StandTask(com=(0.0, -0.07))  # above the right foot
    lifted = pa.StandTask(com=(0.0, -0.07), swing={foot: 0.02})
    path = stance_path(robot, [shifted, lifted], 3.0)
    points = [column for column, name in enumerate(path.feet) if robot.foot_of(name) == foot]
    assert len(points) == 4
    assert path.clearance[-1, points] == pytest.approx([0.02] * 4)
    others = [column for column in range(len(path.feet)) if column not in points]
    assert not path.clearance[:, others].any()


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "passes"), [(5.0, True), (7.0, False)])
def test_path_passes_only_if_its_last_stand_holds(mass: float, passes: bool) -> None:
    """With 7 kg, v3 follows the path for a second because of the dry friction of the joints, and
    buckles later."""
    robot = pa.robot.with_payload(load("v3"), mass, (0.0, 0.0, 0.08))
    found = study_path(robot, pa.StandTask(height=0.13), 1.0)
    assert found.tracking.passed
    assert found.passed is passes
    assert pa.judge_stand(robot, found.stand).passed is passes


@pytest.mark.slow
def test_path_command_writes_a_path_of_the_given_time(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """References: nominal stand and requested stand, at both ends of the path."""
    csv, file = tmp_path / "way.csv", tmp_path / "all.json"
    three_legs = ("--swing", "RR=0.01", "--com", "inside", "--com-margin", "0.01")
    output = ("--csv", str(csv), "--json", str(file))
    status, out, err = run_command(
        capfd, "path", "original", *three_legs, "--seconds", "3", "-v", *output
    )
    assert status == 0, err
    assert "TRACKED" in out
    assert ["time", "3", "s"] in [line.split() for line in out.splitlines()]
    assert f"written: {csv}\nwritten: {file}\n" in out
    rows = csv.read_text().splitlines()
    arrays = {k: np.array(v) for k, v in json.loads(file.read_text())["path"].items() if v}
    assert len(rows) == 1 + len(arrays["time"]) > 100
    robot = load("original")
    goal = pa.solve_stand(robot, pa.StandTask(swing={"RR": 0.01}, com="inside", com_margin=0.01))
    np.testing.assert_allclose(arrays["qpos"][-1][2:7], goal.qpos[2:7], atol=1e-9)
    np.testing.assert_allclose(arrays["qpos"][-1], goal.qpos, atol=0.05)  # its feet have rolled
    np.testing.assert_allclose(arrays["qpos"][0], pa.solve_stand(robot).qpos, atol=1e-9)


def test_planned_stances_keep_moved_feet_and_ground() -> None:
    robot = load("v3")
    task = pa.StandTask(
        0.12, foot_offsets={"FL": (0.01, 0.0)}, ground=pa.Ground(0.05), com=(0.005, 0.0)
    )
    way = tracking.plan_stances(robot, pa.solve_stand(robot, task))
    assert len(way) == 2
    for stance in way:
        assert stance.ground == task.ground
        assert stance.foot_offsets == task.foot_offsets
    assert way[1].height == 0.12
    assert way[1].com == pytest.approx((0.005, 0.0), abs=1e-9)


def test_negative_duration_is_refused_before_any_file(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["path", "v3", "--seconds", "-2", "--json", "all.json"]
    check_refusal(capfd, tmp_path, arguments, "seconds")


def judge_path(robot: pa.Robot) -> Verdict:
    """Return the verdict of a path of 1 s to a height of 0.33 m."""
    return study_path(robot, pa.StandTask(height=0.33), 1.0).verdict


@pytest.mark.slow
def test_path_verdict_states_the_run_of_the_unmodified_file(tmp_path: Path) -> None:
    verdict = judge_path(load_slip(tmp_path, lambda text: text + "\n"))
    assert verdict.question is Question.TRACKED
    assert verdict.passed
    assert codes(verdict)[-1] == "own-run"
    # The run supports the verdict, so it is a detail of the answer.
    _, details = split_verdict_lines(verdict)
    assert any("unmodified MJCF" in str(line) for line in details)


@pytest.mark.slow
def test_keyframe_run_of_a_path_equals_that_of_the_robot(tmp_path: Path) -> None:
    robot = pa.load_robot(four_legs(tmp_path))
    found = judge_path(robot)
    assert found.keyframe_run == own_run(robot)
    assert "own-run" in codes(found)


@pytest.mark.slow
def test_feet_that_roll_slip_less_than_feet_with_fixed_centres() -> None:
    """On a path with fixed centres, the friction of the rolling feet turns the base."""
    rolling, pinned = (
        track_path(load("original"), path_of("original", "lift", rolling))
        for rolling in (True, False)
    )
    assert max(rolling.foot_slip.values()) < 0.4 * max(pinned.foot_slip.values())
    assert rolling.orientation_error < 0.9 * pinned.orientation_error


@pytest.mark.slow
def test_path_on_a_slope_begins_almost_without_acceleration() -> None:
    """The feet touch the ground one radius below their centres; forces on the other side of the
    centres would accelerate the base by 0.19 m/s^2. The joints begin with 0.5 rad/s^2, because the
    feet creep.
    """
    robot, ground = load("v3"), pa.Ground(slope=0.15)
    height = robot.stand_height
    tasks = [pa.StandTask(ground=ground, height=height - down) for down in (0.0, 0.003)]
    plan = path_commands(robot, stance_path(robot, tasks, 0.5, rate=200))
    model, data = plan.drive.model, mujoco.MjData(plan.drive.model)
    mujoco.mj_setState(model, data, plan.start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    data.ctrl[:] = plan.ctrl[0]
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc[:3]).max() < 0.01
    assert np.abs(data.qacc[3:]).max() < 1.0


@pytest.mark.slow
def test_motors_of_a_path_limit_its_torques_and_speeds(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the line from V Kt N / R at rest to the speed without load, from the result.

    The slow motor has torque at rest for the whole path, but not at the speed of the knees.
    """
    file, data = tmp_path / "slow.toml", tmp_path / "path.json"
    file.write_text(
        'name = "slow"\nsource = "bench"\ntorque_constant = "1 N m/A"\nresistance = "1 ohm"\n'
        'gear_ratio = 1\ngear_efficiency = 1.0\nsupply_voltage = "1.2 V"\n'
    )
    words = ("v3", "--height", "14cm", "--seconds", "0.3", "--json", str(data))
    status, out, err = run_command(capfd, "path", *words, "--motor", f"*_3={file}", "-v")
    assert status == 1, err
    path = json.loads(data.read_text())["path"]
    torques, speeds = np.array(path["torques"]), np.array(path["qvel"])[:, 6:]
    available = np.clip(1.2 - np.sign(torques) * speeds, 0.0, None)
    knees = slice(2, None, 3)
    shares = np.abs(torques[:, knees]) / available[:, knees]
    assert np.abs(torques[:, knees]).max() < 1.2
    assert shares.max() > 1
    assert path["peak_utilisation"] == pytest.approx(shares.max(), rel=1e-9)
    assert path["motors"] == {name: "slow" for name in path["joint_names"] if name.endswith("_3")}
    assert "at its speed (slow)" in out
    status, _, err = run_command(capfd, "path", *words)
    assert status == 0, err
