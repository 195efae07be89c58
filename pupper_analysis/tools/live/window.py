"""A robot in MuJoCo's own viewer, or in words: what its sensors read, and how it drops."""

from __future__ import annotations

import contextlib
import copy
import math
import os
import sys
import warnings
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.prepare.judge import describe_given_masses
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import was_reset_by_mujoco
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.monitor import StandCheck, Upright, Watcher
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.simulation.verify import STABLE_DEVIATION

Array = NDArray[np.float64]

DROP_SECONDS = 6.0
"""How long a drop is simulated (s). It lands after 0.18 s; after 2.3 s it is steady to 0.005 mm."""

DROP_HEIGHT = 0.15
"""How high the feet are above the ground (m) where the keyframe has them on it; v3's are, too."""


@dataclass(frozen=True, eq=False)
class Drop:
    """A simulated drop with the servos at the home pose.

    Attributes:
        time: (n,) s.
        height: (n,) of the base (m).
        height_deviation: Standard deviation of the height in the last second (m).
        end: Check of the final state against the home pose on the ground.
        stable: Whether ``height_deviation`` is below ``STABLE_DEVIATION`` and the robot stands.
    """

    time: Array
    height: Array
    height_deviation: float
    end: StandCheck
    stable: bool


def simulate_drop(robot: Robot) -> Drop:
    """Drops a robot, its servos at the joint positions of its keyframe ``home``.

    It falls from the height of the keyframe (v3: 0.28 m); if that is on the ground, from
    ``DROP_HEIGHT``. Torque limits of both files apply, limits of zero included.
    """
    data = make_home_data(robot)
    model = robot.mj_model
    with contextlib.suppress(ModelError):  # torque motors have no servo, and keep their ranges
        model = model_with_servos(robot).model
    servos_at_home = data.ctrl.copy()
    timestep = float(model.opt.timestep)
    height = np.full(round(DROP_SECONDS / timestep) + 1, data.qpos[2])
    for step in range(1, len(height)):
        data.ctrl[:] = servos_at_home
        mujoco.mj_step(model, data)
        height[step] = data.qpos[2]
    deviation = float(height[-round(1 / timestep) :].std())
    time = timestep * np.arange(len(height), dtype=np.float64)
    end = _check_landing(robot, data)
    stable = deviation < STABLE_DEVIATION and end.stands and not was_reset_by_mujoco(data)
    return Drop(time, height, deviation, end, stable)


def _check_landing(robot: Robot, data: mujoco.MjData) -> StandCheck:
    """Check a final state against the home pose with its lowest foot on the ground."""
    qpos = robot.home.copy()
    if robot.floating and robot.contact_points:
        qpos[2] -= _foot_clearance(robot, qpos)
    state = full_state(robot.mj_model, data)
    touching = Watcher(robot, robot.mj_model).touching(state)
    return Upright.of(robot, qpos).check_stand(state, touching)


def _foot_clearance(robot: Robot, qpos: Array) -> float:
    """Return the vertical distance of the lowest foot from the ground (m)."""
    feet = Configuration(robot, qpos).foot_positions()
    return min(float(place[2]) - robot.contact_radius[foot] for foot, place in feet.items())


def make_home_data(robot: Robot) -> mujoco.MjData:
    """Returns MuJoCo's data with a robot's joints, and its servos' commands, at home.

    A free base is above the ground.
    """
    data = mujoco.MjData(robot.mj_model)
    qpos = robot.home.copy()
    if robot.floating and robot.contact_points:
        clearance = _foot_clearance(robot, qpos)
        qpos[2] += DROP_HEIGHT - clearance if clearance < DROP_HEIGHT / 2 else 0.0
    robot.mj_convention.set_state(data, qpos)
    data.ctrl[robot.mj_convention.actuator_index] = qpos[robot.nq - robot.nu :]
    mujoco.mj_forward(robot.mj_model, data)
    return data


def view_robot(robot: Robot, *, headless: bool) -> None:
    """Shows a robot with its joints as in its keyframe ``home``, until the window is closed.

    The viewer's sliders under "Control" command the servos. A robot whose base is fixed is shown
    without gravity: nothing moves by itself.

    Args:
        robot: The robot.
        headless: Open no window; print what its sensors read.

    Raises:
        DisplayError: If no window can be opened.
    """
    if not headless:
        check_display()
    data, model = make_home_data(robot), robot.mj_model
    print(f"nq={model.nq}, nv={model.nv}, nu={model.nu}", flush=True)
    if headless:
        for sensor in map(model.sensor, range(model.nsensor)):
            reading = " ".join(
                f"{round(value, 3) + 0.0:+.3f}" for value in data.sensor(sensor.id).data
            )
            print(f'data.sensor("{sensor.name}").data  {reading}')
        return
    if not robot.floating:
        model = copy.copy(model)  # the robot's own is not changed
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    show_window(model, data)


def drop_and_report(robot: Robot, *, headless: bool) -> bool:
    """Drop a robot and print whether it stands at the end.

    The result is the same whatever is done in the window.

    Args:
        robot: The robot.
        headless: Open no window.

    Returns:
        Whether the stand is stable, and no link has a mass that the file does not state; otherwise
        the command ends with status 1.

    Raises:
        DisplayError: If no window can be opened.
    """
    if not headless:
        show_window(robot.mj_model, make_home_data(robot))
    result = simulate_drop(robot)
    print(format_drop(result))
    masses = describe_given_masses(robot)
    if masses is not None:
        print(f"UNKNOWN: {masses}")
    return result.stable and masses is None


def format_drop(result: Drop) -> str:
    """Format the line that reports a drop, in the tutorial's form."""
    still = result.height_deviation < STABLE_DEVIATION
    sign, end = "<" if still else ">=", result.end
    ending = " = stable" if result.stable else " = NOT stable" if not still else ""
    words = [
        f"final z={result.height[-1]:.3f} m",
        f"last-1s std={1e3 * result.height_deviation:.2f} mm "
        f"({sign} {1e3 * STABLE_DEVIATION:g} mm{ending})",
        f"tilt {math.degrees(end.tilt):.1f} deg",
    ]
    if result.stable:
        words.append("only the feet touch the ground")
    elif end.touching:
        words.append(f"touching the ground: {', '.join(end.touching)}")
    if not result.stable and end.collapses:
        height, expected = 1e3 * end.height, 1e3 * end.expected_height
        words.append(f"CoM {height:.0f} mm high instead of {expected:.0f} mm")
    return ", ".join(words) + ("" if result.stable or not still else ": NOT stable")


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
