"""A robot in words: what its joints do, and how its IMU is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.view.drop import Reading, imu_sensors

Array = NDArray[np.float64]
IMU_SENSORS = {
    "body_quat": ("1", "orientation of the IMU in the world (w, x, y, z)"),
    "body_gyro": ("rad/s", "angular velocity in the IMU's axes"),
    "body_acc": ("m/s^2", "acceleration less gravity, in the IMU's axes"),
    "global_position": ("m", "position of the IMU in the world"),
    "global_linvel": ("m/s", "velocity of the IMU in world axes"),
    "global_angvel": ("rad/s", "angular velocity in world axes"),
}
"""{sensor: (unit, what it reads)}."""

IMU_SNIPPET = f"imu = {{name: data.sensor(name).data.copy() for name in {tuple(IMU_SENSORS)}}}"
"""The line of Python that reads the IMU from a ``mujoco.MjData`` called ``data``."""

_AXES = {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}


@dataclass(frozen=True, eq=False)
class JointAction(Result):
    """What a joint really does, whatever the file calls its axis.

    Attributes:
        name: The joint.
        motion: ``roll``, ``pitch``, ``yaw`` or ``oblique``.
        axis: (3,) its axis in the base frame.
        foot_motion: (3,) how its leg's foot moves in the base frame as the angle grows (m/rad);
            None of a joint that carries no foot.
        lower: rad.
        upper: rad.
    """

    name: str
    motion: str
    axis: Array
    foot_motion: Array | None
    lower: float
    upper: float


def joint_actions(robot: Robot, data: mujoco.MjData) -> tuple[JointAction, ...]:
    """Returns what each commanded joint does at the state of ``data``, in actuator order."""
    model, base = robot.mj_model, robot.mj_model.body(robot.mj_base).id
    to_base = data.xmat[base].reshape(3, 3).T
    feet: dict[int, Array] = {}  # of each leg's bodies
    for end, centre in robot.contact_places.values():
        body = end
        place = data.xpos[end] + data.xmat[end].reshape(3, 3) @ centre
        while body not in (base, 0):
            feet[body] = place
            body = int(model.body_parentid[body])
    actions = []
    for name in robot.joint_names:
        joint = model.joint(name).id
        foot = feet.get(int(model.jnt_bodyid[joint]))
        moves = None if foot is None else np.cross(data.xaxis[joint], foot - data.xanchor[joint])
        axis: Array = to_base @ data.xaxis[joint]
        lower, upper = (float(limit) for limit in model.jnt_range[joint])
        actions.append(
            JointAction(
                name=model.joint(joint).name,
                motion=_motion(axis),
                axis=axis,
                foot_motion=None if moves is None else to_base @ moves,
                lower=lower,
                upper=upper,
            )
        )
    return tuple(actions)


def _motion(axis: Array) -> str:
    """Names the axis (3,) of the base that a joint's axis is within 1 degree of."""
    close = math.cos(math.radians(1.0))
    return next((name for name, unit in _AXES.items() if abs(axis @ unit) > close), "oblique")


def print_joints(robot: Robot, data: mujoco.MjData) -> None:
    """Prints what each joint does to its foot."""
    print(
        "\nJoints: axis, and what it does to the foot, in the base frame (x forward, y left, z up)"
    )
    rows = [("joint", "motion", "axis", "foot moves by (mm/rad)", "range (rad)")]
    rows += [
        (
            action.name,
            action.motion,
            _numbers(action.axis, 0),
            "-" if action.foot_motion is None else _numbers(1e3 * action.foot_motion, 0),
            f"{action.lower:+.2f} to {action.upper:+.2f}",
        )
        for action in joint_actions(robot, data)
    ]
    _print_table(rows)


def print_imu(data: mujoco.MjData, *, at_rest: bool) -> None:
    """Prints how the IMU is read, and what it reads now, of a robot that has one."""
    model = data.model
    there = {model.sensor(number).name for number in range(model.nsensor)}
    known = {name: told for name, told in IMU_SENSORS.items() if name in there}
    own = zip(imu_sensors(model), ("body_acc", "body_gyro"), strict=True)
    known |= {name: IMU_SENSORS[kind] for name, kind in own if name is not None}
    if not known:
        print("\nIMU: the MJCF has no accelerometer and no gyro")
        return
    print("\nIMU: how to read it")
    if set(IMU_SENSORS) <= there:
        print(f"  {IMU_SNIPPET}")
    rows = [("Python", "value", "unit", "meaning")]
    rows += [
        (f'data.sensor("{name}").data', _numbers(data.sensor(name).data, 3), unit, meaning)
        for name, (unit, meaning) in known.items()
    ]
    _print_table(rows)
    if at_rest:
        print("The base is held: the accelerometer reads what holds it up, +9.81 m/s^2 on z.")
    else:
        print("The base is falling: the accelerometer reads 0; at rest it reads +9.81 m/s^2 on z.")


def print_readings(readings: Sequence[Reading]) -> None:
    """Prints what the IMU read during a drop, if there is one."""
    if not np.isfinite(readings[0].acceleration).all():
        return
    print('IMU during the drop: data.sensor("body_acc").data, data.sensor("body_gyro").data')
    rows = [("moment", "t (s)", "base z (m)", "body_acc (m/s^2)", "body_gyro (rad/s)")]
    rows += [
        (
            reading.moment,
            f"{reading.time:.3f}",
            f"{reading.height:.3f}",
            _numbers(reading.acceleration, 2),
            _numbers(reading.angular_velocity, 2),
        )
        for reading in readings
    ]
    _print_table(rows)


def _numbers(values: Array, decimals: int) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
    texts = (f"{round(float(value), decimals) + 0.0:+.{decimals}f}" for value in values)
    return " ".join(f"{text:>{decimals + 3}}" for text in texts)


def _print_table(rows: Sequence[Sequence[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print(f"  {'  '.join(cells)}".rstrip())
