"""Options of robot, stance and servos, shared by all command-line commands about stances.

The decorators `robot_and_task` and `robot_and_stance` add the options to a command. The command
receives the values of the options as a `RobotAndTask`. This object loads the robot, applies
payload, effort limits and MuJoCo options to the robot, and returns the stand task.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
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
    PREPARING_ROBOT,
    VARIANT_OPTIONS,
    Command,
    RobotOptions,
    add_options,
    check_bases_are_free,
    hide_notes,
    load_selected_robot,
    name_uniquely,
    print_warnings,
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
    from pupper_analysis.models.motors.motor import Motor
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.stance.task import StandTask
    from pupper_analysis.statics.equilibrium import GravityCompensation

AS_IS_OPTION = click.option(
    "--as-is", is_flag=True, help="Add no servos to the MJCF and change no collision shapes."
)
"""Option ``--as-is``: add no servos, and keep the collision shapes. The parameter is ``as_is``."""

PAYLOAD_OPTIONS: tuple[Callable[[Command], Command], ...] = tuple(
    make_option(ROBOT_FIELDS[name]) for name in ("payload", "payload_at")
)
"""Options ``--payload`` and ``--payload-at``: mass [kg] and position of a payload."""

GAIN_OPTIONS = (
    click.option(
        "--kp",
        multiple=True,
        metavar="[JOINTS=]NM",
        help=ROBOT_FIELDS["kp"].help,
    ),
    click.option("--kd", multiple=True, metavar="[JOINTS=]NMS", help=ROBOT_FIELDS["kd"].help),
)
"""Options ``--kp`` and ``--kd``: stiffness and damping of the servos; `parse_gain` reads their
texts."""

SERVO_OPTIONS = (
    *GAIN_OPTIONS,
    click.option(
        "--integrator",
        type=click.Choice(["Euler", "implicitfast", "implicit", "RK4"]),
        help="MuJoCo integrator, instead of the model's; e.g. implicitfast.",
    ),
    click.option(
        "--timestep",
        type=shared.QuantityType("time"),
        help="MuJoCo time step, instead of the model's; e.g. 0.5ms.",
    ),
    click.option(
        "--cone",
        type=click.Choice(["elliptic", "pyramidal"]),
        help="Form of MuJoCo's friction cones, instead of the model's.",
    ),
    click.option(
        "--impratio",
        type=float,
        metavar="X",
        help=(
            "MuJoCo's ratio of friction to normal impedance, instead of the model's; feet creep "
            "less with a larger ratio; e.g. 100."
        ),
    ),
)
"""Options of commands that simulate: servo gains, and MuJoCo's integrator, time step, friction cone
and impratio."""

EFFORT_OPTION = click.option(
    "--effort",
    multiple=True,
    metavar="[JOINTS=]NM",
    help=(
        "Effort limit of the motors of all joints that match a pattern, instead of the limits in "
        "the files (N m; N of a slide); e.g. 3, '*knee*=35'. Repeatable."
    ),
)
"""Option ``--effort``: effort limits of joints; `parse_efforts` reads the texts."""

CONTINUOUS_OPTION = click.option(
    "--continuous",
    multiple=True,
    metavar="[JOINTS=]NM",
    help=(
        "Continuous torque of the motors of all joints that match a pattern (N m), at most their "
        "effort limit; or a motor of `heat --list-motors`, or its file; e.g. 0.4, "
        "'*knee*=12', dephy-actpack. Repeatable."
    ),
)
"""Option ``--continuous``: continuous torques of joints; `parse_continuous_torques` reads the
texts."""

MOTOR_OPTION = click.option(
    "--motor",
    "motors",
    multiple=True,
    metavar="[JOINTS=]MOTOR",
    help=(
        "Motor of all joints, or of the joints that a pattern names: a name of `heat "
        "--list-motors`, or a TOML or JSON file. Torques are compared with the torque-speed region "
        "of the motor, instead of the limits in the files. Repeatable; later options have priority."
    ),
)
"""Option ``--motor``: motors of the joints in a motion; `parse_motors` reads the texts."""

OUTPUT_OPTIONS = (shared.text_format_option, shared.verbose_option)
"""Options for format and extent of the printed output."""


@dataclass(frozen=True)
class RobotAndTask:
    """Values of the command-line options of robot, stance and servos, as typed.

    Methods load the robot and create the stand task from these values. ``which`` contains the
    options that select the robot, ``stance`` the options of the stand task. The command sets
    ``fixed_base``. Each other field is the value of the parameter of this name: ``style`` of
    ``--format``, ``everything`` of ``--verbose``; ``payload`` is in kg, ``timestep`` in s.
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
    def of_fixed_base(cls, **options: Any) -> RobotAndTask:
        """Create the option values for a robot with a fixed base, without stance and payload.

        Args:
            **options: {parameter: value} of the command.
        """
        which = RobotOptions.pop_from(options)
        return cls(
            which=which,
            payload=0.0,
            payload_at=None,
            stance={},
            fixed_base=True,
            **options,
        )

    def robot(
        self, words: tuple[str, ...], *, visuals: bool = True, payload_sought: bool = False
    ) -> Robot:
        """Load the single robot that the user selected, and apply the typed options to the robot.

        Args:
            words: Words that name the robot; without words and options of a robot, v3 is loaded.
            visuals: False if the robot is not drawn: visual meshes are then not converted.
            payload_sought: True if the command computes a payload mass. Then ``--payload-at`` is
                accepted without ``--payload``.

        Raises:
            ConfigurationError: For example if several robots are selected, or an option has no
                effect.
            VariantError: If a word names no robot, or a scale is not valid.
            ModelError: If the robot cannot be loaded from its files.
            UnknownNameError: If an option names a joint or frame that the robot lacks.
        """
        if not self.payload and not payload_sought:
            refuse_alone(("--payload",), "payload_at")
        self._refuse_idle_direction()
        selection = self.which.select_robot(words) or "v3"
        _refuse_file_options([selection])
        return self._load_robot(selection, visuals=visuals)

    def robots(
        self, words: tuple[str, ...], *, default: tuple[str, ...], visuals: bool = True
    ) -> list[Robot]:
        """Load all robots that the user selected, apply the typed options, and make names unique.

        Args:
            words: Words that name the robots.
            visuals: False if the robots are not drawn: visual meshes are then not converted.
            default: Names of variants that are loaded if no robot is selected.

        Raises:
            ConfigurationError: For example if an option is not valid, or has no effect.
            VariantError: If a word names no robot, or a scale is not valid.
            ModelError: If a robot cannot be loaded from its files.
            UnknownNameError: If an option names a joint or frame that a robot lacks.
        """
        if not self.payload:
            refuse_alone(("--payload",), "payload_at")
        self._refuse_idle_direction()
        selections = self.which.select_robots(words) or default
        _refuse_file_options(selections)
        robots = [self._load_robot(selection, visuals=visuals) for selection in selections]
        if len(robots) > 1:
            check_bases_are_free(selections, robots, words)
        return name_uniquely(selections, robots)

    def _refuse_idle_direction(self) -> None:
        """Raise a ConfigurationError if ``--uphill`` was typed for a ground with slope 0."""
        if self.stance and not self.task().ground.slope:
            refuse_alone(("--slope",), "uphill")

    def _load_robot(self, selection: str | VariantSpec | RobotFiles, *, visuals: bool) -> Robot:
        """Load a selected robot, and apply the typed options.

        For text output, warnings about a robot from files are printed at the end of the command.
        """
        robot = load_selected_robot(
            selection, fixed_base=self.fixed_base, as_is=self.as_is, visuals=visuals
        )
        # Markdown output contains the notes.
        prints_notes = isinstance(selection, RobotFiles) and self.style == "text"
        with shared.show_progress(PREPARING_ROBOT):  # postponed steps such as servo tuning
            robot = self._apply_options(robot)
            if prints_notes and not self.everything:
                hide_notes(robot)
        if prints_notes:
            # The result is printed first; an error of the command is printed after the warnings.
            context = click.get_current_context()
            context.call_on_close(partial(print_warnings, robot, everything=self.everything))
        return robot

    def _apply_options(self, robot: Robot) -> Robot:
        """Apply the typed effort limits, payload, MuJoCo options and contacts to a robot.

        A payload is appended to the name of the robot: mass [kg], and position [mm] unless the
        payload is at the origin of the base.
        """
        from pupper_analysis.robot.build import with_efforts
        from pupper_analysis.robot.servos import with_options
        from pupper_analysis.robot.tool import with_payload
        from pupper_analysis.robot.touching import with_contacts

        place = self.place
        robot = with_efforts(robot, parse_efforts(self.effort, robot))
        loaded = with_payload(robot, self.payload, place)
        if self.payload:  # in every title, figure and result
            frame = f"{place[0]} " if isinstance(place[0], str) else ""
            where = ", ".join(f"{1e3 * float(value):.4g}" for value in place[-3:])
            at = f" at {frame}({where}) mm" if frame or any(place) else ""
            loaded = replace(loaded, name=f"{append_payload(loaded.name, self.payload)}{at}")
        loaded = with_options(
            loaded, self.integrator, self.cone, self.impratio, timestep=self.timestep
        )
        return with_contacts(loaded, self.task().contacts) if self.stance else loaded

    @property
    def place(self) -> tuple[str | float, ...]:
        """Position of the payload: (x, y, z) [m] in the base frame, or (frame, x, y, z)."""
        return shared.parse_place("payload-at", self.payload_at or "0,0,0")

    def show(self, result: Result, robot: Robot) -> None:
        """Print a result of the robot in the requested format.

        If the verdict is that the files describe different robots, the first difference to repair
        may be printed, too.
        """
        named = [(robot.name, result)]
        shared.show_results(named, self.style, robots=[robot], everything=self.everything)
        verdict = getattr(result, "verdict", None)
        failures = () if verdict is None else verdict.failures
        two_robots = any(failure.code == "files-of-two-robots" for failure in failures)
        if two_robots and (self.everything or self.style == "markdown"):
            _print_first_difference(robot)

    def gains(self, robot: Robot) -> tuple[ArrayLike | None, ArrayLike | None]:
        """Parse the typed servo gains (``--kp``, ``--kd``): stiffness kp and damping kd.

        Returns:
            kp [N m/rad, N/m] and kd [N m s/rad, N s/m]. Each is a number for all joints, or a list
            in actuator order. None if the option was not typed: the gains of the model apply.

        Raises:
            ConfigurationError: If a typed gain has another form.
            UnknownNameError: If a pattern matches no joint, and the last gain is not for all
                joints.
            ModelError: If a gain of the model is needed, and a joint has no position servo.
        """
        return parse_gain("kp", self.kp, robot), parse_gain("kd", self.kd, robot)

    def task(self) -> StandTask:
        """Return the stand task that the options of the command specify.

        Raises:
            ConfigurationError: If a value is not valid.
        """
        return make_task(self.stance)


