"""``pupper-analysis view`` and ``drop``: a variant in MuJoCo's viewer, or in words."""

from __future__ import annotations

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import (
    FILES,
    VARIANT,
    RobotOptions,
    add_options,
    robot_argument,
    shown_robot,
    with_robot,
)


@shared.command("view")
@robot_argument
@add_options(FILES, VARIANT)
@click.option(
    "--fixed-base",
    is_flag=True,
    help="Fix the base in the air. By default the robot falls and lands.",
)
@click.option("--headless", is_flag=True, help="Open no window; print the model and its IMU.")
@with_robot
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    fixed_base: bool,
    headless: bool,
) -> None:
    """Show a robot in MuJoCo's viewer; on macOS, run it with mjpython.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF.

    \b
    Examples:
      pupper-analysis view
      pupper-analysis view long-leg --fixed-base
      pupper-analysis view go2.urdf
      pupper-analysis view --base v3 --leg-scale 1.2 --headless
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.view import viewer

    meant = which.one(words) or "v3"
    robot = shown_robot(meant, fixed_base=True) if fixed_base else shown_robot(meant)
    viewer.view_robot(robot, fixed=fixed_base, headless=headless)
