"""Pupper v3 dropped on the ground: what it does, and what its IMU reads."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.models import mjcf
from pupper_analysis.pupper.variants import model_folder
from pupper_analysis.pupper.window import show
from pupper_analysis.results import Result
from pupper_analysis.simulation.verify import STABLE_DEVIATION

Array = NDArray[np.float64]

DEFAULT_SECONDS = 6.0
"""How long a drop is simulated (s). It lands after 0.18 s; after 2.3 s it is steady to 0.005 mm."""

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


def drop(seconds: float = DEFAULT_SECONDS, *, window: bool = False) -> Drop:
    """Drops Pupper v3 from its keyframe ``home``, 0.28 m up, with ``ctrl = 0``: the home pose.

    Args:
        seconds: How long (s), from 2 to 600.
        window: Show it in real time.

    Raises:
        ConfigurationError: If ``seconds`` is out of its bounds.
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    check_seconds(seconds)
    model, data = at_home("pupper_v3.xml")
    samples = [_sample(data)]

    def step() -> None:
        data.ctrl[:] = 0.0
        mujoco.mj_step(model, data)
        samples.append(_sample(data))

    timestep = float(model.opt.timestep)
    count = round(seconds / timestep)
    if window:
        show(model, data, step, count)
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
        "impact": int(np.argmax(accelerations)),
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


def _sample(data: mujoco.MjData) -> Array:
    """Returns height, number of contacts, accelerometer and gyro (8,)."""
    acceleration, rate = data.sensor("body_acc").data, data.sensor("body_gyro").data
    return np.array([data.qpos[2], data.ncon, *acceleration, *rate])


def check_seconds(seconds: float) -> None:
    """Refuses a duration out of its bounds.

    Raises:
        ConfigurationError: If it is.
    """
    low, high = SECONDS
    if not (math.isfinite(seconds) and low <= seconds <= high):
        raise ConfigurationError(
            "seconds", f"{seconds:g} s is not valid; it must be from {low:g} to {high:g} s"
        )


def at_home(file: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns a model of the package, and its data at the keyframe ``home``."""
    path = model_folder("mjcf") / file
    model = mjcf.compile_spec(mjcf.load(path), path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data
