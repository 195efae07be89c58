"""The command line."""

from __future__ import annotations

import sys

import click

from pupper_analysis.cli.models import audit_command, crosscheck
from pupper_analysis.cli.motions import path, push
from pupper_analysis.cli.shared import BAD_INPUT, CONTEXT, VERIFIED
from pupper_analysis.cli.stances import best, payload, stand, workspace
from pupper_analysis.cli.sync import sync_command
from pupper_analysis.cli.variants import analyze
from pupper_analysis.cli.windows import drop, view
from pupper_analysis.errors import PupperAnalysisError

__all__ = ["BAD_INPUT", "analyze", "drop", "group", "main", "run", "view"]


def run(command: click.Command, arguments: list[str] | None = None) -> None:
    """Runs a command and leaves the process with its exit status.

    An error of the package, or of the command line, becomes one line on standard error and exit
    status 2.
    """
    try:
        status = command.main(args=arguments, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = BAD_INPUT
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else command.name
        click.echo(f"error: {error.format_message()} (see: {where} --help)", err=True)
        status = BAD_INPUT
    except (PupperAnalysisError, click.ClickException) as error:
        click.echo(f"error: {error}", err=True)
        status = BAD_INPUT
    except click.Abort:
        click.echo("interrupted", err=True)
        status = 130
    except BrokenPipeError:
        # The reader of a pipe, such as head, has seen enough.
        sys.stdout = None
        status = VERIFIED
    sys.exit(status)


def main() -> None:
    """Runs the console command."""
    run(group)


@click.group("pupper-analysis", context_settings=CONTEXT)
@click.version_option(package_name="pupper-analysis")
def group() -> None:
    """Know that a legged robot's models are right, what its motors hold and how it can stand.

    \b
    Exit status: 0 verified, 1 something failed verification or the cross-check, 2 bad input.
    """  # noqa: D301 - click reads the \b


for _command in (
    analyze,
    stand,
    workspace,
    payload,
    best,
    path,
    push,
    crosscheck,
    sync_command,
    audit_command,
    view,
    drop,
):
    group.add_command(_command)
