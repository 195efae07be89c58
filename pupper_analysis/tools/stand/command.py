"""``pupper-analysis stand``: solve a stance, and verify the stance by simulation."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import click

from pupper_analysis.base import kinds
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.robots import PREPARING_ROBOT, RobotOptions, robot_argument
from pupper_analysis.cli.stance_options import (
    RobotAndTask,
    draw_requested_stand,
    robot_and_task,
)
from pupper_analysis.prepare.convert.files import RobotFiles


@shared.command("stand")
@robot_argument
@click.option(
    "--minimum-stiffness",
    is_flag=True,
    help=("Also find the smallest kp with an equilibrium without feed-forward."),
)
@click.option(
    "--explain",
    is_flag=True,
    help="Only list the additions to your files for a stand, by preparation pass.",
)
@shared.file_option(
    "--start",
    help=(
        "Initial guess of the joint positions: JSON or CSV, as written by --json or --csv; selects "
        "the IK branch; e.g. stand.json."
    ),
)
@robot_and_task
@shared.output_option(
    "--csv",
    holds=kinds.STAND_TABLE,
    help="Write the table of joints as CSV to this file, or to standard output (-).",
)
@shared.figure_option
@shared.json_option
@shared.report_option
def command(
    request: RobotAndTask,
    words: tuple[str, ...],
    minimum_stiffness: bool,
    explain: bool,
    start: Path | None,
    csv: Path | None,
    figure: Path | None,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Solve a stance: joint angles and motor torques, verified by a simulation.

    ROBOT is a variant (v3 by default), a URDF, an MJCF, or a URDF and an MJCF; --base, --leg-scale
    and --torso-mass-scale define other variants. From a single file, the other model is made in
    memory. Feet are detected. If the files lack a floor, servos or a start pose, defaults are
    added, and notes report the additions.

    Give lengths and angles with a unit: 20mm, 2cm, 5deg. A number without unit is in m or rad; a
    length without unit that is probably in mm is refused.

    A stance that is out of reach is refused, and the message states the possible values. A stance
    within reach but without equilibrium (the robot slides or tips) is refused, too. In
    simulation the legs are lengthened by the depth to which the feet penetrate MuJoCo's soft
    ground.

    Other commands take the same options of robot and stance: workspace (range of the base), payload
    (largest payload), push (largest pushes), best (a better stance) and path (motion to the
    stance).

    \b
    Examples:
      pupper-analysis stand v3 --swing FL=2cm --com inside --com-margin 1cm
      pupper-analysis stand long-leg --slope 5deg --uphill 90deg --pitch 0.05
      pupper-analysis stand v3 --step FR=0.02 --move RL=-0.01,0.02 \\
        --figure stance.png
      pupper-analysis stand --base v3 --leg-scale 1.2 --minimum-stiffness
      pupper-analysis stand v3 --height 12cm --csv joints.csv
      pupper-analysis stand v3 --start joints.csv
      pupper-analysis stand go2.urdf --explain
      pupper-analysis stand go1.urdf go1.xml --foot FL=FL_foot --foot FR=FR_foot \\
        --foot RL=RL_foot --foot RR=RR_foot --kp 20 --kd 0.5 --kp '*calf*=30'

    Exit status: 0 the stance holds, 1 the verdict does not pass (for example, the stance fails in
    simulation), 2 out of reach, no equilibrium or bad input.
    """  # noqa: D301 - click reads the \b
    if explain:
        refuse_unused("--explain", {"--explain": _EXPLAIN_PARAMETERS})
        _explain_preparation(request, words, json_path)
        return
    from pupper_analysis.stance.stand import solve_stand
    from pupper_analysis.stance.start_file import read_start
    from pupper_analysis.tools.stand.stance import study_stance

    task = request.task()
    robot = request.robot(words, visuals=figure is not None or report_path is not None)
    kp, kd = request.gains(robot)
    guess = None if start is None else read_start(start, robot)
    with shared.show_progress("solving the stance, and simulating it"):
        stance = task if guess is None else solve_stand(robot, task, start=guess)
        result = study_stance(robot, stance, kp=kp, kd=kd, stiffness=minimum_stiffness)
    request.show(result, robot)
    if csv is not None:
        result.to_csv(csv)
        shared.confirm_written(csv)
    draw_requested_stand(robot, result.stand, result.statics, figure, result)
    shared.write_page(report_path, result, [robot])
    shared.finish_command(json_path, result, passed=result.passed)


_EXPLAIN_PARAMETERS = {
    "words",
    "explain",
    *("as_is", "style", "everything", "json_path"),
    *(option.name for option in fields(RobotOptions)),
}
"""Parameters of the command that have an effect together with ``--explain``."""


def _explain_preparation(
    request: RobotAndTask, words: tuple[str, ...], json_path: Path | None
) -> None:
    """Print the steps that prepare a robot from its files, with their changes (``--explain``).

    If ``json_path`` is not None, the steps are also written there as JSON.
    """
    from pupper_analysis.models.mjcf import silence_mujoco
    from pupper_analysis.prepare.convert.load import read_pair
    from pupper_analysis.prepare.passes import LoadRequest, parse_feet
    from pupper_analysis.present.document import Report
    from pupper_analysis.pupper.named_robots import find_model
    from pupper_analysis.tools.stand.document import preparation_document
    from pupper_analysis.tools.stand.stance import explain_loading

    selected = request.which.select_robot(words) or "v3"
    models: tuple[Any, ...]
    options: Mapping[str, Any]
    with ExitStack() as resources:
        if isinstance(selected, RobotFiles):
            models, options = selected.models, selected.options
        else:
            models, options = (find_model(selected, "urdf"), find_model(selected, "mjcf")), {}
        resources.enter_context(shared.show_progress(PREPARING_ROBOT))
        resources.enter_context(silence_mujoco())
        load_request = LoadRequest(
            feet=parse_feet(options["feet"]) if "feet" in options else None,
            fixed_base=False,
            joints=options.get("joints"),
            keyframe=options.get("keyframe"),
            as_is=request.as_is,
        )
        pair = read_pair(
            *models,
            take=options.get("take"),
            body=options.get("body"),
            packages=options.get("packages"),
            xacro=options.get("xacro", False),
            xacro_args=options.get("xacro_args"),
            defer_visuals=load_request.feet is None,
        )
        preparation, robot = explain_loading(pair.urdf, pair.mjcf, load_request)
        preparation = replace(preparation, notes=pair.add_source(robot).notes)
    document = preparation_document(preparation)
    shared.show_report(
        Report(document.title, (document,)), request.style, everything=request.everything
    )
    shared.finish_command(json_path, preparation, passed=True)
