"""``pupper-analysis stand``, ``workspace``, ``payload`` and ``best``: how robots stand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_idle
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_stance, robot_and_task

if TYPE_CHECKING:
    from pupper_analysis.analysis.stance import Stance
    from pupper_analysis.robot.robot import Robot

at_option = click.option(
    "--at",
    default="0,0,0",
    metavar="[FRAME,]X,Y,Z",
    help="Position of the payload in the base frame, or that of a link, site or body (m); "
    "e.g. 0,0,8cm or right_hand,0,0,5cm.",
)


@shared.command()
@robot_argument
@click.option(
    "--minimum-stiffness", is_flag=True, help="Also find the lowest kp that carries the robot."
)
@robot_and_task
@shared.figure_option
@shared.json_option
@shared.report_option
def stand(
    asked: RobotAndTask,
    words: tuple[str, ...],
    minimum_stiffness: bool,
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Solve a stance: joint angles, motor torques, and whether the robot stays upright in it.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF; --base, --leg-scale
    and --torso-mass-scale define other variants. Of one file the other model is made in memory.
    Feet are detected; a floor, servos and a start pose are added where the files lack them, and
    notes say so.

    Lengths are in m and angles in rad, unless they have a unit: 20mm, 2cm, 5deg.

    A stance that is out of reach is refused, and the message says what is possible. A stance
    that is reached but cannot be held (the robot slides or tips) is reported as such. In
    simulation the legs are lengthened by the depth to which the feet penetrate MuJoCo's soft
    ground.

    Other commands take the same options of robot and stance: workspace (how far the base can move),
    payload (how much it can carry), push (how hard it can be pushed), best (a better stance) and
    path (how to get there).

    \b
    Examples:
      pupper-analysis stand v3 --swing FL=2cm --com inside --com-margin 1cm
      pupper-analysis stand long-leg --slope 5deg --uphill 90deg --pitch 0.05
      pupper-analysis stand v3 --step FR=0.02 --move RL=-0.01,0.02 --figure stance.png
      pupper-analysis stand --base v3 --leg-scale 1.2 --minimum-stiffness
      pupper-analysis stand g1.xml --height 0.7
      pupper-analysis stand go1.urdf go1.xml --foot FL=FL_foot --foot FR=FR_foot \\
        --foot RL=RL_foot --foot RR=RR_foot --kp 100 --kd 3 --kp '*calf*=150'

    \b
    Exit status: 0 it holds, 1 it fails in simulation, 2 out of reach, not holdable or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.stance import study_stance

    task = asked.task()
    robot = asked.robot(words)
    kp, kd = asked.gains(robot)
    with shared.show_progress("solving the stance, and simulating it"):
        result = study_stance(robot, task, kp=kp, kd=kd, stiffness=minimum_stiffness)
    asked.show(result, robot)
    _draw(robot, result, figure)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


@shared.command()
@robot_argument
@robot_and_stance
@shared.figure_option
@shared.json_option
def workspace(
    asked: RobotAndTask, words: tuple[str, ...], figure: Path | None, json_path: Path | None
) -> None:
    """Find how far the base can rise, shift, roll, pitch and yaw from a stance.

    The feet stay planted. Each direction is searched separately, up to the first pose that is out
    of reach. Robot and stance are given as for `stand`.

    \b
    Examples:
      pupper-analysis workspace v3 --figure workspace.png
      pupper-analysis workspace v3-heavy --height 12cm --self-clearance 5mm
      pupper-analysis workspace v3 --swing FL=2cm --com inside --json workspace.json

    \b
    Exit status: 0 done, 2 the stance itself is out of reach, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.stance.workspace import base_workspace

    task = asked.task()
    robot = asked.robot(words)
    with shared.show_progress("searching how far the base can go"):
        result = base_workspace(robot, task)
    asked.show(result, robot)
    if figure is not None:
        from pupper_analysis.report.figures.workspace import workspace_figure

        workspace_figure(robot, result, figure)
        shared.confirm_written(figure)
    shared.finish_command(json_path, result, passed=True)


@shared.command()
@robot_argument
@at_option
@robot_and_task
@shared.json_option
def payload(asked: RobotAndTask, words: tuple[str, ...], at: str, json_path: Path | None) -> None:
    """Find the largest payload of a stance, and what fails beyond it.

    It is the largest mass with which `stand --payload` holds: reach and contacts, motor torques and
    servo stiffness each set a limit. The base moves from under the load where the CoM shall be over
    the feet. The robot is then judged as by `stand` with 97 % of it, and simulated with that and
    with 105 % while it is nudged from all sides. Robot and stance are given as for `stand`.

    \b
    Examples:
      pupper-analysis payload v3 --at 0,0,8cm
      pupper-analysis payload v3-long-leg --height 15cm --kp 20 --kd 0.5
      pupper-analysis payload original --swing FL=2cm --com inside --com-margin 1cm

    \b
    Exit status: 0 it carries something, 1 nothing, or it falls in simulation,
    2 out of reach, not holdable or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.payload import payload_limit

    task, place = asked.task(), shared.parse_place("at", at)
    robot = asked.robot(words)
    kp, kd = asked.gains(robot)
    with shared.show_progress("searching for the payload, and simulating it"):
        result = payload_limit(robot, task, place, kp=kp, kd=kd)
    asked.show(result, robot)
    shared.finish_command(json_path, result, passed=result.passed)


@shared.command()
@click.argument("objective", type=click.Choice(["utilisation", "margin", "payload"]))
@robot_argument
@at_option
@robot_and_task
@shared.figure_option
@shared.json_option
def best(
    asked: RobotAndTask,
    objective: str,
    words: tuple[str, ...],
    at: str,
    figure: Path | None,
    json_path: Path | None,
) -> None:
    """Search for the best stance: the base's pose and the place of each foot are free.

    OBJECTIVE is utilisation (lowest peak of torque / limit), margin (CoM deepest inside the support
    polygon) or payload (largest, at --at). The search starts from the given stance (as for `stand`)
    and keeps its ground, swing feet and margins. It takes a few seconds. The result is then printed
    and simulated as by `stand`.

    \b
    Examples:
      pupper-analysis best utilisation v3
      pupper-analysis best payload v3-heavy --at 0,0,8cm --figure best.png
      pupper-analysis best margin original --swing FL=2cm --com inside --self-clearance 5mm

    \b
    Exit status: 0 it holds (and so does its payload), 1 it fails in simulation,
    2 the stance itself is out of reach or not holdable, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.best import study_best
    from pupper_analysis.stance.optimize.search import Objective

    if objective != "payload":
        refuse_idle(objective, "at")
    task, place = asked.task(), shared.parse_place("at", at)
    robot = asked.robot(words)
    kp, kd = asked.gains(robot)
    with shared.show_progress("searching for the best stance, and simulating it"):
        result = study_best(robot, Objective(objective), task, place, kp=kp, kd=kd)
    asked.show(result, robot)
    _draw(robot, result.stance, figure)
    shared.finish_command(json_path, result, passed=result.passed)


def _draw(robot: Robot, stance: Stance, path: Path | None) -> None:
    """Draws a stance, if there is a file to draw it into."""
    if path is not None:
        from pupper_analysis.report.figures.pose import pose_figure

        pose_figure(robot, stance.stand, stance.statics, path)
        shared.confirm_written(path)
