"""``pupper-analysis diff``: show the changes between two versions of a model."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.shared import change_tolerances, fine_tolerance_option


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
        result = diff_models(
            old,
            new,
            packages=folders,
            tolerances=tolerances,
            xacro=xacro,
            xacro_args=shared.parse_xacro_args(xacro_args),
        )
    shared.show_results([("", result)], style, everything=everything)
    shared.finish_command(json_path, result, passed=result.same)
