"""Command ``pupper-analysis analyze``: take robots from model files to a verified stand."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.base import kinds
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_idle
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    RobotOptions,
    add_options,
    check_bases_are_free,
    load_selected_robot,
    name_uniquely,
    pass_robot_options,
    robots_argument,
)
from pupper_analysis.cli.stance_fields import make_options, make_task
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.present.document import text

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.task import StandTask
    from pupper_analysis.tools.analyze.analysis import Analysis
    from pupper_analysis.tools.analyze.document import ComparisonRow


_FIGURE_FILES = kinds.Folder(
    dict.fromkeys(("torques.png", "heights.png", "gains.png", "variants.png"), kinds.PICTURE_KIND)
)
"""Files that ``analyze`` may write or replace in its output folder, in addition to a figure of each
robot's pose."""


@shared.command("analyze")
@robots_argument
@add_options(FILE_OPTIONS, VARIANT_OPTIONS, make_options("Base"))
@shared.output_option(
    "-o",
    "--output",
    holds=lambda given: None if given["no_figures"] else _FIGURE_FILES,
    default=Path("output"),
    show_default=True,
    help="Write the figures into this folder; it is created if needed.",
)
@shared.json_option
@shared.report_option
@click.option("--no-figures", is_flag=True, help="Draw no figures.")
@shared.text_format_option
@shared.verbose_option
@shared.output_option(
    "--write",
    "write_folder",
    holds=kinds.Folder({}),
    help="Write the variants' URDFs, MJCFs and meshes into this folder.",
)
@pass_robot_options
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    output: Path,
    json_path: Path | None,
    report_path: Path | None,
    no_figures: bool,
    style: str,
    everything: bool,
    write_folder: Path | None,
    **stance: Any,
) -> None:
    """Compute and verify the stand of robots from their model files.

    Each ROBOT is a variant of Pupper (original, long-leg, heavy, v3, v3-long-leg, v3-heavy; by
    default all six), a URDF, an MJCF, or both: the URDF and then the MJCF. Define other
    variants with --base, --leg-scale and --torso-mass-scale.

    The output is a verdict and two lines per robot, and a table that compares several robots. With
    -v, everything is printed: the joints and their directions of rotation, masses and CoM, the
    stand (PlaCo), foot Jacobians, motor torques and contact forces (Pinocchio), the simulated stand
    and the gain sweep (MuJoCo), and the cross-check of URDF and MJCF.

    \b
    Examples:
      pupper-analysis analyze
      pupper-analysis analyze original long-leg --no-figures -v
      pupper-analysis analyze --base v3 --leg-scale 1.2 --json v3-1.2.json
      pupper-analysis analyze v3 --height 0.12 --pitch 0.1 --report v3.html
      pupper-analysis analyze go2.xml a1.urdf v3

    Exit status: 0 all verified, 1 something failed verification or the cross-check,
    2 bad input (an unknown name, an invalid scale, a stance out of reach).
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present.terminal import make_console, print_table
    from pupper_analysis.pupper.variant_files import write_variant
    from pupper_analysis.pupper.variants import VARIANTS, get_variant_spec
    from pupper_analysis.tools.analyze.document import comparison_table

    if no_figures:
        refuse_idle("--no-figures", "output")
    meant = [
        robot if isinstance(robot, RobotFiles) else get_variant_spec(robot)
        for robot in which.select_robots(words) or VARIANTS.values()
    ]
    specs = [robot for robot in meant if not isinstance(robot, RobotFiles)]
    if write_folder is not None and len(specs) < len(meant):
        raise ConfigurationError("--write", diagnose("written-are-variants"))
    task = make_task(stance)
    shown = style == "text"
    is_drawn = not no_figures or report_path is not None
    analyses, robots = _analyze_all(
        meant,
        words,
        task,
        everything=everything,
        shown=shown,
        visuals=is_drawn,
        sweep=everything or is_drawn or json_path is not None or style == "markdown",
    )
    folder = None if no_figures else output
    rows = _compare_variants(meant, analyses)
    table, named = comparison_table(rows), [(analysis.name, analysis) for analysis in analyses]
    if shown and (everything or len(rows) > 1):
        print_table(make_console(), table)
    if style == "markdown":
        shared.show_results(named, style, robots=robots, overview=[table])
    if folder is not None:
        _write_figures(robots, analyses, folder)
    shared.write_json(json_path, {"variants": dict(named), "comparison": rows})
    shared.write_page(report_path, [*analyses, table], robots)
    good = sum(analysis.verified for analysis in analyses)
    if len(analyses) > 1:
        shared.print_text(text("verified-count", good=good, count=len(analyses)), err=not shown)
    if shown and not everything:
        shared.print_text(text("options-for-more"))
    if write_folder is not None:
        for spec in specs:
            for path in write_variant(spec, write_folder):
                shared.confirm_written(path)
    if good < len(analyses):
        click.get_current_context().exit(shared.EXIT_FAILED)


def _analyze_all(
    meant: list[VariantSpec | RobotFiles],
    words: tuple[str, ...],
    task: StandTask,
    *,
    everything: bool,
    shown: bool,
    visuals: bool,
    sweep: bool,
) -> tuple[list[Analysis], list[Robot]]:
    """Analyse robots, and print each result as soon as it is known if ``shown``.

    ``words`` are the typed words that name the robots, for an error about one of the robots.

    ``visuals`` is False if the robots are not drawn: visual meshes are then not converted. The gain
    sweep is computed if ``sweep``; the short output does not contain it.

    Returns:
        Analyses, and loaded robots with distinct names, both in the order of ``meant``.
    """
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.terminal import make_console, print_document, print_summary
    from pupper_analysis.stance.stand import solve_stand
    from pupper_analysis.tools.analyze.analysis import analyze_variant
    from pupper_analysis.tools.analyze.document import analysis_document

    has_files = any(isinstance(robot, RobotFiles) for robot in meant)
    # Loading files shows its own progress.
    with nullcontext() if has_files else shared.show_progress("loading the robots"):
        loaded = [load_selected_robot(robot, visuals=visuals) for robot in meant]
        robots = name_uniquely(meant, loaded)
        if len(robots) > 1:
            check_bases_are_free(meant, robots, words)
        for robot in robots:  # a stance out of reach is found before anything is printed
            solve_stand(robot, task)
    out = make_console()
    analyses = []
    for robot in robots:
        analyses.append(analyze_variant(robot, task, sweep=sweep, progress=out.is_terminal))
        if shown and everything:
            print_document(out, analysis_document(analyses[-1]), everything=True)
        elif shown:
            document = analysis_document(analyses[-1])
            step = document.next_step if len(robots) == 1 else None
            print_summary(out, document, next_command=complete_command(step))
    return analyses, robots


def _compare_variants(
    meant: list[VariantSpec | RobotFiles], analyses: list[Analysis]
) -> list[ComparisonRow]:
    """Return a row of key figures per robot; variants with ratios to the unscaled variant."""
    from pupper_analysis.pupper.variant_files import load_variant
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.tools.analyze.analysis import measure_leg_lengths
    from pupper_analysis.tools.analyze.document import compare_with_base

    references: dict[str, tuple[float | None, float | None]] = {}
    for name in {variant.base for variant in meant if isinstance(variant, VariantSpec)}:
        robot = load_variant(VariantSpec(base=name))
        references[name] = robot.total_mass, measure_leg_lengths(robot)[0]
    bases = [str(robot) if isinstance(robot, RobotFiles) else robot.base for robot in meant]
    return [
        compare_with_base(analysis, base, *references.get(base, (None, None)))
        for base, analysis in zip(bases, analyses, strict=True)
    ]


def _write_figures(robots: list[Robot], analyses: list[Analysis], folder: Path) -> None:
    """Write the figures of the analyses into a folder, and print the folder."""
    from pupper_analysis.present.documents.registry import make_document
    from pupper_analysis.present.figures.pose import write_pose_figure
    from pupper_analysis.tools.analyze.comparison_figures import FIGURES
    from pupper_analysis.tools.analyze.figures import render_variants

    count = len(robots) + len(FIGURES) + 1
    with shared.show_progress("drawing the figures"):
        for number, (robot, analysis) in enumerate(zip(robots, analyses, strict=True)):
            report_progress("figures", number, count)
            path = folder / f"pose_{analysis.name}.png"
            verdict = make_document(analysis).verdict
            write_pose_figure(robot, analysis.stand, analysis.statics, path, verdict=verdict)
        for number, (name, draw) in enumerate(FIGURES.items(), start=len(robots)):
            report_progress("figures", number, count)
            draw(analyses, folder / name)
        report_progress("figures", count - 1, count)
        stands = [analysis.stand for analysis in analyses]
        picture = render_variants(list(zip(robots, stands, strict=True)), folder / "variants.png")
    shared.confirm_written(f"{folder}/")
    if picture.note:
        shared.print_text(text("note-line", note=picture.note), err=True)
