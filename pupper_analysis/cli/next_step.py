"""Create the command line of the next step that a result suggests.

Input is a ``NextStep``: another command with its words. Output is a line that can be pasted into a
shell: the command, the robot that the user typed, and those of the typed options that the next
command also has.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import (
    ModelError,
    StanceUnreachableError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.base.kinds import GENERATOR_NAME
from pupper_analysis.base.tools import find_format
from pupper_analysis.cli.shared import (
    ROBOT_WORDS,
    TYPED_WORDS,
    Command,
    OutputPath,
    print_text,
    sort_model_paths,
)
from pupper_analysis.present.document import NextStep, text

_ROBOT_ARGUMENTS = ("words", "file", "urdf", "mjcf", "source")
"""Parameter names of the arguments of command-line commands that specify a robot or its model
files."""

_OUTPUT_PARAMETERS = ("everything", "style", "force")
"""Parameter names of the options ``--verbose``, ``--format`` and ``--force``, which the next
command does not get."""

_PAYLOAD_SEARCHES = (("payload",), ("best", "payload"))
"""First words of the command lines that compute a payload mass, which accept ``--payload-at``
without ``--payload``.
"""


SEARCHED_OPTIONS = ("--height", "--roll", "--pitch", "--yaw", "--offset", "--move", "--com")
"""Options of the coordinates that a search for a stance determines: their typed values are the
initial stance, and do not apply to the stance that was found."""

_COMMANDS_WITHOUT_WELDS = ("best", "path", "push")
"""Commands that refuse a stance with a weld or a grip (``--contact NAME=weld``)."""

_COMMANDS_WITHOUT_WELDED_BASE = (*_COMMANDS_WITHOUT_WELDS, "workspace")
"""Commands that refuse a stance with ``--contact base=weld``."""


def accepts_welded_base(command: click.Command) -> bool:
    """Return True if a command accepts a robot with a fixed base, with ``--contact base=weld``."""
    options = {option for param in command.params for option in param.opts}
    return "--contact" in options and command.name not in _COMMANDS_WITHOUT_WELDED_BASE


_WORDS_FOR_FIXED_BASE = {
    "fit": ("--log", "motion.csv"),
    "gains": ("--contact", "base=weld"),
    "heat": ("--contact", "base=weld"),
}
"""{command about stands: words with which the command accepts a fixed base}."""

_COMMANDS_OF_FORMATS = ("audit", "contract", "crosscheck")
"""Commands to which a next step passes a typed file of another format than URDF and MJCF."""


def complete_command(step: NextStep | None) -> str:
    """Create the command line of a suggested next step, for the robot of the running command.

    The line contains the command and the words of the step, the typed robot (unless the words
    contain its files), and most of the typed options that both commands have.

    Returns:
        Command line; empty without a step, or if no such line is possible, for example because the
        next command needs more files than were typed. Empty as well for a repetition with ``-v`` if
        the user typed ``-v``.
    """
    context = click.get_current_context(silent=True)
    if step is None or context is None:
        return ""
    root, typed = context.find_root(), context.meta.get(TYPED_WORDS, ())
    group = root.command
    values, _, order = context.command.make_parser(context).parse_args(list(typed))
    step = _replace_step_of_weld(step, values, str(context.command.name))
    if step.stance_found:
        step = _add_stance_file(step, values, context.command)
    target = group.get_command(root, step.command) if isinstance(group, click.Group) else None
    if target is None:
        return ""
    arguments = {
        param.name for param in context.command.params if isinstance(param, click.Argument)
    }
    typed_robot = _list_typed_robot(arguments, values) if step.robot_typed else []
    if typed_robot and step.command != context.command.name:
        typed_robot = list(context.meta.get(ROBOT_WORDS, typed_robot))
    if step.of_mjcf:
        endings = (".xml", ".mjcf")
        typed_robot = [word for word in typed_robot if word.endswith(endings)] or typed_robot
    if typed_robot and step.command not in _COMMANDS_OF_FORMATS:
        typed_robot = [word for word in typed_robot if find_format(Path(word)) is None]
        if not typed_robot:  # the command would load its default robot
            return ""
    robot = _fit_robot_arguments(typed_robot, arguments, target, required=step.robot_typed)
    if robot is None:
        return ""
    options = _list_common_options(order, values, target, _list_excluded_options(step, values))
    split = next(
        (place for place, word in enumerate(step.words) if word.startswith("-")), len(step.words)
    )
    first, last = step.words[:split], step.words[split:]
    words = [step.command, *first, *robot, *options, *last]
    repeated = "-v" in last and context.params.get("everything")
    return "" if "-" in words or repeated else f"{GENERATOR_NAME} {shlex.join(words)}"


def _replace_step_of_weld(
    step: NextStep, values: Mapping[str, Any], running_command: str
) -> NextStep:
    """Replace a next step that does not suit the welds or grips of the typed stance.

    Args:
        step: Next step.
        values: {name of a parameter: typed value}.
        running_command: Name of the running command.

    Returns:
        `hold` if the base is welded; otherwise `payload`, or `gains` after `payload`. The given
        step if no replacement is necessary.
    """
    contacts = [word.partition("=")[::2] for word in _split_parameter(values.get("contacts"))]
    fixed_parts = [
        part for part, surface in contacts if surface.startswith("weld") or "grip=" in surface
    ]
    payload_on_base = step.command == "payload" and not values.get("payload_at")
    refused = step.command in _COMMANDS_WITHOUT_WELDED_BASE or payload_on_base
    if "base" in fixed_parts and refused:
        return NextStep("hold")
    if fixed_parts and step.command in _COMMANDS_WITHOUT_WELDS:
        return NextStep("gains" if running_command == "payload" else "payload")
    return step


def _add_stance_file(step: NextStep, values: Mapping[str, Any], running: click.Command) -> NextStep:
    """Add the stance that the running command has found to a next step.

    Args:
        step: Next step, without the options of the stance.
        values: {name of a parameter: typed value}.
        running: Running command.

    Returns:
        Next step with ``--stance FILE``, without the typed options of the stance. If ``--json``
        was not typed, or for standard output, next step with the options of the stance
        (``NextStep.stance_words``), which replace the typed values; without such options, the
        running command with ``--json FILE``.
    """
    from pupper_analysis.cli.stance_fields import OPTION_FIELDS

    file = values.get("json_path")
    if (not file or file == "-") and step.stance_words:
        replaced = (*step.omitted, *SEARCHED_OPTIONS, "--stance")
        return replace(step, words=(*step.words, *step.stance_words), omitted=replaced)
    if not file or file == "-":
        words = ("--json", f"{running.name}.json")
        return NextStep(str(running.name), (*_list_arguments(running, values), *words))
    typed = tuple(f"--{field.option}" for field in OPTION_FIELDS.values())
    return replace(step, words=(*step.words, "--stance", file), omitted=(*step.omitted, *typed))


def _list_arguments(command: click.Command, values: Mapping[str, Any]) -> list[str]:
    """Return the typed arguments of a command that do not specify the robot."""
    return [
        word
        for argument in command.params
        if isinstance(argument, click.Argument) and argument.name not in _ROBOT_ARGUMENTS
        for word in _split_parameter(values.get(str(argument.name)))
    ]


def list_typed_robot(context: click.Context) -> list[str]:
    """Return the typed words that specify the robot of a running command."""
    if (words := context.meta.get(ROBOT_WORDS)) is not None:
        return list(words)
    values, _, _ = context.command.make_parser(context).parse_args(
        list(context.meta.get(TYPED_WORDS, ()))
    )
    arguments = {
        param.name for param in context.command.params if isinstance(param, click.Argument)
    }
    return _list_typed_robot(arguments, values)


def _list_typed_robot(arguments: Set[str | None], values: Mapping[str, Any]) -> list[str]:
    """Return the typed words that specify the robot or its model files, such as ``v3``."""
    words = [
        word
        for name in _ROBOT_ARGUMENTS
        if name in arguments
        for word in _split_parameter(values.get(name))
    ]
    if arguments >= {"urdf", "mjcf"} and len(words) == len(arguments):
        return [str(path) for path in sort_model_paths(*map(Path, words))]
    return words


def _fit_robot_arguments(
    robot: list[str], arguments: Set[str | None], target: click.Command, *, required: bool
) -> list[str] | None:
    """Return the typed words of the robot that a suggested next command accepts as arguments.

    ``arguments`` are the names of the running command's arguments. None if ``required``, and the
    next command ``target`` needs more words.
    """
    from pupper_analysis.pupper.named_robots import is_variant

    taken = [
        argument
        for argument in target.params
        if isinstance(argument, click.Argument) and argument.name in _ROBOT_ARGUMENTS
    ]
    several = any(argument.nargs == -1 for argument in taken)
    lacking = len(robot) < sum(argument.required for argument in taken) or (
        taken and not (robot or several)
    )
    # A variant stands for both files.
    pair = any(argument.name == "mjcf" for argument in taken) and not any(map(is_variant, robot))
    if required and (lacking or (pair and len(robot) < len(taken))):
        return None
    if not several:
        return robot[: len(taken)]
    if len(robot) > 1 and arguments >= {"urdf", "mjcf"}:  # a variant and a file are two robots
        return [word for word in robot if not is_variant(word)] or robot[:1]
    return robot


def _list_excluded_options(step: NextStep, values: Mapping[str, Any]) -> list[str]:
    """Return the words of typed options that the suggested next command does not repeat.

    Typed values of an option are kept if the step adds a value for a pattern of joints, such as
    ``--kp 'knee_*=5'``.
    """
    following = (*step.words[1:], "")
    replacing = [
        word for word, value in zip(step.words, following, strict=False) if "=" not in value
    ]
    excluded = [*replacing, *step.omitted]
    words = (step.command, *step.words)
    searches = any(words[: len(start)] == start for start in _PAYLOAD_SEARCHES)
    if not (searches or values.get("payload") or "--payload" in step.words):
        excluded.append("--payload-at")
    return excluded


def complete_fixed_base_command(running_command: str) -> str:
    """Create a command line that accepts a fixed base, after the refusal of a command on stands.

    Args:
        running_command: Name of the refused command.
    """
    context = click.get_current_context(silent=True)
    modes = {} if context is None else context.params
    if running_command == "live" and (modes.get("headless") or modes.get("dropped")):
        return complete_command(NextStep("live", ("--mujoco",), omitted=("--drop",)))
    words = _WORDS_FOR_FIXED_BASE.get(running_command)
    if words is None:
        return complete_command(NextStep("hold"))
    return complete_command(NextStep(running_command, words))


def complete_audit_command(error: ModelError) -> str:
    """Create the command line of `audit` for the file of a model error.

    The command line contains ``--fix`` for a fault with a single repair.
    """
    sources = error.cause.sources
    words = (sources[0].file,) if sources else ()
    repair = ("--fix",) if error.cause.code == "joint-limits-crossed" else ()
    return complete_command(NextStep("audit", (*words, *repair), robot_typed=not words))


def make_second_model_error(command: Command, present: Path) -> click.UsageError:
    """Create the error about a missing MJCF in `crosscheck` and `sync`, with the next command.

    Args:
        command: Running command.
        present: Typed URDF, MJCF, or name of a published robot.

    Raises:
        VariantError: If the word names no robot.
        ModelError: If the published robot is not downloaded.
    """
    from pupper_analysis.models.published import find_file, is_published_name
    from pupper_analysis.pupper.named_robots import refuse_unknown_variant

    refuse_unknown_variant(str(present))
    error = command.make_missing_error(click.get_current_context(), "mjcf")
    if is_published_name(str(present)):
        find_file(present)
        error.add_note(complete_command(NextStep("audit", (str(present),), robot_typed=False)))
    else:
        error.add_note(complete_pair_command(present))
    return error


def complete_comparison_command(first: Path, second: Path, *, related: bool) -> str:
    """Create the command line after the refusal of two files of one format in `crosscheck`, `sync`.

    Args:
        first: First typed file.
        second: Second typed file.
        related: True if the files share names of joints, so that they may be versions of a robot.

    Returns:
        `diff` of related files; otherwise the line after the refusal of a single file.
    """
    if not related:
        return complete_pair_command(first)
    return complete_command(NextStep("diff", (str(first), str(second)), robot_typed=False))


def complete_pair_command(present: Path, missing: Path | None = None) -> str:
    """Create the command line after the refusal of `crosscheck` or `sync` with a single model file.

    Without a typed second file, the line gets the file of the other format with the same name, if
    it exists. Otherwise the line is `audit` of the present file after `crosscheck`; after `sync`,
    `convert`, which writes the second file.

    Args:
        present: Typed URDF or MJCF.
        missing: Typed second file, which does not exist; None if no second file was typed.

    Returns:
        Command line; empty if ``present`` does not exist or is no URDF or MJCF by its suffix, for
        example. After `sync`, ``missing`` must also have a suffix of the other format.
    """
    context = click.get_current_context(silent=True)
    suffixes = _SUFFIXES_OF_OTHER_FORMAT.get(present.suffix.lower())
    if context is None or suffixes is None or not path_exists(present):
        return ""
    beside = [present.with_suffix(suffix) for suffix in suffixes]
    found = next(filter(path_exists, beside), None) if missing is None else None
    if found is not None:
        pair = sorted((present, found), key=lambda path: path.suffix.lower() != ".urdf")
        step = NextStep(str(context.command.name), tuple(map(str, pair)), robot_typed=False)
    elif context.command.name == "crosscheck":
        step = NextStep("audit", (str(present),), robot_typed=False)
    else:
        written = beside[0] if missing is None else missing
        if written.suffix.lower() not in suffixes:
            return ""
        step = NextStep("convert", (str(present), "-o", str(written)), robot_typed=False)
    return complete_command(step)


_SUFFIXES_OF_OTHER_FORMAT = {
    ".urdf": (".xml", ".mjcf"),
    ".xml": (".urdf",),
    ".mjcf": (".urdf",),
}
"""{suffix of a URDF or MJCF: suffixes of the other format}."""


def complete_forced_command() -> str:
    """Create the typed command line with ``--force``; empty if no command is running."""
    context = click.get_current_context(silent=True)
    if context is None:
        return ""
    typed = list(context.meta.get(TYPED_WORDS, ()))
    words = ["--force", *typed] if "--" in typed else [*typed, "--force"]
    return f"{GENERATOR_NAME} {shlex.join([str(context.command.name), *words])}"


def complete_corrected_command(error: UnknownNameError) -> str:
    """Create the typed command line with the most similar valid name in place of an unknown name.

    Returns:
        Command line; empty if no valid name is similar, or no option or argument contains the
        unknown name as a whole word.
    """
    if not error.correction or not isinstance(error.name, str):
        return ""
    return _correct_typed_command(error.name, error.correction)


def _correct_typed_command(unknown: str, correction: str) -> str:
    """Create the typed command line with another name in place of an unknown name.

    Empty if no command is running, or no typed word contains the unknown name as a whole word.
    """
    context = click.get_current_context(silent=True)
    if context is None:
        return ""
    typed = list(map(str, context.meta.get(TYPED_WORDS, ())))
    words = _replace_name(typed, unknown, correction)
    if words == typed:
        return ""
    return f"{GENERATOR_NAME} {shlex.join([str(context.command.name), *words])}"


def complete_command_without(removed: object) -> str:
    """Create the typed command line without some typed words, a tuple of texts."""
    context = click.get_current_context(silent=True)
    if context is None:
        return ""
    removed_words = _split_parameter(removed)
    words = [word for word in context.meta.get(TYPED_WORDS, ()) if word not in removed_words]
    return f"{GENERATOR_NAME} {shlex.join([str(context.command.name), *words])}"


def _replace_name(words: Sequence[str], name: str, replacement: str) -> list[str]:
    """Replace a name in words, where the name is a whole word or a part between ``=``, ``,``."""
    pattern = re.compile(rf"(?<![^=,:\s]){re.escape(name)}(?![^=,:\s])")
    return [pattern.sub(lambda _: replacement, word) for word in words]


_COMMANDS_ABOUT_STANDS = (
    *("analyze", "best", "gains", "heat", "live", "path", "payload", "push", "stand", "walk"),
    "workspace",
)
"""Commands that refuse a robot with a fixed base, unless the base is welded."""


def correct_unknown_robot(error: VariantError) -> VariantError:
    """Add the command line with the proposed robot to the error about a word that names no robot.

    In a command about stands, the robots are those of the kind of the most similar robot: all have
    a fixed base, or none. For a fixed base, the command line is that for a fixed base.

    Returns:
        Error with the command line as a note; the given error if the word names no similar robot.
    """
    from pupper_analysis.models.published import has_fixed_base
    from pupper_analysis.pupper.named_robots import make_known_robots_error

    context = click.get_current_context(silent=True)
    problem = error.diagnostic.values.get("valid")
    if context is None or not isinstance(problem, Diagnostic) or not isinstance(error.value, str):
        return error
    similar, absent = problem.values.get("alike"), str(problem.values.get("absent", ""))
    names = [*(map(str, similar) if isinstance(similar, tuple) else ()), *filter(None, [absent])]
    if problem.code != "known-robots" or not names:
        return error
    fixed = False
    if str(context.command.name) in _COMMANDS_ABOUT_STANDS:
        fixed = has_fixed_base(names[0])
        names = [name for name in names if has_fixed_base(name) == fixed]
    corrected = make_known_robots_error(
        error.value,
        [name for name in names if name != absent],
        [name for name in names if name == absent],
        fixed=fixed,
    )
    corrected.add_note(_complete_download(error.value, names[0], absent, fixed=fixed))
    return corrected


def correct_absent_model(error: ModelError) -> ModelError:
    """Add the command lines that download a published model and run the typed command.

    For a robot with a fixed base in a command about stands, the command for a fixed base is run.

    Returns:
        Error with the command lines as a note.
    """
    from pupper_analysis.models.published import has_fixed_base

    context = click.get_current_context(silent=True)
    name = "" if context is None else str(context.command.name)
    fixed = name in _COMMANDS_ABOUT_STANDS and has_fixed_base(error.source)
    cause = replace(error.cause, values=FrozenDict({**error.cause.values, "fixed": fixed}))
    corrected = ModelError(error.source, cause)
    corrected.add_note(_complete_download(error.source, error.source, error.source, fixed=fixed))
    return corrected


def _complete_download(typed: str, name: str, absent: str, *, fixed: bool) -> str:
    """Create the command line with the name of a robot in place of a typed word.

    Args:
        typed: Typed word.
        name: Name of the robot.
        absent: Name of the robot that must be downloaded first; empty if none.
        fixed: True for the command for a fixed base, in place of the running command.

    Returns:
        Command line; empty if no typed word contains the word ``typed``, for example.
    """
    from pupper_analysis.models.published import make_download_command
    from pupper_analysis.pupper.named_robots import is_variant

    context = click.get_current_context(silent=True)
    if context is None:
        return ""
    arguments = {
        param.name for param in context.command.params if isinstance(param, click.Argument)
    }
    single = len(list_typed_robot(context)) == 1
    if single and {"urdf", "mjcf"} <= arguments and not is_variant(name):  # no second file
        line = complete_command(NextStep("audit", (name,), robot_typed=False))
    elif fixed:
        line = complete_fixed_base_command(str(context.command.name))
        line = shlex.join(_replace_name(shlex.split(line), typed, name))
    elif name == typed:
        words = (str(context.command.name), *map(str, context.meta.get(TYPED_WORDS, ())))
        line = f"{GENERATOR_NAME} {shlex.join(words)}"
    else:
        line = _correct_typed_command(typed, name)
    parts = (make_download_command(absent) if name == absent else "", line)
    return " && ".join(filter(None, parts))


def complete_relaxed_command(error: StanceUnreachableError) -> str:
    """Create the command line that requests the nearest reachable stance, after a refusal.

    Options of the relaxed requirements have the values of the reachable stance (`error.nearest`).

    Returns:
        Command line; empty if there is none, for example without a reachable stance.
    """
    from pupper_analysis.cli.stance_fields import format_as_options

    context = click.get_current_context(silent=True)
    if context is None or error.nearest is None:
        return ""
    task = error.nearest.task
    relaxed = next(
        (
            list(limits)
            for limits in error.limits.values()
            if all(getattr(task, requirement) == value for requirement, value in limits.items())
        ),
        [],
    )
    options = format_as_options(task, relaxed)
    if not options:
        return ""
    first = _list_arguments(context.command, context.params)
    words = [word for option, values in options.items() for value in values
             for word in (option, value)]  # fmt: skip
    step = NextStep(str(context.command.name), (*first, *words), omitted=tuple(options))
    return complete_command(step)


def print_next_step(step: NextStep | None) -> None:
    """Print the command line of a suggested next step, if any (`complete_command`)."""
    if line := complete_command(step):
        print_text(text("next-command", command=line), indent=2)


def _split_parameter(value: object) -> list[str]:
    """Return a text, or the items of a list, as command-line words; empty for another value."""
    if isinstance(value, list | tuple):
        return [str(item) for item in value]
    return [value] if isinstance(value, str) else []


def _list_common_options(
    order: Sequence[click.Parameter],
    values: Mapping[str, Any],
    target: click.Command,
    excluded: Sequence[str],
) -> Iterator[str]:
    """Yield the typed options, with values, that the suggested next command ``target`` also has.

    Options for output files, `_OUTPUT_PARAMETERS` and the options ``excluded`` are left out.
    """
    known = {
        (param.name, *param.opts) for param in target.params if isinstance(param, click.Option)
    }
    for option in dict.fromkeys(order):
        name = max(option.opts, key=len)
        if (
            not isinstance(option, click.Option)
            or (option.name, *option.opts) not in known
            or option.name in _OUTPUT_PARAMETERS
            or isinstance(option.type, OutputPath)
            or not {*option.opts, "*"}.isdisjoint(excluded)
        ):
            continue
        if option.is_flag:
            yield name
        else:
            yield from (
                word
                for value in _split_parameter(values[str(option.name)])
                for word in (name, value)
            )