def _refuse_file_options(selections: Sequence[str | VariantSpec | RobotFiles]) -> None:
    """Raise a ConfigurationError if ``--as-is`` was typed, and no robot is loaded from files."""
    variants = [selection for selection in selections if not isinstance(selection, RobotFiles)]
    if len(variants) == len(selections):
        names = [
            selection if isinstance(selection, str) else selection.name for selection in variants
        ]
        refuse_idle(", ".join(names), "as_is")


def _print_first_difference(robot: Robot) -> None:
    """Compare a robot's URDF and MJCF, and print the difference to repair first, if possible."""
    from pupper_analysis.base.errors import ModelError
    from pupper_analysis.present.document import diagnostic_text
    from pupper_analysis.present.terminal import make_console
    from pupper_analysis.present.terminal import print_notes as print_lines
    from pupper_analysis.robot.compare.compare import compare_files

    files = robot.description
    try:
        comparison = compare_files(files.urdf_source, files.mjcf_source).result
    except ModelError:
        return  # the files cannot be compared; the verdict is sufficient
    first = diagnose("first-difference-of-files", cause=comparison.main_problem)
    print_lines(make_console(), [diagnostic_text(first)])


def robot_and_task(command: Command) -> Command:
    """Add the options of robot, stance, servos and output to a command-line command.

    Args:
        command: Function that receives a `RobotAndTask`, and the values of further options.
    """
    return _gather_options(command, (*SERVO_OPTIONS, *OUTPUT_OPTIONS))


