"""A variant on the screen, or in words: its joints, its IMU, and the stand it drops into."""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np

from pupper_analysis.pupper.drop import DEFAULT_SECONDS, at_home, check_seconds, drop
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.pupper.window import check_display, open_window, play_steps
from pupper_analysis.pupper.words import print_imu, print_joints, print_readings
from pupper_analysis.simulation.verify import STABLE_DEVIATION


def view_variant(variant: str | VariantSpec = "v3", *, fixed: bool, headless: bool) -> None:
    """Shows a variant with its joints as in its keyframe ``home``, until the window is closed.

    With a fixed base nothing moves by itself; the viewer's sliders under "Control" set the joints.
    With a free base gravity and contact run in real time, and the sliders command the servos.

    Args:
        variant: Its name, or a ``VariantSpec``.
        fixed: Fix the base in the world.
        headless: Open no window; print what the joints do and how the IMU is read.

    Raises:
        DisplayError: If no window can be opened.
        ModelError: If the model file is missing or damaged.
    """
    if not headless:
        check_display()
    robot, data = at_home(variant, fixed=fixed)
    model = robot.mj_model
    print(f"nq={model.nq}, nv={model.nv}, nu={model.nu}")
    if headless:
        print_joints(robot, data)
        print_imu(data, at_rest=fixed)
        return

    joints = model.actuator_trnid[:, 0]
    lower, upper = model.jnt_range[joints].T

    def step() -> None:
        if fixed:
            data.qpos[model.jnt_qposadr[joints]] = np.clip(data.ctrl, lower, upper)
            mujoco.mj_forward(model, data)
        else:
            mujoco.mj_step(model, data)

    with contextlib.suppress(KeyboardInterrupt), open_window(model, data) as handle:
        play_steps(handle, model.opt.timestep, step)


def drop_and_report(
    variant: str | VariantSpec = "v3", *, headless: bool, seconds: float = DEFAULT_SECONDS
) -> bool:
    """Drops a variant and prints how steadily it stands at the end.

    With a window it runs in real time; a window that is closed early does not change the result.

    Args:
        variant: Its name, or a ``VariantSpec``.
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
    result = drop(seconds, variant=variant, window=not headless)
    if headless:
        print_readings(result.readings)
    deviation = 1e3 * result.height_deviation
    sign, verdict = ("<", "stable") if result.stable else (">=", "NOT stable")
    print(
        f"final z={result.height[-1]:.3f} m, last-1s std={deviation:.2f} mm "
        f"({sign} {1e3 * STABLE_DEVIATION:g} mm = {verdict})"
    )
    return result.stable
