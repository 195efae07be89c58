"""``pupper-analysis crosscheck``: find the differences between a URDF and an MJCF."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.next_step import make_second_model_error
from pupper_analysis.cli.shared import (
    change_tolerances,
    frame_option,
    map_option,
    parse_name_map,
)


@shared.command(
    "crosscheck",
    meanings={
        "urdf": "a URDF, or the name of a variant such as v3",
        "mjcf": "the MJCF to compare with the URDF",
    },
)
@click.argument("urdf", type=shared.MODEL_FILE)
@click.argument("mjcf", type=shared.MODEL_FILE, required=False)
@map_option
@shared.package_option
@shared.xacro_options
@frame_option
@click.option(
    "--tolerance",
    "changes",
    multiple=True,
    metavar="KIND=VALUE",
    help="Largest difference to ignore; e.g. mass=1e-3. KIND is mass, com, inertia, position, "
    "rotation, axis, limit, effort, velocity, damping, friction, gravity or dynamics. "
    "Repeatable.",
)
@click.option(
    "--strict",
    is_flag=True,
    help="Report everything above rounding errors (1e-9): differences in printed digits, in "
    "names, damping that the URDF lacks, and a fixed base that is tilted against the URDF's.",
)
@shared.all_option
@shared.json_option
@shared.report_option
@shared.format_option
def command(
    urdf: Path,
    mjcf: Path | None,
    pairs: tuple[str, ...],
    packages: tuple[str, ...],
    xacro: bool,
    xacro_args: tuple[str, ...],
    feet: tuple[str, ...],
    changes: tuple[str, ...],
    strict: bool,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    style: str,
) -> None:
    """Find the numbers that make a robot's URDF and MJCF disagree.

    Both models are compared in both engines, and body by body. Each difference is shown with the
    lines in both files and the effect on the dynamics, the most important difference first. The
    list is checked for completeness. Other positions of link frames are no differences. Joints are
    matched by --map, by name, by name without prefixes and suffixes, and finally by structure
    (which is then printed).

    SAME ROBOT, DIFFERENT CONVENTIONS: only the zero angles of joints or the frame of a free base
    differ. Equal joint angles then mean different poses, so the exit status is 1.

    \b
    Examples:
      pupper-analysis crosscheck go1.urdf go1.xml
      pupper-analysis crosscheck v3                  both files of a variant
      pupper-analysis crosscheck a1.urdf a1.xml --map lf_haa=FL_hip \\
        --tolerance mass=1e-3
      pupper-analysis crosscheck robot.urdf robot.xml --strict --format github
      pupper-analysis crosscheck robot.urdf.xacro robot.xml --xacro

    Exit status: 0 the files agree within the tolerances (a tilted base counts with --strict alone),
    1 the files differ, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present import formats
    from pupper_analysis.pupper.named_robots import is_variant
    from pupper_analysis.robot.matching.tolerances import Tolerances
    from pupper_analysis.tools.crosscheck.crosscheck import compare_models
    from pupper_analysis.tools.crosscheck.document import make_comparison_annotations

    if mjcf is not None:
        urdf, mjcf = shared.sort_model_paths(urdf, mjcf)
    elif not is_variant(urdf):
        raise make_second_model_error(command, urdf)
    names = parse_name_map(pairs)
    folders = shared.parse_packages(packages)
    tolerances = Tolerances.strict() if strict else Tolerances()
    tolerances = change_tolerances(tolerances, changes)
    with shared.show_progress("comparing both files in both engines"):
        comparison = compare_models(
            urdf,
            mjcf,
            names=names,
            packages=folders,
            feet=feet,
            tolerances=tolerances,
            strict_names=strict,
            xacro=xacro,
            xacro_args=shared.parse_xacro_args(xacro_args),
        )
    if style in ("text", "markdown"):
        shared.show_results([("", comparison)], style, everything=everything)
    else:
        click.echo(
            formats.write_annotations(
                style,
                make_comparison_annotations(comparison),
                f"pupper-analysis crosscheck {Path(comparison.urdf).name} "
                f"{Path(comparison.mjcf).name}",
            )
        )
    shared.write_page(report_path, comparison)
    shared.finish_command(json_path, comparison, passed=comparison.agree)
