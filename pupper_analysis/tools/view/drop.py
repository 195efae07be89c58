"""A robot dropped on the ground: what it does, and what its IMU reads."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.pupper.load import load_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import STABLE_DEVIATION
from pupper_analysis.tools.view.window import show_window

Array = NDArray[np.float64]

DEFAULT_SECONDS = 6.0
"""How long a drop is simulated (s). It lands after 0.18 s; after 2.3 s it is steady to 0.005 mm."""

FALL = 0.15
"""How high the feet are above the ground (m) where the keyframe has them on it; v3's are, too."""

SECONDS = (2.0, 600.0)
"""The shortest and the longest drop that can be asked for (s)."""


@dataclass(frozen=True, eq=False)
class Reading(Result):
    """What the IMU read at one moment of a drop.

    Attributes:
        moment: ``release``, ``touchdown`` (first contact), ``impact`` (greatest acceleration) or
            ``rest`` (the end).
        time: s.
        height: Of the base (m).
        acceleration: (3,) acceleration less gravity, in the IMU's axes (m/s^2).
        angular_velocity: (3,) in the IMU's axes (rad/s).
    """

    moment: str
    time: float
    height: float
    acceleration: Array
    angular_velocity: Array


@dataclass(frozen=True, eq=False)
class Drop(Result):
    """A simulated drop with the servos at the home pose.

    Attributes:
        time: (n,) s.
        height: (n,) of the base (m).
        height_deviation: Standard deviation of the height in the last second (m).
        stable: Whether that is below ``STABLE_DEVIATION``.
        readings: What the IMU read at release, touchdown, impact and rest.
    """

    time: Array
    height: Array
    height_deviation: float
    stable: bool
    readings: tuple[Reading, ...]


def drop(
    seconds: float = DEFAULT_SECONDS,
    *,
    robot: str | VariantSpec | Robot = "v3",
    window: bool = False,
) -> Drop:
    """Drops a robot, its servos at the joint positions of its keyframe ``home``.

    It falls from where the keyframe has it (v3: 0.28 m up); if that is on the ground, its feet are
    ``FALL`` above it.

    Args:
        seconds: How long (s), from 2 to 600.
        robot: A variant's name, a ``VariantSpec``, or a robot.
        window: Show it in real time.

    Raises:
        ConfigurationError: If ``seconds`` is out of its bounds.
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
        VariantError: If the name is unknown.
    """
    check_seconds(seconds)
    dropped, data = at_home(robot)
    model, imu = dropped.mj_model, imu_sensors(dropped.mj_model)
    servos_at_home = data.ctrl.copy()
    samples = [_sample(data, imu)]

    def step() -> None:
        data.ctrl[:] = servos_at_home
        mujoco.mj_step(model, data)
        samples.append(_sample(data, imu))

    timestep = float(model.opt.timestep)
    count = round(seconds / timestep)
    if window:
        show_window(model, data, step, count)
    while len(samples) <= count:
        step()

    record = np.array(samples)
    moment = np.arange(count + 1, dtype=np.float64) * timestep
    height = record[:, 0]
    deviation = float(height[-round(1 / timestep) :].std())
    accelerations = np.linalg.norm(record[:, 2:5], axis=1)
    moments = {
        "release": 0,
        "touchdown": int(np.argmax(record[:, 1] > 0)),
        "impact": int(np.argmax(np.nan_to_num(accelerations))),
        "rest": count,
    }
    return Drop(
        time=moment,
        height=height,
        height_deviation=deviation,
        stable=deviation < STABLE_DEVIATION,
        readings=tuple(
            Reading(name, float(moment[at]), float(height[at]), record[at, 2:5], record[at, 5:8])
            for name, at in moments.items()
        ),
    )


def imu_sensors(model: mujoco.MjModel) -> tuple[str | None, str | None]:
    """Returns the names of a model's first accelerometer and gyro; None where it has none."""
    kinds = (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO)
    found = (np.flatnonzero(model.sensor_type == kind) for kind in kinds)
    one, other = (str(model.sensor(int(at[0])).name) if len(at) else None for at in found)
    return one, other


def _sample(data: mujoco.MjData, imu: tuple[str | None, str | None]) -> Array:
    """Returns height, number of contacts, accelerometer and gyro (8,); NaN of what there is not."""
    read = [np.full(3, np.nan) if name is None else data.sensor(name).data for name in imu]
    return np.array([data.qpos[2], data.ncon, *read[0], *read[1]])


def check_seconds(seconds: float) -> None:
    """Refuses a duration out of its bounds.

    Raises:
        ConfigurationError: If it is.
    """
    low, high = SECONDS
    if not (math.isfinite(seconds) and low <= seconds <= high):
        problem = diagnose("duration-not-valid", seconds=seconds, low=low, high=high)
        raise ConfigurationError("seconds", problem)


def at_home(
    robot: str | VariantSpec | Robot, *, fixed: bool = False
) -> tuple[Robot, mujoco.MjData]:
    """Returns a robot, and MuJoCo's data with its joints, and its servos' commands, at home.

    A free base is above the ground.

    Args:
        robot: A robot, or a variant.
        fixed: Whether a variant is loaded with its base fixed.
    """
    if not isinstance(robot, Robot):
        robot = load_variant(robot, fixed_base=fixed)
    data = mujoco.MjData(robot.mj_model)
    qpos = robot.home.copy()
    if robot.floating and robot.contact_points:
        feet = Configuration(robot, qpos).foot_positions()
        clearance = min(
            float(place[2]) - robot.contact_radius[foot] for foot, place in feet.items()
        )
        qpos[2] += FALL - clearance if clearance < FALL / 2 else 0.0
    robot.mj_convention.set_state(data, qpos)
    data.ctrl[robot.mj_convention.actuator_index] = qpos[robot.nq - robot.nu :]
    mujoco.mj_forward(robot.mj_model, data)
    return robot, data
