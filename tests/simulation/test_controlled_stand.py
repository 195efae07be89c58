"""Closed loops of standing robots, against bare MuJoCo with the same controller."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.simulation.controlled_stand import ControlledStand, _divide_period
from pupper_analysis.simulation.rollout import StandStart, make_stand_start
from tests.support.variants import load

SERVO = """
<mujoco model="servo">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="base">
      <geom size="0.05" mass="1"/>
      <body name="arm">
        <joint name="yaw" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.01 0.01 0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="yaw" kp="5" kv="0.1" forcerange="-10 10"/></actuator>
</mujoco>
"""
"""Servo with an inertia of 0.02 kg m^2 about a vertical axis, which gravity does not load."""


def start_of(name: str) -> StandStart:
    robot = load(name)
    return make_stand_start(robot, pa.solve_stand_as_simulated(robot))


def torque_model(held: StandStart, timestep: float) -> mujoco.MjModel:
    """Compile the robot's MJCF with torque motors, without dry friction of the joints."""
    spec = held.robot.description.mjcf.copy()
    for motor in spec.actuators:
        motor.set_to_motor()
        motor.gear[0] = 1.0
        motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        motor.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    model = spec.compile()
    model.dof_frictionloss[:] = 0.0
    model.opt.timestep = timestep
    model.opt.tolerance = 1e-14
    return model


def velocities(
    held: StandStart, kp: float, kd: float, *, timestep: float, steps: int, delay: int, periods: int
) -> np.ndarray:
    """Simulate u = torque + kp (q0 - q) - kd v in bare MuJoCo; return joint speeds per period.

    The command is computed every ``steps`` time steps, and acts ``delay`` time steps later.
    """
    model = torque_model(held, timestep)
    data = mujoco.MjData(model)
    data.qpos[:] = held.start[1 : 1 + model.nq]
    torques = held.prediction.joint_torques
    home = data.qpos[7:].copy()
    data.qvel[6:] = 1e-8 * np.random.default_rng(3).standard_normal(model.nv - 6)
    commands, speeds = [torques] * (delay + 1), []
    for step in range(steps * periods):
        if step % steps == 0:
            commands.append(torques + kp * (home - data.qpos[7:]) - kd * data.qvel[6:])
            speeds.append(np.linalg.norm(data.qvel[6:]))
        else:
            commands.append(commands[-1])
        data.ctrl[:] = commands[-1 - delay]
        mujoco.mj_step(model, data)
    return np.array(speeds)


