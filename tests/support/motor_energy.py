"""Robots with motors, and the work of the motors from the change of momentum in bare MuJoCo."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.models.motors.dcmotor import list_dcmotors, make_dcmotor_element
from pupper_analysis.models.motors.energy import MotorEnergy
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from tests.support.legged import quadruped
from tests.support.variants import load

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


SOURCES = ("TOML motors", "dcmotors")
"""Sources of motors: v3 with motors of a TOML file, a quadruped with ``dcmotor`` actuators."""


def make_driven_robot(source: str, folder: Path) -> tuple[pa.Robot, dict[str, Motor]]:
    """Load a robot and {joint: motor}, for a source of motors in `SOURCES`."""
    if source == "dcmotors":
        return write_dcmotors(folder)
    robot = load("v3")
    return robot, dict.fromkeys(robot.joint_names, find_motor("lk-tech-mg4010-10"))
