"""Run the command line: find the commands of the tools, and return the exit status of a run.

`group` finds the commands of this package and of installed plug-ins by name, and imports a command
at its first use. `run` executes a command and ends the process with the exit status; errors become
a line on standard error.
"""

from __future__ import annotations

import difflib
import errno
import gc
import os
import shlex
import sys
import traceback
from functools import cache
from importlib import import_module
from pathlib import Path

import click

import pupper_analysis
from pupper_analysis.base.diagnostics import fill_template, phrase
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.inputs import discard_standard_input
from pupper_analysis.base.kinds import GENERATOR_NAME
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.base.tools import HELP_HEADINGS, other_tools, own_tools
from pupper_analysis.cli.process import (
    ProcessEnded,
    catch_ending_signals,
    raise_if_ended,
    tolerate_output_errors,
)
from pupper_analysis.cli.shared import (
    CONTEXT_SETTINGS,
    EXIT_BAD_INPUT,
    EXIT_FAILED,
    EXIT_INTERNAL,
    EXIT_VERIFIED,
)


def list_tools() -> list[str]:
    """Return the names of all tools, which are also the names of their command-line commands.

    The sorted list contains the tools of this package, and of installed plug-ins.
    """
    return sorted([*own_tools(), *other_tools()])


@cache
def _import_command(name: str) -> click.Command | None:
    """Import the command-line command of a tool, and return it; None if there is no such tool."""
    tools = {**other_tools(), **own_tools()}
    if name not in tools:
        return None
    command: click.Command = import_module(f"{tools[name].package}.command").command
    return command


