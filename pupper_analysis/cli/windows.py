"""``pupper-analysis view`` and ``drop``: a variant in MuJoCo's viewer, or in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.stance_options import (
    VARIANT,
    derived_variant,
    name_argument,
    stance_options,
)
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec


@click.command(context_settings=shared.CONTEXT, short_help="Show a variant in MuJoCo's viewer.")
@name_argument
@stance_options(VARIANT)
@click.option(
    "--fixed-base",
    is_flag=True,
    help="Fix the base in the air. By default the robot falls and lands.",
)
@click.option("--headless", is_flag=True, help="Open no window; print the model and its IMU.")
def view(
    name: str | None,
    base: str | None,
    leg_scale: float | None,
    torso_mass_scale: float | None,
    fixed_base: bool,
    headless: bool,
) -> None:
    """Show a variant (v3 by default) in MuJoCo's viewer; on macOS, run it with mjpython.

    \b
    Examples:
      pupper-analysis view
      pupper-analysis view long-leg --fixed-base
      pupper-analysis view --base v3 --leg-scale 1.2 --headless
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.pupper import viewer

    variant = _variant(name, base, leg_scale, torso_mass_scale)
    viewer.view_variant(variant, fixed=fixed_base, headless=headless)


@click.command(
    context_settings=shared.CONTEXT, short_help="Drop a variant, and see that it stands."
)
@name_argument
@stance_options(VARIANT)
@click.option("--headless", is_flag=True, help="Open no window; simulate and print the result.")
@click.option("--seconds", type=float, help="Simulated time of the drop (s). [default: 6]")
@click.option(
    "--demo", type=click.Choice(["squat", "sway", "lift"]), help="Run a motion instead of a drop."
)
@shared.file_option(
    "--csv",
    help="Write the path of the demo as CSV to this file, or to standard output (-).",
)
def drop(
    name: str | None,
    base: str | None,
    leg_scale: float | None,
    torso_mass_scale: float | None,
    headless: bool,
    seconds: float | None,
    demo: str | None,
    csv: Path | None,
) -> None:
    """Drop a variant (v3 by default) from its home pose; on macOS, run it with mjpython.

    With --demo it moves instead: it squats, sways from side to side, or shifts its weight and lifts
    a foot. Every sample of the path is a whole-body stand in balance.

    \b
    Exit status: 0 the robot stands or follows the path, 1 it does not, 2 bad input.
    """  # noqa: D301 - click reads the \b
    variant = _variant(name, base, leg_scale, torso_mass_scale)
    if demo is None:
        if csv is not None:
            raise ConfigurationError("--csv", diagnose("csv-without-demo"))
        from pupper_analysis.pupper import viewer
        from pupper_analysis.pupper.drop import DEFAULT_SECONDS

        seconds = DEFAULT_SECONDS if seconds is None else seconds
        good = viewer.drop_and_report(variant, headless=headless, seconds=seconds)
    else:
        if seconds is not None:
            raise ConfigurationError("--seconds", diagnose("demo-has-its-duration"))
        from pupper_analysis.pupper import demo as demos

        shared.check_outputs(csv)
        good = demos.demo(demo, variant, headless=headless, csv=csv)
    if not good:
        click.get_current_context().exit(shared.FAILED)


def _variant(
    name: str | None, base: str | None, leg_scale: float | None, torso_mass_scale: float | None
) -> str | VariantSpec:
    """Returns the variant that is named, or given by a base and its scales; v3 by default."""
    derived = derived_variant(base, leg_scale, torso_mass_scale)
    if derived is not None and name is not None:
        raise ConfigurationError("NAME", diagnose("one-variant-of-two-ways"))
    return derived if derived is not None else name or "v3"
