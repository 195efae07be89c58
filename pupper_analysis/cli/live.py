"""``pupper-analysis live``: a page to play with."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.stance_options import (
    OWN,
    VARIANT,
    derived_variant,
    files_given,
    name_argument,
    print_notes,
    stance_options,
)
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.live.source import LiveSource


@click.command("live", context_settings=shared.CONTEXT, short_help="A page to play with stances.")
@name_argument
@stance_options(OWN, VARIANT)
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
def live_command(
    name: str | None,
    urdf: Path | None,
    mjcf: Path | None,
    feet: tuple[str, ...],
    pairs: tuple[str, ...],
    keyframe: str | None,
    packages: tuple[str, ...],
    base: str | None,
    leg_scale: float | None,
    torso_mass_scale: float | None,
    state: str,
    language: str,
    host: str,
    port: int | None,
    no_browser: bool,
) -> None:
    """Open a page with sliders for a stance that shows its torques, contact forces and sag.

    NAME is a variant (v3 by default). Each browser that opens the page has its own session.
    Only this machine can reach the page, unless --host is given: then anyone can who reaches
    the port and has the printed address with its token. The page is served until Ctrl-C.

    \b
    Examples:
      pupper-analysis live
      pupper-analysis live long-leg --port 8080 --no-browser
      pupper-analysis live v3 --language zh
      pupper-analysis live v3 --state 'height:120;roll:5;lift:FL,20'
      pupper-analysis live --urdf go1.urdf --mjcf go1.xml

    \b
    Exit status: 130 ended by Ctrl-C, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.live.door import is_loopback
    from pupper_analysis.live.server import Page, serve
    from pupper_analysis.live.state import parse_state
    from pupper_analysis.live.viser_parts import import_viser

    import_viser()  # before anything is loaded
    begin = parse_state(state)
    derived = derived_variant(base, leg_scale, torso_mass_scale)
    source: LiveSource
    if urdf or mjcf or feet or pairs or keyframe or packages:
        if name is not None or derived is not None:
            raise ConfigurationError("NAME", diagnose("one-robot-of-three-ways"))
        from pupper_analysis.live.source import UploadedPair

        with shared.show_progress("preparing the robot: feet, start pose, servos"):
            source = UploadedPair.of(files_given(urdf, mjcf, feet, pairs, keyframe, packages))
        print_notes(source.robot({}))
    else:
        from pupper_analysis.pupper.live import LiveVariants
        from pupper_analysis.pupper.variants import variant_spec

        if name is not None and derived is not None:
            raise ConfigurationError("NAME", diagnose("one-variant-of-two-ways"))
        source = LiveVariants(derived if derived is not None else variant_spec(name or "v3"))
    with shared.show_progress("making the page"):
        page = Page(source, begin, language=language, host=host, port=port)
    click.echo(f"{page.address}  (Ctrl-C ends it)")
    if not is_loopback(host):
        click.echo(
            f"warning: whoever can reach {host} and has this address, with its token, can use the "
            "page; what is said on the way is not encrypted",
            err=True,
        )
    serve(page, browser=not no_browser, wait=threading.Event().wait)
