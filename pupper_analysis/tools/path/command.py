"""``pupper-analysis path``: plan a path to a stance, and simulate the path."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import (
    MOTOR_OPTION,
    RobotAndTask,
    apply_motors,
    robot_and_task,
)
from pupper_analysis.tools.path import kinds


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
    from pupper_analysis.tools.path.tracking import study_path

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None)
    robot, assigned = apply_motors(motors, robot, request.effort)
    kp, kd = request.gains(robot)
    with shared.show_progress("solving the path, and simulating it"):
        result = study_path(robot, task, seconds, kp=kp, kd=kd, motors=assigned)
    request.show(result, robot)
    if csv is not None:
        result.path.to_csv(csv)
        shared.confirm_written(csv)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