def robot_and_stance(command: Command) -> Command:
    """Add the options of robot, stance and output to a command-line command without simulation.

    Args:
        command: Function that receives a `RobotAndTask`, and the values of further options.
    """
    return _gather_options(command, OUTPUT_OPTIONS)


def _gather_options(command: Command, more: tuple[Callable[[Command], Command], ...]) -> Command:
    """Add the options of robot and stance to a command-line command, and the options ``more``.

    ``command`` receives the options of robot and stance as a `RobotAndTask`.
    """
    own = ("stance", "which", "fixed_base")
    names = [field.name for field in fields(RobotAndTask) if field.name not in own]

    @wraps(command)
    def wrapped(**values: Any) -> None:
        """Collect the option values in a `RobotAndTask`, and call the command with this object."""
        stance = {name: values.pop(name) for name in OPTION_FIELDS}
        which = RobotOptions.pop_from(values)
        own = {name: values.pop(name) for name in names if name in values}
        options = RobotAndTask(which=which, stance=stance, **own)
        command(options, **values)

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
    return add_options(*groups)(wrapped)


def _parse_assignments(option: str, texts: tuple[str, ...]) -> list[tuple[str, float]]:
    """Parse texts ``[JOINTS=]NUMBER`` of an option into pairs (pattern of joint names, number).

    Without ``JOINTS=``, the pattern is ``*``: all joints.
    """
    return [
        shared.parse_number_assignment(option, text if "=" in text else f"*={text}")
        for text in texts
    ]


