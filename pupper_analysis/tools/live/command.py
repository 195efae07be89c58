"""Command ``pupper-analysis live``: a page to play with stances, or MuJoCo's viewer."""

from __future__ import annotations

import gc
import threading
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from pupper_analysis.base.diagnostics import Phrase
from pupper_analysis.base.runs import current_language
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    RobotOptions,
    add_options,
    load_selected_robot,
    pass_robot_options,
    print_robot_notes,
    robot_argument,
)
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, make_options, make_task, stance_option
from pupper_analysis.cli.stance_options import GAIN_OPTIONS, PAYLOAD_OPTIONS
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.present.document import text
from pupper_analysis.tools.walk.options import COMMAND_OPTION, CONTRACT_OPTION, load_walking_robot

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.tools.live.server import ServedPage, ServeOptions
    from pupper_analysis.tools.live.state import State

PYTHON_THRESHOLDS = 700, 10, 10
"""Arguments of `gc.set_threshold` while the page runs: number of new objects before a collection of
generation 0, and numbers of collections of generations 0 and 1 before a collection of the next
generation. The values are the defaults of Python up to 3.12. They replace `cli.GC_THRESHOLDS`,
which postpone collections, because the page runs for hours."""

_ROBOT_OPTIONS = frozenset(("words", *(option.name for option in fields(RobotOptions))))
"""Names of the command's parameters that all modes accept: files and options of the robot."""

_PAGE = Phrase("the page", "网页")
"""Default mode of `live`: the page with sliders, which no option selects."""

_OPTIONS_OF_MODE = {
    "--mujoco": {*_ROBOT_OPTIONS, "viewer", "headless", "fixed_base"},
    "--drop": {*_ROBOT_OPTIONS, "dropped", "headless"},
    "--policy": {
        *_ROBOT_OPTIONS,
        "policy",
        "contract",
        "command_text",
        "host",
        "port",
        "no_browser",
    },
    _PAGE: {*_ROBOT_OPTIONS, "stance", "host", "port", "no_browser"},
}
"""{option that selects a mode of `live`, or `_PAGE`: names of the parameters that the mode
uses}. Other options are refused in this mode.
"""


@shared.command("live")
@robot_argument
@add_options(FILE_OPTIONS, VARIANT_OPTIONS)
@click.option(
    "--stance",
    type=click.Path(path_type=Path),
    help="TOML file of the page's initial stance, as saved by the page; e.g. stance.toml.",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to serve on; e.g. 0.0.0.0 for all machines that can reach this one.",
)
@click.option("--port", type=int, help="Port to serve on. [default: any free port]")
@click.option("--no-browser", is_flag=True, help="Do not open a browser; print the address.")
@click.option(
    "--mujoco", "viewer", is_flag=True, help=("Open MuJoCo's own viewer instead of the page.")
)
@click.option(
    "--drop",
    "dropped",
    is_flag=True,
    help=("Drop the robot in MuJoCo's viewer, and report if the robot stands."),
)
@click.option(
    "--headless",
    is_flag=True,
    help="With --mujoco or --drop: open no window; print joints, IMU and result.",
)
@click.option(
    "--fixed-base", is_flag=True, help="With --mujoco: fix the base in the air, without gravity."
)
@shared.file_option(
    "--policy",
    help=("Simulate the robot with this policy; the page commands and pushes the robot."),
)
@CONTRACT_OPTION
@COMMAND_OPTION
@pass_robot_options
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    policy: Path | None,
    contract: Path | None,
    command_text: str,
    stance: Path | None,
    host: str,
    port: int | None,
    no_browser: bool,
    viewer: bool,
    dropped: bool,
    headless: bool,
    fixed_base: bool,
) -> None:
    """Open a page with sliders for a stance, which shows torques, contact forces and sag.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF. Each browser that
    opens the page has a separate session.
    Only this machine can reach the page. With --host, other machines can open the page with the
    printed address, which contains a token. The page is served until Ctrl-C.

    With --policy, the page shows the walking robot instead. With --mujoco or --drop, MuJoCo's own
    viewer opens instead; with --headless, no window opens.

    \b
    Examples:
      pupper-analysis live
      pupper-analysis live long-leg --port 8080 --no-browser
      pupper-analysis live v3 --language zh
      pupper-analysis live go1.urdf
      pupper-analysis live v3 --policy policy_latest.json --command 0.5,0,0
      pupper-analysis live long-leg --mujoco --fixed-base
      pupper-analysis live go2.urdf --drop --headless

    Exit status: 0 done (with --drop: the robot stands), 1 with --drop: the robot does not stand,
    its unmodified file may behave differently, or a mass is unknown, 130 ended by Ctrl-C, 2 bad
    input.
    """  # noqa: D301 - click reads the \b
    modes = {"--mujoco": viewer, "--drop": dropped, "--policy": policy is not None}
    mode = next((name for name, chosen in modes.items() if chosen), _PAGE)
    refuse_unused(mode, _OPTIONS_OF_MODE)
    selection = which.select_robot(words) or "v3"
    server_options: ServeOptions = {"language": current_language(), "host": host, "port": port}
    if policy is not None:
        _open_walk(
            selection, policy, contract, command_text, browser=not no_browser, **server_options
        )
        return
    if mode != _PAGE:
        from pupper_analysis.tools.live import window

        robot = load_selected_robot(selection, fixed_base=fixed_base)
        if isinstance(selection, RobotFiles):
            print_robot_notes(robot)
        if not dropped:
            window.view_robot(robot, headless=headless)
            return
        if not window.drop_and_report(robot, headless=headless):
            click.get_current_context().exit(shared.EXIT_FAILED)
        return
    _open_page(selection, stance, browser=not no_browser, **server_options)


