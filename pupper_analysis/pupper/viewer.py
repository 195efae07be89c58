"""Pupper v3 on the screen, or in words: its joints, its IMU, and the stand it drops into."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.models import mjcf
from pupper_analysis.pupper.variants import BASES, model_folder
from pupper_analysis.results import Result
from pupper_analysis.simulation.verify import STABLE_DEVIATION

Array = NDArray[np.float64]

DEFAULT_SECONDS = 6.0
"""How long a drop is simulated (s). It lands after 0.18 s; after 2.3 s it is steady to 0.005 mm."""

SECONDS = (2.0, 600.0)
"""The shortest and the longest drop that can be asked for (s)."""

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

_FRAME = 1 / 60  # s between two pictures
_AXES = {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}


class DisplayError(PupperAnalysisError):
    """The viewer cannot open a window here; the message says what to do instead."""


# ------------------------------------------------------------------------------------- commands


def view(*, fixed: bool, headless: bool) -> None:
    """Shows Pupper v3 at its keyframe ``home`` until the window is closed.

    With a fixed base nothing moves by itself; the viewer's sliders under "Control" set the joints.
    With a free base gravity and contact run in real time, and the sliders command the servos.

    Args:
        fixed: Fix the base in the world.
        headless: Open no window; print what the joints do and how the IMU is read.

    Raises:
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    if not headless:
        check_display()
    model, data = _home("pupper_v3_fixed.xml" if fixed else "pupper_v3.xml")
    print(f"nq={model.nq}, nv={model.nv}, nu={model.nu}")
    if headless:
        _print_joints(model, data)
        _print_imu(data, at_rest=fixed)
        return

    joints = model.actuator_trnid[:, 0]
    lower, upper = model.jnt_range[joints].T

    def step() -> None:
        if fixed:
            data.qpos[model.jnt_qposadr[joints]] = np.clip(data.ctrl, lower, upper)
            mujoco.mj_forward(model, data)
        else:
            mujoco.mj_step(model, data)

    with contextlib.suppress(KeyboardInterrupt), _window(model, data) as handle:
        _play(handle, model.opt.timestep, step)


