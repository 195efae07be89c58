"""Command ``pupper-analysis payload``: find the largest payload of a stance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import (
    CONTINUOUS_OPTION,
    RobotAndTask,
    limit_by_peak,
    parse_continuous_torques,
    robot_and_task,
)


@shared.command("payload")
@robot_argument
@robot_and_task
@CONTINUOUS_OPTION
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    continuous: tuple[str, ...],
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the largest payload of a stance, and the failure beyond this limit.

    The payload is a point mass at --payload-at, in addition to --payload: the largest mass with
    which `stand --payload` holds. Reach and contacts, motor torques and servo stiffness each set a
    bound. If the CoM must be above the feet, the base shifts with the load. With the smallest
    bound the robot is judged as by `stand`, and simulated with twelve nudges of the base. If it
    fails, the payload is the largest mass that holds in simulation, found to 1 %.
    Robot and stance are given as for `stand`.

    The effort limits in the files are taken as peak torques: the payload can be carried for
    moments. With --continuous the payload can be carried permanently; motors that no pattern
    matches keep the peak torque.

    \b
    Examples:
      pupper-analysis payload v3 --payload-at 0,0,8cm
      pupper-analysis payload robot.urdf --continuous 8
      pupper-analysis payload v3 --continuous dephy-actpack
      pupper-analysis payload v3-long-leg --height 15cm --kp 20 --kd 0.5
      pupper-analysis payload original --swing FL=2cm --com inside \\
        --com-margin 1cm

    Exit status: 0 a payload is carried, 1 no payload, unknown torque limits or masses, or a
    verdict that does not pass, 2 stance out of reach or not in balance, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.models.motors.assignment import describe_weak_motors
    from pupper_analysis.robot.build import with_efforts
    from pupper_analysis.tools.payload.limit import payload_limit

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None, payload_sought=True)
    continuous_efforts, motors = parse_continuous_torques(continuous, robot)
    robot = with_efforts(robot, limit_by_peak(robot, continuous_efforts))
    kp, kd = request.gains(robot)
    with shared.show_progress("searching for the payload, and simulating it"):
        result = payload_limit(robot, task, request.place, kp=kp, kd=kd, commands_alone=True)
        weak = describe_weak_motors(motors, result.torque_by_joint)
        result = replace(
            result,
            continuous=tuple(continuous_efforts),
            weak_motors=weak,
            carried=request.payload,
        )
    request.show(result, robot)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)
