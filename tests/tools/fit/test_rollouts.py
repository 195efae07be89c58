"""Simulations with changed parameters, compared with Pinocchio and with step-by-step MuJoCo."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.motions.fit import SeriesNoise, differentiate_motion
from pupper_analysis.tools.fit.motions.rollouts import (
    SERVOS_SUBJECT,
    LogSegment,
    MomentCoordinates,
    MovingBodies,
    Simulator,
    _apply_lag,
    shorten_run,
    split_runs,
)
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable, find_moved_link
from tests.support.arm import arm
from tests.support.bar import MJCF, URDF, bar
from tests.support.bar import log as bar_log
from tests.support.variants import load

Array = NDArray[np.float64]

MIDDLE = np.array([1.3, 0.1, -0.7, 0.2])  # of the arm, in actuator order


def table(robot: Robot, joints: tuple[str, ...], damping: float = 2.0) -> ParameterTable:
    """Return parameters of joints: mass and CoM of the link, gains, friction, offset; and the servo
    delay.
    """
    links = MovingBodies(robot, robot.mj_model)
    found = []
    for name in joints:
        at = robot.joint_names.index(name)
        found.append(Parameter("mass", links.links[at], "", links.mass[at], 0.2))
        for axis, own in zip("xyz", links.com[at], strict=True):
            found.append(Parameter("com", links.links[at], axis, own, 0.01))
        for kind, width in (
            ("kp", 20),
            ("damping", damping / 2),
            ("friction", 0.2),
            ("offset", 0.02),
        ):
            stated = {"kp": 300.0, "damping": damping}.get(kind, 0.0)
            found.append(Parameter(kind, name, "", stated, width))
    return ParameterTable((*found, Parameter("delay", SERVOS_SUBJECT, "", 0.0, 0.01)))


@pytest.mark.parametrize("name", ["arm", "v3"])
def test_masses_and_coms_equal_pinocchio_in_joint_frames(name: str) -> None:
    """Reference: Pinocchio's mass matrix and bias forces [N m] with the same inertias in joint
    frames.
    """
    robot = arm() if name == "arm" else load("v3", fixed_base=True)
    random, bodies = np.random.default_rng(3), MovingBodies(robot, robot.mj_model)
    parameters, by_pin = [], robot.pin_model.copy()
    for joint, link in zip(robot.joint_names, bodies.links, strict=True):
        number = by_pin.getJointId(joint)
        own = by_pin.inertias[number]
        mass, com = own.mass * random.uniform(0.6, 1.4), own.lever + 0.02 * random.normal(size=3)
        by_pin.inertias[number] = pin.Inertia(mass, com, own.inertia * mass / own.mass)
        parameters.append(Parameter("mass", link, "", mass, 1.0))
        parameters += [
            Parameter("com", link, axis, value, 1.0) for axis, value in zip("xyz", com, strict=True)
        ]
        assert link == find_moved_link(robot.pin_model, robot.pin_model.getJointId(joint))
    given = ParameterTable(parameters)
    model = bodies.model
    bodies.set_parameters(model, given, given.stated)
    data, state = mujoco.MjData(model), random.uniform(-0.3, 0.3, (2, robot.nu))
    robot.mj_convention.set_state(data, *state)
    mujoco.mj_forward(model, data)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    at, by = robot.mj_convention.qvel_index, robot.pin_convention.v_index
    q, v = robot.pin_convention.q(state[0]), np.empty(by_pin.nv)
    v[by] = state[1]
    expected = pin.crba(by_pin, by_pin.createData(), q)
    expected = np.triu(expected) + np.triu(expected, 1).T  # with armature
    bias = pin.nonLinearEffects(by_pin, by_pin.createData(), q, v)
    assert mass_matrix[np.ix_(at, at)] == pytest.approx(expected[np.ix_(by, by)], abs=1e-9)
    assert data.qfrc_bias[at] == pytest.approx(bias[by], abs=1e-9)


def make_moving_log(seconds: float = 1.5, interval: float = 0.005) -> Log:
    time = np.arange(0, seconds, interval)
    command = MIDDLE + 0.2 * np.sin(np.outer(time, (5.0, 7.0, 4.0, 6.0))) * (1, 0.2, 1, 1)
    command[len(time) // 2 :] += (0.1, 0.01, -0.1, 0.2)
    return Log("moving", time, arm().joint_names, command, np.tile(MIDDLE, (len(time), 1)))


def test_prediction_equals_stepwise_mujoco_with_delay_and_offsets() -> None:
    """Another integrator, forty times finer; commands that are delayed by 13 ms."""
    robot = arm()
    drive, given = model_with_servos(robot), table(robot, ("elbow", "a_turn"))
    x = given.stated + given.width * np.random.default_rng(1).uniform(0, 1, len(given))
    x[-1] = 0.013
    simulator = Simulator(robot, drive, given, 0.005)
    (run,) = split_runs(make_moving_log(), MIDDLE, 0.2)
    found = simulator.predict_positions(run, [x])[0]

    model, step = copy.copy(simulator.bodies.model), 1.25e-4
    simulator.set_parameters(model, x)
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    offset = np.array([given.get_value(x, "offset", name, "", 0.0) for name in robot.joint_names])
    data, positions = mujoco.MjData(model), []
    robot.mj_convention.set_state(data, run.start[0] - offset, run.start[1])
    for tick in range(round(run.time[-1] / step)):
        if tick % 40 == 0:
            positions.append(data.qpos[robot.mj_convention.qpos_index] + offset)
        sample = max(int((tick * step - x[-1]) / 0.005 + 1e-9), 0)
        data.ctrl[:] = run.command[sample] - offset  # in actuator order, of gear 1
        mujoco.mj_step(model, data)
    late = 50  # samples: until how it began is forgotten
    assert found[late : len(positions)] == pytest.approx(np.array(positions)[late:], abs=2e-4)
    assert np.ptp(found[late:, 0]) > 0.2


def test_lag_equals_stepwise_simulation_of_slow_motors() -> None:
    """Reference: MuJoCo with steps of 0.125 ms and a first-order lag of 4 ms in each torque."""
    robot, lag, step = arm(), 0.004, 1.25e-4
    late = [Parameter("lag", SERVOS_SUBJECT, part, 0.0, 0.005) for part in ("command", "position")]
    given = ParameterTable((Parameter("delay", SERVOS_SUBJECT, "", 0.0, 0.01), *late))
    simulator = Simulator(robot, model_with_servos(robot), given, 0.005)
    (run,) = split_runs(
        make_moving_log(3.0).select_rows(slice(0, 300)), MIDDLE, 0.2
    )  # before its step
    model = copy.copy(simulator.bodies.model)
    simulator.set_parameters(model, np.zeros(3))
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data, positions, kp = mujoco.MjData(model), [], simulator.drive.kp
    at, dofs = robot.mj_convention.qpos_index, robot.mj_convention.qvel_index
    robot.mj_convention.set_state(data, *run.start)
    torque = kp * (run.command[0] - run.start[0])
    for tick in range(round(run.time[-1] / step)):
        if tick % 40 == 0:
            positions.append(data.qpos[at].copy())
        data.ctrl[:] = run.command[tick // 40]
        commanded = kp * (data.ctrl - data.qpos[at])
        torque += (commanded - torque) * (1 - np.exp(-step / lag))
        data.qfrc_applied[dofs] = torque - commanded
        mujoco.mj_step(model, data)
    late = np.array(positions)[50:]
    vectors = np.array([[lag, lag, lag], [lag, lag, 0], [0, 0, lag], [0, 0, 0]])
    off = [
        np.abs(position[50 : len(positions)] - late).max()
        for position in simulator.predict_positions(run, vectors)
    ]
    assert off[0] < 1e-4
    assert min(off[1:]) > 1e-3


def test_smoothed_commands_equal_a_first_order_lag() -> None:
    """Reference: the mean over each step of the exponential, at a thousand times; for lags shorter
    and longer than a step."""
    command = np.random.default_rng(2).normal(size=(6, 2))
    for lag in (0.3, 1.7):
        followed, means = command[0].copy(), []
        for target in command:
            parts = target + (followed - target) * np.exp(
                -(np.arange(1000)[:, None] + 0.5) / 1e3 / lag
            )
            means.append(parts.mean(axis=0))
            followed = target + (followed - target) * np.exp(-1 / lag)
        np.testing.assert_allclose(_apply_lag(command, lag), means, atol=1e-6)
    np.testing.assert_array_equal(_apply_lag(command, 0.0), command)


def test_rollout_derivatives_equal_finite_differences_across_limbs() -> None:
    """Reference: finite differences of predicted positions [rad] with 1 % of the prior width."""
    robot = load("v3", fixed_base=True)
    joints = ("leg_front_r_3", "leg_back_l_2")
    drive, given = model_with_servos(robot), table(robot, joints, 0.05)
    x = given.stated.copy()
    x[[place for place, one in enumerate(given) if one.kind == "kp"]] = 5.0
    time = np.arange(0, 1.05, 0.005)
    command = robot.home + 0.3 * np.sin(6 * time)[:, None]
    log = Log("v3", time, robot.joint_names, command, command)
    (run,) = split_runs(log, robot.home, 0.0)
    simulator, moments = Simulator(robot, drive, given, 0.005), MomentCoordinates(given)
    here, y = simulator.predict_positions(run, [x])[0], moments.from_parameters(x)
    derivatives = np.zeros((*here.shape, len(given)))
    for number, (places, rates) in differentiate_motion(simulator, moments, run, y).items():
        derivatives[:, np.array(simulator.groups[number][0])[:, None], places] = rates
    for place in range(0, len(given), 2):  # of every other: they are many
        one = given.parameters[place]
        change = 1e-2 * one.width * np.eye(len(given))[place]
        there = simulator.predict_positions(run, [moments.to_parameters(y + change)])[0]
        expected = (there - here) / (1e-2 * one.width)
        assert derivatives[:, :, place] == pytest.approx(
            expected, abs=1e-6 * (1 + np.abs(expected).max())
        )


@pytest.mark.parametrize("kinds", [("armature",), ("damping",), ("damping", "armature")])
def test_derivative_by_the_lag_does_not_need_damping_and_armature(kinds: tuple[str, ...]) -> None:
    """Reference: difference quotient of predicted positions [rad] about a lag of 4 ms."""
    robot, lag = arm(), 0.004
    given = ParameterTable(
        (
            *(
                Parameter(kind, name, "", 0.02, 0.01)
                for name in robot.joint_names
                for kind in kinds
            ),
            Parameter("lag", SERVOS_SUBJECT, "position", 0.0, 0.005),
        )
    )
    simulator = Simulator(robot, model_with_servos(robot), given, 0.005)
    (run,) = split_runs(make_moving_log(3.0).select_rows(slice(0, 300)), MIDDLE, 0.0)
    x = np.append(given.stated[:-1], lag)
    change = 1e-4 * np.eye(len(x))[-1]
    low, high = simulator.predict_positions(run, [x - change, x + change])
    expected = (high - low)[:, 0] / 2e-4
    derivatives = differentiate_motion(simulator, MomentCoordinates(given), run, x)
    indices, rates = next(
        found for number, found in derivatives.items() if 0 in simulator.groups[number][0]
    )
    (group,) = (joints for joints, _ in simulator.groups if 0 in joints)
    found = rates[:, group.index(0), indices.tolist().index(len(x) - 1)]
    assert found == pytest.approx(expected, abs=0.05 * np.abs(expected).max())


@pytest.mark.slow
def test_common_factor_of_all_forces_is_not_determined() -> None:
    """A common factor on masses, gains and friction leaves a motion with servos unchanged."""
    robot = load("v3", fixed_base=True)
    names = ("leg_front_r_1", "leg_front_r_2", "leg_front_r_3")
    drive, bodies = model_with_servos(robot, 5.0, 0.0), MovingBodies(robot, robot.mj_model)
    dofs = robot.mj_convention.qvel_index
    model, rows = robot.mj_model, []
    for name in names:
        at = robot.joint_names.index(name)
        friction, armature = model.dof_frictionloss[dofs[at]], model.dof_armature[dofs[at]]
        rows += [
            Parameter("mass", bodies.links[at], "", bodies.mass[at], 0.5 * bodies.mass[at]),
            Parameter("kp", name, "", 5.0, 1.5),
            Parameter("damping", name, "", 0.2, 0.2),
            Parameter("friction", name, "", friction, friction),
            Parameter("armature", name, "", armature, armature),
        ]
    given = ParameterTable(rows)
    time = np.arange(0, 3, 0.005)
    swings = np.sin(np.outer(time, (3.0, 5.0, 7.0, 4.0) * 3)) + np.sin(11 * time)[:, None]
    command = robot.home + 0.2 * swings
    log = Log("v3", time, robot.joint_names, command, command)
    (run,) = split_runs(log, robot.home, 0.0)
    simulator, moments = Simulator(robot, drive, given, 0.005), MomentCoordinates(given)
    factor = given.stated / given.width
    factor /= np.linalg.norm(factor)
    messages, known = [], None
    for _ in range(2):
        found = differentiate_motion(simulator, moments, run, given.stated, known)
        information = np.zeros((len(given), len(given)))
        for places, rates in found.values():
            for by_joint in np.moveaxis(rates, 1, 0):
                moved = by_joint * given.width[places] / 5e-4
                information[places[:, None], places] += moved.T @ moved
        known = information + np.eye(len(given))
        messages.append(float(factor @ information @ factor))
    assert messages[1] < 1e-2
    assert messages[0] > 1.0


def test_runs_are_split_at_clock_jumps_and_gaps_are_kept() -> None:
    log = make_moving_log(4.0)
    command, position = log.command.copy(), log.position.copy()
    command[100:110, 0], position[200:210, 1] = np.nan, np.nan
    time = log.time + 5.0 * (np.arange(len(log.time)) > 399)
    odd = replace(log, time=time, command=command, position=position)
    runs: list[LogSegment] = list(split_runs(odd, MIDDLE, 0.2))
    assert [len(run.time) for run in runs] == [400, 400]
    assert (runs[0].command[100:110, 0] == command[99, 0]).all()
    assert not runs[0].counts[200:210, 1].any()
    assert runs[0].counts[200:210, 0].all()
    assert not (runs[0].counts & runs[0].held_out).any()
    assert runs[0].held_out.sum() == pytest.approx(0.2 * 400 * 4, abs=8)


def test_derivatives_without_friction_equal_those_with_little_friction() -> None:
    """Steps along eigenvectors decrease a friction of 0, which the simulation replaces by 0.
    Reference: derivatives of the positions [rad] with 0.02 N m, more than a step. The derivative by
    friction itself changes, because the joint sticks.
    """
    robot, random = load("v3", fixed_base=True), np.random.default_rng(4)
    given = table(robot, ("leg_front_r_3",), 0.05)
    time = np.arange(0, 1.05, 0.005)
    command = robot.home + 0.3 * np.sin(6 * time)[:, None]
    (run,) = split_runs(Log("v3", time, robot.joint_names, command, command), robot.home, 0.0)
    simulator = Simulator(robot, model_with_servos(robot), given, 0.005)
    moments, size = MomentCoordinates(given), len(given)
    friction = [parameter.kind for parameter in given].index("friction")
    root = random.normal(size=(size, size))
    information = 100.0 * (root @ root.T + size * np.eye(size))
    rates = []
    for value in (0.0, 0.02):
        point = given.stated.copy()
        point[friction] = value
        found = differentiate_motion(
            simulator, moments, run, moments.from_parameters(point), information
        )
        rates.append(next(rows for columns, rows in found.values() if friction in columns))
    error = np.abs(rates[0] - rates[1]).max(axis=(0, 1)) / np.abs(rates[1]).max(axis=(0, 1))
    assert np.delete(error, friction).max() < 0.5


def test_shortened_run_contains_the_motion_of_each_joint() -> None:
    """A joint that first moves after 12 s needs 16 of 30 s. A joint that never moves needs none."""
    log = make_moving_log(30.0)
    run = next(split_runs(replace(log, position=log.command), MIDDLE, 0.0))
    assert shorten_run(run, 4.0).time[-1] == pytest.approx(4.0, abs=0.006)
    late = run.position.copy()
    late[run.time < 12.0, 0] = late[-1, 0]
    late[:, 1] = 0.3
    short = shorten_run(replace(run, position=late), 4.0)
    assert short.time[-1] == pytest.approx(16.0, abs=0.006)
    assert len(short.position) == len(short.command) == len(short.counts) == len(short.time)
    assert shorten_run(run, 40.0) is run


def test_correlated_noise_gives_the_true_uncertainty_of_sums() -> None:
    """Reference: covariance of weighted sums of 400 simulated series."""
    random, weights = np.random.default_rng(5), np.column_stack([np.ones(200), np.arange(200.0)])
    kicks, series = 1e-3 * random.normal(size=(300, 400)), np.zeros((300, 400))
    for at, kick in enumerate(kicks):
        series[at] = 0.8 * series[at - 1] - 0.2 * series[at - 2] + kick
    samples = np.concatenate(series.T[:20])
    samples[300] = np.nan
    found = SeriesNoise.fit_autoregression([samples])
    assert found.coefficients[:2] == pytest.approx([0.8, -0.2], abs=0.05)
    assert found.innovation == pytest.approx(1e-3, rel=0.03)
    assert found.long_run_std == pytest.approx(1e-3 / 0.4, rel=0.1)
    spread = found.propagate_weights(weights)
    assert spread @ spread.T == pytest.approx(np.cov(weights.T @ series[100:]), rel=0.25)


def test_joint_limits_do_not_change_predicted_motions(tmp_path: Path) -> None:
    """Reference: the same bar with wide limits. An encoder offset may put a simulated joint beyond
    its limit, although the real joint never touches its stop.
    """
    files = tmp_path / "bar.urdf", tmp_path / "bar.xml"
    files[0].write_text(URDF.replace('upper="2"', 'upper="0.7"'), encoding="utf-8")
    files[1].write_text(MJCF.replace('range="-2 2"', 'range="-2 0.7"'), encoding="utf-8")
    (run,) = split_runs(bar_log(), bar().home, 0.0)
    with_limit, without = (
        Simulator(
            robot, model_with_servos(robot), ParameterTable(()), bar_log().interval
        ).predict_positions(run, [np.zeros(0)])[0]
        for robot in (load_robot(*files), bar())
    )
    assert without.max() > 0.8
    assert with_limit == pytest.approx(without, abs=1e-12)
