"""Command ``pupper-analysis walk``: simulates a walking policy and measures motor torques."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_idle
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    RobotOptions,
    add_options,
    pass_robot_options,
    robot_argument,
)
from pupper_analysis.tools.walk.modes import COMMAND_OPTION, CONTRACT_OPTION, load_walking_robot

if TYPE_CHECKING:
    from pupper_analysis.tools.walk.gait import Walk
    from pupper_analysis.tools.walk.intervals import TrackedIntervals
    from pupper_analysis.tools.walk.orders import Orders


@shared.command("walk")
@robot_argument
@add_options(FILE_OPTIONS, VARIANT_OPTIONS)
@shared.file_option(
    "--policy",
    help="The policy: ONNX, RTNeural's JSON, or TorchScript; e.g. policy.json.",
    required=True,
)
@CONTRACT_OPTION
@COMMAND_OPTION
@click.option(
    "--seeds",
    type=int,
    help=("Number of runs with different initial states; by default 1, with --vary 3; e.g. 20."),
)
@click.option(
    "--seconds",
    type=float,
    help=("Duration of each run (s); by default 8, with --vary and --orders 5."),
)
@click.option(
    "--vary",
    metavar="QUANTITY,...",
    help=(
        "Find the interval of each quantity in which the command is tracked: all, or some of "
        "mass, com, friction, kp, kd, delay, strength, legs, payload, push-forward, push-left."
    ),
)
@shared.file_option(
    "--fit",
    "fitted",
    help=(
        "With --vary: JSON of a fit; its intervals of the real robot are compared with the "
        "tracked intervals."
    ),
)
@click.option(
    "--orders",
    is_flag=True,
    help=(
        "Check whether the policy belongs to the robot: rank joint orders, signs, scales and "
        "histories."
    ),
)
@shared.text_format_option
@shared.verbose_option
@shared.json_option
@shared.report_option
@pass_robot_options
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    policy: Path,
    contract: Path | None,
    command_text: str,
    seeds: int | None,
    seconds: float | None,
    vary: str | None,
    fitted: Path | None,
    orders: bool,
    style: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Simulate a robot that walks with a learnt policy, and compare its torques with motor limits.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF. The robot is
    simulated as in its files, with servos that have the policy's gains. Observation and action of
    the policy are read from the policy file, and from a TOML file of the same name beside it.

    \b
    Examples:
      pupper-analysis walk v3 --policy policy_latest.json --command 0.5,0,0
      pupper-analysis walk go1.xml --policy go1.onnx --seeds 20 --report walk.html
      pupper-analysis walk v3 --policy policy_latest.json --vary mass,kp,delay \\
        --fit fit.json
      pupper-analysis walk v3 --policy policy_latest.json --orders

    Exit status: 0 every run tracks the command (with --fit, within the intervals of the fit; with
    --orders, no interpretation walks better than the stated one), 1 otherwise, 2 bad input.
    """  # noqa: D301 - click reads the \b
    if orders:
        refuse_idle("--orders", "command_text", "seeds", "vary", "fitted")
    if vary is None:
        refuse_alone(["--vary"], "fitted")
    from pupper_analysis.tools.walk.gait import parse_walking_command, simulate_walk
    from pupper_analysis.tools.walk.intervals import (
        QUANTITIES,
        read_measured_intervals,
        tracked_intervals,
    )
    from pupper_analysis.tools.walk.orders import rank_orders
    from pupper_analysis.tools.walk.policy import Policy

    checked_command = parse_walking_command(command_text)
    source = which.select_robot(words) or "v3"
    loaded_policy = Policy.load(policy, contract)
    robot = load_walking_robot(source, style, everything=everything)
    arguments: dict[str, Any] = {} if seconds is None else {"seconds": seconds}
    if seeds is not None:
        arguments["seeds"] = seeds
    result: Walk | TrackedIntervals | Orders
    with shared.show_progress(f"{robot.name} walks by {loaded_policy.name}"):
        if orders:
            result = rank_orders(robot, loaded_policy, **arguments)
        elif vary is not None:
            measured = (
                None
                if fitted is None
                else read_measured_intervals(fitted, robot, loaded_policy.contract.latency)
            )
            quantities = tuple(QUANTITIES) if vary == "all" else tuple(vary.split(","))
            result = tracked_intervals(
                robot,
                loaded_policy,
                checked_command,
                quantities=quantities,
                measured=measured,
                **arguments,
            )
        else:
            result = simulate_walk(robot, loaded_policy, checked_command, **arguments)
    shared.show_results([(robot.name, result)], style, robots=[robot], everything=everything)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
