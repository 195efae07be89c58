"""``pupper-analysis hold``: statics and simulation of a posture of a robot with a fixed base."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    add_options,
    robot_argument,
)
from pupper_analysis.cli.stance_options import (
    AS_IS_OPTION,
    CONTINUOUS_OPTION,
    EFFORT_OPTION,
    OUTPUT_OPTIONS,
    SERVO_OPTIONS,
    RobotAndTask,
    append_payload,
    limit_by_peak,
    parse_continuous_torques,
)


@shared.command("hold")
@robot_argument
@click.option(
    "--joints",
    "positions",
    multiple=True,
    metavar="NAME=POSITION",
    help="Position of a joint, or of all that match a pattern; e.g. elbow=90deg, "
    "'*finger*=2cm'. Repeatable.",
)
@click.option(
    "--tool",
    metavar="FRAME",
    help=(
        "Point that carries loads: a link, site, body or geom; e.g. tool0. By default the end of "
        "the longest chain of joints."
    ),
)
@click.option(
    "--payload", type=shared.QuantityType("mass"), default=0.0, help="Mass at the tool; e.g. 2kg."
)
@add_options(
    FILE_OPTIONS, (AS_IS_OPTION,), VARIANT_OPTIONS, (EFFORT_OPTION,), SERVO_OPTIONS, OUTPUT_OPTIONS
)
@CONTINUOUS_OPTION
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    words: tuple[str, ...],
    positions: tuple[str, ...],
    tool: str | None,
    payload: float,
    continuous: tuple[str, ...],
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
    **robot_options: object,
) -> None:
    """Hold a posture with the base fixed: motor torques, sag, and simulation of the posture.

    For arms, hands, and any robot that is bolted down. Pinocchio computes gravity torques from the
    URDF, and MuJoCo from the MJCF. They are compared with the motors' limits. The sag of the
    position servos is predicted at each joint and at the tool. MuJoCo then simulates 12 s with
    feed-forward and 12 s without, and nudges the robot.

    Three further results: the worst posture of each motor, by a search; the largest payload at the
    tool, in this posture and in the worst posture; and the largest force at the tool that the
    motors withstand, in each direction.

    Joints without --joints have the position of the keyframe, or are in the middle of their range
    (0 without limits). Missing servos are added, with a note, unless --as-is is given.

    \b
    Examples:
      pupper-analysis hold panda.urdf
      pupper-analysis hold ur5.urdf ur5.xml --joints '*lift*=-90deg' \\
        --tool tool0 --payload 3
      pupper-analysis hold hand.xml --keyframe open --tool thumb_tip \\
        --figure held.png

    Exit status: 0 the posture holds, 1 the posture does not hold, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.models.motors.assignment import describe_weak_motors
    from pupper_analysis.robot.build import with_efforts
    from pupper_analysis.tools.hold.hold import hold_posture

    joints = dict(shared.parse_position("joints", text) for text in positions)
    options = RobotAndTask.of_fixed_base(**robot_options)
    robot = options.robot(words, visuals=report_path is not None)
    continuous_efforts, motors = parse_continuous_torques(continuous, robot)
    robot = with_efforts(robot, limit_by_peak(robot, continuous_efforts))
    kp, kd = options.gains(robot)
    with shared.show_progress("holding the posture, and simulating it"):
        result = hold_posture(
            robot,
            joints,
            keyframe=options.which.keyframe,
            tool=tool,
            payload=payload,
            kp=kp,
            kd=kd,
            commands_alone=True,
        )
        torques = zip(robot.joint_names, result.statics.joint_torques.tolist(), strict=True)
        if payload:
            result = replace(result, name=append_payload(result.name, payload))
        result = replace(result, weak_motors=describe_weak_motors(motors, dict(torques)))
    options.show(result, robot)
    if figure is not None:
        from pupper_analysis.tools.hold.figures import hold_figure

        hold_figure(result, figure)
        shared.confirm_written(figure)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