def match_joint_pattern(
    option: str, pattern: str, robot: Robot, *, motors: bool = False
) -> list[bool]:
    """Find the joints of a robot that a name or pattern of an option selects.

    Args:
        option: Name of the command-line option, for the error message.
        pattern: Name of a joint, or pattern with the wildcards of ``fnmatch``, such as "leg_*_3";
            case-sensitive.
        robot: Robot.
        motors: True to select joints with a motor only (`find_motor_joints`).

    Returns:
        For each joint in ``robot.joint_names``, True if the pattern selects the joint.

    Raises:
        UnknownNameError: If no joint matches.
    """
    from pupper_analysis.base.errors import UnknownNameError
    from pupper_analysis.robot.joints import find_joints, find_motor_joints

    try:
        selected = (find_motor_joints if motors else find_joints)(robot, pattern)
    except UnknownNameError as error:
        raise error.with_location(f"--{option}") from None
    return [name in selected for name in robot.joint_names]


def parse_efforts(texts: tuple[str, ...], robot: Robot, option: str = "effort") -> dict[str, float]:
    """Parse the texts ``[JOINTS=]NM`` of ``--effort`` into effort limits.

    Args:
        texts: Texts of the option; later texts have priority. Without ``JOINTS=``, the number is
            for all joints with a motor.
        robot: Robot.
        option: Name of the option, for errors.

    Returns:
        {joint: effort limit [N m, of a slide N]}.

    Raises:
        UnknownNameError: If a pattern matches no joint.
        ConfigurationError: If a text is neither a number nor ``PATTERN=NUMBER`` (``*knee*=12``).
    """
    efforts: dict[str, float] = {}
    for pattern, value in _parse_assignments(option, texts):
        matches = match_joint_pattern(option, pattern, robot, motors=True)
        efforts |= {
            name: value
            for name, matches_pattern in zip(robot.joint_names, matches, strict=True)
            if matches_pattern
        }
    return efforts


def parse_motors(texts: tuple[str, ...], robot: Robot, option: str = "motor") -> dict[str, Motor]:
    """Parse the texts ``[JOINTS=]MOTOR`` of ``--motor`` into motors; later texts have priority.

    Args:
        texts: Texts of the option; without ``JOINTS=``, the motor is for all joints. ``MOTOR`` is a
            name or a file.
        robot: Robot.
        option: Name of the option, for errors.

    Returns:
        {joint: motor}.

    Raises:
        UnknownNameError: If a pattern matches no joint, or ``MOTOR`` is no known name, for example.
        ConfigurationError: If a selected joint is a slide.
        ModelError: If the motor's file cannot be read or is not valid.
    """
    from pupper_analysis.base.errors import ConfigurationError
    from pupper_analysis.models.motors.reading import find_motor
    from pupper_analysis.robot.joints import check_motor_joints

    assigned: dict[str, Motor] = {}
    for text in texts:
        pattern, _, name = text.rpartition("=")
        motor = find_motor(name)
        matches = match_joint_pattern(option, pattern or "*", robot, motors=True)
        joints = [name for name, match in zip(robot.joint_names, matches, strict=True) if match]
        try:
            check_motor_joints(robot, joints, option)
        except ConfigurationError as error:
            if option == "motor":
                error.add_note(complete_motor_command(texts, robot))
            raise
        assigned |= dict.fromkeys(joints, motor)
    return assigned


