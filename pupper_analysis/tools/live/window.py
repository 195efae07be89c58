"""A robot in MuJoCo's own viewer, or in words: its joints, its IMU, and how it drops."""

from __future__ import annotations

import copy
import math
import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import STABLE_DEVIATION

Array = NDArray[np.float64]

# A robot dropped on the ground: what it does, and what its IMU reads.


DEFAULT_SECONDS = 6.0
"""How long a drop is simulated (s). It lands after 0.18 s; after 2.3 s it is steady to 0.005 mm."""

FALL = 0.15
"""How high the feet are above the ground (m) where the keyframe has them on it; v3's are, too."""

SECONDS = (2.0, 600.0)
"""The shortest and the longest drop that can be asked for (s)."""


@dataclass(frozen=True, eq=False)
class Reading:
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
class Drop:
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
) -> Drop:
    """Drops a robot, its servos at the joint positions of its keyframe ``home``.

    It falls from where the keyframe has it (v3: 0.28 m up); if that is on the ground, its feet are
    ``FALL`` above it.

    Args:
        seconds: How long (s), from 2 to 600.
        robot: A variant's name, a ``VariantSpec``, or a robot.

    Raises:
        ConfigurationError: If ``seconds`` is out of its bounds.
        ModelError: If the model file is missing or damaged.
        VariantError: If the name is unknown.
    """
    check_seconds(seconds)
    dropped, data = at_home(robot)
    model, imu = dropped.mj_model, imu_sensors(dropped.mj_model)
    servos_at_home = data.ctrl.copy()
    samples = [_sample(data, imu)]

    timestep = float(model.opt.timestep)
    count = round(seconds / timestep)
    for _ in range(count):
        data.ctrl[:] = servos_at_home
        mujoco.mj_step(model, data)
        samples.append(_sample(data, imu))

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


# A robot in words: what its joints do, and how its IMU is read.

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
class JointAction:
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
    known = {name: message for name, message in IMU_SENSORS.items() if name in there}
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


def view_robot(
    robot: str | VariantSpec | Robot = "v3", *, fixed: bool = False, headless: bool
) -> None:
    """Shows a robot with its joints as in its keyframe ``home``, until the window is closed.

    The viewer's sliders under "Control" command the servos. A robot whose base is fixed is shown
    without gravity: nothing moves by itself.

    Args:
        robot: A variant's name, a ``VariantSpec``, or a robot.
        fixed: Fix a variant's base in the world.
        headless: Open no window; print what the joints do and how the IMU is read.

    Raises:
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    if not headless:
        check_display()
    shown, data = at_home(robot, fixed=fixed)
    model = shown.mj_model
    print(f"nq={model.nq}, nv={model.nv}, nu={model.nu}", flush=True)
    if headless:
        print_joints(shown, data)
        print_imu(data, at_rest=not shown.floating)
        return
    if not shown.floating:
        model = copy.copy(model)  # the robot's own is not changed
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    show_window(model, data)


def drop_and_report(
    robot: str | VariantSpec | Robot = "v3", *, headless: bool, seconds: float = DEFAULT_SECONDS
) -> bool:
    """Drops a robot and prints how steadily it stands at the end.

    The result is the same whatever is done in the window.

    Args:
        robot: A variant's name, a ``VariantSpec``, or a robot.
        headless: Open no window; print what the IMU reads on the way.
        seconds: How long (s), from 2 to 600.

    Returns:
        Whether the stand is stable; a command whose stand is not ends with status 1.

    Raises:
        ConfigurationError: If ``seconds`` is out of its bounds.
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    check_seconds(seconds)
    if not headless:
        dropped, data = at_home(robot)
        show_window(dropped.mj_model, data)
    result = drop(seconds, robot=robot)
    if headless:
        print_readings(result.readings)
    deviation = 1e3 * result.height_deviation
    sign, verdict = ("<", "stable") if result.stable else (">=", "NOT stable")
    print(
        f"final z={result.height[-1]:.3f} m, last-1s std={deviation:.2f} mm "
        f"({sign} {1e3 * STABLE_DEVIATION:g} mm = {verdict})"
    )
    return result.stable


class DisplayError(PupperAnalysisError):
    """The viewer cannot open a window here; the message says what to do instead."""


def check_display() -> None:
    """Makes sure that a window can be opened; without one MuJoCo's viewer ends the interpreter.

    Raises:
        DisplayError: If not.
    """
    no_screen = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and no_screen:
        raise DisplayError(diagnose("no-display"))
    try:
        from mujoco.viewer import glfw
    except (ImportError, RuntimeError) as error:
        raise DisplayError(diagnose("viewer-not-available", message=str(error))) from error
    with warnings.catch_warnings(record=True) as caught:  # how glfw reports errors
        warnings.simplefilter("always")
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "", None, None)
            glfw.default_window_hints()
    if not window:
        message = str(caught[-1].message) if caught else "no window with OpenGL"
        raise DisplayError(diagnose("viewer-not-available", message=message))
    glfw.destroy_window(window)


def show_window(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Simulates in MuJoCo's viewer, in real time, until its window is closed.

    Args:
        model: The model.
        data: Where it begins.

    Raises:
        DisplayError: If no window can be opened.
    """
    check_display()
    from mujoco import viewer

    viewer.launch(model, data)
