"""Electrical energy of motors, for single steps and in all simulated runs of the commands.

Integration rule: the torque with which MuJoCo integrates a step, times the mean speed of the step.
With this rule, electrical energy = work + copper loss + friction, and a step changes the kinetic
energy by exactly the work of all forces. The energy of a whole robot changes by more, since a step
holds the mass matrix and gravity constant (`test_energy_error_of_a_robot_is_of_first_order`).
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.motors.dcmotor import list_dcmotors, make_dcmotor_element
from pupper_analysis.models.motors.energy import MotorEnergy, compute_motor_energy
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.simulation.rollout import simulate_commands
from pupper_analysis.tools.heat.heat import study_heat
from pupper_analysis.tools.path.tracking import path_commands, study_path
from pupper_analysis.tools.push import recovery as push
from pupper_analysis.tools.push.bench import make_push_bench
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import prepare_stage, simulate_cases
from tests.support.legged import quadruped
from tests.support.variants import load
from tests.tools.walk import made

MOTOR = Motor(
    *("test", "bench"),
    torque_constant=0.1,
    gear_ratio=6.0,
    gear_efficiency=1.0,
    resistance=0.5,
    supply_voltage=48.0,
    peak_torque=20.0,
)


def check_balance(energy: MotorEnergy | None) -> MotorEnergy:
    """Check that electrical energy = work + copper loss + friction, to 1e-6 of the throughput."""
    assert energy is not None
    assert energy.residual is not None
    assert energy.residual < 1e-6
    assert None not in (energy.electrical, energy.work, energy.copper, energy.friction)
    lost = energy.electrical - energy.work - energy.copper - energy.friction  # type: ignore[operator]
    scale = abs(energy.electrical) + energy.copper + energy.friction  # type: ignore[arg-type,operator]
    assert abs(lost) < 1e-6 * scale
    assert energy.copper > 0  # type: ignore[operator]
    assert energy.friction >= 0  # type: ignore[operator]
    return energy


def test_energy_agrees_with_the_voltage_and_current_of_a_dcmotor() -> None:
    """Reference: MuJoCo's ``dcmotor`` (no gear losses) at random torques and speeds.

    The voltage R i + Ke w, applied to the element at the mean speed, exerts the torque; the drawn
    power is this voltage times the current, force / Kt.
    """
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <geom size=".05" mass="1" pos=".2 0 0"/></body></worldbody>
        <actuator>{make_dcmotor_element(MOTOR, "hinge")}</actuator></mujoco>"""
    )
    (motor,) = list_dcmotors(model, "bench").values()
    random = np.random.default_rng(75)
    torques, speeds = random.normal(0, 5, (200, 1)), random.normal(0, 8, (201, 1))
    energy = check_balance(compute_motor_energy({"hinge": motor}, ["hinge"], torques, speeds, 0.01))
    data, drawn = mujoco.MjData(model), 0.0
    for torque, before, after in zip(torques[:, 0], speeds[:-1, 0], speeds[1:, 0], strict=True):
        data.qvel[0] = (before + after) / 2
        data.ctrl[0] = 0.5 * torque / 0.6 + 0.6 * data.qvel[0]
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque, rel=1e-9)
        drawn += 0.01 * data.ctrl[0] * data.actuator_force[0] / 0.1
    assert energy.electrical == pytest.approx(drawn, rel=1e-9)
    assert energy.work == pytest.approx(0.01 * (torques * (speeds[:-1] + speeds[1:]) / 2).sum())
    assert energy.friction == pytest.approx(0.0, abs=1e-9)


def test_gear_with_losses_takes_energy_in_both_directions() -> None:
    """Reference: by hand. 80 % of the rotor's power reach the load, and 80 % of the load's power
    reach the rotor of a motor that brakes. 1 s at 3 N m and 2 rad/s: 6 J of work."""
    motor = replace(MOTOR, gear_efficiency=0.8)
    torques, speeds = np.full((10, 1), 3.0), np.full((11, 1), 2.0)
    drives = check_balance(compute_motor_energy({"a": motor}, ["a"], torques, speeds, 0.1))
    assert (drives.work, drives.friction) == (pytest.approx(6.0), pytest.approx(6 / 0.8 - 6))
    assert drives.copper == pytest.approx((3 / 0.48) ** 2 * 0.5)
    brakes = check_balance(compute_motor_energy({"a": motor}, ["a"], torques, -speeds, 0.1))
    assert (brakes.work, brakes.friction) == (pytest.approx(-6.0), pytest.approx(6 * 0.2))
    assert brakes.copper == pytest.approx((3 * 0.8 / 0.6) ** 2 * 0.5)
    both = (drives.power, drives.duration)
    assert both == (pytest.approx(7.5 + (3 / 0.48) ** 2 * 0.5), pytest.approx(1.0))


