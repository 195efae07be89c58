"""Command ``pupper-analysis sync``: makes a URDF and an MJCF agree."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_idle
from pupper_analysis.cli.next_step import make_second_model_error
from pupper_analysis.cli.shared import (
    change_tolerances,
    fine_tolerance_option,
    map_option,
    parse_name_map,
)


@shared.command(
    "sync",
    meanings={
        "urdf": "the URDF to compare and change, or a variant such as v3",
        "mjcf": "the MJCF to compare and change",
    },
)
@click.argument("urdf", type=click.Path(path_type=Path))
@click.argument("mjcf", type=click.Path(path_type=Path), required=False)
@click.option(
    "--take",
    multiple=True,
    metavar="SIDE[:WHICH]",
    help=(
        "Take the values of urdf or mjcf: all, or the differences WHICH: numbers in the list (3, "
        "or 1,4-6), a kind (mass), a link or joint (link base, joint FL_hip) or a single "
        "difference (link base: mass). Repeatable; the most specific option counts."
    ),
)
@click.option("--dry-run", is_flag=True, help="Write nothing; only show what would change.")
@click.option(
    "--partial",
    is_flag=True,
    help="Write all possible values, even if other chosen values cannot be written.",
)
@click.option("--backup", is_flag=True, help="Keep the old files as NAME.bak.")
@click.option(
    "--force",
    is_flag=True,
    help=f"Write even to files with uncommitted changes. {shared.FORCE_HELP}",
)
@map_option
@shared.package_option
@fine_tolerance_option
@shared.json_option
@shared.text_format_option
@shared.verbose_option
def command(
    urdf: Path,
    mjcf: Path | None,
    take: tuple[str, ...],
    partial: bool,
    dry_run: bool,
    backup: bool,
    force: bool,
    pairs: tuple[str, ...],
    packages: tuple[str, ...],
    changes: tuple[str, ...],
    json_path: Path | None,
    style: str,
    everything: bool,
) -> None:
    """Make a robot's URDF and MJCF agree: write numbers from a file into the other, in place.

    Only attributes whose numbers differ, and attributes that the format then requires, are written;
    comments, order and line ends are unchanged. Without --take the differences are listed, numbered
    from 1, with both values, and nothing is changed. --take FILE takes the values of that
    file; FILE:2,5-7 selects differences by number.
    Values that the other format cannot express, and orientations, are listed as not written.

    \b
    Examples:
      pupper-analysis sync robot.urdf robot.xml
      pupper-analysis sync robot.urdf robot.xml --take urdf --dry-run
      pupper-analysis sync robot.urdf robot.xml --take mjcf:effort \\
        --take urdf:2,5-7 --backup
      pupper-analysis sync robot.urdf robot.xml --take urdf \\
        --take mjcf:"link base_link: mass"

    Exit status: 0 the files agree (with --dry-run: would agree), 1 differences remain, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present.document import Report
    from pupper_analysis.pupper.named_robots import (
        find_model_pair,
        is_variant,
    )
    from pupper_analysis.robot.matching.tolerances import Tolerances
    from pupper_analysis.tools.sync.document import sync_document
    from pupper_analysis.tools.sync.models import sync_models

    if dry_run:
        refuse_idle("--dry-run", "backup")
    if not take:
        refuse_alone(("--take",), "partial", "backup")
    if mjcf is not None:
        urdf, mjcf = shared.sort_model_paths(urdf, mjcf)
    elif not is_variant(urdf):
        raise make_second_model_error(command, urdf)
    names, folders = parse_name_map(pairs), shared.parse_packages(packages)
    tolerances = change_tolerances(Tolerances(), changes)

    with shared.show_progress("comparing both files"):
        result = sync_models(
            urdf,
            mjcf,
            take=take,
            partial=partial,
            dry_run=dry_run or not take,
            backup=backup,
            force=force,
            names=names,
            packages=folders,
            tolerances=tolerances,
        )
    # A scaled variant is derived in memory.
    models = find_model_pair(urdf, mjcf)
    files = tuple(str(getattr(model, "path", model)) for model in models)
    document = sync_document(result, files=files, chosen=bool(take), dry_run=dry_run)
    shared.show_report(Report(document.title, (document,)), style, everything=everything)
    shared.finish_command(json_path, result, passed=result.agree)
