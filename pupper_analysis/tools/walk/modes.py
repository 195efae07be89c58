"""Option ``--policy`` of the commands ``push`` and ``payload``.

Both modes use the search of `walk`, so that all commands give the same result.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_unused
from pupper_analysis.cli.robots import (
    RobotOptions,
    add_options,
    load_selected_robot,
    name_uniquely,
    print_notes,
)
from pupper_analysis.cli.shared import Command
from pupper_analysis.prepare.convert.files import RobotFiles

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot

CONTRACT_OPTION = shared.file_option(
    "--contract",
    help=(
        "TOML file of the observation and action of the policy; by default the file beside the "
        "policy."
    ),
)
"""Option ``--contract`` of the commands that read a walking policy."""

COMMAND_OPTION = click.option(
    "--command",
    "command_text",
    default="0.5,0,0",
    show_default=True,
    metavar="VX,VY,W",
    help="Speed forward and to the left (m/s), and turning to the left (rad/s).",
)
"""Option ``--command`` of the commands that simulate a walking policy: its velocity command."""

_QUANTITIES_OF_COMMAND = {
    "push": (("push-forward", "push-left"), "How hard it can be pushed while this policy walks it"),
    "payload": (("payload",), "What it carries while this policy walks it"),
}
"""Varied quantities of each command, and the help text of the option ``--policy``."""


def load_walking_robot(
    source: str | VariantSpec | RobotFiles, style: str, *, everything: bool
) -> Robot:
    """Load a robot for walking, and print the notes on a robot of files.

    Args:
        source: Variant, or files.
        style: ``text``, or ``markdown``: nothing is printed, since the page contains the notes.
        everything: True to print all notes.
    """
    robot = load_selected_robot(source)
    # In Markdown the notes are part of the page.
    if isinstance(source, RobotFiles) and style == "text":
        print_notes(robot, everything=everything)
    return robot


def _add_policy_mode(name: str, command: Command) -> Command:
    """Return a copy of a command with the option ``--policy``."""
    callback = command.callback
    assert callback is not None
    quantities, question = _QUANTITIES_OF_COMMAND[name]
    options = (
        shared.file_option(
            "--policy",
            help=f"{question}: ONNX, RTNeural's JSON, or TorchScript; as `walk --vary "
            f"{','.join(quantities)}`, of v3 by default.",
        ),
        CONTRACT_OPTION,
        COMMAND_OPTION,
        click.option(
            "--seeds",
            type=int,
            help=("With --policy: number of runs with different initial states. [default: 5]"),
        ),
        click.option(
            "--seconds", type=float, help=("With --policy: duration of a run (s). [default: 5]")
        ),
    )
    added: Any = click.command(**{})(add_options(options)(lambda: None)).params
    option_names = tuple(str(option.name) for option in added)
    allowed = {"words", *(field.name for field in fields(RobotOptions)), *option_names}
    allowed |= {"style", "everything", "json_path", "report_path", "force"}

    def run(**values: Any) -> None:
        policy_options = {option: values.pop(option) for option in option_names}
        if policy_options["policy"] is None:
            refuse_alone(("--policy",), *option_names[1:])
            callback(**values)
            return
        refuse_unused("--policy", {"--policy": allowed})
        _run_policy_mode(
            name, quantities, **policy_options, which=RobotOptions.pop_from(values), **values
        )

    extended = copy.copy(command)
    extended.params, extended.callback = [*command.params, *added], run
    return extended


def _run_policy_mode(
    name: str,
    quantities: tuple[str, ...],
    *,
    which: RobotOptions,
    words: tuple[str, ...],
    policy: Path,
    contract: Path | None,
    command_text: str,
    seeds: int | None,
    seconds: float | None,
    style: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    **_: object,
) -> None:
    """Find and show the intervals of quantities within which a policy tracks the command.

    ``name`` is the command: ``push`` accepts several robots, others accept one.
    """
    from pupper_analysis.tools.walk.gait import parse_walking_command
    from pupper_analysis.tools.walk.intervals import tracked_intervals
    from pupper_analysis.tools.walk.policy import Policy

    command = parse_walking_command(command_text)
    loaded_policy = Policy.load(policy, contract)
    is_push = name == "push"
    sources = (which.select_robots(words) if is_push else [which.select_robot(words) or "v3"]) or [
        "v3"
    ]
    robots = [load_walking_robot(item, style, everything=everything) for item in sources]
    robots = name_uniquely(sources, robots) if is_push else robots
    arguments: dict[str, Any] = {"seeds": seeds, "seconds": seconds}
    arguments = {key: value for key, value in arguments.items() if value is not None}
    results = {}
    for robot in robots:
        with shared.show_progress(f"{robot.name} walks by {loaded_policy.name}"):
            results[robot.name] = tracked_intervals(
                robot, loaded_policy, command, quantities=quantities, **arguments
            )
    shared.show_results(results.items(), style, robots=robots, everything=everything)
    result: Any = results if is_push else results[robots[0].name]
    shared.write_page(report_path, result, robots)
    passed = all(item.passed for item in results.values())
    shared.finish_command(json_path, result, passed=passed)


MODES: Mapping[str, Callable[[Command], Command]] = {
    name: partial(_add_policy_mode, name) for name in _QUANTITIES_OF_COMMAND
}
"""{command of another tool: function that adds the option ``--policy`` to it}. With this option,
the command evaluates a walking policy instead of a stand."""
