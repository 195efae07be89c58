"""Which robot, and how it shall stand: the options that all commands about stances share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.stance_fields import TYPED, option_of, options_of, task_of, to_task_value
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.stance.fields import ROBOT_FIELDS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.results import Result
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.task import StandTask

Command = Callable[..., None]

VARIANT = (
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
FOUND = (
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
    shared.package_option,
)
"""What is found in two files, unless it is said."""

OWN = (
    shared.file_option("--urdf", help="URDF of your own robot (with --mjcf)."),
    shared.file_option("--mjcf", help="MJCF of your own robot (with --urdf)."),
    *FOUND,
)
AS_IS = click.option(
    "--as-is", is_flag=True, help="Add no servos to the MJCF and change no collision shapes."
)
AS_PUBLISHED = (
    AS_IS,
    click.option(
        "--self-check/--no-self-check",
        default=True,
        help="Also simulate the MJCF as published, unedited. [default: on]",
    ),
)
LOAD = tuple(option_of(ROBOT_FIELDS[name]) for name in ("payload", "payload_at"))
SERVOS = (
    click.option(
        "--kp",
        multiple=True,
        metavar="[JOINTS=]NM",
        help=ROBOT_FIELDS["kp"].help,
    ),
    click.option("--kd", multiple=True, metavar="[JOINTS=]NMS", help=ROBOT_FIELDS["kd"].help),
    click.option(
        "--integrator",
        type=click.Choice(["Euler", "implicitfast", "implicit", "RK4"]),
        help="MuJoCo integrator, in place of the model's; e.g. implicitfast.",
    ),
)

LOOK = (shared.look_option, shared.verbose_option)

name_argument = click.argument("name", required=False)


def stance_options(
    *groups: tuple[Callable[[Command], Command], ...],
) -> Callable[[Command], Command]:
    """Returns what gives a command the options of these groups, in this order."""

    def add(command: Command) -> Command:
        for option in reversed([option for group in groups for option in group]):
            command = option(command)
        return command

    return add


@dataclass(frozen=True)
class RobotAndTask:
    """What these options say, as it was given.

    Each field is an option's; ``stance`` has those of the table of what can be asked of a stand.
    """

    urdf: Path | None
    mjcf: Path | None
    feet: tuple[str, ...]
    pairs: tuple[str, ...]
    keyframe: str | None
    packages: tuple[str, ...]
    as_is: bool
    self_check: bool
    base: str | None
    leg_scale: float | None
    torso_mass_scale: float | None
    payload: float
    payload_at: str | None
    stance: Mapping[str, Any]
    kp: tuple[str, ...]
    kd: tuple[str, ...]
    integrator: str | None
    style: str
    everything: bool
    fixed_base: bool = False

    @classmethod
    def of_held(cls, **given: Any) -> RobotAndTask:
        """Returns what the options of a robot alone say of one whose base is fixed."""
        return cls(
            payload=0.0,
            payload_at=None,
            stance={},
            self_check=False,  # which is of feet
            fixed_base=True,
            **given,
        )

    def robot(self, name: str | None) -> Robot:
        """Returns the variant of that name or of a base (v3 by default), or the files' robot."""
        robots = self.robots(() if name is None else (name,), default=("v3",))
        if len(robots) > 1:
            raise ConfigurationError("NAME", diagnose("one-variant-of-two-ways"))
        return robots[0]

    def robots(self, names: tuple[str, ...], *, default: tuple[str, ...]) -> list[Robot]:
        """Returns the variants of these names and of a base, or the robot of the two files."""
        return [self._as_asked(robot) for robot in self._bare(names, default)]

    def _as_asked(self, robot: Robot) -> Robot:
        """Returns a robot with the payload and the integrator that were asked for."""
        from pupper_analysis.robot.payload import with_payload
        from pupper_analysis.robot.servos import with_integrator

        place = to_task_value(ROBOT_FIELDS["payload_at"], self.payload_at) or (0.0, 0.0, 0.0)
        return with_integrator(with_payload(robot, self.payload, place), self.integrator)

    def _bare(self, names: tuple[str, ...], default: tuple[str, ...]) -> list[Robot]:
        """Returns the robots as their files have them."""
        from pupper_analysis.pupper.load import load_variant

        derived = derived_variant(self.base, self.leg_scale, self.torso_mass_scale)
        variants: list[str | VariantSpec] = [*dict.fromkeys(names)]
        if derived is not None:
            variants.append(derived)
        if not self.own:
            fixed = self.fixed_base
            return [load_variant(each, fixed_base=fixed) for each in variants or default]
        if variants:
            raise ConfigurationError("NAME", diagnose("one-robot-of-three-ways"))
        from pupper_analysis.convert.load import load_robot

        given = files_given(
            self.urdf, self.mjcf, self.feet, self.pairs, self.keyframe, self.packages
        )
        with shared.show_progress("preparing the robot: feet, start pose, servos"):
            robot = load_robot(
                **given,
                as_is=self.as_is,
                self_check=self.self_check,
                fixed_base=self.fixed_base,
            )
        if self.style == "text":  # Markdown has them in its document
            print_notes(robot, everything=self.everything)
        return [robot]

    def show(self, result: Result, robot: Robot) -> None:
        """Shows a result of that robot as it was asked for."""
        named = [(robot.name, result)]
        shared.show_results(named, self.style, robots=[robot], everything=self.everything)

    @property
    def own(self) -> bool:
        """Whether the robot is given by files."""
        given = (self.urdf, self.mjcf, self.feet, self.pairs, self.keyframe, self.packages)
        return any(given)

    def gains(self, robot: Robot) -> tuple[ArrayLike | None, ArrayLike | None]:
        """Returns the servos' stiffness and damping at a robot's joints; None: the model's own."""
        return _gain("kp", self.kp, robot), _gain("kd", self.kd, robot)

    def task(self) -> StandTask:
        """Returns the task of the stance."""
        return task_of(self.stance)


