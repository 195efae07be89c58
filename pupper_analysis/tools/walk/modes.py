"""What a policy brings to other commands: ``push --policy`` and ``payload --policy``.

They are answered by `walk`'s own search, so that no two commands say different things.
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
    help="TOML of what the policy observes and commands; by default the one beside the policy.",
)
COMMAND_OPTION = click.option(
    "--command",
    "asked",
    default="0.5,0,0",
    show_default=True,
    metavar="VX,VY,W",
    help="Speed forward and to the left (m/s), and turning to the left (rad/s).",
)

_QUESTIONS = {
    "push": (("push-forward", "push-left"), "How hard it can be pushed while this policy walks it"),
    "payload": (("payload",), "What it carries while this policy walks it"),
}
"""{command: (quantities that are varied, what it answers)}."""


def load_walking_robot(
    meant: str | VariantSpec | RobotFiles, style: str, *, everything: bool
) -> Robot:
    """Loads a robot as its files have it, and prints what was added to them."""
    robot = load_selected_robot(meant)
    if isinstance(meant, RobotFiles) and style == "text":  # Markdown has them in its page
        print_notes(robot, everything=everything)
    return robot


def _with_policy(name: str, command: Command) -> Command:
    """Returns a command that has the mode as well."""
    before = command.callback
    assert before is not None
    quantities, question = _QUESTIONS[name]
    options = (
        shared.file_option(
            "--policy",
            help=f"{question}: ONNX, RTNeural's JSON, or TorchScript; as `walk --vary "
            f"{','.join(quantities)}`, of v3 by default.",
        ),
        CONTRACT_OPTION,
        COMMAND_OPTION,
        click.option("--seeds", type=int, help="With --policy: starts that differ. [default: 3]"),
        click.option("--seconds", type=float, help="With --policy: of a run (s). [default: 5]"),
    )
    added: Any = click.command(**{})(add_options(options)(lambda: None)).params
    own = tuple(str(option.name) for option in added)
    used = {"words", *(one.name for one in fields(RobotOptions)), *own}
    used |= {"style", "everything", "json_path", "report_path", "force"}

    def chosen(**given: Any) -> None:
        mine = {option: given.pop(option) for option in own}
        if mine["policy"] is None:
            refuse_alone(("--policy",), *own[1:])
            before(**given)
            return
        refuse_unused("--policy", {"--policy": used})
        _vary(name, quantities, **mine, which=RobotOptions.taken_from(given), **given)

    extended = copy.copy(command)
    extended.params, extended.callback = [*command.params, *added], chosen
    return extended


def _vary(
    name: str,
    quantities: tuple[str, ...],
    *,
    which: RobotOptions,
    words: tuple[str, ...],
    policy: Path,
    contract: Path | None,
    asked: str,
    seeds: int | None,
    seconds: float | None,
    style: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    **_: object,
) -> None:
    """Answers the command, of one robot or, as the command itself, of several."""
    from pupper_analysis.tools.walk.intervals import tracked_intervals
    from pupper_analysis.tools.walk.policy import Policy

    wanted = shared.parse_point("command", asked, 3)
    brain = Policy.load(policy, contract)
    several = name == "push"
    meant = (which.select_robots(words) if several else [which.select_robot(words) or "v3"]) or [
        "v3"
    ]
    robots = [load_walking_robot(one, style, everything=everything) for one in meant]
    robots = name_uniquely(meant, robots) if several else robots
    given: dict[str, Any] = {"seeds": seeds, "seconds": seconds}
    given = {key: value for key, value in given.items() if value is not None}
    found = {}
    for robot in robots:
        with shared.show_progress(f"{robot.name} walks by {brain.name}"):
            one = tracked_intervals(robot, brain, wanted, quantities=quantities, **given)
        found[robot.name] = one
    shared.show_results(found.items(), style, robots=robots, everything=everything)
    result: Any = found if several else found[robots[0].name]
    shared.write_page(report_path, result, robots)
    passed = all(one.passed for one in found.values())
    shared.finish_command(json_path, result, passed=passed)


MODES: Mapping[str, Callable[[Command], Command]] = {
    name: partial(_with_policy, name) for name in _QUESTIONS
}
"""{command of another tool: what gives it a mode}."""