class LazyGroup(click.Group):
    """Group of the command-line commands of all tools; a command is imported at its first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all command-line commands; called by click."""
        return list_tools()

    def get_command(
        self,
        ctx: click.Context | None,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        """Import the command-line command with a name; None without. Called by click."""
        return _import_command(cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the first word of the command line names; called by click.

        Returns:
            Name of the command; command; words after the name.

        Raises:
            click.UsageError: If there is no such command. The message suggests similar names, if
                any.
        """
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            alike = difflib.get_close_matches(name, list_tools())
            if not alike and f"--{name}" in (word for param in self.params for word in param.opts):
                alike = [f"--{name}"]
            hint = f"Did you mean {' or '.join(alike)}?" if alike else ""
            if not alike and _is_robot(name):
                line = shlex.join([GENERATOR_NAME, "stand", *args])
                hint = f"{name} is a robot; type {line}"
            refusal = click.UsageError(f"No such command {name!r}. {hint}".strip(), ctx)
            if not alike and hint:
                refusal.add_note(line)
            elif alike:
                refusal.add_note(shlex.join([GENERATOR_NAME, alike[0], *args[1:]]))
            raise refusal
        return super().resolve_command(ctx, args)

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Write the list of all commands for ``--help``, under headings, without importing them."""
        tools = {**own_tools(), **other_tools()}
        width = max(map(len, tools))  # common width of the names in all lists
        for heading in HELP_HEADINGS:
            listed = [name for name in sorted(tools) if tools[name].heading == heading]
            if listed:
                with formatter.section(heading):
                    formatter.write_dl(
                        [(name.ljust(width), tools[name].question) for name in listed]
                    )


def _is_robot(word: str) -> bool:
    """Return True if a word is the name of a variant, or has the suffix of a URDF or MJCF."""
    from pupper_analysis.pupper.named_robots import is_variant

    return is_variant(word) or word.lower().endswith((".urdf", ".xml", ".mjcf"))


__all__ = ["EXIT_BAD_INPUT", "find_command", "group", "main", "run"]

DEBUG_OPTION = "--debug"
"""Option of all command-line commands that prints the traceback of an unexpected error."""

GC_THRESHOLDS = 200_000, 2, 2
"""Thresholds of Python's garbage collector for the three generations of objects [1]. The first is
larger than Python's default, so that collections are rarer. Chosen, not tuned.
"""


def run(command: click.Command, arguments: list[str] | None = None) -> None:
    """Run a command-line command, and end the process with the exit status of the command.

    The exit status is one of the constants ``EXIT_...``; for a signal, that of a shell (130 for
    Ctrl-C); or that of a library that ends the process. Errors are printed on standard error. A
    closed output pipe is no error.

    Args:
        command: Command.
        arguments: Words after the program name; None: the command-line arguments of the process.
    """
    os.environ["MPLBACKEND"] = "agg"  # figures are written to files
    gc.set_threshold(*GC_THRESHOLDS)
    given = sys.argv[1:] if arguments is None else list(arguments)
    debug = DEBUG_OPTION in given
    given = [argument for argument in given if argument != DEBUG_OPTION]
    status = EXIT_BAD_INPUT
    with tolerate_output_errors() as streams:
        with catch_ending_signals() as ending:
            try:
                status = _run_command(command, given, debug=debug)
            except (ProcessEnded, KeyboardInterrupt):
                ending.caught = True
                ending.signal = ending.signal or 2
            except BaseException:
                ending.caught = True
                if not ending.signal:
                    raise
        if ending.signal:
            click.echo(str(ending), err=True)
            status = ending.status
        sys.stdout.flush()
        failure = next((stream.failure for stream in streams if stream.failure), None)
        if failure is not None:
            click.echo(f"error: cannot write standard output: {failure.strerror}", err=True)
            status = EXIT_BAD_INPUT
    sys.exit(status)


def _run_command(command: click.Command, arguments: list[str], *, debug: bool) -> int:
    """Run a command-line command, print its error if it fails, and return the exit status.

    ``debug`` prints the traceback of an unexpected error.
    """
    language = "en"
    try:
        with ensure_run() as run:  # includes parsing, because options read files
            run.command = (GENERATOR_NAME, *arguments)
            try:
                return command.main(args=arguments, standalone_mode=False) or EXIT_VERIFIED
            finally:
                language = run.language
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else command.name
        text = f"{error.format_message()} (see: {where} --help)"
        _print_error(text, *getattr(error, "__notes__", ()))
    except PupperAnalysisError as error:
        message = error.diagnostic.get_short_form(language)
        _print_error(message, *getattr(error, "__notes__", ()), language=language)
    except click.ClickException as error:
        _print_error(str(error), *getattr(error, "__notes__", ()))
    except click.Abort as error:
        raise KeyboardInterrupt from error
    except BrokenPipeError:  # a pipe for results has no reader
        return EXIT_VERIFIED
    except SystemExit as error:  # of a library or a plug-in
        if error.code is None or isinstance(error.code, int):
            return error.code or EXIT_VERIFIED
        _print_error(str(error.code))
        return EXIT_FAILED  # as Python does for a text
    except Exception as error:
        raise_if_ended()
        if debug:
            traceback.print_exc()
        if lack := _describe_lack(error):
            _print_error(lack)
            return EXIT_BAD_INPUT
        what = f"{type(error).__name__}: {error}".rstrip(": ")
        hint = "" if debug else f"; {DEBUG_OPTION} shows where"
        _print_error(
            f"unexpected: {what}. This is a bug: please report it to the maintainers{hint}"
        )
        return EXIT_INTERNAL
    finally:
        discard_standard_input()
    return EXIT_BAD_INPUT


_RESOURCE_ERRORS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOSPC, errno.EDQUOT)
"""Error numbers (``errno``) of missing system resources, such as disk space. These errors have the
exit status `EXIT_BAD_INPUT`, because they are no bugs of this package.
"""


def _describe_lack(error: Exception) -> str:
    """Describe the system resource, such as disk space, whose lack caused an error; else empty."""
    if isinstance(error, OSError) and error.errno in _RESOURCE_ERRORS:
        return f"the system has no more to give: {error.strerror}"
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the current folder is gone; go to one that is there"
    return ""


def _print_error(text: str, *next_commands: str, language: str = "en") -> None:
    """Print an error on standard error, and command lines to run next."""
    from pupper_analysis.present.formats import escape_control

    raise_if_ended()  # a library may have turned the signal into this error
    click.echo(f"{phrase('error-prefix', language)}{escape_control(text)}", err=True)
    for line in filter(None, next_commands):
        values = {"command": escape_control(line)}
        proposal = fill_template(phrase("next-command", language), values, language)
        click.echo(f"  {proposal}", err=True)


def _disable_color(_context: click.Context, _option: click.Parameter, given: bool) -> None:
    """Set the environment variable NO_COLOR if ``--no-color`` was typed; called by click."""
    if given:
        os.environ["NO_COLOR"] = "1"  # rich prints without colour


def main() -> None:
    """Run the console command ``pupper-analysis`` with the arguments of the process."""
    run(group)


COMMAND_NAMES = tuple(own_tools())
"""Names of the command-line commands, one for each tool of this package (without plug-ins)."""


@click.group("pupper-analysis", cls=LazyGroup, context_settings=CONTEXT_SETTINGS)
@click.version_option(pupper_analysis.__version__, "-V", "--version")
@click.option(
    "--no-color",
    is_flag=True,
    expose_value=False,
    callback=_disable_color,
    help="Print no colors, as with the environment variable NO_COLOR.",
)
@click.option(
    DEBUG_OPTION, is_flag=True, expose_value=False, help="Show the traceback of unexpected errors."
)
def group() -> None:
    """Verify models of legged robots, and compute motor torques and stands.

    \b
    Examples:
      pupper-analysis stand go2.urdf                 or go2.xml, or both; v3 is our own
      pupper-analysis crosscheck go2.urdf go2.xml    causes of disagreement
      pupper-analysis hold panda.urdf                an arm, with its base fixed
    """  # noqa: D301 - click reads the \b


def find_command(name: str) -> click.Command:
    """Import and return the command of ``pupper-analysis`` with a name, which must exist."""
    command = group.get_command(None, name)
    assert command is not None
    return command
