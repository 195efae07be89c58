"""Shared parts of commands: options, parsing of option values, and output of results.

`Command` parses the command line. It registers the files that the parameters name, and checks
before the computation that all results can be written. The functions ``parse_...`` convert the text
of an option into its value, with numbers in SI units. Output are tables on the terminal, Markdown,
JSON and HTML files, and the exit status.
"""

from __future__ import annotations

import copy
import difflib
import math
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import pairwise, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click
from click.core import ParameterSource

from pupper_analysis.base import kinds
from pupper_analysis.base.diagnostics import LANGUAGES, Diagnostic, Phrase, Term, diagnose
from pupper_analysis.base.drivers import import_without_opengl, no_mujoco_log
from pupper_analysis.base.errors import (
    MODEL_FAULT_CODES,
    ConfigurationError,
    ModelError,
    OutputError,
    PupperAnalysisError,
    StanceUnreachableError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.kinds import Folder, OutputKind
from pupper_analysis.base.progress import MIN_REPORTED_TIME, ProgressClock, observe_progress
from pupper_analysis.base.runs import current_language, current_run, ensure_run, register_input
from pupper_analysis.base.units import UNIT_FACTORS, Position, lacks_unit

if TYPE_CHECKING:
    from pupper_analysis.base.results import Result
    from pupper_analysis.present.document import Block, NextStep, Report, Words
    from pupper_analysis.present.html.write import ReportInput
    from pupper_analysis.robot.robot import Robot
if TYPE_CHECKING:
    from pupper_analysis.robot.matching.tolerances import Tolerances

CommandFunction = TypeVar("CommandFunction", bound=Callable[..., Any])
"""Type of the function of a command-line command."""

EXIT_VERIFIED, EXIT_FAILED, EXIT_BAD_INPUT, EXIT_INTERNAL = 0, 1, 2, 3
"""Exit statuses of all command-line commands. 0: success. 1: a check failed. 2: invalid input, or
for example a full disk. 3: unexpected error, a bug. For signals, see `run`."""

CONTEXT_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of click for all command-line commands: names of the help option, and maximum line width
of the help [characters].
"""

package_option = click.option(
    "--package",
    "packages",
    multiple=True,
    metavar="NAME=DIR",
    help="Folder of package://NAME/. Repeatable. By default ROS_PACKAGE_PATH and the folders "
    "above the URDF are searched.",
)
"""Option ``--package``: folders of ROS packages. The parameter is ``packages``."""


XACRO_OPTIONS = (
    click.option(
        "--xacro",
        is_flag=True,
        help="Expand a xacro file. This evaluates the Python expressions in the file: only for "
        "files that you trust.",
    ),
    click.option(
        "--xacro-arg",
        "xacro_args",
        multiple=True,
        metavar="NAME=VALUE",
        help="Argument of a xacro file, with --xacro; e.g. arm=true. Repeatable.",
    ),
)
"""Options ``--xacro`` and ``--xacro-arg``: expansion of a xacro file. The parameters of the
command's function are ``xacro`` and ``xacro_args``."""


def xacro_options(command: CommandFunction) -> CommandFunction:
    """Add the options `XACRO_OPTIONS` to a command."""
    for option in reversed(XACRO_OPTIONS):
        command = option(command)
    return command


class OutputPath(click.Path):
    """Parameter type of an option whose value is the path of an output file or folder.

    Args:
        holds: Kind of the result file, or content of the folder. Alternatively a function that
            returns this kind or content from the parameters of the command; None if nothing is
            written.
    """

    def __init__(
        self, holds: OutputKind | Folder | Callable[[Mapping[str, Any]], OutputKind | Folder | None]
    ) -> None:
        folder = isinstance(holds, Folder)
        super().__init__(path_type=Path, file_okay=not folder)
        self._holds = holds

    def get_kind(self, given: Mapping[str, Any]) -> OutputKind | Folder | None:
        """Return the file format or folder content that a command-line command writes to this path.

        Args:
            given: {parameter: value} of the command.

        Returns:
            Format or folder content; None if the command writes nothing.
        """
        return self._holds(given) if callable(self._holds) else self._holds

    def check_suffix(self, option: str, path: Path, kind: OutputKind) -> None:
        """Check that the suffix of an output file does not belong to another format.

        Programs choose by the suffix how to open a file.

        Raises:
            ConfigurationError: If the suffix is not permitted.
        """
        suffix = path.suffix.lower()
        drawn = kind in (kinds.PICTURE_KIND, kinds.PAGE_KIND)
        is_other = bool(suffix) if drawn else suffix in FORMAT_SUFFIXES
        if kind.suffixes and is_other and suffix not in kind.suffixes:
            message = diagnose("output-suffix", file=path.name, suffixes=kind.suffixes)
            raise ConfigurationError(option, message)


FORMAT_SUFFIXES: Final = frozenset(
    (
        *(".csv", ".docx", ".gif", ".htm", ".html", ".jpeg", ".jpg", ".json", ".md", ".mjcf"),
        *(".pdf", ".png", ".svg", ".toml", ".urdf", ".xlsx", ".xml", ".yaml", ".yml"),
    )
)
"""File name suffixes by which programs select a format. An output of a kind with suffixes must not
have another of these suffixes (`OutputPath.check_suffix`)."""


TYPED_WORDS: Final = "pupper_analysis.typed_words"
"""Key of ``click.Context.meta`` whose value is a tuple of the words that the user typed after the
name of the command."""


ROBOT_WORDS: Final = "pupper_analysis.robot_words"
"""Key of ``click.Context.meta`` for the typed words that specify the robot (a tuple), if the
argument of the command also accepts other files. Suggested next commands contain only these
words."""


HIDDEN_NOTES: Final = "pupper_analysis.hidden_notes"
"""Key of ``click.Context.meta`` whose value is the number of notes on robots that are not printed.
A short report with a single document prints this number below the results."""


_FIXED_BASE_CODES = (
    *("base-is-fixed", "base-is-welded", "drop-of-fixed-base", "page-of-fixed-base"),
    "stands-of-fixed-base",
    *("gains-of-fixed-base", "heat-of-fixed-base", "range-of-fixed-base", "walk-of-fixed-base"),
    "no-feet",
)
"""Codes of errors about a robot with a fixed base, in a command about stands. `Command.invoke` adds
the command line of a suitable command, for example `hold`, to such an error, unless the tool has
added a command line.
"""


_UNWELDABLE_CODES = ("base-without-mass", "no-base-to-weld")
"""Codes of errors about a base that cannot be welded. `Command.invoke` adds the command line of
`hold`, which needs no weld.
"""

_WELDED_BASE_CODES = ("robot-is-welded", "payload-on-fixed-base")
"""Codes of errors about a weld that a command does not support. If the weld is that of the base,
`Command.invoke` adds the command line of `hold`, which computes torques and payloads of such a
robot."""

_EFFORT_LIMIT_CODES = ("no-effort-limits", "effort-limit-is-zero")
"""Codes of errors about torque limits that an optimisation requires. `Command.invoke` adds the
command line of `audit`, which lists the joints without a limit."""


_ABSENT_MODEL_CODES = ("menagerie-not-downloaded", "description-not-cached")
"""Codes of errors about a published model that must be downloaded. `Command.invoke` adds the
command line that downloads the model."""


def _complete_command_after_refusal(code: str, *, welds: bool) -> str:
    """Return the command line to suggest after an error with a code; empty if there is none.

    ``welds`` states that the command welds the base.
    """
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.document import NextStep

    if code in _UNWELDABLE_CODES or (code in _WELDED_BASE_CODES and welds):
        return complete_command(NextStep("hold", omitted=("--contact",)))
    return complete_command(NextStep("audit")) if code in _EFFORT_LIMIT_CODES else ""


LANGUAGE_VARIABLE: Final = "PUPPER_ANALYSIS_LANGUAGE"
"""Environment variable with the default of the option ``--language``."""


def _set_language(context: click.Context, _option: click.Parameter, language: str | None) -> None:
    """Set the language of the run to the value of ``--language``; called by click."""
    context.meta[_LANGUAGE] = language
    run = current_run()
    if run is not None and language is not None:
        run.language = language


_LANGUAGE: Final = "pupper_analysis.language"
"""Key of ``click.Context.meta`` whose value is the language of the printed texts."""


LANGUAGE_OPTION: Final = click.Option(
    ["--language"],
    type=click.Choice(LANGUAGES),
    default=LANGUAGES[0],
    show_default=True,
    envvar=LANGUAGE_VARIABLE,
    show_envvar=True,
    is_eager=True,  # errors about the other parameters are in this language
    expose_value=False,  # JSON does not depend on the language
    callback=_set_language,
    help="Language of the answer: English (en) or Chinese (zh).",
)
"""Option ``--language`` of all command-line commands. `current_language` returns its value. The
default does not depend on the locale, so that the output of scripts is reproducible.
"""


class Command(click.Command):
    """Command-line command that checks, before computing, that all results can be written.

    Each command has the option ``--language``. A command with results also has the option
    ``--force``.

    Args:
        meanings: {name of an argument: meaning of the argument}, for the error about a missing
            argument.
        examples: {required option: function that returns an example value from the typed values of
            the parameters}, for the error about a missing option.
        *args: Arguments of ``click.Command``.
        **options: Keyword arguments of ``click.Command``.
    """

    def __init__(
        self,
        *args: Any,
        meanings: Mapping[str, str] | None = None,
        examples: Mapping[str, Callable[[Mapping[str, Any]], str]] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self._meanings = meanings or {}
        self._examples = examples or {}
        self._has_force = any(option.name == "force" for option in self.params)
        if self.outputs and not self._has_force:
            self.params.append(click.Option(["--force"], is_flag=True, help=FORCE_HELP))
        self.params.append(LANGUAGE_OPTION)

    @property
    def outputs(self) -> list[click.Parameter]:
        """Options of this command-line command whose value is an output file or folder."""
        return [option for option in self.params if isinstance(option.type, OutputPath)]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words of the command line into the parameters of the command.

        Several errors of click are replaced by more helpful ones, for example with similar options.

        Returns:
            Words that click has not processed.

        Raises:
            click.UsageError: If a word is not valid, for example a unit apart from its number.
        """
        _refuse_other_dashes(ctx, args, [name for param in self.params for name in param.opts])
        _refuse_separate_units(ctx, args)
        _refuse_separate_values(ctx, args, self.params)
        self._refuse_options_without_hyphens(ctx, args)
        ctx.meta[TYPED_WORDS] = tuple(args)
        try:
            rest = super().parse_args(ctx, args)
            if not ctx.resilient_parsing:
                self._refuse_repetition(ctx)
            return rest
        except click.MissingParameter as error:
            if isinstance(error.param, click.Argument):
                raise self.make_missing_error(ctx, str(error.param.name)) from error
            if isinstance(error.param, click.Option):
                raise self._make_missing_option_error(ctx, error.param) from error
            raise
        except click.BadParameter as error:
            if found := _INVALID_NUMBER.fullmatch(error.message):
                number = _NUMBER_START.match(found[1])
                point = "" if number is None else number[0].replace(",", ".")
                if found[2] == "integer":
                    point = point if point.isdecimal() else ""
                problem = diagnose(
                    "part-is-no-number" if found[2] == "float" else "part-is-no-integer",
                    part=found[1],
                    given="",
                    point=point,
                    unit=_find_unit(error.param) if found[2] == "float" else "",
                )
                refusal = click.BadParameter(str(problem), error.ctx, error.param, error.param_hint)
                refusal.add_note(_complete_value(error.param, problem))
                raise refusal from error
            if error.param is not None and isinstance(error.param.type, click.Choice):
                raise _suggest_choice(error, error.param.type) from error
            raise
        except click.BadOptionUsage as error:
            error.ctx = error.ctx or ctx
            raise self._add_example_value(error) from error
        except click.NoSuchOption as error:
            similar = _find_similar_options(
                error.option_name, [name for option in self.params for name in option.opts]
            )
            hint = f" Did you mean {' or '.join(map(repr, similar))}?" if similar else ""
            if not similar and (about := _find_options_about(error.option_name, self.params)):
                hint = f" An option with this word in its help is {' or '.join(map(repr, about))}."
            message = f"No such option {error.option_name!r}.{hint}"
            unknown = click.NoSuchOption(error.option_name, message, ctx=error.ctx)
            if len(similar) == 1:
                unknown.add_note(
                    self._replace_option(ctx, ctx.meta[TYPED_WORDS], error.option_name, similar[0])
                )
            raise unknown from error
        except click.UsageError as error:
            if found := _EXTRA_ARGUMENTS.fullmatch(error.message):
                usage = " ".join((ctx.command_path, *self._list_metavars(ctx).values()))
                extra = diagnose("argument-extra", given=found[1], usage=usage)
                raise click.UsageError(str(extra), ctx) from error
            raise

    def _refuse_options_without_hyphens(self, ctx: click.Context, words: Sequence[str]) -> None:
        """Refuse words such as ``height=12cm`` and ``-height``, where a known option lacks hyphens.

        Click reads ``height=12cm`` as a robot, and ``-height`` as options ``-h``, ``-e`` and so on.
        """
        options = {name for option in self.params for name in option.opts if name[:2] == "--"}
        for previous, word in pairwise(("", *words)):
            name, equals, _ = word.partition("=")
            wanted = f"--{name.lstrip('-')}"
            is_value = previous.startswith("-") and "=" not in previous and not word.startswith("-")
            bare = equals and not is_value and not word.startswith("-")
            single = word[:1] == "-" and word[:2] != "--" and len(name) > _SHORT_OPTION_LENGTH
            if wanted in options and (bare or single):
                message = f"No such option {name!r}. Did you mean {wanted!r}?"
                refusal = click.NoSuchOption(name, message, ctx=ctx)
                refusal.add_note(self._replace_option(ctx, words, name, wanted))
                raise refusal

    def _add_example_value(self, error: click.BadOptionUsage) -> click.BadOptionUsage:
        """Add an example from the help to the error about an option whose value is missing."""
        option = next((one for one in self.params if error.option_name in one.opts), None)
        found = _EXAMPLE_IN_HELP.search(getattr(option, "help", None) or "")
        context = error.ctx
        if option is None or found is None or context is None or not _is_last_word(error, context):
            return error
        example = found[1].rstrip(".,;").strip("'")
        if isinstance(option.type, click.Path) or not _accepts_value(option, example, context):
            return error
        message = f"{error.message.rstrip('.')}, e.g. {example}."
        extended = click.BadOptionUsage(error.option_name, message, context)
        if not _requires_name(option):  # the robot may have other names
            extended.add_note(_join_command(self, (*context.meta[TYPED_WORDS], example)))
        return extended

    def _replace_option(
        self, ctx: click.Context, words: Sequence[str], unknown: str, name: str
    ) -> str:
        """Create the typed command line with an option in place of an unknown option.

        Empty if the option does not accept the typed value.
        """
        pattern = re.compile(rf"{re.escape(unknown)}(?==|$)")
        place = next((place for place, word in enumerate(words) if pattern.match(word)), None)
        if place is None:  # part of several short options in one word
            return ""
        replaced = pattern.sub(name, words[place])
        option = next(one for one in self.params if name in one.opts)
        value = replaced.partition("=")[2] or (*words[place + 1 :], "")[0]
        if not _accepts_value(option, value, ctx):
            return ""
        return _join_command(self, (*words[:place], replaced, *words[place + 1 :]))

    def _refuse_repetition(self, ctx: click.Context) -> None:
        """Refuse different values of an option that is not repeatable, or of a NAME in NAME=VALUE.

        Otherwise one of the values would be ignored. The error is a click.UsageError.
        """
        repeatable = copy.copy(self)
        repeatable.params = [copy.copy(parameter) for parameter in self.params]
        for option in repeatable.params:
            if isinstance(option, click.Option):
                option.multiple = True
        values, _, _ = repeatable.make_parser(ctx).parse_args(list(ctx.meta[TYPED_WORDS]))
        for option in self.params:
            typed = values.get(option.name or "")
            if not isinstance(option, click.Option) or not isinstance(typed, Sequence):
                continue
            names = max(option.opts, key=len), *option.secondary_opts
            first: dict[str, str] = {}
            for value in typed:
                name, shown = _split_assignment(option, value)
                if isinstance(value, bool):
                    shown = names[0 if value else -1]
                if first.setdefault(name, shown) != shown:
                    message = diagnose(
                        "option-repeated", option=names[0], one=first[name], two=shown
                    )
                    raise click.UsageError(str(message), ctx)

    def _list_metavars(self, ctx: click.Context) -> dict[str | None, str]:
        """Return {name of an argument: word in usage lines, such as ``URDF``} for this command."""
        arguments = [param for param in self.params if isinstance(param, click.Argument)]
        return {argument.name: argument.make_metavar(ctx).strip("[]") for argument in arguments}

    def make_missing_error(self, ctx: click.Context, name: str) -> click.UsageError:
        """Create the error about a missing argument, with its meaning and a usage line."""
        shown = self._list_metavars(ctx)
        message = diagnose(
            "argument-missing",
            argument=shown[name],
            meaning=self._meanings.get(name, ""),
            usage=" ".join((ctx.command_path, *shown.values())),
        )
        error = click.UsageError(str(message), ctx)
        if not ctx.meta.get(TYPED_WORDS):
            error.add_note(self._make_example(name))
        return error

    def _make_missing_option_error(
        self, ctx: click.Context, option: click.Option
    ) -> click.UsageError:
        """Create the error about a missing option, with the typed words and an example value."""
        name, meaning = option.opts[0], option.help or ""
        missing = diagnose("option-missing", option=name, meaning=meaning.rstrip("."))
        error = click.UsageError(str(missing), ctx)
        if name in self._examples:
            values, _, _ = self.make_parser(ctx).parse_args([*ctx.meta[TYPED_WORDS]])
            example = (name, self._examples[name](values))
            error.add_note(_join_command(self, (*ctx.meta[TYPED_WORDS], *example)))
        return error

    def _make_example(self, missing: str) -> str:
        """Create a command line without options, with an example of each required argument.

        Empty if an argument has no example. ``missing`` is the name of the missing argument, which
        may be required only without the name of a variant.
        """
        words = []
        for argument in self.params:
            if not isinstance(argument, click.Argument):
                continue
            if not (argument.required or argument.name == missing):
                continue
            if isinstance(argument.type, click.Choice):
                words.append(str(argument.type.choices[0]))
            elif example := _EXAMPLE_ARGUMENTS.get(str(argument.name)):
                words.append(example)
            else:
                return ""
        return _join_command(self, words)

    def invoke(self, context: click.Context) -> Any:
        """Check that the output files of the command can be written, and run the command.

        Files that the parameters name are registered as inputs: a result must not replace an input.

        Raises:
            OutputError: If a result cannot or must not be written, for example.
            ConfigurationError: For example if the suffix of a result belongs to another format.
        """
        run = context.with_resource(ensure_run())
        run.request = _collect_options(self, context)
        run.language = context.meta.get(_LANGUAGE) or run.language
        take_parameter = context.params.get if self._has_force else context.params.pop
        run.force = bool(take_parameter("force", False))
        for name in _list_named_files(self, context):
            register_input(name)
        import_without_opengl()
        context.with_resource(no_mujoco_log())
        try:
            _prepare_outputs(self, context)
            return super().invoke(context)
        except OutputError as error:
            problem = error.diagnostic.values.get("problem")
            if isinstance(problem, Diagnostic) and problem.code == "output-there":
                from pupper_analysis.cli.next_step import complete_forced_command

                error.add_note(complete_forced_command())
            raise
        except ConfigurationError as error:
            problem = error.problem
            if (
                isinstance(problem, Diagnostic)
                and problem.code in _FIXED_BASE_CODES
                and not getattr(error, "__notes__", ())
            ):
                from pupper_analysis.cli.next_step import complete_fixed_base_command

                error.add_note(complete_fixed_base_command(str(self.name)))
            refused = problem.code if isinstance(problem, Diagnostic) else ""
            welds = "base=weld" in (context.params.get("contacts") or ())
            if line := _complete_command_after_refusal(refused, welds=welds):
                error.add_note(line)
            if isinstance(problem, Diagnostic) and refused == "one-robot-at-a-time":
                from pupper_analysis.cli.next_step import complete_command_without

                error.add_note(complete_command_without(problem.values["others"]))
            if line := _complete_value(_find_running_option(str(error.field)), problem):
                error.add_note(line)
            if named := self._rename_field(context, error):
                for note in getattr(error, "__notes__", ()):
                    named.add_note(note)
                raise named from error
            raise
        except VariantError as error:
            from pupper_analysis.cli.next_step import correct_unknown_robot

            raise correct_unknown_robot(error) from error.__cause__
        except ModelError as error:
            raise self._add_command_to_model_error(context, error) from error.__cause__
        except StanceUnreachableError as error:
            from pupper_analysis.cli.next_step import complete_relaxed_command

            error.add_note(complete_relaxed_command(error))
            raise

    def _add_command_to_model_error(self, context: click.Context, error: ModelError) -> ModelError:
        """Add the command line to run next, if any, to an error about a model."""
        from pupper_analysis.cli import next_step
        from pupper_analysis.present.document import NextStep

        if error.cause.code in _ABSENT_MODEL_CODES:
            return next_step.correct_absent_model(error)
        if isinstance(error, UnknownNameError):
            error.add_note(next_step.complete_corrected_command(error))
        elif error.cause.code in MODEL_FAULT_CODES and self.name != "audit":
            error.add_note(next_step.complete_audit_command(error))
        elif error.cause.code == "no-joint-paired":
            error.add_note(next_step.complete_command(NextStep("audit")))
        elif error.cause.code == "no-such-file" and not error.cause.values.get("alike"):
            error.add_note(_complete_pair_command(context, error))
        return error

    def _rename_field(
        self, context: click.Context, error: ConfigurationError
    ) -> PupperAnalysisError | None:
        """Create an error with the typed option, or with the typed robot, in place of the argument.

        The text of a problem with the value ``robot`` contains the name of the robot: the error
        then has no prefix.

        Returns:
            New error; None if the argument was not typed.
        """
        problem = error.problem
        if error.field != "robot":
            option = self._find_typed_option(context, error.field)
            return ConfigurationError(option, problem) if option else None
        if isinstance(problem, Diagnostic) and "robot" in problem.values:
            where, problem = error.where, self._add_command(problem)
            return PupperAnalysisError(
                diagnose("error-at", where=where, what=problem) if where else problem
            )
        from pupper_analysis.cli.next_step import list_typed_robot

        words = list_typed_robot(context)
        return ConfigurationError(" ".join(words), problem) if words else None

    def _add_command(self, problem: Diagnostic) -> Diagnostic:
        """Add to the message about a fixed base whether this command accepts a welded base."""
        if problem.code != "base-is-fixed" or not problem.values.get("advised"):
            return problem
        from pupper_analysis.cli.next_step import accepts_welded_base

        welded = accepts_welded_base(self)
        values = {**problem.values, "command": self.name, "plain": None}
        placed = welded and self.name == "payload"  # a payload on a welded base loads no motor
        values |= {"welded": welded, "placed": placed, "refused": not welded}
        values["advised"] = not welded
        return replace(problem, values=FrozenDict(values))

    def _find_typed_option(self, context: click.Context, field: str) -> str:
        """Return the typed option, such as ``--payload``, that set a function's argument; else "".

        ``field`` is the name of the argument in an error, such as ``mass``.
        """
        own = f"--{field.removeprefix('--').replace('_', '-')}"
        for option in self.params:
            name = max(option.opts, key=len)
            typed = context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
            if typed and name in (own, *_OPTIONS_OF_ARGUMENTS.get(field, ())):
                return name
        return ""


def _complete_pair_command(context: click.Context, error: ModelError) -> str:
    """Create the command line after the error about a missing file of a URDF and an MJCF.

    Empty for a command without the arguments URDF and MJCF.
    """
    from pupper_analysis.cli.next_step import complete_pair_command

    params = context.command.params
    arguments = {param.name for param in params if isinstance(param, click.Argument)}
    urdf, mjcf = context.params.get("urdf"), context.params.get("mjcf")
    if not arguments >= {"urdf", "mjcf"} or urdf is None or mjcf is None:
        return ""
    missing, present = (urdf, mjcf) if str(urdf) == error.source else (mjcf, urdf)
    return complete_pair_command(present, missing)


_EXAMPLE_ARGUMENTS = {
    **dict.fromkeys(("urdf", "sources", "old"), "v3"),
    "new": "v3-heavy",
}
"""{name of an argument: example, a variant of the package's own robot}."""


def _join_command(command: click.Command, words: Iterable[str]) -> str:
    """Create a command line from a command and its words."""
    return f"{kinds.GENERATOR_NAME} {shlex.join([str(command.name), *words])}"


_SHORT_OPTION_LENGTH = 2
"""Number of characters of a short option such as ``-o``. A longer word with a single hyphen may be
a mistyped long option."""

_OPTIONS_OF_ARGUMENTS = {
    "mass": ("--payload", "--added"),
    "point": ("--payload-at", "--added-at"),
    "effort": ("--continuous",),
    "disabled": ("--disable",),
    "xacro_args": ("--xacro-arg",),
    "count": ("--plan",),
}
"""{argument of a function: command-line options that set the argument}, for options with another
name. An error about an argument names the typed option instead.
"""


_ASSIGNMENT_FORM = re.compile(r"(\[?)[A-Z][A-Z:\[\]]*=(\]?)")
"""Pattern of the start of an option's form ``NAME=VALUE``, for example ``FOOT=LENGTH``. The groups
are ``[`` and ``]`` of an optional name, as in ``[JOINTS=]NM``.
"""


def _split_assignment(option: click.Option, value: object) -> tuple[str, str]:
    """Return the name by which a typed value can contradict another value, and the value itself.

    For example, ``FR`` for ``FR=30mm``: two different values with the same name contradict each
    other.
    """
    text = str(value)
    if not option.multiple:
        return "", text
    form = _ASSIGNMENT_FORM.match(option.metavar or "")
    if form is None:
        return text, text
    name, separator, _ = text.partition("=")
    if separator:
        return name.removesuffix(":"), text  # xacro also writes NAME:=VALUE
    return ("", text) if (option.metavar or "").startswith("[JOINTS=]") else (text, text)


_UNTYPED_UNITS = ("N", "Nm", "N*m", "N/m", "Nm/rad", "N*m/rad", "Nms/rad", "Hz", "bit", "%")
"""Units of options whose values are typed without a unit (gains, torques, rates). Most errors about
a value with such a unit contain the number to type instead.
"""


_DASHES = "\u2010\u2011\u2012\u2013\u2014\u2015\u2212"
"""Hyphens, dashes and the minus sign of Unicode, which word processors insert in place of ``-``."""

_DASHED_NUMBER = re.compile(rf"(^|[,=/])[{_DASHES}](?=[0-9.])")
"""Pattern of a dash that is the sign of a number."""


def _refuse_other_dashes(
    context: click.Context, words: Sequence[str], options: Sequence[str]
) -> None:
    """Refuse a known option or a number that begins with a Unicode dash in place of ``-``.

    The error is a click.UsageError. Names of existing files are accepted.
    """
    for word in words:
        wanted = ""
        if _DASHED_NUMBER.search(word):
            wanted = _DASHED_NUMBER.sub(r"\1-", word)
        elif word[:1] in _DASHES and f"--{word.lstrip(f'-{_DASHES}').partition('=')[0]}" in options:
            wanted = f"--{word.lstrip(f'-{_DASHES}')}"
        if wanted and not _is_path(word):
            problem = diagnose("dash-is-no-hyphen", given=word, wanted=wanted)
            refusal = click.UsageError(str(problem), context)
            corrected = [wanted if one == word else one for one in words]
            refusal.add_note(_join_command(context.command, corrected))
            raise refusal


def _is_path(word: str) -> bool:
    """Return True if a word is an existing path. The module is imported only for suspect words."""
    from pupper_analysis.base.inputs import path_exists

    return path_exists(word)


def _refuse_separate_units(context: click.Context, words: Sequence[str]) -> None:
    """Refuse a number and a unit in two words, such as ``--height 12 cm``.

    The error is a click.UsageError. Names of existing files are accepted.
    """
    known = {unit.lower(): unit for units in UNIT_FACTORS.values() for unit in units}
    known |= {unit.lower(): "" for unit in _UNTYPED_UNITS}
    for place, (number, unit) in enumerate(pairwise(words)):
        if unit.lower() in known and not _is_path(unit):
            with suppress(ValueError):
                value = number.rpartition("=")[2]
                float(value)
                given, wanted = f"{value} {unit}", f"{value}{known[unit.lower()]}"
                code = "unit-apart" if known[unit.lower()] else "unit-not-typed"
                problem = diagnose(code, given=given, wanted=wanted)
                refusal = click.UsageError(str(problem), context)
                joined = f"{number.removesuffix(value)}{wanted}"
                corrected = (*words[:place], joined, *words[place + 2 :])
                refusal.add_note(_join_command(context.command, corrected))
                raise refusal


_NUMBER_WORD = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?([a-z°µ]*|%)", re.IGNORECASE)
"""Pattern of a word that is a number, with or without letters or % as unit: ``8``, ``-45deg``."""


def _refuse_separate_values(
    context: click.Context, words: Sequence[str], params: Sequence[click.Parameter]
) -> None:
    """Refuse numbers that are typed as separate words, such as ``--payload-at 0 0 8cm``.

    The error (click.UsageError) contains the words to type.
    """
    forms = {
        name: option.metavar or ""
        for option in params
        if isinstance(option, click.Option) and not option.is_flag
        for name in option.opts
    }
    for place, word in enumerate(words):
        option, equals, value = word.partition("=")
        following = words[place + 1 :]
        if not equals:
            value, following = (*following, "")[0], following[1:]
        numbers = [
            *takewhile(
                lambda number: _NUMBER_WORD.fullmatch(number) and not _is_path(number), following
            )
        ]
        form = forms.get(option, "")
        assigned = value.rpartition("=")[2]
        if not numbers or value.startswith("--"):
            continue
        if "=" in form and "=" not in value and not _NUMBER_WORD.fullmatch(value):
            wanted = f"{value}={','.join(numbers)}"
        elif "," in form and _NUMBER_WORD.fullmatch(assigned):
            wanted = ",".join((value, *numbers))
        else:
            continue
        given = " ".join((value, *numbers))
        message = diagnose("values-apart", given=given, wanted=f"{option} {wanted}")
        refusal = click.UsageError(str(message), context)
        end = place + (1 if equals else 2) + len(numbers)
        corrected = (*words[:place], option, wanted, *words[end:])
        refusal.add_note(_join_command(context.command, corrected))
        raise refusal


def _suggest_choice(error: click.BadParameter, choice: click.Choice[Any]) -> click.BadParameter:
    """Extend the error about a word that is no choice by a proposal, if possible."""
    found = _INVALID_CHOICE.match(error.message)
    typed = "" if found is None else found[1]
    names = {str(name).lower(): str(name) for name in choice.choices}
    alike = difflib.get_close_matches(typed.lower(), names, 1)
    hint = f" Did you mean {names[alike[0]]!r}?" if alike else ""
    if isinstance(error.param, click.Argument) and error.ctx is not None and not alike:
        usage = " ".join(error.ctx.command.collect_usage_pieces(error.ctx)[1:])
        hint = f" Type {error.ctx.command_path} {usage}"
    argument = isinstance(error.param, click.Argument)
    param_hint = str(error.param.name).upper() if argument and error.param else error.param_hint
    refusal = click.BadParameter(f"{error.message}{hint}", error.ctx, error.param, param_hint)
    if error.ctx is not None and typed:
        chosen = names[alike[0]] if alike else str(choice.choices[0]) if argument else ""
        refusal.add_note(_complete_choice(error.ctx, typed, chosen))
    return refusal


def _complete_choice(context: click.Context, typed: str, chosen: str) -> str:
    """Create the typed command line with a valid choice in place of an invalid word.

    Before the name of a robot, the choice is inserted. Empty without a choice, and if the invalid
    word is part of a longer word.
    """
    from pupper_analysis.models.published import is_published_name
    from pupper_analysis.pupper.named_robots import is_variant

    words = [*context.meta[TYPED_WORDS]]
    if not chosen or typed not in words:
        return ""
    place = words.index(typed)
    is_robot = is_variant(typed) or is_published_name(typed) or _is_path(typed)
    words[place : place if is_robot else place + 1] = [chosen]
    return _join_command(context.command, words)


def _is_last_word(error: click.BadOptionUsage, context: click.Context) -> bool:
    """Return True if the option that an error names is the last typed word."""
    return tuple(context.meta[TYPED_WORDS][-1:]) == (error.option_name,)


def _requires_name(option: click.Parameter) -> bool:
    """Return True if an option requires the form NAME=VALUE, with the name of a joint or foot."""
    form = _ASSIGNMENT_FORM.match(option.metavar or "")
    return form is not None and not form[1]


def _accepts_value(option: click.Parameter, value: str, context: click.Context) -> bool:
    """Return True if a typed value has the form and the type that an option requires."""
    if isinstance(option, click.Option) and option.is_flag:
        return True
    if _requires_name(option):
        return "=" in value
    try:
        option.type.convert(value, option, context)
    except click.BadParameter:
        return False
    return value != ""


_SYNONYMS = {
    **dict.fromkeys(("mass", "load", "weight"), ("--payload", "--weight")),
    **dict.fromkeys(("posture", "pose", "angles", "position"), ("--joints", "--posture")),
    **dict.fromkeys(("time", "duration"), ("--seconds",)),
    **dict.fromkeys(("stiffness", "gain", "gains"), ("--kp",)),
    "damping": ("--kd",),
    "torque": ("--effort",),
    "out": ("--output",),
}
"""{mistyped option without hyphens, such as "mass": options that the user probably means}."""


def _find_similar_options(unknown: str, known: Sequence[str]) -> list[str]:
    """Return options to suggest for an unknown option: `_SYNONYMS`, else similar names.

    Names are compared without the leading hyphens, because these make all short names similar.
    """
    names = {name.strip("-"): name for name in known if name.startswith("--")}
    wanted = unknown.strip("-")
    synonyms = [name for name in _SYNONYMS.get(wanted, ()) if name in known]
    if synonyms:
        return synonyms
    words = set(wanted.split("-"))
    containing = [name for name in names if words < set(name.split("-"))]
    return [names[name] for name in containing or difflib.get_close_matches(wanted, names)]


def _find_options_about(unknown: str, parameters: Sequence[click.Parameter]) -> list[str]:
    """Return options whose help contains the words of an unknown option, to suggest them."""
    words = unknown.strip("-").lower().split("-")
    if min(map(len, words)) < _MIN_WORD_LENGTH:
        return []
    patterns = [re.compile(rf"\b{re.escape(word)}s?\b") for word in words]
    found = [
        max(option.opts, key=len)
        for option in parameters
        if isinstance(option, click.Option)
        and all(pattern.search((option.help or "").lower()) for pattern in patterns)
    ]
    return found if len(found) <= _MAX_OPTIONS_ABOUT else []


_MAX_OPTIONS_ABOUT = 3
"""Maximum number of suggested options of `_find_options_about`. A word in the help of more options,
such as "robot", does not identify an option. Chosen, not tuned.
"""

_MIN_WORD_LENGTH = 4
"""Minimum length [characters] of the words that `_find_options_about` searches for. Shorter words,
such as "at", occur in many help texts. Chosen, not tuned.
"""


FORCE_HELP: Final = (
    "Replace files that are no results of this command; never one that it reads, nor measurements."
)
"""Help text of ``--force``."""


def command(name: str | None = None, **options: Any) -> Callable[[Callable[..., Any]], Command]:
    """Create a decorator that turns a function into a `Command` of the command line.

    Args:
        name: Name of the command; None: derived from the name of the function.
        **options: Keyword arguments of `Command`.
    """
    return click.command(name, cls=Command, context_settings=CONTEXT_SETTINGS, **options)


def _collect_options(command: click.Command, context: click.Context) -> dict[str, Any]:
    """Return {option: value} of the options that were set, for example typed.

    Paths of results and ``--force`` are not included.
    """
    default_sources = (ParameterSource.DEFAULT, None)
    return {
        max(option.opts, key=len).lstrip("-").replace("-", "_"): context.params[name]
        for option in command.params
        if (name := option.name or "") in context.params
        and name != "force"
        and isinstance(option, click.Option)
        and not isinstance(option.type, OutputPath)
        and context.get_parameter_source(name) not in default_sources
    }


def _list_named_files(command: click.Command, context: click.Context) -> Iterator[Path]:
    """Yield paths that the parameters may name as inputs; a path need not exist."""
    for parameter in command.params:
        reads = isinstance(parameter, click.Argument) or isinstance(parameter.type, click.Path)
        if not reads or isinstance(parameter.type, OutputPath):
            continue
        values = context.params.get(parameter.name or "")
        for value in values if isinstance(values, tuple) else (values,):
            text = "" if value is None else str(value)
            # Further forms: a.urdf+a.xml, and REVISION:PATH.
            for word in {text, *text.split("+"), text.rpartition(":")[2]} - {""}:
                yield Path(word)
            if isinstance(parameter.type, click.Path) and text:  # folder of a recording
                with suppress(OSError, ValueError):
                    yield from Path(text).iterdir()


def _prepare_outputs(command: Command, context: click.Context) -> None:
    """Check that the results of a command can be written, and register the files as outputs."""
    from pupper_analysis.base import files

    targets: set[Path] = set()
    for option in command.outputs:
        path: Path | None = context.params.get(option.name or "")
        holds = None if path is None else option.type.get_kind(context.params)  # type: ignore[attr-defined]
        if path is None or holds is None:
            continue
        if isinstance(holds, Folder):
            files.check_folder(path)
            kinds_of_files = {path / name: kind for name, kind in holds.files.items()}
        else:
            kinds_of_files = {path: holds}
        for file, kind in kinds_of_files.items():
            files.check_writable(file, kind)
            option.type.check_suffix(option.opts[0], file, kind)  # type: ignore[attr-defined]
            target = file if file == files.STANDARD_OUTPUT else files.resolve_target(file)[0]
            if target in targets:
                raise OutputError(file, diagnose("two-results-to-one-file"))
            targets.add(target)
    if files.STANDARD_OUTPUT in targets:
        context.with_resource(files.results_on_standard_output())


def file_option(
    *names: str, help: str, required: bool = False
) -> Callable[[CommandFunction], CommandFunction]:
    """Create a decorator that adds an option for an input file to a command-line command."""
    path = click.Path(path_type=Path)
    return click.option(*names, type=path, required=required, help=help)


def output_option(
    *names: str,
    holds: OutputKind | Folder | Callable[[Mapping[str, Any]], OutputKind | Folder | None],
    help: str,
    **more: Any,
) -> Callable[[CommandFunction], CommandFunction]:
    """Create a decorator that adds an option for an output file or folder to a command.

    Args:
        *names: Names of the option, such as ``--json``.
        holds: Format of the result, or content of the folder. Alternatively a function that returns
            the format or content from the parameters of the command, or None if nothing is written.
        help: Text in ``--help``.
        **more: Further arguments of ``click.option``.
    """
    return click.option(*names, type=OutputPath(holds), help=help, **more)


json_option = output_option(
    "--json",
    "json_path",
    holds=kinds.RESULTS_KIND,
    help="Write all results as JSON to this file, or to standard output (-).",
)
"""Option ``--json``: JSON file of all results. The parameter is ``json_path``."""
report_option = output_option(
    "--report",
    "report_path",
    holds=kinds.PAGE_KIND,
    help="Write an HTML report with tables, plots and a 3-D view to this file.",
)
"""Option ``--report``: HTML report. The parameter is ``report_path``."""
figure_option = output_option(
    "--figure", holds=kinds.PICTURE_KIND, help="Draw the result to this PNG file."
)
"""Option ``--figure``: PNG file of the result. The parameter is ``figure``."""
format_option = click.option(
    "--format",
    "style",
    type=click.Choice(["text", "markdown", "github", "junit", "sarif"]),
    default="text",
    show_default=True,
    help="Output format: text, Markdown, GitHub annotations, JUnit XML, or SARIF for code "
    "scanning.",
)
"""Option ``--format`` with formats for CI services. The parameter is ``style``."""
text_format_option = click.option(
    "--format",
    "style",
    type=click.Choice(["text", "markdown"]),
    default="text",
    show_default=True,
    help="Output format: text for a terminal, or Markdown, e.g. for a pull request.",
)
"""Option ``--format`` with text and Markdown only. The parameter is ``style``."""
verbose_option = click.option(
    "-v", "--verbose", "everything", is_flag=True, help="Print all tables and notes."
)
"""Option ``--verbose``: all tables and notes. The parameter is ``everything``."""
all_option = click.option(
    "-v",
    "--verbose",
    "--all",
    "everything",
    is_flag=True,
    help="Print all findings and all tables.",
)
"""Option ``--verbose``, also as ``--all``. The parameter is ``everything``."""


class ModelFileType(click.Path):
    """Type of a command-line parameter that is a model file; ``-`` reads standard input."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(  # type: ignore[override]  # type of click.Path includes str
        self, value: str, param: click.Parameter | None, ctx: click.Context | None
    ) -> Path:
        """Convert a typed word to the path of a model file.

        For ``-``, standard input is read. Its content is available under the returned path until
        the command ends.

        Raises:
            ConfigurationError: If ``-`` is typed twice, or standard input cannot be read.
        """
        if str(value) == "-":
            from pupper_analysis.base.inputs import read_standard_input
            from pupper_analysis.models.xml import MAX_BYTES

            return read_standard_input(MAX_BYTES + 1)
        return Path(str(super().convert(value, param, ctx)))


MODEL_FILE = ModelFileType()
"""Type of a command-line parameter that is a model file, or ``-`` for standard input."""


def sort_model_paths(first: Path, second: Path) -> tuple[Path, Path]:
    """Sort two model files by format: the URDF first. The user may type both in any order.

    A path may be the name of a variant of the package's own robot (such as ``v3``), which has both
    formats.

    Returns:
        Path of the URDF; path of the MJCF. If a file cannot be read, the paths as typed.

    Raises:
        ConfigurationError: If both files are URDFs, or both are MJCFs.
    """
    from pupper_analysis.base.errors import ModelError
    from pupper_analysis.models.published import find_file
    from pupper_analysis.models.xml import parse_xml
    from pupper_analysis.pupper.named_robots import is_variant

    tags, joints = [], []
    for path in (first, second):
        if is_variant(path):
            tags.append("")
            continue
        try:
            root = parse_xml(find_file(path))[1]
        except ModelError:
            return first, second
        tags.append(root.tag)
        joints.append({joint.get("name") for joint in root.iter("joint")} - {None})
    kinds_by_tag = {"robot": "URDF", "mujoco": "MJCF"}
    if tags[0] == tags[1] and tags[0] in kinds_by_tag:
        given, missing = kinds_by_tag[tags[0]], kinds_by_tag[{*kinds_by_tag}.difference(tags).pop()]
        problem = diagnose("both-of-one-format", given=given, missing=missing)
        from pupper_analysis.base.inputs import name_files
        from pupper_analysis.cli.next_step import complete_comparison_command

        error = ConfigurationError(", ".join(name_files(first, second)), problem)

        related = first != second and not joints[0].isdisjoint(joints[1])
        error.add_note(complete_comparison_command(first, second, related=related))
        raise error
    return (second, first) if tags[0] == "mujoco" or tags[1] == "robot" else (first, second)


class QuantityType(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """Type of a command-line number with or without a unit, such as ``5deg`` or ``0.1``.

    Args:
        kind: Quantity, a key of ``base.units.UNIT_FACTORS``: "length", "angle" and so on.
    """

    def __init__(self, kind: str) -> None:
        self.name = kind

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Parse the text of an option, for example ``5deg``, into the SI unit of the quantity.

        A number without a unit is in the SI unit.

        Returns:
            Value in the SI unit, for example [m] or [rad].

        Raises:
            click.BadParameter: If the text is no such quantity, or probably lacks its unit
                (`lacks_unit`).
        """
        if isinstance(value, float | int):
            value = repr(float(value)) if self.name == "length" else value
        if isinstance(value, float | int):
            return float(value)
        try:
            return parse_quantity(self.name, str(value))
        except ValueError:
            problem = _describe_invalid_quantity(self.name, str(value))
            refusal = click.BadParameter(str(problem), ctx, param)
            refusal.add_note(_complete_value(param, problem))
            raise refusal from None


def parse_quantity(kind: str, text: str) -> float:
    """Parse a number with or without a unit into SI units: ``10cm`` is 0.1.

    A number without a unit is in SI units.

    Args:
        kind: Quantity, a key of ``base.units.UNIT_FACTORS``: "length", "angle", "mass" and so on.
        text: Number, directly followed by the unit, if any.

    Returns:
        Value in the SI unit of the quantity. For the quantity "position", a ``Position`` [rad or m]
        if the text has a unit.

    Raises:
        ValueError: If the text is no such quantity, or probably lacks its unit (`lacks_unit`).
    """
    for unit, size in sorted(UNIT_FACTORS[kind].items(), key=lambda item: -len(item[0])):
        if text.endswith(unit):
            value = float(text.removesuffix(unit)) * size
            if kind == "position":
                return Position(value, "rad" if unit in UNIT_FACTORS["angle"] else "m")
            return value
    value = float(text)
    if lacks_unit(kind, value):
        raise ValueError(text)
    return value


_MISSING_UNIT_CODES = {
    "length": "length-without-unit",
    "angle": "angle-without-unit",
    "time": "time-without-unit",
    "mass": "mass-without-unit",
}
"""{quantity of `MAX_BARE_NUMBERS`: code of the message about a larger number without a unit}. The
name of the quantity is also the name of the message's value.
"""

_FIRST_UNITS = {"length": "mm", "angle": "deg", "time": "ms", "mass": "g"}
"""{quantity of `_MISSING_UNIT_CODES`: first unit that the message proposes}."""


def parse_assignment(option: str, text: str) -> tuple[str, str]:
    """Parse the text ``NAME=VALUE`` of an option into the name and the text of the value.

    Raises:
        ConfigurationError: If the text has another form.
    """
    name, separator, value = text.partition("=")
    if not (name and separator and value):
        form = _find_assignment_form(option)
        raise ConfigurationError(option, diagnose("not-of-the-form", given=text, form=form))
    return name, value


def _find_assignment_form(option: str) -> str:
    """Return the form ``NAME=VALUE`` of an option, with an example from its help, if any."""
    parameter = _find_running_option(option)
    form = "" if parameter is None else parameter.metavar or ""
    if parameter is not None and "=" in form:
        example = _ASSIGNMENT_EXAMPLE.search(parameter.help or "")
        if example is None:
            return form
        shown = example[1].rstrip(",")
        return Phrase(f"{form}, e.g. {shown}", f"{form}（例如 {shown}）")  # noqa: RUF001
    return "NAME=VALUE"


def _find_running_option(name: str) -> click.Option | None:
    """Return the option with this name (with or without ``--``) of the running command, or None."""
    context = click.get_current_context(silent=True)
    for parameter in () if context is None else context.command.params:
        names = [known.lstrip("-") for known in parameter.opts]
        if isinstance(parameter, click.Option) and name.lstrip("-") in names:
            return parameter
    return None


def _find_unit(option: click.Parameter | None) -> str:
    """Return the unit of an option's number from its help text, such as ``N m/rad``; else empty."""
    text = option.help or "" if isinstance(option, click.Option) else ""
    unit = _UNIT_IN_HELP.search(text)
    return "" if unit is None else unit[1]


_UNIT_IN_HELP = re.compile(r"\(([A-Za-z][A-Za-z0-9^/ ]*)(?:;[^)]*)?\)")
"""Unit in the help of an option with a number, such as ``(N m/rad)`` or ``(N m; N of a slide)``."""


_INVALID_NUMBER = re.compile(r"'(.*)' is not a valid (float|integer)(?: range)?\.?")
"""Message of click about an option value that is no number; the groups are value and type."""

_INVALID_CHOICE = re.compile(r"'(.*?)' is not one of ")
"""Start of the message of click about a word that is no choice; the group is the word."""

_EXTRA_ARGUMENTS = re.compile(r"Got unexpected extra arguments? \((.*)\)")
"""Message of click about arguments that the command does not have; the group is their text."""

_NUMBER_START = re.compile(r"[+-]?\d+([.,]\d+)?")
"""Number at the start of a text, with or without a decimal point or comma."""

_XACRO_ASSIGNMENT = re.compile(r"^([^=]*?):=")
"""Name and first separator of a text in xacro's form ``NAME:=VALUE``."""

_EXAMPLE_IN_HELP = re.compile(r"e\.g\.\s+(\S+)")
"""First example of a value in the help of an option, such as ``e.g. 0.5kg.``"""

_ASSIGNMENT_EXAMPLE = re.compile(r"e\.g\. '?([^ ']*=[^ ']*?)'?[.;]?(?: |$)")
"""Example of a value with an equals sign in the help of an option, such as ``e.g. FR=30mm.``"""


def parse_number_assignment(option: str, text: str) -> tuple[str, float]:
    """Parse the text ``NAME=NUMBER`` of an option into the name and the number.

    Raises:
        ConfigurationError: If the text has another form.
    """
    name, value = parse_assignment(option, text)
    try:
        return name, float(value)
    except ValueError as error:
        given = text.removeprefix("*=")  # added for a number without pattern
        message = diagnose(
            "part-is-no-number",
            part=value,
            given="" if given == value else given,
            point=_write_decimal_point(value) or _omit_unit(value),
            unit=_find_unit(_find_running_option(option)),
        )
        raise ConfigurationError(option, message) from error


def _write_decimal_point(text: str) -> str:
    """Replace the decimal comma of a number (``12,5cm``) by a point; empty for other texts."""
    match = re.fullmatch(r"([+-]?\d+),(\d+)([^\d,]*)", text)
    return "" if match is None else f"{match[1]}.{match[2]}{match[3]}"


def _omit_unit(text: str) -> str:
    """Return the number of a text such as ``12.5Nm``, whose unit must not be typed; else empty."""
    match = re.fullmatch(r"([+-]?\d+(?:\.\d+)?)\s*([A-Za-z].*)", text)
    units = [unit.lower() for unit in _UNTYPED_UNITS]
    return match[1] if match is not None and match[2].replace(" ", "").lower() in units else ""


def parse_measure(option: str, kind: str, text: str, given: str = "") -> float:
    """Parse a number with or without a unit into SI units, for an option of a command.

    Args:
        option: Name of the option, for errors.
        kind: Quantity, a key of ``base.units.UNIT_FACTORS``, for example "length".
        text: Text of the number with its unit.
        given: Complete value of the option, for errors, if longer than ``text``.

    Returns:
        Value in the SI unit of the quantity.

    Raises:
        ConfigurationError: If the text is no valid value.
    """
    try:
        return parse_quantity(kind, text)
    except ValueError as error:
        raise ConfigurationError(option, _describe_invalid_quantity(kind, text, given)) from error


def parse_position(option: str, text: str) -> tuple[str, float]:
    """Parse the text ``NAME=POSITION`` of an option into the name and the position [rad or m].

    Raises:
        ConfigurationError: If the text has another form.
    """
    name, value = parse_assignment(option, text)
    return name, parse_measure(option, "position", value, text)


def _describe_invalid_quantity(kind: str, text: str, given: str = "") -> Diagnostic:
    """Create the message about an invalid number with unit, with a correction if possible.

    ``given`` is the whole typed value that contains ``text``, if longer.
    """
    units = tuple(UNIT_FACTORS[kind])
    with suppress(ValueError):
        if lacks_unit(kind, float(text)):
            number: dict[str, Any] = {kind: text}
            return diagnose(_MISSING_UNIT_CODES[kind], **number)
    return diagnose(
        "part-is-no-quantity",
        part=text,
        given=given,
        kind=Term(kind),
        units=units,
        point=_write_decimal_point(text) or _spell_unit(kind, text),
    )


def _complete_value(option: click.Parameter | None, problem: object) -> str:
    """Create the typed command line with the correction of an option's invalid value.

    A number without unit gets the first unit of the message, such as mm.

    Args:
        option: Option with the value.
        problem: Message about the value; the correction is one of its values.

    Returns:
        Command line; empty without a correction.
    """
    context = click.get_current_context(silent=True)
    if context is None or option is None or not isinstance(problem, Diagnostic):
        return ""
    kinds = [kind for kind, code in _MISSING_UNIT_CODES.items() if code == problem.code]
    given = str(problem.values.get(kinds[0] if kinds else "part", ""))
    unit = _FIRST_UNITS[kinds[0]] if kinds else ""
    wanted = f"{given}{unit}" if kinds else str(problem.values.get("point") or "")
    if not given or not wanted:
        return ""
    pattern = re.compile(rf"(?<![^=,:]){re.escape(given)}(?![^=,:])")
    typed = list(map(str, context.meta.get(TYPED_WORDS, ())))
    words = list(typed)
    for place, word in enumerate(words):
        name, equals, value = word.partition("=")
        if name not in option.opts:
            continue
        if equals:
            words[place] = f"{name}={pattern.sub(wanted, value)}"
        elif place + 1 < len(words):
            words[place + 1] = pattern.sub(wanted, words[place + 1])
    return "" if words == typed else _join_command(context.command, words)


def _spell_unit(kind: str, text: str) -> str:
    """Return a number with its unit spelt correctly, such as ``12cm`` for ``12CM``; else empty."""
    number = _NUMBER_START.match(text)
    if number is None:
        return ""
    typed = text[number.end() :].strip().lower()
    spelt = {unit.lower(): unit for unit in UNIT_FACTORS[kind]}
    if "deg" in spelt:
        spelt |= dict.fromkeys(("°", "degree", "degrees"), "deg")
    return f"{number[0].replace(',', '.')}{spelt[typed]}" if typed in spelt else ""


def show_progress(what: str | Words) -> AbstractContextManager[object]:
    """Show a progress message while a context is active, if standard error is a terminal.

    ``what`` is the message: a term of the catalogue, such as ``making the page``, or a text.
    """
    if not sys.stderr.isatty():
        return nullcontext()
    from pupper_analysis.present.document import translate, word

    message = word(what) if isinstance(what, str) else what
    return _display_progress(translate(message, current_language()))


@contextmanager
def _display_progress(what: str) -> Iterator[None]:
    """Display the message ``what`` and the progress on standard error until the context ends."""
    from rich.console import Console
    from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
    from rich.text import Text

    language = current_language()  # rich renders the columns in another thread
    with observe_progress() as clock:

        class TimeColumn(ProgressColumn):
            """Column with the elapsed time, or completed parts and remaining time."""

            def render(self, task: Task) -> Text:  # noqa: ARG002
                """Return the text of the column, from `format_progress`."""
                return Text(format_progress(clock, language))

        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeColumn()
        bar = Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=4)
        bar.add_task(what, total=None)
        with bar:
            yield


def format_progress(clock: ProgressClock, language: str = "en") -> str:
    """Format the progress of a computation, with the remaining or elapsed time [s].

    The text is empty before ``MIN_REPORTED_TIME``.
    """
    from pupper_analysis.present.document import text, translate

    if clock.elapsed < MIN_REPORTED_TIME:
        return ""
    if clock.remaining is None:
        return translate(text("progress-elapsed", elapsed=round(clock.elapsed)), language)
    left = max(1, math.ceil(clock.remaining))
    parts = text("progress-left", done=clock.done, total=clock.total, left=left)
    return translate(parts, language)


def show_results(
    results: Iterable[tuple[str, Result]],
    style: str = "text",
    *,
    robots: Iterable[Robot] = (),
    overview: Iterable[Block] = (),
    everything: bool = False,
    next_step: NextStep | None = None,
) -> None:
    """Print results of a command-line command as text for a terminal, or as Markdown.

    Args:
        results: Pairs (name, result); the name may be empty if the result has a name.
        style: ``text`` or ``markdown``.
        robots: Robots of the results; Markdown includes the notes of the robots.
        overview: Blocks that compare the results, printed in addition.
        everything: True to print all tables and notes. Ignored for Markdown.
        next_step: Command to suggest as next. Default: that of a single result. Ignored for
            Markdown.
    """
    from pupper_analysis.present.documents.registry import build_report

    markdown = style == "markdown"
    report = build_report(results, robots if markdown else (), overview)
    show_report(report, style, everything=everything, next_step=next_step)


def show_report(
    report: Report,
    style: str = "text",
    *,
    everything: bool = False,
    next_step: NextStep | None = None,
) -> None:
    """Print a report as text for a terminal, or as Markdown with the provenance of the results.

    Args:
        report: Report.
        style: ``text`` or ``markdown``.
        everything: True to print all tables and notes. Ignored for Markdown.
        next_step: Command to suggest as next. Default: that of a single document. Ignored for
            Markdown.
    """
    if style == "markdown":
        from pupper_analysis.base.provenance import collect_provenance
        from pupper_analysis.present.markdown import fold_lines, write_markdown

        made = fold_lines("pupper_analysis", collect_provenance().lines())
        click.echo(f"{write_markdown(report)}\n{made}", nl=False)
    else:
        from pupper_analysis.cli.next_step import complete_command
        from pupper_analysis.present.terminal import make_console, print_report

        if next_step is None and len(report.documents) == 1:
            next_step = report.documents[0].next_step
        print_report(
            make_console(),
            report,
            everything=everything,
            next_command=complete_command(next_step),
            hidden_notes=click.get_current_context().meta.get(HIDDEN_NOTES, 0),
        )


def confirm_written(path: Path | str) -> None:
    """Print the path of a written file, unless the file was standard output.

    If standard output carries another format than text, the path is printed on standard error.
    """
    from pupper_analysis.base.files import STANDARD_OUTPUT
    from pupper_analysis.present.document import text
    from pupper_analysis.present.formats import escape_control

    if Path(path) != STANDARD_OUTPUT:
        style = click.get_current_context().params.get("style", "text")
        print_text(text("file-written", path=escape_control(str(path))), err=style != "text")


def print_text(words: Words, *, indent: int = 0, err: bool = False) -> None:
    """Print a text in the language of the command, after ``indent`` spaces.

    ``err`` selects standard error.
    """
    from pupper_analysis.present.document import translate

    click.echo(f"{' ' * indent}{translate(words, current_language())}", err=err)


def write_json(path: Path | None, content: object) -> None:
    """Write results as a JSON file and print the path; without a path, write nothing.

    Raises:
        ProcessEnded: If a signal, such as Ctrl-C, has arrived.
        ConfigurationError: If a value has no JSON equivalent.
        OutputError: If the file cannot be written, or must not be replaced.
    """
    from pupper_analysis.base.files import write_atomically
    from pupper_analysis.base.provenance import to_marked_json
    from pupper_analysis.cli.process import raise_if_ended

    raise_if_ended()
    if path is not None:
        with write_atomically(path, kinds.RESULTS_KIND) as file:
            file.write(to_marked_json(content).encode())
        confirm_written(path)


def write_page(path: Path | None, results: ReportInput, robots: Iterable[Robot] = ()) -> None:
    """Write results as a single HTML file and print the path; without a path, write nothing.

    Raises:
        ProcessEnded: If a signal, such as Ctrl-C, has arrived.
        ConfigurationError: If there is no result.
        OutputError: If the file cannot be written, or must not be replaced.
    """
    from pupper_analysis.cli.process import raise_if_ended

    raise_if_ended()
    if path is not None:
        from pupper_analysis.present.html.write import write_report

        write_report(results, path, robots=robots)
        confirm_written(path)


def finish_command(json_path: Path | None, content: object, *, passed: bool) -> None:
    """Finish a command-line command: write results as JSON; exit with status 1 if a check failed.

    Args:
        json_path: Path of the option ``--json``; None to write no file.
        content: Results.
        passed: Whether all checks of the command passed.

    Raises:
        click.exceptions.Exit: If ``passed`` is False.
        ProcessEnded: If a signal, such as Ctrl-C, has arrived.
        ConfigurationError: If a value has no JSON equivalent.
        OutputError: If the file cannot be written, or must not be replaced.
    """
    write_json(json_path, content)
    if not passed:
        click.get_current_context().exit(EXIT_FAILED)


def parse_point(
    option: str, text: str, size: int = 2, choices: Iterable[str] = ()
) -> tuple[float, ...]:
    """Parse the text ``X,Y`` or ``X,Y,Z`` of an option into coordinates [m].

    Args:
        option: Name of the option, for error messages.
        text: Lengths separated by commas, each with or without a unit: ``10mm,0,0``.
        size: Number of coordinates, 2 or 3.
        choices: Words that the option accepts in place of coordinates, for the error message only.

    Returns:
        ``size`` coordinates [m].

    Raises:
        ConfigurationError: If the text has another form, or a length is probably in mm.
    """
    try:
        numbers = tuple(parse_quantity("length", part.strip()) for part in text.split(","))
    except ValueError:
        numbers = ()
        for part in text.split(","):
            with suppress(ValueError):
                if lacks_unit("length", float(part)):
                    problem = diagnose("length-without-unit", length=part.strip())
                    raise ConfigurationError(option, problem) from None
    if len(numbers) != size:
        form = ", ".join(["X,Y,Z"[: 2 * size - 1] + f" ({'10mm,0,0'[: 2 * size + 2]})", *choices])
        raise ConfigurationError(option, diagnose("not-of-the-form", given=text, form=form))
    return numbers


def parse_place(option: str, text: str) -> tuple[str | float, ...]:
    """Parse the position ``X,Y,Z``, ``FRAME,X,Y,Z`` or ``FRAME`` of an option.

    Args:
        option: Name of the option, for errors.
        text: Text; ``FRAME`` alone is the origin of the frame. A frame whose name begins with a
            number is not accepted.

    Returns:
        (x, y, z) [m]; or the name of the frame, followed by (x, y, z) [m] expressed in this frame.

    Raises:
        ConfigurationError: If the text has another form, or a length is probably in mm.
    """
    is_frame = text.count(",") in (0, 3) and not _NUMBER_START.match(text)
    frame, _, place = text.partition(",") if is_frame else ("", "", text)
    zero = (0.0, 0.0, 0.0)
    point = parse_point(option, place, 3) if place or not frame else zero
    return (frame, *point) if frame else point


def parse_xacro_args(texts: Sequence[str]) -> dict[str, str]:
    """Parse the values ``NAME=VALUE`` of ``--xacro-arg``; xacro's own ``NAME:=VALUE`` is accepted.

    Returns:
        {argument: value}.

    Raises:
        ConfigurationError: If a text has another form.
    """
    forms = (_XACRO_ASSIGNMENT.sub(r"\1=", text) for text in texts)
    return dict(parse_assignment("xacro-arg", text) for text in forms)


def parse_packages(packages: tuple[str, ...]) -> dict[str, Path]:
    """Parse the values ``NAME=DIR`` of an option with the folders of ROS packages.

    Returns:
        {package: folder}.

    Raises:
        ConfigurationError: If a text has another form, or a folder does not exist.
    """
    from pupper_analysis.base.inputs import is_folder

    folders = {
        name: Path(value)
        for name, value in (parse_assignment("package", text) for text in packages)
    }
    for name, folder in folders.items():
        if not is_folder(folder):
            message = diagnose("package-is-no-folder", package=name, folder=folder)
            raise ConfigurationError("package", message)
    return folders


map_option = click.option(
    "--map",
    "pairs",
    multiple=True,
    metavar="URDF=MJCF",
    help="A joint's or frame's name in the URDF and in the MJCF; e.g. lf_haa=FL_hip. Repeatable.",
)
"""Option ``--map``: pairs of names in URDF and MJCF. The parameter is ``pairs``."""


frame_option = click.option(
    "--frame",
    "feet",
    multiple=True,
    metavar="FRAME",
    help="Compare only this frame; e.g. FL_foot. Repeatable. By default all frames that both "
    "files have are compared.",
)
"""Option ``--frame``: names of compared frames. The parameter is ``feet``."""


fine_tolerance_option = click.option(
    "--tolerance",
    "changes",
    multiple=True,
    metavar="KIND=VALUE",
    help="Largest difference to ignore, as for crosscheck; e.g. mass=1e-3. Repeatable.",
)
"""Option ``--tolerance``: ignored differences. The parameter is ``changes``."""


def change_tolerances(tolerances: Tolerances, changes: tuple[str, ...]) -> Tolerances:
    """Change tolerances of a model comparison by the typed values of ``--tolerance KIND=VALUE``.

    Raises:
        ConfigurationError: If a text has another form, or a kind or value is not valid.
    """
    return tolerances.with_values(
        dict(parse_number_assignment("tolerance", text) for text in changes)
    )


def parse_name_map(pairs: tuple[str, ...]) -> dict[str, str]:
    """Parse the values ``URDF_NAME=MJCF_NAME`` of the option ``--map``.

    Returns:
        {name in the URDF: name in the MJCF}.

    Raises:
        ConfigurationError: If a value has another form, or a URDF name is mapped to two names.
    """
    names: dict[str, str] = {}
    for text in pairs:
        urdf_name, mjcf_name = parse_assignment("map", text)
        if names.setdefault(urdf_name, mjcf_name) != mjcf_name:
            message = diagnose("mapped-twice", joint=urdf_name, one=names[urdf_name], two=mjcf_name)
            raise ConfigurationError("map", message)
    return names
