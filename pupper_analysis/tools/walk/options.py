"""Options and loading of the robot that ``walk`` and ``live`` share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.robots import load_selected_robot, print_robot_notes
from pupper_analysis.prepare.convert.files import RobotFiles

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot

CONTRACT_OPTION = shared.file_option(
    "--contract",
    help=(
        "TOML file of the observation and action of the policy; by default the file beside the "
        "policy."
    ),
)
"""Option ``--contract`` of the commands that read a walking policy."""

COMMAND_OPTION = click.option(
    "--command",
    "command_text",
    default="0.5,0,0",
    show_default=True,
    metavar="VX,VY,W",
    help="Speed forward and to the left (m/s), and turning to the left (rad/s).",
)
"""Option ``--command`` of the commands that simulate a walking policy: the commanded velocity."""


def load_walking_robot(
    source: str | VariantSpec | RobotFiles, style: str, *, everything: bool, visuals: bool = True
) -> Robot:
    """Load the robot of a walk, and print the notes on a robot that was read from files.

    Args:
        source: Variant, or files.
        style: Output format. Notes are printed only for "text"; a report in "markdown" contains the
            notes.
        everything: True to print all notes.
        visuals: False if the robot is not drawn: visual meshes are then not converted.
    """
    robot = load_selected_robot(source, visuals=visuals)
    if isinstance(source, RobotFiles) and style == "text":
        print_robot_notes(robot, everything=everything)
    return robot
