"""``pupper-analysis load``: what two files lack to be a robot that can stand, and what was done."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import (
    FOUND,
    RobotOptions,
    add_options,
    robot_argument,
    with_robot,
)
from pupper_analysis.cli.stance_options import AS_IS
from pupper_analysis.prepare.convert.files import RobotFiles


@shared.command("load")
@robot_argument
@add_options(FOUND)
@click.option("--fixed-base", is_flag=True, help="Fix the base where the MJCF places it.")
@AS_IS
@click.option(
    "--explain", is_flag=True, help="Print each preparation pass that ran and what it did."
)
@shared.look_option
@shared.verbose_option
@shared.json_option
@with_robot
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    fixed_base: bool,
    as_is: bool,
    explain: bool,
    style: str,
    everything: bool,
    json_path: Path | None,
) -> None:
    """Load a robot of your own, and print what was added so that it can stand.

    ROBOT is a URDF, an MJCF, or a URDF and an MJCF; of one file the other model is made in memory.

    A free base, level ground, feet, a start pose and position servos are detected, or added in
    memory; no file is changed. --explain prints the preparation passes in the order they ran.

    \b
    Examples:
      pupper-analysis load go2.urdf
      pupper-analysis load urdf/pupper_v3.urdf mjcf/pupper_v3.xml --explain
      pupper-analysis load g1.urdf g1.xml --foot left_ankle_roll_link --foot right_ankle_roll_link

    \b
    Exit status: 0 the robot was loaded, 2 it cannot be loaded, or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.models.mjcf import silence_mujoco
    from pupper_analysis.prepare.convert.load import read_pair
    from pupper_analysis.prepare.load import explain_loading, feet_frames
    from pupper_analysis.prepare.ready import Request
    from pupper_analysis.present.document import Report
    from pupper_analysis.present.documents.preparation import preparation_document

    meant = which.one(words)
    if not isinstance(meant, RobotFiles):
        raise ConfigurationError("ROBOT", diagnose("file-of-a-robot-needed"))
    said = meant.options
    with shared.show_progress("preparing the robot: feet, start pose, servos"), silence_mujoco():
        request = Request(
            feet=feet_frames(said["feet"]) if "feet" in said else None,
            fixed_base=fixed_base,
            joints=said.get("joints"),
            keyframe=said.get("keyframe"),
            as_is=as_is,
        )
        pair = read_pair(
            *meant.models,
            take=said.get("take"),
            body=said.get("body"),
            packages=said.get("packages"),
        )
        told, robot = explain_loading(pair.urdf, pair.mjcf, request)
        told = replace(told, notes=pair.mark(robot).notes)
    document = preparation_document(told, explained=explain)
    shared.show_report(Report(document.title, (document,)), style, everything=everything)
    shared.finish_command(json_path, told, passed=True)