def complete_motor_command(
    texts: tuple[str, ...], robot: Robot, words: tuple[str, ...] = ()
) -> str:
    """Create the running command line with the motors of ``--motor`` at hinges only.

    A rotary motor is refused at a slide. The patterns of the created texts are made from the joint
    names of the robot.

    Args:
        texts: Texts ``[JOINTS=]MOTOR`` of ``--motor``.
        robot: Robot.
        words: Further options of the created command line.
    """
    from pupper_analysis.base.arguments import find_name_patterns
    from pupper_analysis.cli.next_step import complete_command
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.robot.joints import find_motor_joints, is_slide

    motors: list[str] = []
    for text in texts:
        pattern, _, name = text.rpartition("=")
        joints = find_motor_joints(robot, pattern or "*")
        hinges = [joint for joint in joints if not is_slide(robot, joint)]
        if len(hinges) == len(joints):
            motors += ("--motor", text)
            continue
        for hinge_pattern in find_name_patterns(hinges, robot.joint_names) if hinges else ():
            motors += ("--motor", f"{hinge_pattern}={name}")
    if texts and not motors:  # no hinge
        return ""
    command = str(click.get_current_context().command.name)
    return complete_command(NextStep(command, (*motors, *words), omitted=("--motor",)))


def apply_motors(
    texts: tuple[str, ...], robot: Robot, effort: tuple[str, ...]
) -> tuple[Robot, dict[str, Motor]]:
    """Assign the motors of ``--motor`` to joints, and set the effort limits of these joints.

    The effort limit becomes the largest torque of the motor at rest, unless ``--effort`` names the
    joint.

    Args:
        texts: Texts ``[JOINTS=]MOTOR`` of ``--motor``.
        robot: Robot.
        effort: Texts ``[JOINTS=]NM`` of ``--effort``.

    Returns:
        Robot with the limits of the motors; {joint: motor}.

    Raises:
        UnknownNameError: If a pattern matches no joint, or a text names no motor.
        ConfigurationError: If a motor is for a slide, or a text of ``effort`` has another form.
        ModelError: If the motor's file is not valid, or its largest torque is unknown, for example.
    """
    if not texts:
        return robot, {}
    from pupper_analysis.models.motors.assignment import list_motor_efforts
    from pupper_analysis.robot.build import with_efforts

    motors, typed = parse_motors(texts, robot), parse_efforts(effort, robot)
    limits = {
        joint: limit for joint, limit in list_motor_efforts(motors).items() if joint not in typed
    }
    return with_efforts(robot, limits), motors


def append_payload(name: str, mass: float) -> str:
    """Append the mass of a payload [kg] to the name of a robot: ``v3 + 2 kg``."""
    return f"{name} + {mass:.6g} kg"


def parse_continuous_torques(
    texts: tuple[str, ...], robot: Robot
) -> tuple[dict[str, float], dict[str, Motor]]:
    """Parse the texts of ``--continuous`` into the torques that motors can exert permanently.

    A text ``[JOINTS=]MOTOR`` means the continuous torque of the motor
    (`compute_continuous_torque`).

    Args:
        texts: Texts ``[JOINTS=]NM`` or ``[JOINTS=]MOTOR``; later texts have priority.
        robot: Robot.

    Returns:
        {joint: continuous torque [N m, of a slide N]}; {joint: motor} of the joints with the torque
        of a motor.

    Raises:
        UnknownNameError: If a pattern matches no joint, or a text names no motor.
        ConfigurationError: If a text has another form, or names a motor for a slide.
        ModelError: If the motor's file is not valid, or lacks a number, for example.
    """
    from pupper_analysis.models.motors.thermal import compute_continuous_torque

    torques: dict[str, float] = {}
    motors: dict[str, Motor] = {}
    for text in texts:
        if _names_motor(text.rpartition("=")[2]):
            assigned = parse_motors((text,), robot, "continuous")
            motors |= assigned
            torques |= {
                joint: compute_continuous_torque(motor) for joint, motor in assigned.items()
            }
        else:
            typed = parse_efforts((text,), robot, "continuous")
            torques |= typed
            motors = {joint: motor for joint, motor in motors.items() if joint not in typed}
    return torques, motors


