"""``pupper-analysis payload``: how much a stance carries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import (
    RobotAndTask,
    parse_efforts,
    robot_and_task,
)


@shared.command("payload")
@robot_argument
@robot_and_task
@click.option(
    "--continuous",
    multiple=True,
    metavar="[JOINTS=]NM",
    help="What the motors of all joints that match a pattern give for as long as you like (N m): "
    "the payload is then what lasts; e.g. 0.4, '*knee*=12'. Repeatable.",
)
@shared.json_option
@shared.report_option
def command(
    asked: RobotAndTask,
    words: tuple[str, ...],
    continuous: tuple[str, ...],
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the largest payload of a stance, and what fails beyond it.

    It is sought at --payload-at, besides what --payload puts there: the largest mass with which
    `stand --payload` holds: reach and contacts, motor torques and servo stiffness each set a
    limit. The base moves from under the load where the CoM shall be over the feet. The robot is
    then judged as by `stand` with 97 % of it, and simulated with that and with 105 % while it
    is nudged from all sides. Robot and stance are given as for `stand`.

    The efforts that files state are peak torques: what they carry, they carry for moments. With
    --continuous it is what lasts; motors that no pattern matches keep their peak torque.

    \b
    Examples:
      pupper-analysis payload v3 --payload-at 0,0,8cm
      pupper-analysis payload go2.urdf --continuous 8
      pupper-analysis payload v3-long-leg --height 15cm --kp 20 --kd 0.5
      pupper-analysis payload original --swing FL=2cm --com inside \\
        --com-margin 1cm

    Exit status: 0 it carries something, 1 nothing, or it falls in simulation,
    2 out of reach, not holdable or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.robot.build import with_efforts
    from pupper_analysis.tools.payload.limit import payload_limit

    task = asked.task()
    robot = asked.robot(words, payload_sought=True)
    lasting = parse_efforts(continuous, robot, "continuous")
    robot = with_efforts(robot, lasting)
    kp, kd = asked.gains(robot)
    with shared.show_progress("searching for the payload, and simulating it"):
        result = payload_limit(robot, task, asked.place, kp=kp, kd=kd)
        result = replace(result, continuous=tuple(lasting))
    asked.show(result, robot)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
