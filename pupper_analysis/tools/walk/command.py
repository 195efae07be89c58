"""Command ``pupper-analysis walk``: simulates a walking policy and measures motor torques."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import get_current_context
from click.core import ParameterSource

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_idle
from pupper_analysis.cli.next_step import (
    complete_command,
    complete_command_without,
    print_next_step,
)
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    RobotOptions,
    add_options,
    pass_robot_options,
    robot_and_sources_argument,
)
from pupper_analysis.cli.stance_options import (
    EFFORT_OPTION,
    MOTOR_OPTION,
    parse_efforts,
    parse_motors,
)
from pupper_analysis.present.document import Name, NextStep, diagnostic_text, text
from pupper_analysis.tools.walk.options import COMMAND_OPTION, CONTRACT_OPTION, load_walking_robot

if TYPE_CHECKING:
    from pupper_analysis.base.array_types import Array
    from pupper_analysis.models.motors.motor import Motor
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.tools.contract.deployment import Deployment
    from pupper_analysis.tools.walk.gait import Walk
    from pupper_analysis.tools.walk.intervals import TrackedIntervals
    from pupper_analysis.tools.walk.orders import Orders
    from pupper_analysis.tools.walk.policy import Policy
    from pupper_analysis.tools.walk.response import ResponseMap
    from pupper_analysis.tools.walk.trace import TraceCheck


@shared.command("walk")
@robot_and_sources_argument
@add_options(FILE_OPTIONS, VARIANT_OPTIONS)
@shared.file_option(
    "--policy",
    help=(
        "The policy: ONNX, RTNeural's JSON, or TorchScript, if not given as SOURCE; e.g. "
        "policy.json. By default the only ONNX file beside the deployment."
    ),
)
@CONTRACT_OPTION
@COMMAND_OPTION
@EFFORT_OPTION
@MOTOR_OPTION
@click.option(
    "--init",
    "init",
    is_flag=True,
    help="Write a template of the TOML file beside the policy, and exit.",
)
@click.option(
    "--seeds",
    type=int,
    help=("Number of runs with different initial states; by default 1, with --vary 5; e.g. 20."),
)
@click.option(
    "--seconds",
    type=float,
    help=("Duration of each run (s); by default 8, with --vary, --orders and --response 5."),
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
@shared.file_option(
    "--trace",
    help=(
        "CSV or npz of observations and actions recorded on the robot: compare order, sign, scale "
        "and delay of each term, then simulate."
    ),
)
@click.option(
    "--response",
    is_flag=True,
    help=(
        "Map the achieved velocity over commands up to those of --command (by default 1,0.5,1), "
        "with dead zones."
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
    policy: Path | None,
    contract: Path | None,
    command_text: str,
    effort: tuple[str, ...],
    motors: tuple[str, ...],
    init: bool,
    seeds: int | None,
    seconds: float | None,
    vary: str | None,
    fitted: Path | None,
    orders: bool,
    trace: Path | None,
    response: bool,
    style: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Simulate a robot that walks with a learnt policy, and compare its torques with motor limits.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF. The simulated model
    is the robot's MJCF, with servos that have the policy's gains. SOURCE is the policy, and files
    of the deployment or training, which `contract` reads as well. Observation and action of the
    policy are read from the policy file, from the deployment, and from a TOML file of the same name
    beside the policy.

    \b
    Examples:
      pupper-analysis walk v3 --policy policy_latest.json --command 0.5,0,0
      pupper-analysis walk go1.xml --policy go1.onnx --seeds 20 --report walk.html
      pupper-analysis walk g1.xml deploy.yaml policy.onnx --command 0.5,0,0
      pupper-analysis walk v3 --policy policy_latest.json \\
        --motor steadywin-gim4305-10
      pupper-analysis walk g1.xml policy.onnx --init
      pupper-analysis walk v3 --policy policy_latest.json --vary mass,kp,delay \\
        --fit fitted/fit.json
      pupper-analysis walk v3 --policy policy_latest.json --orders
      pupper-analysis walk v3 --policy policy_latest.json --response
      pupper-analysis walk g1.xml deploy.yaml policy.onnx --trace recorded.npz

    Exit status: 0 every run tracks the command, the files state all masses, and motors of --motor
    can exert the torques; 1 otherwise; 2 bad input. Options change the conditions of 0: with
    --fit, every run tracks within the intervals of the fit; with --orders, the stated
    interpretation tracks a command, and no interpretation walks clearly better; with --response, no
    run falls and no command is ignored; with --trace, the trace agrees as well.
    """  # noqa: D301 - click reads the \b
    _refuse_idle_options(
        init=init, orders=orders, response=response, trace=trace is not None, vary=vary is not None
    )
    from pupper_analysis.tools.contract.deployment import read_deployment
    from pupper_analysis.tools.walk.gait import parse_walking_command
    from pupper_analysis.tools.walk.orders import rank_orders
    from pupper_analysis.tools.walk.policy import Policy, select_policy, split_sources
    from pupper_analysis.tools.walk.response import DEFAULT_LIMITS, map_response
    from pupper_analysis.tools.walk.runs import replace_efforts

    checked_command = parse_walking_command(command_text)
    words, sources = split_sources(words)
    click.get_current_context().meta[shared.ROBOT_WORDS] = words
    source = which.select_robot(words) or "v3"
    is_drawn = report_path is not None
    robot = load_walking_robot(source, style, everything=everything, visuals=is_drawn)
    if not init:
        robot.check_floating("walk-of-fixed-base")
    try:
        policy_path, sources = select_policy(policy, sources)
    except ConfigurationError as error:
        raise _propose_policy(error) from error
    deployment = read_deployment(robot, sources, policy_path) if sources else None
    if init:
        _write_first_contract(policy_path, robot, deployment)
        return
    with _explain_missing_key(policy_path, contract, sources):
        loaded_policy = Policy.load(policy_path, contract, deployment)
    assigned, torque_limits = _parse_motor_limits(motors, effort, robot)
    _check_joints(robot, loaded_policy, contract or policy_path.with_suffix(".toml"))
    robot, loaded_policy = replace_efforts(robot, loaded_policy, torque_limits)
    arguments: dict[str, Any] = {} if seconds is None else {"seconds": seconds}
    if seeds is not None:
        arguments["seeds"] = seeds
    result: Walk | TrackedIntervals | Orders | ResponseMap | TraceCheck
    with shared.show_progress(
        text("walk-progress", robot=Name(robot.name), policy=Name(loaded_policy.name))
    ):
        if orders:
            result = rank_orders(robot, loaded_policy, **arguments)
        elif response:
            typed = get_current_context().get_parameter_source("command_text")
            limits = DEFAULT_LIMITS if typed is ParameterSource.DEFAULT else checked_command
            result = map_response(robot, loaded_policy, limits, **arguments)
        elif vary is not None:
            result = _vary_quantities(
                robot, loaded_policy, checked_command, vary, fitted, arguments
            )
        else:
            result = _simulate_checked_walk(
                robot, loaded_policy, checked_command, trace, assigned, arguments
            )
    shared.show_results([(robot.name, result)], style, robots=[robot], everything=everything)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


