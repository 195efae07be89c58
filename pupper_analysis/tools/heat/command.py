"""Command ``pupper-analysis heat``: predict how hot the motors of a stance become."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.robots import check_base_is_free, robot_argument
from pupper_analysis.cli.stance_options import (
    RobotAndTask,
    complete_motor_command,
    parse_motors,
    robot_and_stance,
)

if TYPE_CHECKING:
    from pupper_analysis.models.motors.motor import Motor
    from pupper_analysis.robot.robot import Robot


@shared.command("heat")
@robot_argument
@click.option(
    "--motor",
    "motors",
    multiple=True,
    metavar="[JOINTS=]MOTOR",
    help="Motor of all joints, or of the joints that a pattern names: a name of --list-motors, or "
    "a TOML or JSON file. Repeatable; later options have priority. Default: dcmotor actuators of "
    "the MJCF.",
)
@click.option("--list-motors", is_flag=True, help="List the known motors with their sources.")
@click.option(
    "--ambient",
    type=float,
    metavar="DEGC",
    help="Temperature of the ambient air (degC). Default: that of the motor's data.",
)
@click.option(
    "--limit",
    type=float,
    metavar="DEGC",
    help="Largest temperature of the windings (degC). Default: that of the motor's data.",
)
@click.option("--battery", type=float, metavar="WH", help="Energy of the battery (W h); e.g. 74.")
@robot_and_stance
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    motors: tuple[str, ...],
    list_motors: bool,
    ambient: float | None,
    limit: float | None,
    battery: float | None,
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Predict the temperature of the motors of a stance, and the battery current.

    The torque of each joint at rest determines the motor current, the copper loss, and the
    temperature of the winding over time. Robot and stance are given as for `stand`. If the
    data of a motor lack a number, the output names the number; no value is assumed.

    \b
    Examples:
      pupper-analysis heat v3 --motor mit-mini-cheetah --limit 80
      pupper-analysis heat v3 --motor dephy-actpack --battery 74
      pupper-analysis heat v3 --motor dephy-actpack \\
        --motor '*_3=mit-mini-cheetah' --limit 80 --payload 1 --figure heat.png

    Exit status: 0 no motor reaches the limit, 1 a motor reaches the limit, is too weak, or
    has an unknown number, a joint has no motor, or a file does not state the mass of a moving
    link, 2 bad input.
    """  # noqa: D301 - click reads the \b
    if list_motors:
        refuse_unused("--list-motors", {"--list-motors": {"list_motors"}})
        _print_motors()
        return
    from pupper_analysis.tools.heat.heat import study_heat

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None)
    _check_base(robot, motors, limit)  # before the motors: no motor makes a fixed base stand
    assigned = _read_file_motors(robot) | _parse_known_motors(motors, robot, limit)
    if not assigned:
        error = ConfigurationError("--motor", diagnose("motor-not-given"))
        if (motor := _propose_motor(robot)) is None:
            error.add_note(_propose_list())
        else:
            words = _propose_limit((motor,), limit)
            error.add_note(complete_motor_command((motor,), robot, words))
        raise error
    with shared.show_progress("computing the heat of the motors"):
        result = study_heat(
            robot,
            task,
            assigned,
            ambient=ambient,
            limit=limit,
            battery_energy=None if battery is None else 3600 * battery,
        )
    request.show(result, robot)
    if figure is not None:
        from pupper_analysis.tools.heat.figures import heat_figure

        heat_figure(result, figure)
        shared.confirm_written(figure)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


_MAX_TORQUE_RATIO = 2.0
"""Largest ratio [1] between the largest torque of a proposed motor and the robot's median effort
limit, or its inverse. Chosen, not tuned."""


def _propose_motor(robot: Robot) -> str | None:
    """Return the motor whose largest torque is nearest to the robot's median effort limit.

    Motors that `heat` cannot judge are omitted (`_is_rated`). None if no hinge has a known limit,
    or no motor is within `_MAX_TORQUE_RATIO` of the median.
    """
    import math
    import statistics

    from pupper_analysis.models.motors.reading import find_motor, list_motors
    from pupper_analysis.robot.joints import is_slide

    limits = [
        limit
        for joint, limit in zip(robot.joint_names, robot.effort_limits.tolist(), strict=True)
        if 0 < limit < math.inf and not is_slide(robot, joint)
    ]
    if not limits:
        return None
    median = statistics.median(limits)
    distances = {
        name: abs(math.log(largest[0] / median))
        for name in filter(_is_rated, list_motors())
        if (largest := find_motor(name).largest_torque) is not None and largest[0] > 0
    }
    nearest = min(distances, key=distances.__getitem__)
    return nearest if distances[nearest] <= math.log(_MAX_TORQUE_RATIO) else None


def _is_rated(name: str) -> bool:
    """Return True if a known motor has thermal data or a continuous torque: `heat` can judge it."""
    from pupper_analysis.models.motors.reading import find_motor
    from pupper_analysis.models.motors.thermal import list_thermal_motors

    return name in list_thermal_motors() or find_motor(name).continuous_torque is not None


