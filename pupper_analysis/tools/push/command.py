"""Command ``pupper-analysis push``: find the largest pushes from which robots recover."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robots_argument
from pupper_analysis.cli.stance_options import (
    MOTOR_OPTION,
    RobotAndTask,
    apply_motors,
    robot_and_task,
)


@shared.command("push")
@robots_argument
@click.option(
    "--directions",
    default=12,
    show_default=True,
    help="Number of push directions, evenly spaced (0 deg: forward, 90 deg: left); e.g. 4.",
)
@click.option(
    "--resolution",
    type=float,
    metavar="NS",
    help="Resolution of the impulses (N s); e.g. 0.1. Default: 0.02, or less for a small robot.",
)
@MOTOR_OPTION
@robot_and_task
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    directions: int,
    resolution: float | None,
    motors: tuple[str, ...],
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the largest horizontal push, in each direction, that standing robots survive.

    Each ROBOT is a variant, a URDF, an MJCF, or both: the URDF and then the MJCF. By default the
    six variants are pushed. Robot and stance are given as for `stand`. A push lasts 20 ms and acts
    at the CoM of the base. A robot survives a push if the robot comes to rest upright and only the
    feet touch the ground: within 6 s, or within 60 s if the robot still moves after 6 s. The legs
    are lengthened by the depth to which the feet penetrate MuJoCo's soft ground.

    \b
    Examples:
      pupper-analysis push v3 v3-heavy --figure push.png
      pupper-analysis push original --height 0.14 --directions 4 --resolution 0.1
      pupper-analysis push v3 --swing FL=2cm --com inside --com-margin 1cm
      pupper-analysis push --base v3 --torso-mass-scale 1.5 --kp 20 --kd 0.5
      pupper-analysis push v3 --motor steadywin-gim4305-10

    Exit status: 0 done, 1 a robot falls even without a push, or a motor cannot exert the torques at
    the joint speed, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present.document import Name, text
    from pupper_analysis.pupper.variants import VARIANTS
    from pupper_analysis.tools.push.recovery import study_pushes

    task = request.task()
    robots = request.robots(words, default=tuple(VARIANTS), visuals=report_path is not None)
    fitted = [apply_motors(motors, robot, request.effort) for robot in robots]
    robots = [robot for robot, _ in fitted]
    kp, kd = request.gains(robots[0])
    names = [robot.name for robot in robots]
    with shared.show_progress(text("push-progress", names=Name(", ".join(names)))):
        results = study_pushes(
            robots,
            task,
            kp=kp,
            kd=kd,
            directions=directions,
            resolution=resolution,
            motors={robot.name: assigned for robot, assigned in fitted},
        )
    shared.show_results(
        results.items(), request.style, robots=robots, everything=request.everything
    )
    if figure is not None:
        from pupper_analysis.present.plots import make_joint_title
        from pupper_analysis.tools.push.document import push_document
        from pupper_analysis.tools.push.figures import push_figure

        title = make_joint_title([push_document(result) for result in results.values()])
        push_figure(
            {name: result.recovery for name, result in results.items()}, figure, title=title
        )
        shared.confirm_written(figure)
    shared.write_page(report_path, results, robots)
    shared.finish_command(
        json_path, results, passed=all(result.passed for result in results.values())
    )