def _vary_quantities(
    robot: Robot,
    policy: Policy,
    velocity: Array,
    vary: str,
    fitted: Path | None,
    arguments: Mapping[str, Any],
) -> TrackedIntervals:
    """Find the intervals of ``--vary`` in which the commanded velocity is tracked.

    ``velocity`` (3,): forward, left [m/s], yaw rate [rad/s]. ``fitted`` is the JSON of a fit whose
    intervals are compared.
    """
    from pupper_analysis.tools.walk.intervals import (
        VARIED_QUANTITIES,
        read_measured_intervals,
        tracked_intervals,
    )

    measured = (
        None if fitted is None else read_measured_intervals(fitted, robot, policy.contract.latency)
    )
    quantities = tuple(VARIED_QUANTITIES) if vary == "all" else tuple(vary.split(","))
    return tracked_intervals(
        robot, policy, velocity, quantities=quantities, measured=measured, **arguments
    )


def _simulate_checked_walk(
    robot: Robot,
    policy: Policy,
    velocity: Array,
    trace: Path | None,
    motors: dict[str, Motor],
    arguments: Mapping[str, Any],
) -> Walk | TraceCheck:
    """Check a recorded trace, if any, then simulate a walk with tests of the causes of falls.

    If the trace does not agree with the policy, the result is the check. ``velocity`` (3,):
    forward, left [m/s], yaw rate [rad/s].
    """
    from pupper_analysis.tools.contract.contract import TRACED
    from pupper_analysis.tools.walk.falls import find_fall_tests
    from pupper_analysis.tools.walk.gait import DEFAULT_SECONDS, simulate_walk
    from pupper_analysis.tools.walk.trace import check_trace, read_trace

    check = None if trace is None else check_trace(robot, policy, read_trace(trace))
    if check is not None and not check.passed:
        return check
    walk = simulate_walk(robot, policy, velocity, motors=motors, **arguments)
    if check is not None:
        walk = replace(walk, evidence=TRACED, trace=check)
    duration = arguments.get("seconds", DEFAULT_SECONDS)
    return replace(walk, fall_tests=find_fall_tests(robot, policy, walk, duration))


