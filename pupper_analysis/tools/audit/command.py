"""``pupper-analysis crosscheck`` and ``audit``: what is wrong in, and between, model files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.matching.tolerances import Tolerances

map_option = click.option(
    "--map",
    "pairs",
    multiple=True,
    metavar="URDF=MJCF",
    help="A joint's or frame's name in the URDF and in the MJCF; e.g. lf_haa=FL_hip. Repeatable.",
)
map_file_option = shared.file_option(
    "--map-file",
    help='TOML file with one such pair per line: "name in the URDF" = "name in the MJCF".',
)


frame_option = click.option(
    "--frame",
    "feet",
    multiple=True,
    metavar="FRAME",
    help="Compare only this frame; e.g. FL_foot. Repeatable. By default all frames that both "
    "files have are compared.",
)


fine_tolerance_option = click.option(
    "--tolerance",
    "changes",
    multiple=True,
    metavar="KIND=VALUE",
    help="Largest difference to ignore, as for crosscheck; e.g. mass=1e-3. Repeatable.",
)


def with_changes(tolerances: Tolerances, changes: tuple[str, ...]) -> Tolerances:
    """Returns tolerances with the changes of --tolerance KIND=VALUE."""
    return tolerances.changed(
        dict(shared.parse_number_assignment("tolerance", text) for text in changes)
    )


@shared.command()
@click.argument("urdf", type=shared.MODEL_FILE)
@click.argument("mjcf", type=shared.MODEL_FILE)
@map_option
@map_file_option
@shared.package_option
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
    "names, and damping that the URDF lacks.",
)
@click.option(
    "--any-coordinates",
    is_flag=True,
    help="Accept other zero angles of joints and another frame of a free base; notes list them.",
)
@click.option(
    "--same-mount",
    is_flag=True,
    help="Count a fixed base that is tilted against the URDF's as a difference (as --strict "
    "does), since it changes the gravity torques.",
)
@shared.all_option
@shared.json_option
@shared.report_option
@shared.format_option
def crosscheck(
    urdf: Path,
    mjcf: Path,
    pairs: tuple[str, ...],
    map_file: Path | None,
    packages: tuple[str, ...],
    feet: tuple[str, ...],
    changes: tuple[str, ...],
    strict: bool,
    any_coordinates: bool,
    same_mount: bool,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    style: str,
) -> None:
    """Find which number in which file makes a robot's URDF and MJCF disagree.

    Both models are compared in both engines, and body by body. Each difference is shown with its
    line in both files and its effect on the dynamics, the most important first, and the list is
    proven complete. The placement of link frames does not count. Joints are matched by --map, by
    name, by name without prefixes and suffixes, and finally by structure (which is then printed).

    SAME ROBOT, DIFFERENT CONVENTIONS means that only the zero angles of joints, or the frame of a
    free base, differ, so that the same joint angles are another pose. The exit status is then 1, or
    0 with --any-coordinates.

    \b
    Examples:
      pupper-analysis crosscheck go1.urdf go1.xml
      pupper-analysis crosscheck robot.urdf robot.xml --map lf_haa=FL_hip --tolerance mass=1e-3
      pupper-analysis crosscheck robot.urdf robot.xml --strict --format github
      xacro robot.urdf.xacro | pupper-analysis crosscheck - robot.xml

    \b
    Exit status: 0 they agree within the tolerances (a tilted base counts with --same-mount
    alone), 1 they differ, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.checks.compare import compare_models
    from pupper_analysis.matching.tolerances import Tolerances
    from pupper_analysis.report import comparison as comparison_report
    from pupper_analysis.report import formats

    names = mapped_names(pairs, map_file)
    folders = shared.package_folders(packages)
    tolerances = Tolerances.strict() if strict else Tolerances()
    tolerances = with_changes(tolerances, changes)
    comparison = compare_models(
        urdf,
        mjcf,
        names=names,
        packages=folders,
        feet=feet,
        tolerances=tolerances,
        strict_names=strict,
        any_coordinates=any_coordinates,
        same_mount=same_mount or strict,
    )
    if style in ("text", "markdown"):
        shared.show_results([("", comparison)], style, everything=everything)
    else:
        suite = f"{urdf.name} against {mjcf.name}"
        remarks, cases = comparison_report.comparison_remarks, comparison_report.comparison_cases
        click.echo(formats.for_machines(style, suite, remarks(comparison), cases(comparison)))
    shared.write_page(report_path, comparison)
    shared.finish_command(json_path, comparison, passed=comparison.agree)


@shared.command("audit")
@click.argument("file", required=False, type=shared.MODEL_FILE)
@shared.package_option
@click.option(
    "--disable",
    "disabled",
    multiple=True,
    metavar="RULE",
    help="Skip this rule; e.g. armature-zero. Repeatable.",
)
@click.option("--list-rules", is_flag=True, help="List the rules and exit.")
@click.option(
    "--fail-on",
    type=click.Choice(["error", "warning", "note", "info"]),
    default="error",
    show_default=True,
    help="Lowest severity that makes the exit status 1; info is the same as note.",
)
@shared.verbose_option
@shared.json_option
@shared.report_option
@shared.format_option
def audit_command(
    file: Path | None,
    packages: tuple[str, ...],
    disabled: tuple[str, ...],
    list_rules: bool,
    fail_on: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    style: str,
) -> None:
    """Find what is physically or practically wrong in one model file, URDF, MJCF or USD.

    Impossible masses and inertias, legs that are not mirror images, shapes that do not reach their
    joints, limits in degrees, servos that jitter, feet that start inside the floor, and more. Each
    finding says where it is, why it matters, and what to do.

    \b
    Examples:
      pupper-analysis audit robot.urdf
      pupper-analysis audit scene.xml --disable armature-zero --fail-on warning
      pupper-analysis audit robot.usda
      pupper-analysis audit --list-rules
      xacro robot.urdf.xacro | pupper-analysis audit -

    \b
    Exit status: 0 no finding as severe as --fail-on, 1 there is one, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.checks.audit import audit_model
    from pupper_analysis.report import audit as audit_report
    from pupper_analysis.report import formats

    if list_rules:
        refuse_unused("--list-rules", {"--list-rules": {"list_rules"}})
        _list_rules()
        return
    if file is None:
        raise ConfigurationError("FILE", diagnose("nothing-to-audit"))
    folders = shared.package_folders(packages)
    result = audit_model(file, packages=folders, disabled=disabled)
    if style in ("text", "markdown"):
        shared.show_results([("", result)], style, everything=everything)
    else:
        suite = f"audit of {file.name}"
        remarks, cases = audit_report.audit_remarks, audit_report.audit_cases
        click.echo(formats.for_machines(style, suite, remarks(result), cases(result)))
    passed = audit_report.worst_rank(result) > audit_report.rank_severity(fail_on)
    shared.write_page(report_path, result)
    shared.finish_command(json_path, result, passed=passed)


def _list_rules() -> None:
    from pupper_analysis.report.documents.audit import rules_table
    from pupper_analysis.report.terminal import make_console, print_table

    print_table(make_console(), rules_table())


def mapped_names(pairs: tuple[str, ...], map_file: Path | None) -> dict[str, str]:
    """Returns {name in the URDF: name in the MJCF} of --map and --map-file."""
    from pupper_analysis.matching.match import read_mapping

    names = read_mapping(map_file) if map_file is not None else {}
    for text in pairs:
        old, new = shared.parse_assignment("map", text)
        if names.setdefault(old, new) != new:
            told = diagnose("mapped-twice", joint=old, one=names[old], two=new)
            raise ConfigurationError("map", told)
    return names