def test_gear_never_creates_energy_and_unknown_numbers_are_named() -> None:
    """Of a published motor, the torque per current at the output exceeds Kt N (0.45 > 0.42)."""
    torques, speeds = np.full((5, 2), 3.0), np.full((6, 2), 2.0)
    motors = {"a": find_motor("mit-mini-cheetah")}
    assert check_balance(compute_motor_energy(motors, "ab", torques, speeds, 0.1)).friction == 0.0
    motors["b"] = find_motor("unitree-go-m8010-6")
    energy = compute_motor_energy(motors, "ab", torques, speeds, 0.1)
    assert energy.unknown == ("resistance", "stall_current")
    assert (energy.electrical, energy.work, energy.residual, energy.power) == (None,) * 4


def compute_bare_work(
    model: mujoco.MjModel, states: np.ndarray, ctrl: np.ndarray, forces: np.ndarray | None = None
) -> float:
    """Return the work of the motors in a simulation, from the change of momentum alone [J].

    In each step, M (v' - v) = h (f + damping terms of the integrator): the work of the motors is
    the mean velocity times M (v' - v), without the work of all other forces. The servos are not
    evaluated. ``forces`` (n, 2) [N] act on the base.
    """
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    start, step, work = 1 + model.nq, model.opt.timestep, 0.0
    for index, (state, after) in enumerate(itertools.pairwise(states)):
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        data.ctrl[:] = ctrl if ctrl.ndim == 1 else ctrl[index]
        data.xfrc_applied[:] = 0.0
        if forces is not None and index < len(forces):
            data.xfrc_applied[1, :2] = forces[index]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        velocity, change = data.qvel.copy(), after[start : start + model.nv] - data.qvel
        others = data.qfrc_smooth - data.qfrc_actuator + data.qfrc_constraint
        others -= model.dof_damping * change  # damping of joints is implicit
        work += float((velocity + change / 2) @ (mass @ change - step * others))
    return work


def write_dcmotors(folder: Path) -> tuple[pa.Robot, dict[str, Motor]]:
    """Load a quadruped whose MJCF contains dcmotors, and the motors that the file states."""
    pair = quadruped(folder, floor=True)
    text = pair.mjcf.read_text()
    strong = replace(MOTOR, current_limit=100.0, peak_torque=None)
    for leg in ("FL", "FR", "RL", "RR"):
        for joint in ("roll", "pitch", "knee"):
            name = f"{leg}_{joint}"
            element = make_dcmotor_element(strong, name, f"{name}_motor")
            text = text.replace(f'<motor joint="{name}" ctrlrange="-30 30"/>', element)
    pair.mjcf.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    return pa.load_robot(pair.urdf, pair.mjcf), list_dcmotors(model, str(pair.mjcf))


@pytest.fixture(scope="module", params=["TOML motors", "dcmotors"])
def driven(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[pa.Robot, dict[str, Motor]]:
    if request.param == "dcmotors":
        return write_dcmotors(tmp_path_factory.mktemp("dcmotors"))
    robot = load("v3")
    return robot, dict.fromkeys(robot.joint_names, find_motor("lk-tech-mg4010-10"))


@pytest.mark.slow
def test_energy_of_a_path_is_balanced(driven: tuple[pa.Robot, dict[str, Motor]]) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step."""
    robot, motors = driven
    height = 0.14 if robot.name == "v3" else 0.30
    there = study_path(robot, pa.StandTask(height=height), 1.0, motors=motors)
    energy = check_balance(there.tracking.energy)
    plan = path_commands(robot, there.path)
    states = simulate_commands(plan.drive.model, plan.start, plan.ctrl)
    series = np.vstack([plan.start, states])
    bare = compute_bare_work(plan.drive.model, series, plan.ctrl)
    assert energy.work == pytest.approx(bare, rel=1e-6, abs=1e-6 * energy.copper)


@pytest.mark.slow
def test_energy_of_a_push_is_balanced(driven: tuple[pa.Robot, dict[str, Motor]]) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step, with the pushing force."""
    robot, motors = driven
    options: dict[str, Any] = {"directions": 3, "resolution": 1.0}
    found = push.study_pushes([robot], pa.StandTask(), motors={robot.name: motors}, **options)
    pushed = found[robot.name]
    energy = check_balance(pushed.energy)
    recovery = pushed.recovery
    bench = make_push_bench(
        robot,
        pushed.stand,
        np.array([recovery.weakest_direction]),
        duration=recovery.duration,
        kp=None,
        kd=None,
        feedforward=True,
        integrator=None,
    )
    (states,) = bench.simulate_pushes(np.array([0]), np.array([recovery.weakest_impulse]))
    series = np.vstack([bench.start, states])
    force = recovery.weakest_impulse * bench.axes[0] / (bench.pulse_steps * bench.timestep)
    forces = np.tile(force, (bench.pulse_steps, 1))
    bare = compute_bare_work(bench.drive.model, series, bench.ctrl, forces)
    assert energy.duration == pytest.approx(recovery.duration)
    assert energy.work == pytest.approx(bare, rel=1e-6, abs=1e-6 * energy.copper)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "v3-heavy"])
