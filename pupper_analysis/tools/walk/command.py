"""``pupper-analysis walk``: what a policy asks of a robot's motors."""

from __future__ import annotations

from pathlib import Path

import click

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
from pupper_analysis.prepare.convert.files import RobotFiles


@shared.command("walk")
@robot_argument
@add_options(FILES, VARIANT)
@shared.file_option(
    "--policy", help="The policy: ONNX, or RTNeural's JSON; e.g. policy.json.", required=True
)
@shared.file_option(
    "--contract",
    help="TOML of what the policy observes and commands; by default the one beside the policy.",
)
@click.option(
    "--command",
    "asked",
    default="0.5,0,0",
    show_default=True,
    metavar="VX,VY,W",
    help="Speed forward and to the left (m/s), and turning to the left (rad/s).",
)
@click.option("--seeds", default=1, show_default=True, help="Runs, whose starts differ; e.g. 20.")
@click.option("--seconds", default=8.0, show_default=True, help="Of each run (s).")
@shared.look_option
@shared.verbose_option
@shared.json_option
@shared.report_option
@with_robot
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    policy: Path,
    contract: Path | None,
    asked: str,
    seeds: int,
    seconds: float,
    style: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find what a learnt policy asks of the motors as it walks a robot.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF. The robot is
    simulated as its files have it, on servos with the policy's gains. What the policy observes and
    commands is read from its file, and from a TOML beside it of the same name.

    \b
    Examples:
      pupper-analysis walk v3 --policy policy_latest.json --command 0.5,0,0
      pupper-analysis walk go1.xml --policy go1.onnx --seeds 20 --report walk.html

    \b
    Exit status: 0 every run tracks its command, 1 one does not, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.walk.gait import simulate_walk
    from pupper_analysis.tools.walk.policy import Policy

    wanted = shared.parse_point("command", asked, 3)
    brain = Policy.load(policy, contract)
    meant = which.one(words) or "v3"
    robot = robot_from(meant)
    if isinstance(meant, RobotFiles) and style == "text":  # Markdown has them in its page
        print_notes(robot, everything=everything)
    with shared.show_progress(f"{robot.name} walks by {brain.name}"):
        walk = simulate_walk(robot, brain, wanted, seeds=seeds, duration=seconds)
    shared.show_results([(robot.name, walk)], style, robots=[robot], everything=everything)
    shared.write_page(report_path, walk, [robot])
    shared.finish_command(json_path, walk, passed=walk.passed)
