"""Rollouts of a stand: where they begin, and what their states say."""

from __future__ import annotations

import math

import mujoco
import mujoco.rollout
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arrays import rotation_from_quaternion
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

FALLEN_TILT = 0.5
"""A base that is tilted by more than this against its task has fallen over (rad)."""


_SHALLOW, _DEEP = 1e-6, 0.05  # m: within what the feet are looked for that carry the weight


STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
"""What rollouts return: time, qpos, qvel ..."""


def place_on_ground(robot: Robot, drive: Servos, stand: Stand, torques: Array) -> Array:
    """Returns MuJoCo's state at a stand, let down until the contacts carry the weight.

    The ground is soft: feet that just touch it carry nothing. The base is lowered into it, with the
    joints as they are, to where the contacts push against the ground's normal with the weight; so
    the simulation starts at rest instead of with a fall of some millimetres.

    Args:
        robot: The robot.
        drive: The robot's MuJoCo model, with servos.
        stand: The stand.
        torques: (nu,) motor torques that balance it (N m).

    Returns:
        The state (mjSTATE_FULLPHYSICS).
    """
    model = drive.model
    data = mujoco.MjData(model)
    data.ctrl[:] = drive.command(robot, stand.joint_positions(robot), torques)
    normal = stand.task.ground.normal()

    weight = float(model.body_subtreemass[0]) * float(-normal @ model.opt.gravity)

    def surplus(drop: float) -> float:
        """Returns by how much the contacts carry more than the weight (N)."""
        qpos = stand.qpos.copy()
        qpos[:3] -= drop * normal
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(model, data)
        return float(normal @ data.qfrc_constraint[robot.mj_convention.qvel_index[:3]]) - weight

    low, high = 0.0, _SHALLOW
    while surplus(high) <= 0 and high < _DEEP:
        low, high = high, 2 * high
    while high - low > 1e-12:
        middle = (low + high) / 2
        low, high = (middle, high) if surplus(middle) < 0 else (low, middle)
    surplus(high)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def base_heights(robot: Robot, states: Array) -> Array:
    """Returns the base's height in every state of a rollout."""
    heights: Array = states[..., 1 + robot.mj_convention.qpos_index[2]]
    return heights


def turned_by(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns the angle of the base's rotation against the given one (rad)."""
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return float(np.linalg.norm(pin.log3(rotation.T @ rotation_from_quaternion(quaternion))))


def lean(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns how far the base of a state leans off a rotation's vertical (rad); yaw is no lean."""
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    cosine = float(rotation_from_quaternion(quaternion)[2] @ rotation[2])
    return math.acos(min(1.0, max(-1.0, cosine)))


def diverged(states: Array, timestep: float) -> bool:
    """Tells whether a rollout broke down: MuJoCo resets the state, and so the time, if it does."""
    times = states[..., 0]
    return not bool(np.isfinite(states).all() and (np.diff(times) > timestep / 2).all())


def check_stand(robot: Robot, stand: Stand, duration: float) -> None:
    """Checks what a simulation of a stand is given.

    Raises:
        ConfigurationError: If the base is fixed, the stand is another robot's, or the duration (s)
            is not between 2 and 600.
    """
    if not robot.floating:
        raise ConfigurationError("robot", f"{robot.name} has a fixed base and cannot stand")
    stand.check(robot)
    if not math.isfinite(duration) or not 2.0 <= duration <= 600.0:
        raise ConfigurationError("duration", f"{duration} s is not between 2 and 600 s")
