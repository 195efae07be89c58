"""Electrical energy of the motors after a push, and the energy of a simulated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.push import recovery as push
from pupper_analysis.tools.push.bench import make_push_bench
from tests.support.motor_energy import SOURCES, check_balance, compute_bare_work, make_driven_robot
from tests.support.variants import load


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
def test_energy_of_a_push_is_balanced(source: str, tmp_path: Path) -> None:
    """Reference: the change of momentum in bare MuJoCo, step by step, with the pushing force."""
    robot, motors = make_driven_robot(source, tmp_path)
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
