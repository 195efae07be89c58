"""Which robot, and how it shall stand: the options that all commands about stances share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_idle
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    Command,
    RobotOptions,
    add_options,
    load_selected_robot,
    name_uniquely,
    print_notes,
)
from pupper_analysis.cli.stance_fields import (
    OPTION_FIELDS,
    make_option,
    make_options,
    make_task,
    stance_option,
)
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.stance.fields import ROBOT_FIELDS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pupper_analysis.base.results import Result
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.stance.task import StandTask
    from pupper_analysis.statics.equilibrium import GravityCompensation

AS_IS_OPTION = click.option(
    "--as-is", is_flag=True, help="Add no servos to the MJCF and change no collision shapes."
)
PAYLOAD_OPTIONS: tuple[Callable[[Command], Command], ...] = tuple(
    make_option(ROBOT_FIELDS[name]) for name in ("payload", "payload_at")
)
GAIN_OPTIONS = (
    click.option(
        "--kp",
        multiple=True,
        metavar="[JOINTS=]NM",
        help=ROBOT_FIELDS["kp"].help,
    ),
    click.option("--kd", multiple=True, metavar="[JOINTS=]NMS", help=ROBOT_FIELDS["kd"].help),
)
SERVO_OPTIONS = (
    *GAIN_OPTIONS,
    click.option(
        "--integrator",
        type=click.Choice(["Euler", "implicitfast", "implicit", "RK4"]),
        help="MuJoCo integrator, in place of the model's; e.g. implicitfast.",
    ),
    click.option(
        "--timestep",
        type=shared.QuantityType("time"),
        help="MuJoCo time step, in place of the model's; e.g. 0.5ms.",
    ),
    click.option(
        "--cone",
        type=click.Choice(["elliptic", "pyramidal"]),
        help="Form of MuJoCo's friction cones, in place of the model's.",
    ),
    click.option(
        "--impratio",
        type=float,
        metavar="X",
        help="How much stiffer MuJoCo's friction is than its ground, in place of the model's: "
        "feet creep the less; e.g. 100.",
    ),
)

EFFORT_OPTION = click.option(
    "--effort",
    multiple=True,
    metavar="[JOINTS=]NM",
    help="What the motors of all joints that match a pattern can give, in place of what the files "
    "state (N m; N of a slide); e.g. 3, '*knee*=35'. Repeatable.",
)

OUTPUT_OPTIONS = (shared.text_format_option, shared.verbose_option)


@dataclass(frozen=True)
class RobotAndTask:
    """What these options say, as it was given.

    Each field is an option's; ``stance`` has those of the table of what can be asked of a stand.
    """

    which: RobotOptions
    as_is: bool
    payload: float
    payload_at: str | None
    stance: Mapping[str, Any]
    style: str
    everything: bool
    effort: tuple[str, ...] = ()
    kp: tuple[str, ...] = ()
    kd: tuple[str, ...] = ()
    integrator: str | None = None
    timestep: float | None = None
    cone: str | None = None
    impratio: float | None = None
    fixed_base: bool = False

    @classmethod
    def of_fixed_base(cls, **given: Any) -> RobotAndTask:
        """Returns what the options of a robot alone say of one whose base is fixed."""
        which = RobotOptions.taken_from(given)
        return cls(
            which=which,
            payload=0.0,
            payload_at=None,
            stance={},
            fixed_base=True,
            **given,
        )

    def robot(self, words: tuple[str, ...], *, payload_sought: bool = False) -> Robot:
        """Returns the robot that is meant; v3 by default.

        Args:
            words: What names it.
            payload_sought: Whether the command seeks a payload, which has a place without a mass.
        """
        if not self.payload and not payload_sought:
            refuse_alone(("--payload",), "payload_at")
        meant = self.which.select_robot(words) or "v3"
        _refuse_idle([meant])
        return self._loaded(meant)

    def robots(self, words: tuple[str, ...], *, default: tuple[str, ...]) -> list[Robot]:
        """Returns the robots that are meant, by names of their own."""
        if not self.payload:
            refuse_alone(("--payload",), "payload_at")
        meant = self.which.select_robots(words) or default
        _refuse_idle(meant)
        return name_uniquely(meant, [self._loaded(one) for one in meant])

    def _loaded(self, meant: str | VariantSpec | RobotFiles) -> Robot:
        """Returns a robot as it was asked for; of one of files its notes follow the answer."""
        robot = self._as_asked(
            load_selected_robot(meant, fixed_base=self.fixed_base, as_is=self.as_is)
        )
        if isinstance(meant, RobotFiles) and self.style == "text":  # Markdown has them in its page
            # After the answer, or the refusal: what is read first is what was asked.
            context = click.get_current_context()
            context.call_on_close(partial(print_notes, robot, everything=self.everything))
        return robot

    def _as_asked(self, robot: Robot) -> Robot:
        """Returns a robot with efforts, payload and options of MuJoCo as they were asked for."""
        from pupper_analysis.robot.build import with_efforts
        from pupper_analysis.robot.servos import with_options
        from pupper_analysis.robot.tool import with_payload
        from pupper_analysis.robot.touching import touching

        place = self.place
        robot = with_efforts(robot, parse_efforts(self.effort, robot))
        loaded = with_payload(robot, self.payload, place)
        if self.payload:  # in every title, figure and result
            frame = f"{place[0]} " if isinstance(place[0], str) else ""
            where = ", ".join(f"{1e3 * float(value):.4g}" for value in place[-3:])
            name = f"{loaded.name} + {self.payload:.6g} kg at {frame}({where}) mm"
            loaded = replace(loaded, name=name)
        loaded = with_options(
            loaded, self.integrator, self.cone, self.impratio, timestep=self.timestep
        )
        return touching(loaded, self.task().contacts) if self.stance else loaded

    @property
    def place(self) -> tuple[str | float, ...]:
        """Where the payload is: (x, y, z) in the base frame, or with a frame before it (m)."""
        return shared.parse_place("payload-at", self.payload_at or "0,0,0")

    def show(self, result: Result, robot: Robot) -> None:
        """Shows a result of that robot as it was asked for."""
        named = [(robot.name, result)]
        shared.show_results(named, self.style, robots=[robot], everything=self.everything)
        verdict = getattr(result, "verdict", None)
        failures = () if verdict is None else verdict.failures
        if any(failure.code == "files-of-two-robots" for failure in failures):
            _print_first_difference(robot)

    def gains(self, robot: Robot) -> tuple[ArrayLike | None, ArrayLike | None]:
        """Returns the servos' stiffness and damping at a robot's joints; None: the model's own."""
        return parse_gain("kp", self.kp, robot), parse_gain("kd", self.kd, robot)

    def task(self) -> StandTask:
        """Returns the task of the stance."""
        return make_task(self.stance)