def stand(*, headless: bool, seconds: float = DEFAULT_SECONDS) -> bool:
    """Drops Pupper v3 from its keyframe ``home`` and prints how steadily it stands at the end.

    With a window it runs in real time; a window that is closed early does not change the result.

    Args:
        headless: Open no window; print what the IMU reads on the way.
        seconds: How long (s), from 2 to 600.

    Returns:
        Whether the stand is stable; a command whose stand is not ends with status 1.

    Raises:
        ConfigurationError: If ``seconds`` is out of its bounds.
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    _check_seconds(seconds)
    if not headless:
        check_display()
    result = drop(seconds, window=not headless)
    if headless:
        _print_readings(result.readings)
    deviation = 1e3 * result.height_deviation
    sign, verdict = ("<", "stable") if result.stable else (">=", "NOT stable")
    print(
        f"final z={result.height[-1]:.3f} m, last-1s std={deviation:.2f} mm "
        f"({sign} {1e3 * STABLE_DEVIATION:g} mm = {verdict})"
    )
    return result.stable


# ------------------------------------------------------------------------------------- the drop


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
    _check_seconds(seconds)
    model, data = _home("pupper_v3.xml")
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


def _check_seconds(seconds: float) -> None:
    low, high = SECONDS
    if not (math.isfinite(seconds) and low <= seconds <= high):
        raise ConfigurationError(
            "seconds", f"{seconds:g} s is not valid; it must be from {low:g} to {high:g} s"
        )


def _home(file: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns a model of the package, and its data at the keyframe ``home``."""
    path = model_folder("mjcf") / file
    model = mjcf.compile_spec(mjcf.load(path), path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data


# ------------------------------------------------------------------------------------- in words


@dataclass(frozen=True, eq=False)
class JointAction(Result):
    """What a joint really does, whatever the file calls its axis.

    Attributes:
        name: The joint.
        motion: ``roll``, ``pitch``, ``yaw`` or ``oblique``.
        axis: (3,) its axis in the base frame.
        foot_motion: (3,) how its leg's foot moves in the base frame as the angle grows (m/rad).
        lower: rad.
        upper: rad.
    """

    name: str
    motion: str
    axis: Array
    foot_motion: Array
    lower: float
    upper: float


def joint_actions(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[JointAction, ...]:
    """Returns what each hinge of a v3 model does at the state of ``data``, in actuator order."""
    base = int(model.site("body_imu_site").bodyid[0])
    to_base = data.xmat[base].reshape(3, 3).T
    feet: dict[int, Array] = {}  # of each leg's bodies
    for site in BASES["v3"].feet.values():
        body = int(model.site(site).bodyid[0])
        while body != base:
            feet[body] = data.site(site).xpos
            body = int(model.body_parentid[body])
    actions = []
    for joint in (int(joint) for joint in model.actuator_trnid[:, 0]):
        lever = feet[int(model.jnt_bodyid[joint])] - data.xanchor[joint]
        axis: Array = to_base @ data.xaxis[joint]
        lower, upper = (float(limit) for limit in model.jnt_range[joint])
        actions.append(
            JointAction(
                name=model.joint(joint).name,
                motion=_motion(axis),
                axis=axis,
                foot_motion=to_base @ np.cross(data.xaxis[joint], lever),
                lower=lower,
                upper=upper,
            )
        )
    return tuple(actions)


def _motion(axis: Array) -> str:
    """Names the axis (3,) of the base that a joint's axis is within 1 degree of."""
    close = math.cos(math.radians(1.0))
    return next((name for name, unit in _AXES.items() if abs(axis @ unit) > close), "oblique")


def _print_joints(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    print(
        "\nJoints: axis, and what it does to the foot, in the base frame (x forward, y left, z up)"
    )
    rows = [("joint", "motion", "axis", "foot moves by (mm/rad)", "range (rad)")]
    rows += [
        (
            action.name,
            action.motion,
            _numbers(action.axis, 0),
            _numbers(1e3 * action.foot_motion, 0),
            f"{action.lower:+.2f} to {action.upper:+.2f}",
        )
        for action in joint_actions(model, data)
    ]
    _print_table(rows)


def _print_imu(data: mujoco.MjData, *, at_rest: bool) -> None:
    print("\nIMU: how to read it")
    print(f"  {IMU_SNIPPET}")
    rows = [("Python", "value", "unit", "meaning")]
    rows += [
        (f'data.sensor("{name}").data', _numbers(data.sensor(name).data, 3), unit, meaning)
        for name, (unit, meaning) in IMU_SENSORS.items()
    ]
    _print_table(rows)
    if at_rest:
        print("The base is held: the accelerometer reads what holds it up, +9.81 m/s^2 on z.")
    else:
        print("The base is falling: the accelerometer reads 0; at rest it reads +9.81 m/s^2 on z.")


def _print_readings(readings: Sequence[Reading]) -> None:
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


# ------------------------------------------------------------------------------------- the window


def check_display() -> None:
    """Makes sure that a window can be opened; without one GLFW ends the interpreter, or hangs.

    Raises:
        DisplayError: If not.
    """
    instead = "use --headless for the same in words"
    no_screen = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and no_screen:
        raise DisplayError(f"no display: neither DISPLAY nor WAYLAND_DISPLAY is set; {instead}")
    try:
        from mujoco import viewer
    except (ImportError, RuntimeError) as error:
        raise DisplayError(f"the viewer is not available ({error}); {instead}") from error
    if sys.platform == "darwin":
        if viewer._MJPYTHON is None:
            command = shlex.join(["mjpython", *sys.argv])
            raise DisplayError(f"macOS needs MuJoCo's launcher for a window: {command}; {instead}")
        return
    glfw = viewer.glfw
    with warnings.catch_warnings(record=True) as caught:  # how glfw reports errors
        warnings.simplefilter("always")
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "", None, None)
            glfw.default_window_hints()
    if not window:
        reason = str(caught[-1].message) if caught else "it gives no window with OpenGL"
        raise DisplayError(f"the display cannot be used ({reason}); {instead}")
    glfw.destroy_window(window)


@contextlib.contextmanager
def _window(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Any]:
    """Opens MuJoCo's passive viewer, and sees it closed before it goes on."""
    check_display()
    from mujoco import viewer

    before = set(threading.enumerate())
    handle = viewer.launch_passive(model, data)
    with handle.lock():
        handle.cam.lookat[:] = data.site("body_imu_site").xpos * (0.0, 0.0, 0.5)
        handle.cam.distance, handle.cam.azimuth, handle.cam.elevation = 0.8, 130.0, -20.0
    try:
        yield handle
    finally:
        with _no_interrupt():  # if Python ended before the window's thread, it would crash
            handle.close()
            for thread in set(threading.enumerate()) - before:
                thread.join(timeout=5.0)


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Ignores Ctrl-C; only the main thread gets it, and only there it can be ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def show(model: mujoco.MjModel, data: mujoco.MjData, step: Callable[[], None], count: int) -> None:
    """Opens a window and calls ``step`` in it, ``count`` times in real time, until it is closed."""
    with _window(model, data) as handle:
        _play(handle, float(model.opt.timestep), step, count)


def _play(handle: Any, timestep: float, step: Callable[[], None], count: int | None = None) -> None:
    """Calls ``step`` in real time, ``count`` times or without end, while the window is open."""
    done, start = 0, time.perf_counter()
    limit = math.inf if count is None else count
    while handle.is_running() and done < limit:
        now = time.perf_counter()
        due = int((now - start) / timestep)
        if (due - done) * timestep > 0.1:  # too slow, or woken from sleep: do not catch up
            due = done + max(1, round(_FRAME / timestep))
            start = now - due * timestep
        with handle.lock():
            while done < min(due, limit):
                step()
                done += 1
        handle.sync()
        time.sleep(max(0.0, _FRAME - (time.perf_counter() - now)))
