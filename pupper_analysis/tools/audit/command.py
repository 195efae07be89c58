"""``pupper-analysis audit``: find errors in a model file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused

if TYPE_CHECKING:
    from pupper_analysis.models.mjcf_file import MjcfFile
    from pupper_analysis.models.urdf_file import UrdfFile
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.tools.audit.registry import Audit


@shared.command("audit")
@click.argument("file", required=False, type=shared.MODEL_FILE)
@shared.package_option
@shared.xacro_options
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
@click.option(
    "--fix",
    is_flag=True,
    help="Print a patch with all findings that have a single repair, and write it if confirmed.",
)
@click.option("--yes", "confirmed", is_flag=True, help="Write the patch of --fix unasked.")
@click.option(
    "--force",
    is_flag=True,
    help=f"With --fix, write to a file with uncommitted changes. {shared.FORCE_HELP}",
)
@shared.verbose_option
@shared.json_option
@shared.report_option
@shared.format_option
def command(
    file: Path | None,
    packages: tuple[str, ...],
    xacro: bool,
    xacro_args: tuple[str, ...],
    disabled: tuple[str, ...],
    list_rules: bool,
    fail_on: str,
    fix: bool,
    confirmed: bool,
    force: bool,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    style: str,
) -> None:
    """Find physical errors and practical defects in a model file: URDF, MJCF or USD.

    Impossible masses and inertias, legs that are not mirror images, shapes that do not reach the
    joints, limits in degrees, servos of wrong sign, feet that start inside the floor, and more.
    Each finding states the location, the consequence and the repair.

    \b
    Examples:
      pupper-analysis audit robot.urdf
      pupper-analysis audit scene.xml --disable armature-zero --fail-on warning
      pupper-analysis audit robot.usda
      pupper-analysis audit robot.urdf --fix         a patch, then the question
      pupper-analysis audit v3                       both files of a variant
      pupper-analysis audit --list-rules
      pupper-analysis audit robot.urdf.xacro --xacro --xacro-arg camera=true

    Exit status: 0 all findings are less severe than --fail-on, 1 otherwise, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.base.diagnostics import Severity
    from pupper_analysis.present.document import text
    from pupper_analysis.pupper.named_robots import (
        find_model,
        is_variant,
        refuse_unknown_variant,
    )
    from pupper_analysis.tools.audit.audit import audit_model
    from pupper_analysis.tools.audit.document import describe_counts

    if list_rules:
        refuse_unused("--list-rules", {"--list-rules": {"list_rules"}})
        _print_rules()
        return
    if confirmed and not fix:
        raise ConfigurationError("--yes", diagnose("yes-without-fix"))
    if file is None:
        raise ConfigurationError("FILE", diagnose("nothing-to-audit"))
    refuse_unknown_variant(str(file))
    folders = shared.parse_packages(packages)
    named = is_variant(file)
    if fix and (named or not file.is_file()):
        raise ConfigurationError("--fix", diagnose("nothing-to-fix", file=str(file)))
    arguments = shared.parse_xacro_args(xacro_args)

    def audit(model: Path | UrdfFile | MjcfFile) -> Audit:
        """Audit a model with the options of the command."""
        return audit_model(
            model, packages=folders, disabled=disabled, xacro=xacro, xacro_args=arguments
        )

    with shared.show_progress("checking the model against the rules"):
        models = [find_model(file, "urdf"), find_model(file, "mjcf")] if named else [file]
        results = [audit(model) for model in models]
    if style in ("text", "markdown"):
        _show_audits(results, style, fix=fix, confirmed=confirmed, everything=everything)
    else:
        _print_annotations(results, style, file.name)
    is_text = style == "text"
    if fix and (
        count := _fix_files(results, confirmed=confirmed, force=force, prints_patch=is_text)
    ):
        results = [audit(file)]
        left = describe_counts(results[0].counts)
        shared.print_text(text("repairs-written", count=count, left=left), err=True)
    least = Severity(fail_on).rank
    passed = all(finding.severity.rank > least for result in results for finding in result.findings)
    content = (
        results[0] if len(results) == 1 else {Path(result.file).name: result for result in results}
    )
    shared.write_page(report_path, content)
    shared.finish_command(json_path, content, passed=passed)


