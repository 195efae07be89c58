"""Arguments and options that select a robot, shared by all commands.

A robot is the name of a variant of the package's own robot (such as ``v3``), a scaled variant
(``--base``, ``--leg-scale``, ``--torso-mass-scale``), the name of a published robot, or one or two
model files. `RobotOptions` collects the typed options and returns the selected robots;
`load_selected_robot` loads a robot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import click
from click.shell_completion import CompletionItem

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import shared
from pupper_analysis.prepare.convert.files import RobotFiles

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot

Command = Callable[..., None]
"""Function of a command-line command. The arguments of the function are the values of the command's
parameters."""

VARIANT_OPTIONS = (
    click.option("--base", metavar="BASE", help="Base model of a scaled variant: skeleton or v3."),
    click.option(
        "--leg-scale",
        type=float,
        metavar="S",
        help="Scale the legs' length and mass by S; e.g. 1.2.",
    ),
    click.option(
        "--torso-mass-scale", type=float, metavar="T", help="Scale the torso's mass by T; e.g. 1.5."
    ),
)
"""Options that specify a scaled variant of the package's own robot: base model and scales."""

DETECTION_OPTIONS = (
    click.option(
        "--foot",
        "feet",
        multiple=True,
        metavar="[NAME=]FRAME",
        help="A foot: a link, geom, site or body, or LINK:FRAME; e.g. FL=FL_foot. Repeatable. By "
        "default the feet are detected.",
    ),
    click.option(
        "--map",
        "pairs",
        multiple=True,
        metavar="URDF=MJCF",
        help="A joint's name in the URDF and in the MJCF; e.g. lf_haa=FL_hip. Repeatable.",
    ),
    click.option(
        "--keyframe", metavar="NAME", help="Keyframe of the MJCF to start from; e.g. home."
    ),
    click.option(
        "--take",
        type=click.Choice(["urdf", "mjcf"]),
        help="If a URDF and an MJCF disagree, load this file only.",
    ),
    click.option(
        "--body",
        metavar="NAME",
        help=("Root body of the robot in an MJCF with several robots; e.g. base."),
    ),
    shared.package_option,
    *shared.XACRO_OPTIONS,
)
"""Options for loading the files of a robot: properties that are otherwise detected, the file with
priority in a disagreement, and the expansion of a xacro file.
"""

FILE_OPTIONS = (
    shared.file_option("--urdf", help="URDF of your own robot, if not given as ROBOT."),
    shared.file_option("--mjcf", help="MJCF of your own robot, if not given as ROBOT."),
    *DETECTION_OPTIONS,
)
"""Options that name the files of a robot, and the options for loading the files
(`DETECTION_OPTIONS`)."""


def _is_model_file(path: Path) -> bool:
    """Return True if a path is probably a model: an existing file with the suffix of a model."""
    return path.suffix.lower() in (".urdf", ".xml", ".mjcf") and path.is_file()


