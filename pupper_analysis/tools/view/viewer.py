"""A robot on the screen, or in words: its joints, its IMU, and the stand it drops into."""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np

from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import STABLE_DEVIATION
from pupper_analysis.tools.view.drop import (
    DEFAULT_SECONDS,
    at_home,
    check_seconds,
    drop,
)
from pupper_analysis.tools.view.window import check_display, open_window, play_steps
from pupper_analysis.tools.view.words import print_imu, print_joints, print_readings


def view_robot(
    robot: str | VariantSpec | Robot = "v3", *, fixed: bool = False, headless: bool
) -> None:
    """Shows a robot with its joints as in its keyframe ``home``, until the window is closed.

    With a fixed base nothing moves by itself; the viewer's sliders under "Control" set the joints.
    With a free base gravity and contact run in real time, and the sliders command the servos.

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
    model, held = shown.mj_model, not shown.floating
    print(f"nq={model.nq}, nv={model.nv}, nu={model.nu}")
    if headless:
        print_joints(shown, data)
        print_imu(data, at_rest=held)
        return

    at_joints = shown.mj_convention.actuator_index
    joints = model.actuator_trnid[at_joints, 0]
    lower, upper = model.jnt_range[joints].T

    def step() -> None:
        if held:
            data.qpos[model.jnt_qposadr[joints]] = np.clip(data.ctrl[at_joints], lower, upper)
            mujoco.mj_forward(model, data)
        else:
            mujoco.mj_step(model, data)

    with contextlib.suppress(KeyboardInterrupt), open_window(model, data) as handle:
        play_steps(handle, model.opt.timestep, step)


def drop_and_report(
    robot: str | VariantSpec | Robot = "v3", *, headless: bool, seconds: float = DEFAULT_SECONDS
) -> bool:
    """Drops a robot and prints how steadily it stands at the end.

    With a window it runs in real time; a window that is closed early does not change the result.

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
        check_display()
    result = drop(seconds, robot=robot, window=not headless)
    if headless:
        print_readings(result.readings)
    deviation = 1e3 * result.height_deviation
    sign, verdict = ("<", "stable") if result.stable else (">=", "NOT stable")
    print(
        f"final z={result.height[-1]:.3f} m, last-1s std={deviation:.2f} mm "
        f"({sign} {1e3 * STABLE_DEVIATION:g} mm = {verdict})"
    )
    return result.stable
