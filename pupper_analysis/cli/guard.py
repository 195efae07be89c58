"""``pupper-analysis check``: all models that a repository's configuration names."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli.shared import CONTEXT, check_outputs, finish, format_option, json_option


@click.command(
    "check", context_settings=CONTEXT, short_help="Check all models of a repository, as its CI."
)
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="The pupper-analysis.toml; else that of this folder, or of one above it.",
)
@click.option(
    "--update-baseline",
    is_flag=True,
    help="Take all that is found as known: write the baseline. Only what is new fails from then.",
)
@click.option("--all", "everything", is_flag=True, help="Print what does not fail, too.")
@json_option
@format_option
def check_command(
    config: Path | None,
    update_baseline: bool,
    everything: bool,
    json_path: Path | None,
    style: str,
) -> None:
    """Crosscheck and audit all models that pupper-analysis.toml names, as a repository's CI does.

    What the baseline has with the same value is known, and passes: so an old robot can be guarded
    from today on, and only a difference or finding that is new, or has changed, fails. Paths are
    relative to the file. docs/guard.md has all its keys, the GitHub Action and the hook.

    \b
    The least pupper-analysis.toml:
      [[pair]]
      name = "go1"
      urdf = "urdf/go1.urdf"
      mjcf = "mjcf/go1.xml"

    \b
    Examples:
      pupper-analysis check
      pupper-analysis check --update-baseline
      pupper-analysis check --config robots/pupper-analysis.toml --format github
      pupper-analysis check --format sarif > check.sarif

    \b
    Exit status: 0 nothing is new, 1 something is, or a model cannot be read, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.guard.check import check_repository
    from pupper_analysis.report import formats
    from pupper_analysis.report import guard as report
    from pupper_analysis.report.console import console

    check_outputs(json_path)
    result = check_repository(config, update_baseline=update_baseline)
    if style == "text":
        report.print_check(console(), result, everything=everything)
    else:
        found = report.remarks(result)
        if style == "github":
            found = report.unknown(found)
        suite = f"check of {Path(result.config).name}"
        text = formats.for_machines(style, suite, found, report.cases(result))
        click.echo(text, nl=bool(text))
        if style == "github":
            click.echo(f"{'passed' if result.passed else 'failed'}: {report.summary(result)}")
    finish(json_path, result, passed=result.passed)
