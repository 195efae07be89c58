"""``pupper-analysis path``: plan a path to a stance, and simulate the path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.next_step import complete_command
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import (
    MOTOR_OPTION,
    RobotAndTask,
    apply_motors,
    robot_and_task,
)
from pupper_analysis.tools.path import kinds

if TYPE_CHECKING:
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.stand import Stand


@shared.command("path")
@robot_argument
@click.option(
    "--seconds",
    default=4.0,
    show_default=True,
    metavar="S",
    help="Duration of the path (s); e.g. 2.",
)
@shared.output_option(
    "--csv",
    holds=kinds.PATH_TABLE,
    help="Write the commands of the path as CSV to this file, or to standard output (-).",
)
@MOTOR_OPTION
@robot_and_task
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    seconds: float,
    csv: Path | None,
    motors: tuple[str, ...],
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Plan a path from the nominal stand to a stance, and simulate the path.

    The feet start at their positions in the stance. Before a foot is lifted, the weight is shifted
    onto the other feet. Every sample is in dynamic balance, along a minimum-jerk law. Robot
    and stance are given as for `stand`.

    \b
    Examples:
      pupper-analysis path v3 --swing FL=2cm --com inside --seconds 4 \\
        --csv lift.csv
      pupper-analysis path original --height 14cm
      pupper-analysis path v3-heavy --pitch 5deg --seconds 3 --json pitch.json
      pupper-analysis path v3 --height 14cm --seconds 1 \\
        --motor steadywin-gim4305-10

    Exit status: 0 the robot follows the path, 1 the verdict does not pass (for example, the robot
    does not follow), 2 out of reach, no equilibrium or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.path.tracking import plan_path, simulate_path

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None)
    robot, assigned = apply_motors(motors, robot, request.effort)
    kp, kd = request.gains(robot)
    with shared.show_progress("solving the path, and simulating it"):
        stand, path = plan_path(robot, task, seconds, motors=assigned)
        if not path.has_motion:
            _refuse_missing_goal(robot, stand)
        result = simulate_path(robot, stand, path, kp=kp, kd=kd, motors=assigned)
    request.show(result, robot)
    if csv is not None:
        result.path.to_csv(csv)
        shared.confirm_written(csv)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


_EXAMPLE_HEIGHT_RATIOS = (0.9, 1.1)
"""Base heights of the proposed goal, divided by the height of the start stance [1]. The first
reachable height is proposed. Chosen, not tuned: the motion is visible, and most legs reach one of
the two heights."""


def _refuse_missing_goal(robot: Robot, stand: Stand) -> None:
    """Raise an error about a goal that equals the start stance, with a command that has a goal.

    The command contains a reachable base height. If none is found, the command is `workspace`.

    Args:
        robot: Robot.
        stand: Start stance, which is also the goal.
    """
    from pupper_analysis.base.diagnostics import diagnose
    from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.stance.stand import solve_stand

    step = NextStep("workspace")
    for ratio in _EXAMPLE_HEIGHT_RATIOS if stand.task.height else ():
        height = round(1e3 * ratio * (stand.task.height or 0.0))
        try:
            solve_stand(robot, replace(stand.task, height=1e-3 * height))
        except PupperAnalysisError:
            continue
        step = NextStep("path", ("--height", f"{height}mm"))
        break
    error = ConfigurationError("robot", diagnose("path-goal-missing", robot=robot.name))
    error.add_note(complete_command(step))
    raise error