def test_energy_of_a_walk_is_balanced(name: str, tmp_path: Path) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step, after the warm-up."""
    policy = Policy.load(made.write_standing_policy(tmp_path / "still.json"))
    robot = load(name)
    motors = dict.fromkeys(robot.joint_names, find_motor("lk-tech-mg4010-10"))
    walk = simulate_walk(robot, policy, (0, 0, 0), seconds=3.0, warm_up=1.0, motors=motors)
    energy = check_balance(walk.gaits[0].energy)
    stage = prepare_stage(robot, policy)
    (run,) = simulate_cases(stage, [stage.make_case(np.zeros(3), 0)], 3.0, 1.0, None)
    first = round(1.0 / stage.timestep)
    bare = compute_bare_work(stage.model, run.states[first:], run.targets[first + 1 :])
    assert energy.work == pytest.approx(bare, rel=1e-6, abs=1e-6 * energy.copper)


@pytest.mark.slow
def test_energy_at_rest_is_copper_loss(driven: tuple[pa.Robot, dict[str, Motor]]) -> None:
    """``heat`` and ``study`` compute a stance at rest. Reference: the energy without speed.

    The windings are cold: `HeatStudy.motors` states the loss at the temperature of the resistance.
    """
    robot, motors = driven
    study = study_heat(robot, pa.StandTask(), motors)
    torques = np.array([[motor.torque for motor in study.motors]])
    names = [motor.joint for motor in study.motors]
    energy = check_balance(compute_motor_energy(motors, names, torques, np.zeros((2, 12)), 1.0))
    cold = sum(motor.cold_loss or 0.0 for motor in study.motors)
    assert energy.electrical == pytest.approx(cold, rel=1e-12)
    assert (energy.work, energy.friction) == (0.0, 0.0)


@pytest.mark.slow
def test_energy_error_of_a_robot_is_of_first_order() -> None:
    """Kinetic and potential energy of a robot change by more than the work of all forces.

    A semi-implicit step holds the mass matrix, gravity and contact forces of its start. Reference:
    MuJoCo's energies while v3 sways after an initial velocity of 0.4 m/s. The largest error is 0.7
    % of the motors' energy throughput at 2 ms, and proportional to the time step. Therefore 1e-6
    holds between the motors and the joints, and not between the motors and the energy of a robot.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask())
    errors = []
    for timestep in (0.002, 0.0005):
        bench = make_push_bench(
            robot, stand, np.array([0.0]), duration=1.0, kp=None, kd=None,
            feedforward=True, integrator=None,
        )  # fmt: skip
        model, data = bench.drive.model, mujoco.MjData(bench.drive.model)
        model.opt.timestep = timestep
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY.value
        mujoco.mj_setState(model, data, bench.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        data.ctrl[:] = bench.ctrl
        data.qvel[0] = 0.4
        mujoco.mj_forward(model, data)
        before, work, throughput, error = float(data.energy.sum()), 0.0, 0.0, 0.0
        for _ in range(round(1.0 / timestep)):
            mujoco.mj_forward(model, data)
            forces = data.qfrc_actuator + data.qfrc_passive + data.qfrc_constraint
            speed = data.qvel.copy()
            mujoco.mj_step(model, data)
            mean = (speed + data.qvel) / 2
            work += timestep * float(forces @ mean)
            throughput += timestep * float(np.abs(data.qfrc_actuator * mean).sum())
            mujoco.mj_forward(model, data)
            error = max(error, abs(float(data.energy.sum()) - before - work))
        errors.append(error / throughput)
    assert errors[0] == pytest.approx(0.007, rel=0.2)
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.05)