class _RobotWord(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """Type of a command-line word that names a robot: variant, published robot, or file.

    ``-`` is a file on standard input.
    """

    name = "robot"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Convert a typed word: ``-`` becomes the path of standard input; others are unchanged."""
        return str(shared.MODEL_FILE.convert(value, param, ctx)) if value == "-" else value

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        """Return completions of a word: variants, and model files in the current folder.

        Without a match, the shell completes file names by itself.
        """
        from pupper_analysis.pupper.variants import VARIANTS

        candidates = [
            *VARIANTS,
            *(path.name for path in sorted(Path().glob("*[!~]")) if _is_model_file(path)),
        ]
        names = [name for name in candidates if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


robot_argument = click.argument("words", nargs=-1, type=_RobotWord(), metavar="[ROBOT]")
"""Argument of command-line commands that take a single robot: the name of a robot, or one or two
model files. The parameter of the command's function is ``words``."""

robot_and_sources_argument = click.argument(
    "words", nargs=-1, type=_RobotWord(), metavar="[ROBOT] [SOURCE]..."
)
"""Argument of command-line commands that take a single robot, and the files of a policy. The
parameter of the command's function is ``words``.
"""

robots_argument = click.argument("words", nargs=-1, type=_RobotWord(), metavar="[ROBOT]...")
"""Argument of command-line commands that take several robots: names of robots, or model files. The
parameter of the command's function is ``words``."""


@dataclass(frozen=True)
class RobotOptions:
    """Values of the command-line options that select a robot, as typed.

    Each field is the value of the option with this parameter name. The value is None if the command
    does not have the option.
    """

    urdf: Path | None
    mjcf: Path | None
    take: str | None
    body: str | None
    feet: tuple[str, ...]
    pairs: tuple[str, ...]
    keyframe: str | None
    packages: tuple[str, ...]
    xacro: bool | None
    xacro_args: tuple[str, ...]
    base: str | None
    leg_scale: float | None
    torso_mass_scale: float | None

    @staticmethod
    def pop_from(values: dict[str, Any]) -> RobotOptions:
        """Move the options that select a robot from the values of a command to an object.

        Args:
            values: {parameter: value} of a command-line command; the options are removed in place.
                Missing options become None.
        """
        return RobotOptions(
            **{field.name: values.pop(field.name, None) for field in fields(RobotOptions)}
        )

    def select_robot(self, words: tuple[str, ...]) -> str | VariantSpec | RobotFiles | None:
        """Determine the single robot that the words and options of a command specify.

        Returns:
            Name or specification of a variant of the package's own robot, or files; None if no
            robot is specified.

        Raises:
            ConfigurationError: If several robots are specified, or an option for files is not
                valid, for example.
            VariantError: If a word names no robot, or a base or scale is not valid.
        """
        from pupper_analysis.pupper.variant_files import parse_single_robot

        parsed = parse_single_robot(words)
        robots = [
            specification
            for specification in (parsed, self._derived_variant, self._named_files)
            if specification is not None
        ]
        if len(robots) > 1:
            raise ConfigurationError("ROBOT", diagnose("one-robot-of-three-ways"))
        selected = self._attach_options(robots)
        return selected[0] if selected else None

    def select_robots(self, words: tuple[str, ...]) -> list[str | VariantSpec | RobotFiles]:
        """Determine all robots that the words and options of a command specify.

        A URDF and the MJCF after it are a single robot.

        Returns:
            Names or specifications of variants of the package's own robot, and files; empty if no
            robot is specified.

        Raises:
            ConfigurationError: If an option for files is not valid, or is typed without a file.
            VariantError: If a word names no robot, or a base or scale is not valid.
        """
        from pupper_analysis.pupper.variant_files import parse_robot_words

        robots = [*parse_robot_words(words), self._derived_variant, self._named_files]
        return self._attach_options(
            [specification for specification in robots if specification is not None]
        )

    def _attach_options(
        self, robots: list[str | tuple[str, ...] | VariantSpec]
    ) -> list[str | VariantSpec | RobotFiles]:
        """Add the typed options for files to the selected robots that are loaded from files."""
        if self._load_options and not any(
            isinstance(specification, tuple) for specification in robots
        ):
            names = map(OPTIONS_OF_LOADING.__getitem__, self._load_options)
            message = diagnose("options-of-files-alone", options=tuple(names))
            raise ConfigurationError("ROBOT", message)
        return [
            RobotFiles(specification, self._load_options)
            if isinstance(specification, tuple)
            else specification
            for specification in robots
        ]

    @property
    def _derived_variant(self) -> VariantSpec | None:
        """Variant that the options of `VARIANT_OPTIONS` specify; None if none of them is typed."""
        if (self.base, self.leg_scale, self.torso_mass_scale) == (None, None, None):
            return None
        from pupper_analysis.pupper.variants import VariantSpec

        return VariantSpec(
            base="skeleton" if self.base is None else self.base,
            leg_scale=1.0 if self.leg_scale is None else self.leg_scale,
            torso_mass_scale=1.0 if self.torso_mass_scale is None else self.torso_mass_scale,
        )

    @property
    def _named_files(self) -> tuple[str, ...] | None:
        """Files of the options --urdf and --mjcf; None if neither option was typed."""
        return tuple(str(path) for path in (self.urdf, self.mjcf) if path is not None) or None

    @property
    def _load_options(self) -> dict[str, Any]:
        """Typed options for loading files, as {keyword argument of ``load_robot``: value}.

        Raises:
            ConfigurationError: If the text of an option has another form, for example.
        """
        named = [foot if "=" in foot else f"{foot}={foot}" for foot in self.feet or ()]
        frames: dict[str, str | tuple[str, str]] = {}
        for foot, frame in (shared.parse_assignment("foot", text) for text in named):
            link, colon, place = frame.partition(":")
            frames[foot] = (link, place) if colon else frame
        folders = shared.parse_packages(self.packages or ())
        options = {
            "take": self.take,
            "body": self.body,
            "feet": frames,
            "joints": dict(shared.parse_assignment("map", text) for text in self.pairs or ()),
            "keyframe": self.keyframe,
            "packages": {name: str(path) for name, path in folders.items()},
            "xacro": self.xacro,
            "xacro_args": shared.parse_xacro_args(self.xacro_args or ()),
        }
        return {name: value for name, value in options.items() if value}


OPTIONS_OF_LOADING: Final = {
    "take": "--take",
    "body": "--body",
    "feet": "--foot",
    "joints": "--map",
    "keyframe": "--keyframe",
    "packages": "--package",
    "xacro": "--xacro",
    "xacro_args": "--xacro-arg",
}
"""{keyword argument of ``load_robot``: command-line option}, for errors about these options."""


PREPARING_ROBOT: Final = "preparing the robot: feet, start pose, servos"
"""Progress message during the preparation of a robot, including its postponed steps."""


def load_files(files: RobotFiles, **more: Any) -> Robot:
    """Load a robot from files, and show the progress on standard error; print no notes.

    The robot gets the names of the files, as typed, instead of the name that a file states.

    Args:
        files: Files and options of the user.
        **more: Further keyword arguments of ``load_robot``.
    """
    from pupper_analysis.robot.robot import rename_robot

    with shared.show_progress(PREPARING_ROBOT):
        return rename_robot(files.load(**more), str(files))


def load_selected_robot(
    meant: str | VariantSpec | RobotFiles, *, fixed_base: bool = False, **more: bool
) -> Robot:
    """Load a robot that the user selected: a variant of the package's own robot, or files.

    Args:
        meant: Selection: name (such as ``v3``) or specification of a variant, or files of the user.
        fixed_base: True to fix the base in the world.
        **more: Further arguments of ``load_robot``, ignored for a variant.

    Raises:
        ConfigurationError: If an option is invalid.
        VariantError: If the scales of a variant give no valid model.
        ModelError: If no robot can be made of the files.
        UnknownNameError: If a foot, joint, keyframe or body does not exist, for example.
        MissingPackageError: If a package that the reader of the format needs is not installed.
    """
    if isinstance(meant, RobotFiles):
        return load_files(meant, fixed_base=fixed_base, **more)
    from pupper_analysis.pupper.variant_files import load_variant

    return load_variant(meant, fixed_base=fixed_base)


@contextmanager
def write_selected_variant(
    meant: str | VariantSpec | RobotFiles,
) -> Iterator[tuple[Path, Path] | None]:
    """Write the URDF and MJCF of a selected variant to a temporary folder; yield their paths.

    A derived variant, for example, has no files in the package. None for files of the user. The
    folder is deleted at the end of the context.
    """
    if isinstance(meant, RobotFiles):
        yield None
        return
    from pupper_analysis.pupper.variant_files import write_variant

    with TemporaryDirectory() as folder:
        yield write_variant(meant, folder)


def check_base_is_free(robot: Robot, code: str, propose: Callable[[], str], **values: Any) -> None:
    """Raise an error if the base is fixed, with a proposed command.

    The error has no command if a note on the robot states why the robot cannot stand.

    Args:
        robot: Robot.
        code: Code of the diagnostic of the error; see `Robot.check_floating`.
        propose: Function that returns the proposed command (`complete_command`), or raises another
            error.
        **values: Further values of the diagnostic.

    Raises:
        ConfigurationError: If the base is fixed, or falls.
        ModelError: If a fault in a model file prevents a stand.
    """
    try:
        robot.check_floating(code, **values)
    except ConfigurationError as error:
        problem = error.problem
        if isinstance(problem, Diagnostic) and problem.code == code and not problem.values["why"]:
            error.add_note(propose())
        raise


def check_bases_are_free(
    meant: Sequence[str | VariantSpec | RobotFiles], robots: Sequence[Robot], words: Sequence[str]
) -> None:
    """Raise the error about the first of several robots that cannot stand.

    The error is followed by the running command with the other robots. If no robot can stand, it is
    followed by `hold` of the first robot.

    Args:
        meant: Selections of the user.
        robots: Robots of the selections, in the same order.
        words: Typed words that name robots.

    Raises:
        ConfigurationError: If the base of a robot is fixed, or falls.
        ModelError: If a fault in a model file prevents a stand.
    """
    refused: dict[int, ConfigurationError] = {}
    for index, robot in enumerate(robots):
        try:
            robot.check_floating()
        except ConfigurationError as error:
            refused[index] = error
    if not refused:
        return
    first, refusal = next(iter(refused.items()))
    if len(robots) > 1:
        refusal.add_note(_complete_command_of_others(meant, words, [*refused], first))
    raise refusal


def _complete_command_of_others(
    meant: Sequence[str | VariantSpec | RobotFiles],
    words: Sequence[str],
    refused: Sequence[int],
    first: int,
) -> str:
    """Create the running command line without refused robots; `hold` of ``first`` if all are.

    ``refused`` are indices of ``meant``.
    """
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.document import NextStep

    typed: list[set[str]] = [
        {*selection.models}
        if isinstance(selection, RobotFiles)
        else {selection if isinstance(selection, str) else selection.name}
        for selection in meant
    ]

    def list_words(indices: Sequence[int]) -> tuple[str, ...]:
        """Return the typed words that name the selections of some indices."""
        return tuple(
            word
            for word in words
            if any(word in typed[index] or {*word.split("+")} <= typed[index] for index in indices)
        )

    omitted = ("--urdf", "--mjcf") if len(meant) > 1 and not list_words([first]) else ()
    command = str(click.get_current_context().command.name)
    kept = list_words([index for index in range(len(meant)) if index not in refused])
    if len(refused) == len(meant):
        command, kept = "hold", list_words([first])
    return complete_command(NextStep(command, kept, robot_typed=False, omitted=omitted))


def name_uniquely(
    meant: Sequence[str | VariantSpec | RobotFiles], robots: list[Robot]
) -> list[Robot]:
    """Return robots with unique names, so that the results of several robots can be distinguished.

    Args:
        meant: Selections of the user.
        robots: Robots that were loaded from the selections, in the same order.
    """
    from pupper_analysis.robot.robot import rename_robot

    names = Counter(robot.name for robot in robots)
    renamed: list[Robot] = []
    for selection, robot in zip(meant, robots, strict=True):
        name = robot.name
        if names[name] > 1 and isinstance(selection, RobotFiles):
            name = _add_folders(selection, meant)
        taken, number, first = {named.name for named in renamed}, 1, name
        while name in taken:
            number += 1
            name = f"{first} {number}"
        renamed.append(robot if name == robot.name else rename_robot(robot, name))
    return renamed


def _add_folders(files: RobotFiles, meant: Sequence[str | VariantSpec | RobotFiles]) -> str:
    """Return the names of files with as many folders as distinguish them from other selections.

    ``meant`` are all selections of the user.
    """
    other_selections = [
        selection for selection in meant if isinstance(selection, RobotFiles) and selection != files
    ]
    count = max((len(Path(model).parts) for model in files.models), default=1)
    name = str(files)
    for depth in range(2, count + 1):
        if name not in {_join_paths(other_files, depth - 1) for other_files in other_selections}:
            break
        name = _join_paths(files, depth)
    return name


def _join_paths(files: RobotFiles, depth: int) -> str:
    """Return the last ``depth`` parts of each path, joined like `RobotFiles`."""
    return "+".join("/".join(Path(model).parts[-depth:]) for model in files.models)


def print_robot_notes(robot: Robot, *, everything: bool = False) -> None:
    """Print the first warnings and errors on a robot (`print_warnings`), and count its other notes.

    A next report with a single document in the short form prints the count (`hide_notes`).

    Args:
        robot: Robot.
        everything: True to print all notes, and to count none.
    """
    with shared.show_progress(PREPARING_ROBOT):
        robot.complete_stages()
    print_warnings(robot, everything=everything)
    if not everything:
        hide_notes(robot)


def print_warnings(robot: Robot, *, everything: bool = False) -> None:
    """Print the warnings and errors of the notes on a robot.

    Args:
        robot: Robot.
        everything: True to print all notes, otherwise only the warnings and errors, at most
            ``MAX_SHORT_NOTES`` lines.
    """
    from pupper_analysis.base.diagnostics import Severity, merge_diagnostics
    from pupper_analysis.present.document import diagnostic_text
    from pupper_analysis.present.terminal import make_console
    from pupper_analysis.present.terminal import print_notes as print_lines

    notes = merge_diagnostics(robot.notes)
    shown = [note for note in notes if everything or note.severity is not Severity.NOTE]
    print_lines(make_console(), [*map(diagnostic_text, shown)], everything=everything)


def hide_notes(robot: Robot) -> None:
    """Count the unprinted notes on a robot, for the next report.

    A short report with a single document states the number, as "with -v: 3 notes". Warnings and
    errors do not count: callers print these (`print_warnings`).
    """
    from pupper_analysis.base.diagnostics import Severity, merge_diagnostics

    notes = merge_diagnostics(robot.notes)
    hidden = sum(note.severity is Severity.NOTE for note in notes)
    meta = click.get_current_context().meta
    meta[shared.HIDDEN_NOTES] = meta.get(shared.HIDDEN_NOTES, 0) + hidden


def pass_robot_options(command: Command) -> Command:
    """Change a command-line command to receive the options of a robot as a `RobotOptions`.

    The object is the first argument of the function ``command``.
    """

    @wraps(command)
    def wrapped(**values: Any) -> None:
        """Call the command; the options of the robot are its first argument, a `RobotOptions`."""
        command(RobotOptions.pop_from(values), **values)

    return wrapped


def add_options(
    *groups: tuple[Callable[[Command], Command], ...],
) -> Callable[[Command], Command]:
    """Create a decorator that adds groups of options to a command-line command, in this order."""

    def add(command: Command) -> Command:
        """Add the options of all groups to a command."""
        for option in reversed([option for group in groups for option in group]):
            command = option(command)
        return command

    return add
