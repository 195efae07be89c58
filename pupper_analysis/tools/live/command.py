"""``pupper-analysis live``: a page to play with."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_idle
from pupper_analysis.cli.robots import (
    FILES,
    VARIANT,
    RobotOptions,
    add_options,
    print_notes,
    robot_argument,
    with_robot,
)
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles

if TYPE_CHECKING:
    from pupper_analysis.tools.live.state import LiveSource
from collections.abc import Mapping

from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VARIANTS, Scaled, VariantSpec
from pupper_analysis.robot.robot import Robot


@shared.command("live")
@robot_argument
@add_options(FILES, VARIANT)
@click.option(
    "--state",
    default="",
    metavar="STATE",
    help="Initial state of the page, as the page's address shows it; e.g. 'height:120;roll:5'.",
)
@click.option(
    "--language",
    type=click.Choice(["en", "zh"]),
    default="en",
    show_default=True,
    help="Language of the page: English (en) or Chinese (zh).",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to serve on; e.g. 0.0.0.0 for all machines that can reach this one.",
)
@click.option("--port", type=int, help="Port to serve on. [default: any that is free]")
@click.option("--no-browser", is_flag=True, help="Do not open a browser; print the address.")
@with_robot
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    state: str,
    language: str,
    host: str,
    port: int | None,
    no_browser: bool,
) -> None:
    """Open a page with sliders for a stance that shows its torques, contact forces and sag.

    Of an arm, or any robot with a fixed base, there is a slider for each joint.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF. Each browser that
    opens the page has its own session.
    Only this machine can reach the page, unless --host is given: then anyone can who reaches
    the port and has the printed address with its token. The page is served until Ctrl-C.

    \b
    Examples:
      pupper-analysis live
      pupper-analysis live long-leg --port 8080 --no-browser
      pupper-analysis live v3 --language zh
      pupper-analysis live v3 --state 'height:120;roll:5;lift:FL,20'
      pupper-analysis live go1.urdf

    \b
    Exit status: 130 ended by Ctrl-C, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.live.door import is_loopback
    from pupper_analysis.tools.live.held import HeldPage
    from pupper_analysis.tools.live.render import import_viser
    from pupper_analysis.tools.live.server import Page, serve
    from pupper_analysis.tools.live.state import load_source, parse_state

    import_viser()  # before anything is loaded
    begin = parse_state(state)
    meant = which.one(words) or "v3"
    source: LiveSource
    if isinstance(meant, RobotFiles):
        with shared.show_progress("preparing the robot: feet, start pose, servos"):
            source = load_source(RobotFiles.of(*meant.models, **meant.options))
        if not source.loaded.floating:
            refuse_idle(str(meant), "state")
        print_notes(source.robot({}))
    else:
        from pupper_analysis.pupper.variants import variant_spec
        from pupper_analysis.tools.live.command import LiveVariants

        source = LiveVariants(variant_spec(meant))
    with shared.show_progress("making the page"):
        page: Page | HeldPage
        if isinstance(source, FileSource) and not source.loaded.floating:
            page = HeldPage(source, language=language, host=host, port=port)
        else:
            page = Page(source, begin, language=language, host=host, port=port)
    click.echo(f"{page.address}  (Ctrl-C ends it)")
    if not is_loopback(host):
        click.echo(
            f"warning: whoever can reach {host} and has this address, with its token, can use the "
            "page; what is said on the way is not encrypted",
            err=True,
        )
    serve(page, browser=not no_browser, wait=threading.Event().wait)


class LiveVariants(Scaled):
    """The robots that scales make of a variant."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales.

        Raises:
            VariantError: If a scale is not a finite positive number, or nothing can be made so.
        """
        return load_variant(self._spec(scales))

    def python(self, scales: Mapping[str, float]) -> str:
        """Returns the call of ``load_variant``."""
        spec = self._spec(scales)
        if spec.name in VARIANTS:
            return f"pa.load_variant({spec.name!r})"
        return (
            f"pa.load_variant(pa.pupper.VariantSpec(base={spec.base!r}, "
            f"leg_scale={spec.leg_scale!r}, torso_mass_scale={spec.torso_mass_scale!r}))"
        )

    def arguments(self, scales: Mapping[str, float]) -> list[str]:
        """Returns a variant's name, or the options of its scales."""
        spec = self._spec(scales)
        if spec.name in VARIANTS:
            return [spec.name]
        words = ["--base", spec.base]
        for name, value in (
            ("--leg-scale", spec.leg_scale),
            ("--torso-mass-scale", spec.torso_mass_scale),
        ):
            words += [name, repr(value)] if value != 1.0 else []
        return words

    def _spec(self, scales: Mapping[str, float]) -> VariantSpec:
        """Returns the variant of some scales, by the name that it has, if any."""
        made = self.scaled(scales)
        return {spec: spec for spec in VARIANTS.values()}.get(made, made)
