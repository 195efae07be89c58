"""``pupper-analysis check``: check all models of a repository."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.next_step import complete_command
from pupper_analysis.present.document import NextStep

if TYPE_CHECKING:
    from pupper_analysis.present.document import Text


@shared.command("check")
@click.argument("folder", type=click.Path(path_type=Path), required=False)
@shared.file_option(
    "--config",
    help="Configuration file. By default pupper-analysis.toml in FOLDER or in a folder above it.",
)
@click.option(
    "--update-baseline",
    is_flag=True,
    help="Write all current findings to the baseline; afterwards only new findings fail.",
)
@click.option(
    "--since",
    metavar="REVISION",
    help="Also report the changes since this git revision, and their effect in MuJoCo.",
)
@click.option(
    "--init",
    "first",
    is_flag=True,
    help="Write a pupper-analysis.toml that lists all models in FOLDER, and exit.",
)
@shared.all_option
@shared.json_option
@shared.format_option
def command(
    folder: Path | None,
    config: Path | None,
    update_baseline: bool,
    since: str | None,
    first: bool,
    everything: bool,
    json_path: Path | None,
    style: str,
) -> None:
    """Cross-check and audit all models that pupper-analysis.toml lists, e.g. in a repository's CI.

    The file is in FOLDER or in a folder above it; by default FOLDER is the current folder. Paths in
    the file are relative to the folder of the file.

    The baseline lists accepted findings with their values. Only a finding that is new or has
    another value fails. With --since, each MJCF is compared with an older revision: contacts,
    options, keyframes and servos. A change that makes the robot fall fails. docs/how-to/check.md
    contains an example, the GitHub Action and the pre-commit hook.

    \b
    A minimal pupper-analysis.toml:
      [[pair]]
      name = "go1"
      urdf = "urdf/go1.urdf"
      mjcf = "mjcf/go1.xml"

    \b
    Many models, by patterns; * represents the same text in both patterns:
      [[pair]]
      name = "robots"
      urdf = "urdf/*.urdf"
      mjcf = "mjcf/*.xml"

    \b
    Examples:
      pupper-analysis check --init
      pupper-analysis check
      pupper-analysis check robots/
      pupper-analysis check --update-baseline
      pupper-analysis check --since origin/main
      pupper-analysis check --config robots/pupper-analysis.toml --format github
      pupper-analysis check --format sarif --json check.json

    Exit status: 0 all new findings are less severe than fail-on, 1 otherwise, or if a model cannot
    be read, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present import formats
    from pupper_analysis.tools.check import document as report
    from pupper_analysis.tools.check.check import check_repository

    if first:
        refuse_unused("--init", {"--init": {"first", "config", "folder"}})
        _write_first_config(config, folder or Path())
        return
    config = _find_typed_config(config, folder)
    with shared.show_progress("checking all models"):
        result = check_repository(config, update_baseline=update_baseline, since=since)
    if style in ("text", "markdown"):
        shared.show_results([("", result)], style, everything=everything)
    else:
        found = report.make_check_annotations(result, in_a_change=style == "github")
        if style == "github":
            found = [
                annotation for annotation in found if not annotation.known
            ]  # known findings are not shown again
        text = formats.write_annotations(style, found, "pupper-analysis check")
        click.echo(text, nl=bool(text))
        if style == "github":
            click.echo(
                f"{'passed' if result.passed else 'failed'}: {report.summarise_check(result).en}"
            )
    shared.finish_command(json_path, result, passed=result.passed)


def _find_typed_config(config: Path | None, folder: Path | None) -> Path:
    """Return the configuration file that the user typed, or that of the typed or current folder.

    Raises:
        ConfigurationError: If both were typed, or there is no configuration, for example.
    """
    from pupper_analysis.base.diagnostics import diagnose
    from pupper_analysis.base.errors import ConfigurationError
    from pupper_analysis.base.inputs import is_folder, path_exists
    from pupper_analysis.tools.check.config import find_config

    if config is not None and folder is not None:
        raise ConfigurationError("--config", diagnose("config-and-folder", folder=folder))
    if config is not None:
        return config
    if folder is not None and not is_folder(folder):
        missing = not path_exists(folder) or None
        raise ConfigurationError(str(folder), diagnose("check-needs-folder", missing=missing))
    try:
        return find_config(folder)
    except ConfigurationError as error:
        error.add_note(_complete_check(folder, "--init"))
        raise


def _write_first_config(config: Path | None, folder: Path) -> None:
    """Write a first configuration of a folder, and print the next steps.

    Raises:
        ConfigurationError: If the folder already contains a configuration, or no model, for
            example.
        OutputError: If the file cannot be written.
    """
    from pupper_analysis.base.diagnostics import diagnose
    from pupper_analysis.base.errors import ConfigurationError
    from pupper_analysis.base.inputs import CONFIG_NAME, is_folder, path_exists
    from pupper_analysis.present.document import MAX_ANSWER_WIDTH, join_words, text
    from pupper_analysis.tools.check.config import write_config

    if config is not None:
        raise ConfigurationError("--config", diagnose("init-writes-here"))
    if not is_folder(folder):
        missing = not path_exists(folder) or None
        raise ConfigurationError(str(folder), diagnose("check-needs-folder", missing=missing))
    try:
        path, pairs, singles = write_config(folder)
    except ConfigurationError as error:
        if path_exists(folder / CONFIG_NAME):
            error.add_note(_complete_check(folder))
        raise
    count = len(pairs) + len(singles)
    shared.print_text(text("config-written", path=str(path), count=count, pairs=len(pairs)))
    groups: dict[str, Sequence[str]] = {"models-paired": pairs}
    for lacking, key in (("mjcf", "models-without-mjcf"), ("urdf", "models-without-urdf")):
        groups[key] = [name for name, missing in singles.items() if missing == lacking]
    groups = {key: names for key, names in groups.items() if names}
    width = (MAX_ANSWER_WIDTH - 2) // max(len(groups), 1) - 2
    listed = [_shorten_list(key, names, width) for key, names in groups.items()]
    shared.print_text(join_words(listed, "semicolon"), indent=2)
    line = _complete_check(folder)
    shared.print_text(text("next-command", command=line), indent=2)


def _complete_check(folder: Path | None, *options: str) -> str:
    """Create the command line of `check` for a folder, with the typed language."""
    words = () if folder in (None, Path()) else (str(folder),)
    omitted = ("--init", "--config")
    return complete_command(
        NextStep("check", (*words, *options), robot_typed=False, omitted=omitted)
    )


def _shorten_list(key: str, names: Sequence[str], width: int) -> Text:
    """Create the text ``key`` with a list of names; names beyond ``width`` characters are counted.

    The first name is always included.
    """
    from pupper_analysis.present.document import Name, join_words, text

    for count in range(len(names), 0, -1):
        listed = join_words(map(Name, names[:count]))
        line = text(key, names=listed, more=len(names) - count)
        if len(line.en) <= width:
            break
    return line
