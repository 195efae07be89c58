"""``pupper-analysis path`` and ``push``: how robots come to stand, and what makes them fall."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis import kinds
from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument, robots_argument
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_task


@shared.command()
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
@shared.output_option(
    "--npz",
    holds=kinds.PATH_ARRAYS,
    help="Write the arrays of the path to this NumPy file (.npz).",
)
@robot_and_task
@shared.json_option
@shared.report_option
def path(
    asked: RobotAndTask,
    words: tuple[str, ...],
    seconds: float,
    csv: Path | None,
    npz: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Plan a path from the nominal stand to a stance, and simulate it.

    The feet start where the stance has them; before one is lifted, the weight is shifted onto the
    others. Every sample is a stand in dynamic balance, along a minimum-jerk law. Robot and stance
    are given as for `stand`.

    \b
    Examples:
      pupper-analysis path v3 --swing FL=2cm --com inside --seconds 4 --csv lift.csv
      pupper-analysis path original --height 14cm
      pupper-analysis path v3-heavy --pitch 5deg --seconds 3 --npz pitch.npz

    \b
    Exit status: 0 the robot follows the path, 1 it does not, 2 out of reach, not holdable or
    bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.path import study_path

    task = asked.task()
    robot = asked.robot(words)
    kp, kd = asked.gains(robot)
    with shared.show_progress("solving the path, and simulating it"):
        result = study_path(robot, task, seconds, kp=kp, kd=kd)
    asked.show(result, robot)
    if csv is not None:
        result.path.to_csv(csv)
        shared.confirm_written(csv)
    if npz is not None:
        result.path.to_npz(npz)
        shared.confirm_written(npz)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


@shared.command()
@robots_argument
@click.option(
    "--directions",
    default=12,
    show_default=True,
    help="Number of push directions, evenly spaced; e.g. 4.",
)
@click.option(
    "--resolution",
    default=0.02,
    show_default=True,
    metavar="NS",
    help="Resolution of the impulses (N s); e.g. 0.1.",
)
@robot_and_task
@shared.figure_option
@shared.json_option
@shared.report_option
def push(
    asked: RobotAndTask,
    words: tuple[str, ...],
    directions: int,
    resolution: float,
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the largest horizontal push, in each direction, that standing robots survive.

    Each ROBOT is a variant, a URDF, an MJCF, or both: the URDF and then the MJCF. By default the
    six variants are pushed (about three seconds each). Robot and
    stance are given as for `stand`. A push lasts 20 ms and acts at the CoM of the base. A robot
    survives it if it is upright and at rest after 6 s and only its feet ever touched the
    ground. The legs are lengthened by the depth to which the feet penetrate MuJoCo's soft
    ground.

    \b
    Examples:
      pupper-analysis push v3 v3-heavy --figure push.png
      pupper-analysis push original --height 0.12 --directions 4 --resolution 0.1
      pupper-analysis push v3 --swing FL=2cm --com inside --com-margin 1cm
      pupper-analysis push --base v3 --torso-mass-scale 1.5 --kp 20 --kd 0.5

    \b
    Exit status: 0 done, 1 a robot falls even without a push, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.push import study_pushes
    from pupper_analysis.pupper.variants import VARIANTS

    task = asked.task()
    robots = asked.robots(words, default=tuple(VARIANTS))
    kp, kd = asked.gains(robots[0])
    with shared.show_progress(
        f"pushing {', '.join(robot.name for robot in robots)}: some three seconds each"
    ):
        results = study_pushes(
            robots,
            task,
            kp=kp,
            kd=kd,
            directions=directions,
            resolution=resolution,
        )
    shared.show_results(results.items(), asked.style, robots=robots, everything=asked.everything)
    if figure is not None:
        from pupper_analysis.report.figures.push import push_figure

        push_figure({name: result.recovery for name, result in results.items()}, figure)
        shared.confirm_written(figure)
    shared.write_page(report_path, results, robots)
    shared.finish_command(
        json_path, results, passed=all(result.passed for result in results.values())
    )
