"""Which robot: the words and options by which all commands are given it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import shared
from pupper_analysis.prepare.convert.files import RobotFiles

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot

Command = Callable[..., None]

VARIANT_OPTIONS = (
    click.option(
        "--base", metavar="BASE", help="Base model of a variant of your own: skeleton or v3."
    ),
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
        help="Of a URDF and an MJCF that disagree, go on with this one alone.",
    ),
    click.option(
        "--body", metavar="NAME", help="Root body of the robot, in an MJCF of several; e.g. base."
    ),
    shared.package_option,
)
"""What is found in a robot's files, unless it is said."""

FILE_OPTIONS = (
    shared.file_option("--urdf", help="URDF of your own robot, if not given as ROBOT."),
    shared.file_option("--mjcf", help="MJCF of your own robot, if not given as ROBOT."),
    *DETECTION_OPTIONS,
)


def _is_model(path: Path) -> bool:
    """Tells whether a file's name is that of a robot's model."""
    return path.suffix in (".urdf", ".xml") and path.is_file()


class _Word(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """A variant's name, or a file; ``-`` is standard input."""

    name = "robot"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Returns the word, or the name under which standard input is read."""
        return str(shared.MODEL_FILE.convert(value, param, ctx)) if value == "-" else value

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        """Returns the variants and model files that begin so; without, asks the shell for files.

        A shell that has names to offer looks for no files of its own.
        """
        from pupper_analysis.pupper.variants import VARIANTS

        there = [
            *VARIANTS,
            *(path.name for path in sorted(Path().glob("*[!~]")) if _is_model(path)),
        ]
        names = [name for name in there if name.startswith(incomplete)]
        return [CompletionItem(one) for one in names] or [CompletionItem(incomplete, type="file")]


robot_argument = click.argument("words", nargs=-1, type=_Word(), metavar="[ROBOT]")
robots_argument = click.argument("words", nargs=-1, type=_Word(), metavar="[ROBOT]...")


@dataclass(frozen=True)
class RobotOptions:
    """What these options say of the robot, as it was given; each field is an option's."""

    urdf: Path | None
    mjcf: Path | None
    take: str | None
    body: str | None
    feet: tuple[str, ...]
    pairs: tuple[str, ...]
    keyframe: str | None
    packages: tuple[str, ...]
    base: str | None
    leg_scale: float | None
    torso_mass_scale: float | None

    @staticmethod
    def taken_from(values: dict[str, Any]) -> RobotOptions:
        """Takes the options of the robot out of a command's; those that it has not are None."""
        return RobotOptions(
            **{one.name: values.pop(one.name, None) for one in fields(RobotOptions)}
        )

    def select_robot(self, words: tuple[str, ...]) -> str | VariantSpec | RobotFiles | None:
        """Returns the robot that is meant; None if none is.

        Raises:
            ConfigurationError: If it is given in several ways.
            VariantError: If a word names no robot.
        """
        from pupper_analysis.pupper.variant_files import parse_single_robot

        found = parse_single_robot(words)
        robots = [way for way in (found, self._derived, self._named) if way is not None]
        if len(robots) > 1:
            raise ConfigurationError("ROBOT", diagnose("one-robot-of-three-ways"))
        given = self._given(robots)
        return given[0] if given else None

    def select_robots(self, words: tuple[str, ...]) -> list[str | VariantSpec | RobotFiles]:
        """Returns the robots that are meant; a URDF and the MJCF after it are one.

        Raises:
            ConfigurationError: If options are for files, and there are none.
            VariantError: If a word names no robot.
        """
        from pupper_analysis.pupper.variant_files import parse_robot_words

        robots = [*parse_robot_words(words), self._derived, self._named]
        return self._given([way for way in robots if way is not None])

    def _given(
        self, robots: list[str | tuple[str, ...] | VariantSpec]
    ) -> list[str | VariantSpec | RobotFiles]:
        if self._said and not any(isinstance(way, tuple) for way in robots):
            raise ConfigurationError("ROBOT", diagnose("options-of-files-alone"))
        return [RobotFiles(way, self._said) if isinstance(way, tuple) else way for way in robots]

    @property
    def _derived(self) -> VariantSpec | None:
        """The variant of a base that the options give, if they give one."""
        if (self.base, self.leg_scale, self.torso_mass_scale) == (None, None, None):
            return None
        from pupper_analysis.pupper.variants import VariantSpec

        return VariantSpec(
            base="skeleton" if self.base is None else self.base,
            leg_scale=1.0 if self.leg_scale is None else self.leg_scale,
            torso_mass_scale=1.0 if self.torso_mass_scale is None else self.torso_mass_scale,
        )

    @property
    def _named(self) -> tuple[str, ...] | None:
        """The files that --urdf and --mjcf name, if they do."""
        return tuple(str(path) for path in (self.urdf, self.mjcf) if path is not None) or None

    @property
    def _said(self) -> dict[str, Any]:
        """What is said of the files, as ``load_robot`` takes it."""
        named = [foot if "=" in foot else f"{foot}={foot}" for foot in self.feet or ()]
        frames: dict[str, str | tuple[str, str]] = {}
        for foot, frame in (shared.parse_assignment("foot", text) for text in named):
            link, colon, place = frame.partition(":")
            frames[foot] = (link, place) if colon else frame
        folders = shared.parse_packages(self.packages or ())
        said = {
            "take": self.take,
            "body": self.body,
            "feet": frames,
            "joints": dict(shared.parse_assignment("map", text) for text in self.pairs or ()),
            "keyframe": self.keyframe,
            "packages": {name: str(path) for name, path in folders.items()},
        }
        return {name: value for name, value in said.items() if value}


def load_files(files: RobotFiles, **more: Any) -> Robot:
    """Loads the robot of files, and shows that it takes a while; notes are left to the caller."""
    with shared.show_progress("preparing the robot: feet, start pose, servos"):
        return files.load(**more)


def load_selected_robot(
    meant: str | VariantSpec | RobotFiles, *, fixed_base: bool = False, **more: bool
) -> Robot:
    """Loads a robot that is meant.

    Args:
        meant: A variant, or files.
        fixed_base: Fix its base.
        **more: What else ``load_robot`` is given of files, and matters to no variant.
    """
    if isinstance(meant, RobotFiles):
        return load_files(meant, fixed_base=fixed_base, **more)
    from pupper_analysis.pupper.variant_files import load_variant

    return load_variant(meant, fixed_base=fixed_base)


def name_uniquely(
    meant: Sequence[str | VariantSpec | RobotFiles], robots: list[Robot]
) -> list[Robot]:
    """Returns robots by names of their own: those of one name have their files', or a number."""
    names = Counter(robot.name for robot in robots)
    found: list[Robot] = []
    for one, robot in zip(meant, robots, strict=True):
        name = robot.name
        if names[name] > 1 and isinstance(one, RobotFiles):
            name = f"{name} ({one})"
        taken, number, first = {other.name for other in found}, 1, name
        while name in taken:
            number += 1
            name = f"{first} {number}"
        found.append(robot if name == robot.name else replace(robot, name=name))
    return found


def print_notes(robot: Robot, *, everything: bool = False) -> None:
    """Prints what was assumed of a robot of files: warnings, and how much else was added.

    Args:
        robot: The robot.
        everything: Print all of it.
    """
    from pupper_analysis.base.diagnostics import Severity, merge_diagnostics
    from pupper_analysis.present.document import diagnostic_text, text
    from pupper_analysis.present.terminal import make_console
    from pupper_analysis.present.terminal import print_notes as print_lines

    notes = merge_diagnostics(robot.notes)
    shown = [one for one in notes if everything or one.severity is not Severity.NOTE]
    lines = [*map(diagnostic_text, shown)]
    if left := len(notes) - len(shown):
        lines.append(text("things-were-added", robot=robot.name, count=left))
    print_lines(make_console(), lines, everything=everything)


def pass_robot_options(command: Command) -> Command:
    """Gives a command the options of a robot as one ``RobotOptions``, its first argument."""

    @wraps(command)
    def gathered(**values: Any) -> None:
        command(RobotOptions.taken_from(values), **values)

    return gathered


def add_options(
    *groups: tuple[Callable[[Command], Command], ...],
) -> Callable[[Command], Command]:
    """Returns what gives a command the options of these groups, in this order."""

    def add(command: Command) -> Command:
        for option in reversed([option for group in groups for option in group]):
            command = option(command)
        return command

    return add
