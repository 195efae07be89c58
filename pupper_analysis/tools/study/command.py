"""Command ``pupper-analysis study``: evaluates the designs of a study file."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.base import kinds
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.cli import shared

if TYPE_CHECKING:
    from pupper_analysis.present.document import Document
    from pupper_analysis.tools.study.running import Progress
    from pupper_analysis.tools.study.study import Study


def _list_metrics(context: click.Context, _: click.Parameter, requested: bool) -> None:
    """Print all metrics with units and exit, if ``--list-metrics`` was requested."""
    if not requested or context.resilient_parsing:
        return
    from pupper_analysis.tools.study.document import metrics_document

    _show_document(metrics_document(), "text", everything=True)
    context.exit()


_STUDY_FOLDER = kinds.Folder(
    {"study.json": kinds.OutputKind("study", kinds.match_prefix('{\n  "format": ', '{"format": '))}
)
"""Folder of a study, recognised by the beginning of the file ``study.json``."""


@shared.command("study", meanings={"file": "a TOML file that describes the study"})
@click.argument("file", type=click.Path(path_type=Path))
@shared.output_option(
    "-o",
    "--output",
    "folder",
    holds=_STUDY_FOLDER,
    help="Folder of the results; an interrupted run is resumed.  [required]",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help=("Number of processes. By default the number of cores."),
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help=(
        "Workers of a Dask cluster: address of its scheduler, e.g. tcp://host:8786, or local:N for "
        "N workers on this machine."
    ),
)
@click.option(
    "--minimise",
    multiple=True,
    metavar="NAME",
    help="Metric to minimise on the Pareto front; e.g. servo_sag. Repeatable.",
)
@click.option(
    "--maximise",
    multiple=True,
    metavar="NAME",
    help="Metric or parameter to maximise on the Pareto front; e.g. leg_scale. Repeatable.",
)
@click.option(
    "--write",
    "numbers",
    multiple=True,
    type=click.IntRange(min=1),
    metavar="N",
    help="Write design N of the table (from 1) as a URDF and an MJCF with its gains, and its "
    "stance, to design-N in the output folder. Repeatable.",
)
@click.option(
    "--list-metrics",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_metrics,
    help="List all metrics with units, and exit.",
)
@shared.report_option
@shared.json_option
@shared.text_format_option
@shared.verbose_option
def command(
    file: Path,
    folder: Path | None,
    workers: int | None,
    dask: str | None,
    minimise: tuple[str, ...],
    maximise: tuple[str, ...],
    numbers: tuple[int, ...],
    report_path: Path | None,
    json_path: Path | None,
    style: str,
    everything: bool,
) -> None:
    """Measure the designs that a TOML file describes, on all cores.

    Results are stored in a folder, as Parquet. A study can be interrupted at any time and
    resumes at the last stored design; after a change of the file, only new designs are measured. A
    design that fails is a row with the reason.

    \b
    Example of a file:
      robot = "v3"
      measure = ["peak_utilisation", "servo_sag", "stands"]
      [vary]
      leg_scale = { linspace = [0.8, 1.6, 9] }
      torso_mass_scale = { linspace = [1.0, 3.0, 9] }
      kp = { values = [5, 10, 20] }

    \b
    Examples:
      pupper-analysis study legs.toml -o legs/
      pupper-analysis study legs.toml -o legs/ --minimise servo_sag \\
        --maximise leg_scale
      pupper-analysis study legs.toml -o legs/ --report legs.html \\
        --maximise leg_scale
      pupper-analysis study legs.toml -o legs/ --write 3
      pupper-analysis study legs.toml -o legs/ --dask tcp://host:8786

    Exit status: 0 all designs were evaluated, 1 no design has a value of a metric, or the files of
    a written design give other metrics, 2 bad input, 130 interrupted.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.base.inputs import path_exists
    from pupper_analysis.models.published import is_published_name
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.pupper.named_robots import is_variant
    from pupper_analysis.tools.study.document import progress_bar
    from pupper_analysis.tools.study.outcome import check_objectives, study_outcome
    from pupper_analysis.tools.study.study import Study

    if is_variant(file) or is_published_name(str(file)):
        raise ConfigurationError("FILE", diagnose("study-of-variant", variant=str(file)))
    if not path_exists(file):
        raise _make_missing_file_error(file, folder)
    with shared.show_progress("reading the study, and loading its robot"):
        study = Study.read(file)
    if folder is None:  # after the file, so that a wrong name is reported first
        raise click.UsageError("Missing option '-o' / '--output'.", click.get_current_context())
    check_objectives(study, minimise, maximise)
    chosen = bool(minimise or maximise or study.minimise or study.maximise)
    if dask is not None and workers is not None:
        raise ConfigurationError("workers", diagnose("workers-of-a-cluster"))
    with ExitStack() as stack:
        executor = None
        if dask is not None:
            from pupper_analysis.tools.study.cluster import connect_dask

            executor, workers = stack.enter_context(connect_dask(dask))
        show = stack.enter_context(progress_bar())
        _run_study(study, folder, executor, workers, show)
    outcome = study_outcome(study, folder, minimise=minimise, maximise=maximise)
    step = None
    if outcome.varying_metrics and not (chosen or numbers):
        step = NextStep("study", ("-o", str(folder), "--minimise", outcome.varying_metrics[0]))
    shared.show_results([("", outcome)], style, everything=everything, next_step=step)
    shared.write_page(report_path, outcome)
    passed = outcome.is_measured
    if numbers:
        passed = _write_designs(study, numbers, folder, style, everything) and passed
    shared.finish_command(json_path, outcome.table.to_dict(orient="list"), passed=passed)


def _make_missing_file_error(file: Path, folder: Path | None) -> InputError:
    """Return the error about a missing study file, with the command to run next.

    The command repeats the study with a similar file, or prints the help with an example.
    """
    from pupper_analysis.base.inputs import find_similar_files
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.document import NextStep

    alike = [str(similar) for similar in find_similar_files(file) if similar.suffix == ".toml"]
    error = InputError(file, diagnose("study-file-missing", alike=alike))
    output = () if folder is None else ("-o", str(folder))
    words = (alike[0], *output) if alike else ("--help",)
    error.add_note(complete_command(NextStep("study", words, robot_typed=False)))
    return error


def _write_designs(
    study: Study, numbers: tuple[int, ...], folder: Path, style: str, everything: bool
) -> bool:
    """Write designs (rows ``numbers``, from 1) as files; return True if the metrics agree."""
    from pupper_analysis.tools.study.document import written_document
    from pupper_analysis.tools.study.write import write_design

    passed = True
    for number in dict.fromkeys(numbers):
        written = write_design(study, number, folder)
        _show_document(written_document(written, study.base), style, everything)
        for path in (written.urdf, written.mjcf, written.stance):
            shared.confirm_written(path)
        passed = passed and written.passed
    return passed


def _show_document(document: Document, style: str, everything: bool) -> None:
    """Print a document in the output format ``style``; with all details if ``everything``."""
    from pupper_analysis.present.document import Report

    shared.show_report(Report(document.title, (document,)), style, everything=everything)


def _run_study(
    study: Study,
    folder: Path,
    executor: Executor | None,
    workers: int | None,
    show: Callable[[Progress], None],
) -> None:
    """Evaluate the study; after an interruption or error, print how to resume, and raise again."""
    from pupper_analysis.present.document import text

    try:
        study.execute(folder, executor=executor, workers=workers, progress=show)
    except BaseException:
        shared.print_text(text("study-is-resumable", folder=str(folder)), err=True)
        raise