def read_stance(path: Path) -> State:
    """Read a stance file as the state of the live page: stance, payload and servo gains.

    Raises:
        ConfigurationError: If the file is not a stance, an option is unknown or has no slider, or a
            value is invalid.
        click.BadParameter: If a value is not of the type of the option.
    """
    from pupper_analysis.tools.live.state import (
        ROBOT_SLIDER_FIELDS,
        convert_to_page_units,
        make_state,
    )

    def accept_options(**_: object) -> None:
        """Do nothing: this command exists so that click parses the options of a stance file."""

    options = add_options((stance_option,), PAYLOAD_OPTIONS, GAIN_OPTIONS, make_options())
    parameters = (
        click.command(options(accept_options))
        .make_context("stance", ["--stance", str(path)])
        .params
    )
    robot_values = {"payload": parameters["payload"]}
    if parameters["payload_at"] is not None:
        point = shared.parse_place("payload-at", parameters["payload_at"])
        robot_values["payload_at"] = convert_to_page_units(ROBOT_SLIDER_FIELDS["payload_at"], point)
    for name in ("kp", "kd"):
        for gain in parameters[name]:
            _, robot_values[name] = shared.parse_number_assignment(name, f"*={gain}")
    return make_state(make_task({name: parameters[name] for name in OPTION_FIELDS}), **robot_values)


def _open_page(
    selection: str | VariantSpec | RobotFiles,
    stance: Path | None,
    *,
    browser: bool,
    **server_options: Unpack[ServeOptions],
) -> None:
    """Serve the page with the sliders of a robot until Ctrl-C.

    ``stance`` is the file of the stance that the page shows first.
    """
    from pupper_analysis.tools.live.render import import_viser
    from pupper_analysis.tools.live.server import Page

    import_viser()  # before the robot is loaded
    initial_state = None if stance is None else read_stance(stance)
    robot = load_walking_robot(selection, "text", everything=False)
    with shared.show_progress("making the page"):
        page = Page(robot, initial_state, **server_options)
    _serve_page(page, server_options["host"], browser=browser)


def _open_walk(
    selection: str | VariantSpec | RobotFiles,
    policy: Path,
    contract: Path | None,
    command_text: str,
    *,
    browser: bool,
    **server_options: Unpack[ServeOptions],
) -> None:
    """Serve the page of a walking policy until Ctrl-C.

    ``command_text`` is the initial velocity command, such as ``0.5,0,0`` (`parse_walking_command`).
    """
    from pupper_analysis.tools.live.render import import_viser
    from pupper_analysis.tools.live.walking import WalkPage
    from pupper_analysis.tools.walk.gait import parse_walking_command
    from pupper_analysis.tools.walk.policy import Policy

    import_viser()  # before anything is loaded
    command, loaded_policy = parse_walking_command(command_text), Policy.load(policy, contract)
    robot = load_walking_robot(selection, "text", everything=False)
    with shared.show_progress("making the page"):
        page = WalkPage(robot, loaded_policy, command, **server_options)
    _serve_page(page, server_options["host"], browser=browser)


def _serve_page(page: ServedPage, host: str, *, browser: bool) -> None:
    """Print the address of a page, warn if other machines can reach it, and serve until Ctrl-C."""
    from pupper_analysis.tools.live.access import is_loopback
    from pupper_analysis.tools.live.server import serve

    local = is_loopback(host)
    reach = text("page-for-this-machine") if local else text("page-for-machines", host=host)
    shared.print_text(text("page-is-served", address=page.address))
    shared.print_text(reach, indent=2)
    if not local:
        shared.print_text(text("page-is-not-encrypted"), err=True)
    restore_garbage_collection()
    serve(page, browser=browser, wait=threading.Event().wait)


def restore_garbage_collection() -> None:
    """Set the thresholds `PYTHON_THRESHOLDS` of garbage collection, and exempt all present objects.

    Commands postpone collections because commands end soon (``cli.GC_THRESHOLDS``). A page runs for
    hours, and the PlaCo robots are in reference cycles.
    """
    gc.collect()
    gc.freeze()  # loaded objects are permanent: exclude them from collections
    gc.set_threshold(*PYTHON_THRESHOLDS)
