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
    from pupper_analysis.tools.live.server import Page, serve
    from pupper_analysis.tools.live.state import load_source, parse_state
    from pupper_analysis.tools.live.viser_parts import import_viser

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
        from pupper_analysis.tools.live.variants import LiveVariants

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
