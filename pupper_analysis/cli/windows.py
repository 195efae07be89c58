"""``pupper-analysis view`` and ``drop``: Pupper v3 in MuJoCo's viewer, or in words."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli.shared import CONTEXT, FAILED, check_outputs
from pupper_analysis.errors import ConfigurationError


@click.command(context_settings=CONTEXT, short_help="Show Pupper v3 in MuJoCo's viewer.")
@click.option("--fixed", is_flag=True, help="Fix the base in the air; else it falls and lands.")
@click.option("--headless", is_flag=True, help="Open no window: print the model and its IMU.")
def view(fixed: bool, headless: bool) -> None:
    """Show Pupper v3 in MuJoCo's viewer (on macOS, run this with mjpython)."""
    from pupper_analysis.pupper import viewer

    viewer.view(fixed=fixed, headless=headless)


@click.command(context_settings=CONTEXT, short_help="Drop Pupper v3, and see that it stands.")
@click.option("--headless", is_flag=True, help="Open no window: simulate, and print the result.")
@click.option("--seconds", type=float, help="Simulated time of the drop (s).  [default: 6]")
@click.option("--demo", type=click.Choice(["squat", "sway", "lift"]), help="Let it move instead.")
@click.option(
    "--csv",
    type=click.Path(path_type=Path),
    help="Write the path of a demo here, or to -.",
)
def drop(headless: bool, seconds: float | None, demo: str | None, csv: Path | None) -> None:
    """Drop Pupper v3 from its home pose, and see that it stands (on macOS, run with mjpython).

    With --demo it moves instead: squat, sway from side to side, or shift its weight and lift a
    foot. Every sample of the path is a stand in balance, solved on the whole body.

    \b
    Exit status: 0 it stands, or follows the path; 1 it does not; 2 bad input.
    """  # noqa: D301 - click reads the \b
    if demo is None:
        if csv is not None:
            raise ConfigurationError("--csv", "only a demo has a path to write; give --demo too")
        from pupper_analysis.pupper import viewer
        from pupper_analysis.pupper.drop import DEFAULT_SECONDS

        seconds = DEFAULT_SECONDS if seconds is None else seconds
        good = viewer.stand(headless=headless, seconds=seconds)
    else:
        if seconds is not None:
            raise ConfigurationError("--seconds", "a demo has its own duration")
        from pupper_analysis.pupper import demo as demos

        check_outputs(csv)
        good = demos.demo(demo, headless=headless, csv=csv)
    if not good:
        click.get_current_context().exit(FAILED)
