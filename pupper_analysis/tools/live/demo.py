"""Pupper v3 moving between stances: what ``live --drop --demo`` shows."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from pupper_analysis.present.terminal import make_console, print_document
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.rollout import STATE
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.live.window import show_window
from pupper_analysis.tools.path.document import tracking_document
from pupper_analysis.tools.path.path_commands import path_commands
from pupper_analysis.tools.path.plan import StancePath, stance_path
from pupper_analysis.tools.path.tracking import track_path

DEMOS = {
    "squat": "down by a fifth, and up again",
    "sway": "to the left, to the right, and back",
    "lift": "the weight on to three feet, FL 20 mm up and down again, and back",
}
"""{demo: what it does}."""

_SECONDS = {"squat": 4.0, "sway": 6.0, "lift": 8.0}


def demo_path(robot: Robot, name: str) -> StancePath:
    """Returns the path of a demo.

    Args:
        robot: Where it shall move.
        name: One of ``DEMOS``.

    Raises:
        StanceUnreachableError: If this robot cannot do it; says when.
        StaticsInfeasibleError: If it would fall; says when.
    """
    return stance_path(robot, demo_stances(robot, name), _SECONDS[name])


def demo_stances(robot: Robot, name: str, *, depth: float = 0.2) -> list[StandTask]:
    """Returns the stances of a demo.

    Args:
        robot: Where it shall move.
        name: One of ``DEMOS``.
        depth: Of the squat, as a share of the height.
    """
    stand = StandTask()
    if name == "squat":
        return [stand, StandTask(height=(1 - depth) * robot.stand_height), stand]
    if name == "sway":
        return [stand, *(StandTask(offset=(0.0, y)) for y in (0.02, -0.02)), stand]
    feet = Configuration(robot, robot.neutral()).foot_positions()
    front_left = max(feet, key=lambda foot: float(feet[foot][0] + feet[foot][1]))
    x, y = np.mean([place[:2] for foot, place in feet.items() if foot != front_left], axis=0)
    over = StandTask(com=(float(x), float(y)))
    up = StandTask(com=(float(x), float(y)), swing={front_left: 0.02})
    return [stand, over, up, up, over, stand]


def demo(
    name: str,
    robot: str | VariantSpec | Robot = "v3",
    *,
    headless: bool,
    csv: Path | None = None,
) -> bool:
    """Moves a robot in MuJoCo, and prints how well it follows.

    Args:
        name: One of ``DEMOS``.
        robot: A variant's name, a ``VariantSpec``, or a robot.
        headless: Open no window.
        csv: Where to write the path: time, joint positions and torques.

    Returns:
        Whether it was tracked.

    Raises:
        DisplayError: If no window can be opened.
        OutputError: If the file cannot be written.
    """
    if not isinstance(robot, Robot):
        robot = load_variant(robot)
    path = demo_path(robot, name)
    if not headless:
        _show(robot, path)
    tracking = track_path(robot, path)
    print(f"{name}: {DEMOS[name]}")
    print_document(make_console(), tracking_document(name, path, tracking), everything=True)
    if csv is not None:
        path.to_csv(csv)
        print(f"path: {csv}")
    return tracking.passed


def _show(robot: Robot, path: StancePath) -> None:
    plan = path_commands(robot, path)
    model = plan.drive.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, plan.start, STATE)
    begun = data.time

    def control(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        step = round((data.time - begun) / model.opt.timestep)
        data.ctrl[:] = plan.ctrl[min(step, len(plan.ctrl) - 1)]

    show_window(model, data, control)
