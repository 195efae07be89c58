"""``pupper-analysis diff``: show the changes between two versions of a model."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.cli import shared
from pupper_analysis.cli.next_step import complete_command
from pupper_analysis.cli.shared import change_tolerances, fine_tolerance_option
from pupper_analysis.present.document import NextStep
from pupper_analysis.pupper.named_robots import is_variant


def _propose_other_command(code: str, old: str, new: str) -> str:
    """Return the command line after the refusal of a comparison; empty if there is none.

    ``code`` is the code of the error: `crosscheck` compares two formats, and `audit` checks one of
    two robots without a common joint. A revision in git is passed to no command.
    """
    words = [word for word in (old, new) if path_exists(word) or is_variant(word)]
    if code == "formats-differ" and len(words) > 1:
        return complete_command(NextStep("crosscheck", (old, new), robot_typed=False))
    if code == "no-joint-in-common" and words:
        return complete_command(NextStep("audit", (words[0],), robot_typed=False))
    return ""


@shared.command(
    "diff",
    meanings={
        "old": "the old version, a URDF or MJCF, REVISION:PATH, or a variant",
        "new": "the new version, of the same format as the old one",
    },
)
@click.argument("old", type=click.Path())
@click.argument("new", type=click.Path())
@shared.package_option
@shared.xacro_options
@fine_tolerance_option
@shared.json_option
@shared.text_format_option
@shared.verbose_option
def command(
    old: str,
    new: str,
    packages: tuple[str, ...],
    xacro: bool,
    xacro_args: tuple[str, ...],
    changes: tuple[str, ...],
    json_path: Path | None,
    style: str,
    everything: bool,
) -> None:
    """Show the changes of the robot between OLD and NEW: two URDFs, or two MJCFs.

    The change in total mass comes first. Each changed number is shown with the lines in both files
    and the effect on the dynamics. The largest change of a gravity torque follows, for a base that
    is held in the air (-v: all joints). Changes of the text without a change of numbers are
    ignored. OLD or NEW may be
    REVISION:PATH, a file in git's history, or the name of a variant.

    \b
    Examples:
      pupper-analysis diff HEAD:robots/go1.urdf robots/go1.urdf
      pupper-analysis diff v1.0:./robot.xml main:./robot.xml
      pupper-analysis diff robot.urdf longer.urdf --tolerance mass=1e-3
      pupper-analysis diff v3 v3-heavy

    Exit status: 0 the robot is the same, 1 the robot has changed, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.robot.matching.tolerances import Tolerances
    from pupper_analysis.tools.diff.compare import diff_models

    tolerances = change_tolerances(Tolerances.strict(), changes)
    folders = shared.parse_packages(packages)
    with shared.show_progress("comparing both versions"):
        try:
            result = diff_models(
                old,
                new,
                packages=folders,
                tolerances=tolerances,
                xacro=xacro,
                xacro_args=shared.parse_xacro_args(xacro_args),
            )
        except ModelError as error:
            error.add_note(_propose_other_command(error.cause.code, old, new))
            raise
    shared.show_results([("", result)], style, everything=everything)
    shared.finish_command(json_path, result, passed=result.same)
