"""Command ``pupper-analysis gains``: find the gains with which a robot stands stably."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.kinds import Folder
from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import robot_argument
from pupper_analysis.cli.stance_options import RobotAndTask, robot_and_task

if TYPE_CHECKING:
    from pupper_analysis.tools.gains.gains import GainStudy

GAINS_FOLDER = Folder({})
"""Kind of the output folder of ``--write``, which contains only copies of the robot's files."""


@shared.command("gains")
@robot_argument
@click.option(
    "--rate",
    type=float,
    metavar="HZ",
    help="Control rate (Hz); e.g. 500. Default: one command per time step of the model.",
)
@click.option(
    "--delay",
    type=shared.QuantityType("time"),
    default=0.0,
    metavar="TIME",
    help="Time between measurement and effect of a command; e.g. 4ms.",
)
@click.option(
    "--error",
    type=shared.QuantityType("angle"),
    metavar="ANGLE",
    help="Position error for which the motors must have torque; e.g. 10deg.",
)
@click.option(
    "--encoder-bits",
    type=int,
    metavar="N",
    help="Resolution of the joint encoders, 2^N counts per turn; e.g. 14.",
)
@shared.output_option(
    "--write",
    "folder",
    holds=GAINS_FOLDER,
    help="Write copies of the robot's files with the recommended gains to this folder.",
)
@robot_and_task
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    rate: float | None,
    delay: float,
    error: float | None,
    encoder_bits: int | None,
    folder: Path | None,
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Find the stiffness kp and damping kd of the servos with which a robot stands stably.

    The servos are an explicit PD controller: it measures angles and velocities once per control
    period, and its torque acts after the delay. Robot and stance are given as for `stand`. The
    stability bounds follow from the modes of the robot on its feet; the bounds for all joints
    together are checked by simulation.

    \b
    Examples:
      pupper-analysis gains v3
      pupper-analysis gains v3 --rate 500 --delay 4ms --encoder-bits 14
      pupper-analysis gains v3-heavy --kp 8 --kd 0.2 --error 10deg \\
        --figure gains.png
      pupper-analysis gains go1.urdf go1.xml --write tuned/

    Exit status: 0 the robot stands stably with the present gains, which are within all bounds, and
    the files state all masses; 1 otherwise; 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.gains.gains import study_gains

    task = request.task()
    robot = request.robot(words, visuals=report_path is not None)
    robot.check_floating("gains-of-fixed-base")
    kp, kd = request.gains(robot)
    with shared.show_progress("finding the bounds of the gains"):
        result = study_gains(
            robot,
            task,
            kp=kp,
            kd=kd,
            rate=rate,
            delay=delay,
            error=error,
            encoder_bits=encoder_bits,
        )
    request.show(result, robot)
    if figure is not None:
        from pupper_analysis.tools.gains.figures import gain_figure

        gain_figure(result, figure)
        shared.confirm_written(figure)
    shared.write_page(report_path, result, [robot])
    if folder is not None:
        _write_files(request, words, result, folder)
    shared.finish_command(json_path, result, passed=result.passed)


def _write_files(
    request: RobotAndTask, words: tuple[str, ...], study: GainStudy, folder: Path
) -> None:
    """Write copies of the robot's files, with the recommended gains, to a folder.

    The files do not contain the payload of the command line.
    """
    from pupper_analysis.cli.robots import load_selected_robot, write_selected_variant
    from pupper_analysis.present.document import diagnostic_text
    from pupper_analysis.tools.gains.write import write_gains

    selection = request.which.select_robot(words) or "v3"
    # Without payload: the files state the robot alone.
    robot = load_selected_robot(
        selection, fixed_base=request.fixed_base, as_is=request.as_is, visuals=False
    )
    with write_selected_variant(selection) as files:
        write_gains(study, robot, folder, files=files)
    shared.confirm_written(folder)
    if request.payload:
        message = diagnose("gains-written-for-payload", mass=Quantity(request.payload, "kg"))
        shared.print_text(diagnostic_text(message))