def _propose_list() -> str:
    """Return the command that lists the known motors."""
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.document import NextStep

    step = NextStep("heat", ("--list-motors",), robot_typed=False, omitted=("*",))
    return complete_command(step)


def _parse_known_motors(
    motors: tuple[str, ...], robot: Robot, limit: float | None
) -> dict[str, Motor]:
    """Parse the texts of ``--motor``; propose a motor with thermal data for an unknown motor.

    Returns:
        {joint: motor}.

    Raises:
        ConfigurationError: If a text names no motor, and the most similar known motor has neither
            thermal data nor a continuous torque.
        UnknownNameError: For another unknown name.
    """
    from pupper_analysis.models.motors.reading import list_motors
    from pupper_analysis.models.motors.thermal import list_thermal_motors

    try:
        return parse_motors(motors, robot)
    except UnknownNameError as error:
        if error.kind != "motor":
            raise
        thermal, similar = list_thermal_motors(), error.correction
        if similar in list_motors() and _is_rated(similar):
            raise
        unknown = str(error.name)
        problem = diagnose("heat-motor-unknown", motor=unknown, known=thermal)
        refusal = ConfigurationError("--motor", problem)
        [proposed] = difflib.get_close_matches(unknown, thermal, 1, 0.0)
        texts = tuple(
            f"{pattern}{separator}{proposed if name == unknown else name}"
            for pattern, separator, name in (text.rpartition("=") for text in motors)
        )
        refusal.add_note(complete_motor_command(texts, robot, _propose_limit(texts, limit)))
        raise refusal from error


def _propose_limit(texts: tuple[str, ...], limit: float | None) -> tuple[str, ...]:
    """Return ``--limit`` with an example [degC] if a motor of ``--motor`` has no known limit."""
    from pupper_analysis.base.errors import PupperAnalysisError
    from pupper_analysis.models.motors.reading import find_motor
    from pupper_analysis.tools.heat.document import EXAMPLE_LIMIT

    try:
        limits = [find_motor(text.rpartition("=")[2]).limit_temperature for text in texts]
    except PupperAnalysisError:  # the proposed command refuses the motor
        return ()
    return ("--limit", f"{EXAMPLE_LIMIT:g}") if limit is None and None in limits else ()


def _check_base(robot: Robot, motors: tuple[str, ...], limit: float | None) -> None:
    """Raise an error if the base is fixed, with the command that welds the base if possible.

    The command contains a motor for the hinges of the robot (`_propose_motor`), if none is given.
    """
    from pupper_analysis.robot.plane import Weld
    from pupper_analysis.robot.touching import with_contacts

    needs_motor = not (motors or robot.floating or _read_file_motors(robot))
    proposed = _propose_motor(robot) if needs_motor else None
    texts = (proposed,) if proposed is not None else motors

    def propose_weld() -> str:
        """Return the command that welds the base; raise an error if it cannot be welded."""
        with_contacts(robot, {"base": Weld()})
        if needs_motor and proposed is None:
            return _propose_list()
        words = ("--contact", "base=weld", *_propose_limit(texts, limit))
        return complete_motor_command(texts, robot, words)

    missing = {
        "motor": needs_motor,
        "hinges": bool(motors) and not robot.floating and _select_slides(motors, robot),
        "limit": bool(not robot.floating and _propose_limit(texts, limit)),
    }
    check_base_is_free(robot, "heat-of-fixed-base", propose_weld, **missing)


def _select_slides(motors: tuple[str, ...], robot: Robot) -> bool:
    """Return True if a text of ``--motor`` selects a slide, which has no rotary motor."""
    from pupper_analysis.robot.joints import find_motor_joints, is_slide

    return any(
        is_slide(robot, joint)
        for motor in motors
        for joint in find_motor_joints(robot, motor.rpartition("=")[0] or "*")
    )


def _read_file_motors(robot: Robot) -> dict[str, Motor]:
    """Read the motors that the robot's MJCF states as `dcmotor` actuators: {joint: motor}."""
    from pupper_analysis.models.mjcf_file import read_mjcf
    from pupper_analysis.models.motors.dcmotor import list_dcmotors

    description = robot.description
    if description.converted == "mjcf" or not description.mjcf_source.is_file():
        return {}
    found = list_dcmotors(read_mjcf(description.mjcf_source).model, str(description.mjcf_source))
    return {joint: motor for joint, motor in found.items() if joint in robot.joint_names}


def _print_motors() -> None:
    """Print the known motors: name, whether the thermal data are complete, and source.

    The limit temperature is not included, because ``--limit`` states it.
    """
    from pupper_analysis.models.motors.reading import find_motor, list_motors
    from pupper_analysis.models.motors.thermal import list_thermal_motors

    for name in list_motors():
        mark = "thermal data" if name in list_thermal_motors() else ""
        click.echo(f"{name:<26} {mark:<12} {find_motor(name).source}")