def limit_by_peak(robot: Robot, torques: Mapping[str, float]) -> dict[str, float]:
    """Limit continuous torques to the peak torques (effort limits) of a robot.

    Joints whose peak torque is 0 in one direction are left out. An unknown peak torque is no limit.

    Args:
        robot: Robot.
        torques: {joint: continuous torque [N m, of a slide N]}.

    Returns:
        {joint: smaller of continuous and peak torque [N m, of a slide N]}.
    """
    peaks = {limit.joint: limit.symmetric_torque for limit in robot.efforts}
    return {
        joint: min(torque, peaks[joint]) for joint, torque in torques.items() if peaks[joint] > 0
    }


def _names_motor(text: str) -> bool:
    """Return True if a text of ``--continuous`` names a motor instead of a torque."""
    return re.match(r"[\d.+-]|(inf|nan)\b|$", text, re.IGNORECASE) is None


def parse_gain(option: str, texts: tuple[str, ...], robot: Robot) -> ArrayLike | None:
    """Parse the texts ``[JOINTS=]NUMBER`` of ``--kp`` or ``--kd`` into servo gains.

    Later texts have priority. Joints that no text names keep the gain of the model. For kp this
    requires that the servos of these joints are valid in the MJCF, or were missing.

    Args:
        option: ``kp`` (N m/rad; N/m for a slide) or ``kd`` (N m s/rad; N s/m).
        texts: Texts of the option.
        robot: Robot.

    Returns:
        A number for all joints, or a list of length nu in actuator order; None without texts.

    Raises:
        ConfigurationError: If a text has another form.
        UnknownNameError: If a pattern matches no joint, and the last text is not for all joints.
        ModelError: If a gain of the model is needed, and a joint has no position servo; or if a
            stiffness is needed, and the servo of the MJCF has an invalid stiffness.
    """
    from pupper_analysis.robot.servos import model_with_servos

    values = _parse_assignments(option, texts)
    if not values:
        return None
    if values[-1][0] == "*":
        return values[-1][1]
    gains, named = None, set[str]()
    for pattern, value in values:
        matches = match_joint_pattern(option, pattern, robot)
        named |= {name for name, at in zip(robot.joint_names, matches, strict=True) if at}
        if gains is None:
            gains = (
                [value] * robot.nu
                if all(matches)
                else list(getattr(model_with_servos(robot), option))
            )
        gains = [
            value if matches_pattern else gain
            for matches_pattern, gain in zip(matches, gains, strict=True)
        ]
    if option == "kp":
        _refuse_replaced_stiffness(robot, named)
    return gains


def _refuse_replaced_stiffness(robot: Robot, named: Collection[str]) -> None:
    """Raise a ModelError if a joint that is not in ``named`` has an invalid servo in the MJCF."""
    from pupper_analysis.base.errors import ModelError

    for servo in robot.description.made_servos:
        if servo.instead_of.has_invalid_stiffness and servo.joint not in named:
            problem = diagnose("stiffness-of-invalid-servo", subject=("joint", servo.joint))
            raise ModelError(robot.description.mjcf_source, problem)


def draw_requested_stand(
    robot: Robot,
    stand: Stand,
    statics: GravityCompensation,
    path: Path | None,
    result: Result,
    subject: str | None = None,
) -> None:
    """Draw a stand to the file of ``--figure``, and print the path; without a path, do nothing.

    The title contains the verdict of ``result``. ``subject`` replaces the part of the title after
    the name of the robot.
    """
    if path is not None:
        from pupper_analysis.present.documents.registry import make_document
        from pupper_analysis.present.figures.pose import DEFAULT_SUBJECT, write_pose_figure

        verdict = make_document(result).verdict
        subject = subject or DEFAULT_SUBJECT
        write_pose_figure(robot, stand, statics, path, subject=subject, verdict=verdict)
        shared.confirm_written(path)