def differentiate_period(
    held: StandStart, kp: float, kd: float, *, timestep: float, steps: int, delay: int
) -> np.ndarray:
    """Differentiate a control period of bare MuJoCo with the controller, by centred differences.

    Coordinates: positions and velocities in the tangent space, then the pending commands of the
    previous periods, the newest first.
    """
    model, home = torque_model(held, timestep), held.start[8:20]
    data, torques = mujoco.MjData(model), held.prediction.joint_torques
    nv, pending = model.nv, -(-delay // steps)
    size = 2 * nv + 12 * pending

    def advance(change: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, velocities and pending commands after a period."""
        mujoco.mj_resetData(model, data)
        data.qpos[:] = held.start[1 : 1 + model.nq]
        mujoco.mj_integratePos(model, data.qpos, change[:nv], 1.0)
        data.qvel[:] = change[nv : 2 * nv]
        older = torques + change[2 * nv :].reshape(-1, 12)
        newest = torques + kp * (home - data.qpos[7:]) - kd * data.qvel[6:]
        commands = [newest, *older]
        for step in range(steps):
            data.ctrl[:] = commands[max(0, -(-(delay - step) // steps))]
            mujoco.mj_step(model, data)
        return data.qpos.copy(), data.qvel.copy(), np.array(commands[:pending]).ravel()

    matrix, moved = np.zeros((size, size)), np.zeros(nv)
    for column in range(size):
        change = np.zeros(size)
        change[column] = 1e-6
        (low, slow, old), (high, fast, new) = advance(-change), advance(change)
        mujoco.mj_differentiatePos(model, moved, 2e-6, low, high)
        matrix[:, column] = np.concatenate([moved, (fast - slow) / 2e-6, (new - old) / 2e-6])
    return matrix


@pytest.mark.parametrize(
    ("name", "kp", "kd", "rate", "delay", "steps", "late"),
    [
        ("original", 60.0, 2.2, None, 0.0, 1, 0),
        ("original", 60.0, 1.0, None, 0.008, 1, 2),
        ("original", 60.0, 1.2, 125.0, 0.004, 2, 1),
        ("original", 60.0, 0.5, 125.0, 0.012, 2, 3),
        ("v3", 5.0, 1.0, None, 0.004, 1, 2),
        ("v3", 5.0, 1.4, 250.0, 0.002, 2, 1),
        ("v3", 0.8, 0.1, None, 0.0, 1, 0),
    ],
)
def test_growth_rate_equals_the_spectrum_of_bare_mujoco(
    name: str, kp: float, kd: float, rate: float | None, delay: float, steps: int, late: int
) -> None:
    """Reference: finite differences of a whole control period, simulated with its delay."""
    held = start_of(name)
    loop = ControlledStand(held, rate, delay)
    timestep = float(held.drive.model.opt.timestep)
    assert (loop.steps, loop.delay_steps, loop.timestep) == (steps, late, timestep)
    mode = loop.find_worst_mode(np.full(12, kp), np.full(12, kd))
    assert mode.growth_rate > 0.05
    values = np.linalg.eigvals(
        differentiate_period(held, kp, kd, timestep=timestep, steps=steps, delay=late)
    )
    worst = values[np.abs(values).argmax()]
    period = timestep * steps
    assert math.log(abs(worst)) / period == pytest.approx(mode.growth_rate, rel=1e-3)
    frequency = abs(np.angle(worst)) / (2 * math.pi * period)
    assert frequency == pytest.approx(mode.frequency, rel=1e-3, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kp"), [("original", 60.0), ("v3", 5.0)])
def test_stable_dampings_decay_in_bare_mujoco(name: str, kp: float) -> None:
    """Reference: MuJoCo's own loop 10 % below and above the largest stable damping."""
    held = start_of(name)
    loop = ControlledStand(held)
    low, high = 0.0, 20.0
    while high - low > 1e-3:
        middle = (low + high) / 2
        stable = loop.is_stable(np.full(12, kp), np.full(12, middle))
        low, high = (middle, high) if stable else (low, middle)
    grows = []
    for kd in (0.9 * low, 1.1 * low):
        speeds = velocities(held, kp, kd, timestep=loop.timestep, steps=1, delay=0, periods=400)
        grows.append(bool(speeds[-50:].max() > speeds[:50].max()))
    assert grows == [False, True]


@pytest.mark.parametrize("kd", [0.1, 5.0, 10.5, 12.0, 19.9, 21.0])
def test_damping_ratio_of_a_single_servo_equals_the_closed_form(tmp_path: Path, kd: float) -> None:
    """Reference: z^2 - (2 - a - b) z + 1 - a = 0 with a = kd T / I and b = kp T^2 / I, and s = ln z
    / T. From kd = I / T = 10 N m s/rad, z is negative: an oscillation with a period of 2 T. With
    10.5 N m s/rad, z is -0.05: the oscillation has decayed after T.
    """
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    robot = pa.load_robot(path)
    task = pa.StandTask(contacts={"base": pa.Weld()})
    held = make_stand_start(robot, pa.solve_stand_as_simulated(robot, task))
    kp, inertia, period = 5.0, 0.02, 0.002
    a, b = kd * period / inertia, kp * period**2 / inertia
    values = np.roots([1.0, a + b - 2.0, 1.0 - a]).astype(complex)
    poles = np.log(values[np.abs(values) > 0.1])
    ratio = ControlledStand(held).find_smallest_damping_ratio(np.array([kp]), np.array([kd]))
    assert ratio == pytest.approx(np.min(-poles.real / np.abs(poles)), rel=1e-5)
    assert (ratio < 0.5) == (kd not in (5.0, 10.5))
    assert (ratio < 0) == (kd > 20.0)


def test_joint_inertias_equal_the_acceleration_by_a_torque_in_mujoco() -> None:
    """Reference: difference of joint velocities after one step with and without 1 mN m.

    The dry friction of the joints, which would hold the joints at rest, is zero.
    """
    robot = load("v3")
    loop = ControlledStand(make_stand_start(robot, pa.solve_stand_as_simulated(robot)))
    model, torque, speeds = copy.copy(loop.model), 1e-3, []
    model.dof_frictionloss[:] = 0.0
    for joint in (None, *range(robot.nu)):
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, loop._start)
        if joint is not None:
            data.ctrl[loop._controls[joint]] += torque
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[loop._dofs].copy())
    gained = np.diag(np.array(speeds[1:]) - speeds[0])
    expected = torque * model.opt.timestep / gained
    assert loop.compute_joint_inertias() == pytest.approx(expected, rel=0.02)