def _parse_motor_limits(
    motors: tuple[str, ...], effort: tuple[str, ...], robot: Robot
) -> tuple[dict[str, Motor], dict[str, float]]:
    """Parse ``--motor`` and ``--effort``: {joint: motor} and {joint: limit [N m, N]}.

    A limit that ``--effort`` states has priority over the largest torque of the motor at rest.
    """
    from pupper_analysis.models.motors.assignment import list_motor_efforts

    assigned = parse_motors(motors, robot)
    return assigned, list_motor_efforts(assigned) | parse_efforts(effort, robot)


def _write_first_contract(policy: Path, robot: Robot, deployment: Deployment | None) -> None:
    """Write a template of the TOML file of a policy, and print the keys to be completed."""
    from pupper_analysis.tools.walk.template import write_template

    path, missing = write_template(policy, robot, deployment)
    message = diagnose("walk-template-written", file=str(path), missing=missing)
    shared.print_text(diagnostic_text(message))
    print_next_step(NextStep("walk", omitted=("--init",)))


def _propose_policy(error: ConfigurationError) -> ConfigurationError:
    """Add the command line with a policy to the error about no or several policies.

    The policy is the first of several; otherwise an ONNX file in the current folder, or an example.
    """
    problem = error.problem
    if not isinstance(problem, Diagnostic):
        return error
    names = problem.values["names"]
    if isinstance(names, tuple) and names:
        error.add_note(complete_command_without([str(name) for name in names[1:]]))
        return error
    files = sorted(Path().glob("*.onnx"))
    example = "" if files else "policy.onnx"
    values = FrozenDict({**problem.values, "example": example})
    refusal = ConfigurationError(error.field, replace(problem, values=values))
    step = NextStep("walk", ("--policy", example or str(files[0])))
    refusal.add_note(complete_command(step))
    return refusal


@contextmanager
def _explain_missing_key(
    policy: Path, contract: Path | None, sources: Sequence[str]
) -> Iterator[None]:
    """Name the missing base class in an error about a key that no file states.

    The new error contains the command that writes a template, unless there is a TOML file.
    """
    from pupper_analysis.tools.walk.template import list_missing_bases

    try:
        yield
    except ModelError as error:
        problem = error.cause.values.get("problem")
        if not isinstance(problem, Diagnostic) or problem.code != "contract-lacks":
            raise
        template = contract or policy.with_suffix(".toml")
        has_template = path_exists(template)
        bases = list_missing_bases(sources)
        incomplete = diagnose(
            "contract-incomplete",
            key=problem.values["key"],
            base=bases[0] if bases else None,
            template=str(template) if has_template else None,
        )
        explained = ModelError(policy, incomplete)
        if not has_template:
            explained.add_note(_complete_template_command())
        raise explained from error


def _check_joints(robot: Robot, policy: Policy, template: Path) -> None:
    """Raise an error if the joints of a policy are not the robot's, with a command if one helps.

    If the policy names no joints and commands fewer than the robot has, the command writes the
    TOML file ``template``, which contains the names. There is no command if this file exists.
    """
    from pupper_analysis.tools.walk.runs import find_joint_indices

    try:
        find_joint_indices(robot, policy)
    except ModelError as error:
        contract = policy.contract
        can_help = not contract.joints and contract.num_joints < robot.nu
        if can_help and not path_exists(template):
            error.add_note(_complete_template_command())
        raise


def _complete_template_command() -> str:
    """Create the command line that writes a template of the TOML file of the typed policy."""
    from pupper_analysis.tools.walk.document import TEMPLATE_STEP

    return complete_command(TEMPLATE_STEP)


def _refuse_idle_options(
    *, init: bool, orders: bool, response: bool, trace: bool, vary: bool
) -> None:
    """Refuse typed options that have no effect in the selected mode."""
    if init:
        idle = (
            "command_text",
            "seeds",
            "seconds",
            "vary",
            "fitted",
            "effort",
            "motors",
            "orders",
            "contract",
        )
        refuse_idle("--init", *idle, "trace", "response", "json_path", "report_path", "everything")
    if orders:
        refuse_idle("--orders", "command_text", "seeds", "vary", "fitted", "motors")
    if response:
        refuse_idle("--response", "vary", "fitted", "orders", "trace", "motors")
    if trace:
        refuse_idle("--trace", "vary", "fitted", "orders")
    if vary:
        refuse_idle("--vary", "motors")
    if not vary:
        refuse_alone(["--vary"], "fitted")
