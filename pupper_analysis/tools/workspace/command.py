"""Command ``pupper-analysis workspace``: find the range of the base with planted feet."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_stance


@shared.command("workspace")
@robot_argument
@robot_and_stance
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the range in which the base can rise, shift, roll, pitch and yaw from a stance.

    The feet stay planted. Each direction is searched separately, up to the first pose of the base
    without a solution; very short gaps are skipped. Robot and stance are given as for `stand`.

    \b
    Examples:
      pupper-analysis workspace v3 --report workspace.html
      pupper-analysis workspace v3-heavy --height 12cm --self-clearance 5mm
      pupper-analysis workspace v3 --swing FL=2cm --com inside \\
        --json workspace.json

    Exit status: 0 done, 1 a file does not state the mass of a moving link, 2 the stance itself is
    out of reach, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.stance.workspace import base_workspace

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None)
    robot.check_floating("range-of-fixed-base")
    with shared.show_progress("searching how far the base can go"):
        result = base_workspace(robot, task)
    request.show(result, robot)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
