"""``pupper-analysis view`` and ``drop``: a variant in MuJoCo's viewer, or in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis import kinds
from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import (
    FILES,
    VARIANT,
    RobotOptions,
    add_options,
    print_notes,
    robot_argument,
    robot_from,
    with_robot,
)
from pupper_analysis.convert.files import RobotFiles
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot


@shared.command()
@robot_argument
@add_options(FILES, VARIANT)
@click.option(
    "--fixed-base",
    is_flag=True,
    help="Fix the base in the air. By default the robot falls and lands.",
)
@click.option("--headless", is_flag=True, help="Open no window; print the model and its IMU.")
@with_robot
def view(
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
    from pupper_analysis.pupper import viewer

    meant = which.one(words) or "v3"
    robot = _robot(meant, fixed_base=True) if fixed_base else _robot(meant)
    viewer.view_robot(robot, fixed=fixed_base, headless=headless)


@shared.command()
@robot_argument
@add_options(FILES, VARIANT)
@click.option("--headless", is_flag=True, help="Open no window; simulate and print the result.")
@click.option("--seconds", type=float, help="Simulated time of the drop (s). [default: 6]")
@click.option(
    "--demo", type=click.Choice(["squat", "sway", "lift"]), help="Run a motion instead of a drop."
)
@shared.output_option(
    "--csv",
    holds=kinds.PATH_TABLE,
    help="Write the path of the demo as CSV to this file, or to standard output (-).",
)
@with_robot
def drop(
    which: RobotOptions,
    words: tuple[str, ...],
    headless: bool,
    seconds: float | None,
    demo: str | None,
    csv: Path | None,
) -> None:
    """Drop a robot from its home pose; on macOS, run it with mjpython.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF.

    With --demo it moves instead: it squats, sways from side to side, or shifts its weight and lifts
    a foot. Every sample of the path is a whole-body stand in balance.

    \b
    Examples:
      pupper-analysis drop v3 --demo squat
      pupper-analysis drop go2.urdf --headless

    \b
    Exit status: 0 the robot stands or follows the path, 1 it does not, 2 bad input.
    """  # noqa: D301 - click reads the \b
    robot = _robot(which.one(words) or "v3")
    if demo is None:
        if csv is not None:
            raise ConfigurationError("--csv", diagnose("csv-without-demo"))
        from pupper_analysis.pupper import viewer
        from pupper_analysis.pupper.drop import DEFAULT_SECONDS

        seconds = DEFAULT_SECONDS if seconds is None else seconds
        good = viewer.drop_and_report(robot, headless=headless, seconds=seconds)
    else:
        if seconds is not None:
            raise ConfigurationError("--seconds", diagnose("demo-has-its-duration"))
        from pupper_analysis.pupper import demo as demos

        good = demos.demo(demo, robot, headless=headless, csv=csv)
    if not good:
        click.get_current_context().exit(shared.FAILED)


def _robot(meant: str | VariantSpec | RobotFiles, **more: bool) -> str | VariantSpec | Robot:
    """Returns a variant as it is, and the robot of files, of which it is told what was assumed."""
    if not isinstance(meant, RobotFiles):
        return meant
    robot = robot_from(meant, **more)
    print_notes(robot)
    return robot
