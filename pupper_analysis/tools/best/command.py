"""``pupper-analysis best``: search for the best stance, print and simulate the result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import (
    CONTINUOUS_OPTION,
    RobotAndTask,
    draw_requested_stand,
    limit_by_peak,
    parse_continuous_torques,
    robot_and_task,
)


@shared.command("best", meanings={"objective": "what to optimise"})
@click.argument("objective", type=click.Choice(["utilisation", "margin", "payload"]))
@robot_argument
@robot_and_task
@CONTINUOUS_OPTION
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    objective: str,
    words: tuple[str, ...],
    continuous: tuple[str, ...],
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Search for the best stance: the pose of the base and the position of each foot are free.

    OBJECTIVE is utilisation (smallest peak of torque / limit), margin (largest distance of the CoM
    from the edge of the support polygon) or payload (largest mass at --payload-at). The
    search starts from the given stance (as for `stand`) and keeps its ground, swing feet and
    margins. The search takes some seconds, for a payload up to minutes. The result is then
    printed and simulated as by `stand`. With --continuous, the motors are limited to torques
    that they exert permanently, as for `payload`.

    \b
    Examples:
      pupper-analysis best utilisation v3
      pupper-analysis best payload v3-heavy --payload-at 0,0,8cm --figure best.png
      pupper-analysis best margin original --swing FL=2cm --com inside \\
        --self-clearance 4mm

    Exit status: 0 the stance (and its payload) holds, 1 the stance fails in simulation,
    2 the given stance is out of reach or has no equilibrium, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.robot.build import with_efforts
    from pupper_analysis.tools.best.best import study_best
    from pupper_analysis.tools.best.search import Objective

    task = request.task()
    visuals = figure is not None or report_path is not None
    robot = request.robot(words, visuals=visuals, payload_sought=objective == "payload")
    continuous_efforts, _ = parse_continuous_torques(continuous, robot)
    robot = with_efforts(robot, limit_by_peak(robot, continuous_efforts))
    kp, kd = request.gains(robot)
    with shared.show_progress("searching for the best stance, and simulating it"):
        result = study_best(robot, Objective(objective), task, request.place, kp=kp, kd=kd)
    if result.best.payload is not None:
        payload = replace(result.best.payload, continuous=tuple(continuous_efforts))
        result = replace(result, best=replace(result.best, payload=payload))
    request.show(result, robot)
    subject = f"best stance for {objective}, and static contact forces"
    draw_requested_stand(robot, result.stance.stand, result.stance.statics, figure, result, subject)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
