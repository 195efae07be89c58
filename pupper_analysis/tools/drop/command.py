"""``pupper-analysis drop``: a robot falls and stands."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.base import kinds
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
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


@shared.command("drop")
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
def command(
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
    robot = shown_robot(which.one(words) or "v3")
    if demo is None:
        if csv is not None:
            raise ConfigurationError("--csv", diagnose("csv-without-demo"))
        from pupper_analysis.tools.view import viewer
        from pupper_analysis.tools.view.viewer import DEFAULT_SECONDS

        seconds = DEFAULT_SECONDS if seconds is None else seconds
        good = viewer.drop_and_report(robot, headless=headless, seconds=seconds)
    else:
        if seconds is not None:
            raise ConfigurationError("--seconds", diagnose("demo-has-its-duration"))
        from pupper_analysis.tools.drop import demo as demos

        good = demos.demo(demo, robot, headless=headless, csv=csv)
    if not good:
        click.get_current_context().exit(shared.FAILED)