def test_shorter_periods_and_delays_allow_more_damping() -> None:
    """Reference: an explicit damper on an inertia m is stable for kd < 2 m / period."""
    held = start_of("original")

    def largest_damping(rate: float | None, delay: float) -> float:
        loop = ControlledStand(held, rate, delay)
        low, high = 0.0, 50.0
        while high - low > 0.01:
            middle = (low + high) / 2
            stable = loop.is_stable(np.full(12, 60.0), np.full(12, middle))
            low, high = (middle, high) if stable else (low, middle)
        return low

    slow, fast = largest_damping(250.0, 0.0), largest_damping(1000.0, 0.0)
    assert 3.0 < fast / slow < 5.0
    assert largest_damping(1000.0, 0.001) < 0.7 * fast


@pytest.mark.parametrize(
    ("timestep", "rate", "delay", "expected"),
    [
        (0.002, None, 0.0, (0.002, 1, 0)),
        (0.002, None, 0.004, (0.002, 1, 2)),
        (0.002, None, 0.001, (0.002, 2, 1)),
        (0.002, 100.0, 0.003, (0.01, 10, 3)),
        (0.002, 1000.0, 0.0, (0.001, 1, 0)),
        (0.004, 300.0, 0.01, (1 / 300, 1, 3)),
    ],
)
def test_periods_are_divided_so_that_delays_are_multiples(
    timestep: float, rate: float | None, delay: float, expected: tuple[float, int, int]
) -> None:
    """Reference: hand calculation; time steps never exceed that of the model."""
    period, steps, late = _divide_period(timestep, rate, delay)
    assert (period, steps, late) == (pytest.approx(expected[0]), expected[1], expected[2])
    assert period / steps <= timestep + 1e-12


@pytest.mark.parametrize(
    ("rate", "delay", "field"),
    [
        *((rate, 0.0, "rate") for rate in (0.0, math.nan, -5.0, 1e9)),
        *((None, delay, "delay") for delay in (-0.001, 2.0, math.inf)),
    ],
)
def test_invalid_rates_and_delays_are_refused(rate: float | None, delay: float, field: str) -> None:
    with pytest.raises(pa.ConfigurationError) as caught:
        _divide_period(0.002, rate, delay)
    assert caught.value.field == field


@pytest.mark.parametrize("count", [1, 3])
def test_stand_on_feet_without_friction_is_stable_as_in_mujoco(count: int) -> None:
    """Reference: a simulation along the mode. MuJoCo replaces a friction of 0 by 1e-5."""
    held = start_of("v3")
    model = copy.copy(held.drive.model)
    model.geom_friction[model.geom_bodyid == 0] = 0.0  # MuJoCo combines by the maximum
    model.geom_friction[list(held.robot.foot_geoms)[:count]] = 0.0
    loop = ControlledStand(replace(held, drive=replace(held.drive, model=model)))
    kp, kd = np.full(12, 5.0), np.full(12, 0.1)
    mode = loop.find_worst_mode(kp, kd)
    assert mode.stable
    assert loop.survives_simulation(kp, kd, duration=4.0, mode=mode)