def _print_rules() -> None:
    """Print the table of all rules."""
    from pupper_analysis.present.terminal import make_console, print_table
    from pupper_analysis.tools.audit.document import make_rules_table

    print_table(make_console(), make_rules_table())


def _show_audits(
    audits: Sequence[Audit], style: str, *, fix: bool, confirmed: bool, everything: bool
) -> None:
    """Print the reports of audits; with ``fix``, the answer is about the patch that follows.

    Markdown contains the report without the patch.
    """
    from dataclasses import replace

    from pupper_analysis.present.documents.registry import build_report
    from pupper_analysis.tools.audit.document import describe_patch
    from pupper_analysis.tools.audit.fix import apply_repairs

    step = _select_next_step(audits, fix=fix, confirmed=confirmed)
    report = build_report([("", audit) for audit in audits])
    if fix and style == "text":
        (audit,), (document,) = audits, report.documents
        count = apply_repairs(audits)[1]
        report = replace(report, documents=(describe_patch(document, audit, count),))
        if step is None and (proposed := document.next_step) is not None:
            step = replace(proposed, omitted=(*proposed.omitted, "--fix", "--yes"))
    shared.show_report(report, style, everything=everything, next_step=step)


def _select_next_step(audits: Sequence[Audit], *, fix: bool, confirmed: bool) -> NextStep | None:
    """Return the command to suggest next: `crosscheck` for both files of a variant; else None.

    With ``fix`` and unambiguous repairs, the command is `audit`: without options if this run may
    write the repairs, otherwise with the options ``--fix --yes``.
    """
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.tools.audit.fix import list_unique_repairs

    if fix and list_unique_repairs(audits):
        may_write = confirmed or sys.stdin.isatty()
        words = () if may_write else ("--fix", "--yes")
        return NextStep("audit", words, omitted=("--fix", "--yes"))
    return NextStep("crosscheck") if len(audits) > 1 else None


def _print_annotations(audits: Sequence[Audit], style: str, name: str) -> None:
    """Print the findings on the file ``name`` as annotations in the format ``style``."""
    from pupper_analysis.present.formats import write_annotations
    from pupper_analysis.tools.audit.document import make_audit_annotations

    annotations = [found for audit in audits for found in make_audit_annotations(audit)]
    click.echo(write_annotations(style, annotations, f"pupper-analysis audit {name}"))


def _fix_files(audits: Sequence[Audit], *, confirmed: bool, force: bool, prints_patch: bool) -> int:
    """Print the patch of the repairs that are unambiguous, and write the files if confirmed.

    Without ``confirmed``, the user is asked on a terminal. Without ``prints_patch``, the patch is
    printed to standard error. ``force`` overwrites files with uncommitted changes.

    Returns:
        Number of repairs in the written files; 0 if nothing was written.
    """
    from pupper_analysis.base.patches import make_patch
    from pupper_analysis.base.runs import current_language
    from pupper_analysis.present.document import text, translate
    from pupper_analysis.tools.audit.document import describe_repair
    from pupper_analysis.tools.audit.fix import (
        apply_repairs,
        list_computed_repairs,
        list_estimates,
        write_documents,
    )

    documents, count = apply_repairs(audits)
    for repair in list_estimates(audits):
        shared.print_text(describe_repair(repair), err=True)
    for repair in list_computed_repairs(audits):
        shared.print_text(describe_repair(repair, is_stated=False), err=True)
    for document in documents:
        patch = make_patch(document.path, document.data, document.render())
        click.echo(patch, nl=False, err=not prints_patch)
    if not documents:
        if not prints_patch:  # otherwise the answer states this
            shared.print_text(text("no-unique-repair"), err=True)
        return 0
    may_ask = sys.stdin.isatty()
    question = translate(text("write-repairs", count=count), current_language())
    if not confirmed and not (may_ask and click.confirm(question, err=True)):
        shared.print_text(text("repairs-not-written", count=count), err=True)
        return 0
    write_documents(documents, force=force)
    return count