def _refuse_idle(meant: Sequence[str | VariantSpec | RobotFiles]) -> None:
    """Refuses what is for robots of files, where there is none."""
    variants = [one for one in meant if not isinstance(one, RobotFiles)]
    if len(variants) == len(meant):
        names = [one if isinstance(one, str) else one.name for one in variants]
        refuse_idle(", ".join(names), "as_is")


def _print_first_difference(robot: Robot) -> None:
    """Prints what makes a robot's files those of two robots, as far as one thing does."""
    from pupper_analysis.base.errors import ModelError
    from pupper_analysis.present.document import diagnostic_text
    from pupper_analysis.present.terminal import make_console
    from pupper_analysis.present.terminal import print_notes as print_lines
    from pupper_analysis.robot.compare.compare import compare_files

    files = robot.description
    try:
        comparison = compare_files(files.urdf_source, files.mjcf_source).result
    except ModelError:
        return  # they are not comparable as they are; the verdict has said enough
    first = diagnose("first-difference-of-files", cause=comparison.first_to_mend)
    print_lines(make_console(), [diagnostic_text(first)])


def robot_and_task(command: Command) -> Command:
    """Gives a command the options of robot, stance and servos, as one ``RobotAndTask``."""
    return _gathered(command, (*SERVO_OPTIONS, *OUTPUT_OPTIONS))


def robot_and_stance(command: Command) -> Command:
    """Gives a command those of robot and stance alone: of one that simulates nothing."""
    return _gathered(command, OUTPUT_OPTIONS)


def _gathered(command: Command, more: tuple[Callable[[Command], Command], ...]) -> Command:
    own = ("stance", "which", "fixed_base")
    names = [one.name for one in fields(RobotAndTask) if one.name not in own]

    @wraps(command)
    def gathered(**values: Any) -> None:
        stance = {name: values.pop(name) for name in OPTION_FIELDS}
        which = RobotOptions.taken_from(values)
        own = {name: values.pop(name) for name in names if name in values}
        asked = RobotAndTask(which=which, stance=stance, **own)
        command(asked, **values)

    groups = (
        FILE_OPTIONS,
        (AS_IS_OPTION,),
        VARIANT_OPTIONS,
        (stance_option,),
        PAYLOAD_OPTIONS,
        (EFFORT_OPTION,),
        make_options(),
        more,
    )
    return add_options(*groups)(gathered)


def _assigned(option: str, texts: tuple[str, ...]) -> list[tuple[str, float]]:
    """Returns (pattern of joints, number) of each [JOINTS=]NUMBER."""
    return [
        shared.parse_number_assignment(option, text if "=" in text else f"*={text}")
        for text in texts
    ]


def _matching(option: str, pattern: str, robot: Robot) -> list[bool]:
    """Returns of each joint whether a pattern is its name's; refuses one of none."""
    from fnmatch import fnmatchcase

    from pupper_analysis.base.errors import UnknownNameError

    chosen = [fnmatchcase(name, pattern) for name in robot.joint_names]
    if not any(chosen):
        unknown = UnknownNameError(robot.name, "joint", pattern, robot.joint_names)
        raise unknown.at(f"--{option}")
    return chosen


def parse_efforts(texts: tuple[str, ...], robot: Robot, option: str = "effort") -> dict[str, float]:
    """Returns {joint: its motor's limit} (N m) of what was typed for ``--effort``, or another."""
    efforts: dict[str, float] = {}
    for pattern, value in _assigned(option, texts):
        chosen = _matching(option, pattern, robot)
        efforts |= {
            name: value for name, this in zip(robot.joint_names, chosen, strict=True) if this
        }
    return efforts


def parse_gain(option: str, texts: tuple[str, ...], robot: Robot) -> ArrayLike | None:
    """Returns a gain for all joints, or (nu,) one each; the model's own where none is given."""
    from pupper_analysis.robot.servos import model_with_servos

    values = _assigned(option, texts)
    if not values:
        return None
    if values[-1][0] == "*":
        return values[-1][1]
    gains = None
    for pattern, value in values:
        chosen = _matching(option, pattern, robot)
        if gains is None:
            gains = (
                [value] * robot.nu
                if all(chosen)
                else list(getattr(model_with_servos(robot), option))
            )
        gains = [value if this else gain for this, gain in zip(chosen, gains, strict=True)]
    return gains


def draw_stand(robot: Robot, stand: Stand, statics: GravityCompensation, path: Path | None) -> None:
    """Draws a stand, if there is a file to draw it into."""
    if path is not None:
        from pupper_analysis.present.figures.pose import write_pose_figure

        write_pose_figure(robot, stand, statics, path)
        shared.confirm_written(path)