def files_given(
    urdf: Path | None,
    mjcf: Path | None,
    feet: tuple[str, ...],
    pairs: tuple[str, ...],
    keyframe: str | None,
    packages: tuple[str, ...],
) -> dict[str, Any]:
    """Returns what ``load_robot`` is given for the robot of two files.

    Raises:
        ConfigurationError: If one of them is not given.
    """
    if urdf is None or mjcf is None:
        raise ConfigurationError("--urdf, --mjcf", diagnose("both-files-needed"))
    named = [foot if "=" in foot else f"{foot}={foot}" for foot in feet]
    frames: dict[str, str | tuple[str, str]] = {}
    for foot, frame in (shared.parse_assignment("foot", text) for text in named):
        link, colon, place = frame.partition(":")
        frames[foot] = (link, place) if colon else frame
    return {
        "urdf": urdf,
        "mjcf": mjcf,
        "feet": frames or None,
        "joints": dict(shared.parse_assignment("map", text) for text in pairs),
        "keyframe": keyframe,
        "packages": {name: str(path) for name, path in shared.package_folders(packages).items()},
    }


def print_notes(robot: Robot, *, everything: bool = False) -> None:
    """Prints what was assumed of a robot of two files, and what its MJCF does by itself."""
    from pupper_analysis.report.documents.standing import assumption_texts
    from pupper_analysis.report.terminal import make_console
    from pupper_analysis.report.terminal import print_notes as print_lines

    print_lines(make_console(), assumption_texts(robot), everything=everything)


def robot_and_task(command: Command) -> Command:
    """Gives a command the options of robot, stance and servos, as one ``RobotAndTask``."""
    own = ("stance", "fixed_base")
    names = [field.name for field in fields(RobotAndTask) if field.name not in own]

    @wraps(command)
    def gathered(**values: Any) -> None:
        stance = {name: values.pop(name) for name in TYPED}
        asked = RobotAndTask(stance=stance, **{name: values.pop(name) for name in names})
        command(asked, **values)

    return stance_options(OWN, AS_PUBLISHED, VARIANT, LOAD, options_of(), SERVOS, LOOK)(gathered)


def derived_variant(
    base: str | None, leg_scale: float | None, torso_mass_scale: float | None
) -> VariantSpec | None:
    """Returns the variant of a base that the options give, or None if they give none."""
    from pupper_analysis.pupper.variants import VariantSpec

    if base is None and leg_scale is None and torso_mass_scale is None:
        return None
    return VariantSpec(
        base="skeleton" if base is None else base,
        leg_scale=1.0 if leg_scale is None else leg_scale,
        torso_mass_scale=1.0 if torso_mass_scale is None else torso_mass_scale,
    )


def _gain(option: str, texts: tuple[str, ...], robot: Robot) -> ArrayLike | None:
    """Returns a gain for all joints, or (nu,) one each; the model's own where none is given."""
    from fnmatch import fnmatchcase

    from pupper_analysis.errors import UnknownNameError
    from pupper_analysis.robot.servos import model_with_servos

    values = [
        shared.parse_number_assignment(option, text if "=" in text else f"*={text}")
        for text in texts
    ]
    if not values:
        return None
    if values[-1][0] == "*":
        return values[-1][1]
    gains = None
    for pattern, value in values:
        chosen = [fnmatchcase(name, pattern) for name in robot.joint_names]
        if not any(chosen):
            unknown = UnknownNameError(robot.name, "joint", pattern, robot.joint_names)
            raise unknown.at(f"--{option}")
        if gains is None:
            gains = (
                [value] * robot.nu
                if all(chosen)
                else list(getattr(model_with_servos(robot), option))
            )
        gains = [value if this else gain for this, gain in zip(chosen, gains, strict=True)]
    return gains
