"""``pupper-analysis fit``: estimate a robot's parameters from measurements."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.base import kinds
from pupper_analysis.base.arguments import find_name_patterns
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    MeasurementError,
    PupperAnalysisError,
)
from pupper_analysis.base.inputs import find_similar_files, path_exists
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_alone, refuse_unused
from pupper_analysis.cli.next_step import complete_command
from pupper_analysis.cli.robots import (
    FILE_OPTIONS,
    VARIANT_OPTIONS,
    RobotOptions,
    add_options,
    check_base_is_free,
    load_selected_robot,
    pass_robot_options,
    print_robot_notes,
    robot_argument,
    write_selected_variant,
)
from pupper_analysis.cli.stance_options import GAIN_OPTIONS, parse_gain
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.present.document import NextStep, Words, diagnostic_text, text
from pupper_analysis.tools.fit.kinds import TRACE_KIND

if TYPE_CHECKING:
    from pupper_analysis.pupper.variants import VariantSpec
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.tools.fit.measurements.log import Log
    from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
    from pupper_analysis.tools.fit.record.listen import TraceRecording
    from pupper_analysis.tools.fit.record.recorder import Recording
    from pupper_analysis.tools.fit.result import Fit
    from pupper_analysis.tools.fit.stands.plan import StandPlan


_SHARED_OPTIONS = {field.name for field in fields(RobotOptions)} | {
    *("words", "output", "priors", "kp", "everything"),
    *("style", "json_path", "report_path", "force"),
}
"""Names of the parameters of ``fit`` that the modes accept, with a few exceptions
(`_MODE_OPTIONS`).
"""
_MODE_OPTIONS = {
    "--record": {*_SHARED_OPTIONS, "record", "bridge"} - {"priors", "kp"},
    "--listen": {*_SHARED_OPTIONS, "listen", "bridge"} - {"priors", "kp"},
    "--stands": {*_SHARED_OPTIONS, "stands", "weight", "anyway"},
    "--log": {*_SHARED_OPTIONS, "anyway", "logs", "hold_out", "kd"},
    "--plan": {*_SHARED_OPTIONS, "count", "added", "added_at"},
}
"""{option that selects a mode: names of the parameters that the mode accepts}."""


@shared.command("fit")
@robot_argument
@shared.file_option("--stands", help="CSV of stands at rest: commands and positions.")
@click.option(
    "--log",
    "logs",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="CSV of motions, the base held: time, positions, commands. Repeatable.",
)
@click.option(
    "--hold-out",
    multiple=True,
    metavar="SHARE|FILE",
    help=(
        "Measurements that are predicted instead of fitted: a fraction at the end of each log "
        "(0.2 by default), or a log of another motion. Repeatable."
    ),
)
@click.option(
    "--plan",
    "count",
    type=int,
    metavar="COUNT",
    help="Choose the most informative stands, and write the plan to -o.",
)
@click.option(
    "--added",
    metavar="MASS",
    help=(
        "Known mass that is added for half of the stands and determines kp. By default 15 % of "
        "the robot's mass; 0kg: none."
    ),
)
@click.option(
    "--added-at",
    metavar="X,Y,Z",
    help=(
        "Position of the known mass in the base frame, or LINK,X,Y,Z in a link frame; by default "
        "on top of the base."
    ),
)
@shared.file_option("--record", help="CSV of a plan: record its stands, each as a row of -o.")
@click.option(
    "--listen",
    type=float,
    metavar="SECONDS",
    help="Record observations and actions of the running policy as a trace for `walk --trace`.",
)
@click.option(
    "--bridge",
    metavar="NAME",
    help=(
        "Connection to the robot: ros2, typed (by a person), or mujoco (simulated, with perturbed "
        "parameters)."
    ),
)
@shared.output_option(
    "-o",
    "--output",
    holds=lambda given: (
        kinds.RECORD_KIND
        if given["record"] is not None
        else TRACE_KIND
        if given["listen"] is not None
        else kinds.FIT_FOLDER
        if given["count"] is None
        else kinds.PLAN_KIND
    ),
    help=(
        "Output: CSV of the plan or of the recorded stands; npz of a trace; or folder of the "
        "corrected URDF and MJCF, fit.json, offsets.csv and samples.csv."
    ),
)
@click.option(
    "--prior",
    "priors",
    multiple=True,
    metavar="KIND[:NAME]=WIDTH",
    help=(
        "Prior standard deviation of a parameter; e.g. mass=20%, com:base_link=5mm, kp=0 (kp is "
        "exact). Repeatable."
    ),
)
@click.option(
    "--anyway",
    is_flag=True,
    help=(
        "Also write a fit that does not explain the measurements; the intervals are widened by "
        "the residuals."
    ),
)
@click.option("--weight", metavar="MASS", help="Mass of the whole robot on a scale; e.g. 3.55kg.")
@add_options(FILE_OPTIONS, VARIANT_OPTIONS, GAIN_OPTIONS)
@shared.verbose_option
@shared.text_format_option
@shared.json_option
@shared.report_option
@pass_robot_options
def command(
    which: RobotOptions,
    words: tuple[str, ...],
    stands: Path | None,
    logs: tuple[Path, ...],
    hold_out: tuple[str, ...],
    count: int | None,
    added: str | None,
    added_at: str | None,
    record: Path | None,
    listen: float | None,
    bridge: str | None,
    output: Path | None,
    priors: tuple[str, ...],
    anyway: bool,
    weight: str | None,
    kp: tuple[str, ...],
    kd: tuple[str, ...],
    everything: bool,
    style: str,
    json_path: Path | None,
    report_path: Path | None,
) -> None:
    """Fit a robot's numbers to measurements: masses, centres of mass, zeros of encoders, kp.

    A soft servo is a torque sensor: tau = kp (command - position). A stand is a pose in which the
    robot is at rest on its feet. A file of stands has a row per reading, with the columns
    command.<joint> and position.<joint> (rad, or [deg] in the header) and swing (feet in the air).
    A log is recorded on a robot that hangs or is bolted down, with the columns time,
    position.<joint> and command.<joint>; friction, damping and armature are fitted, too.

    Every number has an interval. The output states whether the measurements determine the number.

    \b
    Examples:
      pupper-analysis fit v3 --plan 12 -o plan.csv        which stands to take
      pupper-analysis fit v3 --record plan.csv --bridge ros2 -o stands.csv
      pupper-analysis fit v3 --stands stands.csv --weight 3.55kg -o fitted/
      pupper-analysis fit v3 --stands stands.csv --prior kp=0 --report fit.html
      pupper-analysis fit v3 --log hanging.csv --hold-out 0.2
      pupper-analysis fit v3 --listen 20 --bridge ros2 -o trace.npz

    Exit status: 0 the model explains the measurements, or the plan or recording is complete, 1
    otherwise, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.tools.fit.result import Fit

    modes = {
        "--record": record is not None,
        "--listen": listen is not None,
        "--plan": count is not None,
        "--log": bool(logs),
        "--stands": stands is not None,
    }
    mode = _find_mode(modes)
    refuse_unused(mode, _MODE_OPTIONS)
    if output is None:
        refuse_alone(("--output",), "anyway")
    mass = None if weight is None else shared.parse_measure("weight", "mass", weight)
    load = None if added is None else shared.parse_measure("added", "mass", added)
    if load == 0:
        refuse_alone(("--added",), "added_at")
    selection = which.select_robot(words) or "v3"
    robot = load_selected_robot(selection)
    if mode in ("--plan", "--record", "--stands"):
        _check_stands(robot, mode, record, stands, has_kp=bool(kp))
    stiffness, damping = parse_gain("kp", kp, robot), parse_gain("kd", kd, robot)
    result: Fit | StandPlan | Recording | TraceRecording
    if record is not None:
        result = _record_plan(robot, record, output, bridge)
    elif listen is not None:
        result = _record_policy(robot, listen, output, bridge)
    elif count is not None:
        place = None if added_at is None else shared.parse_place("added-at", added_at)
        result = _plan_stands(
            robot, count, output, priors=priors, kp=stiffness, added=load, added_at=place
        )
    else:
        measured, held_out = _read_measurements(stands, logs, hold_out)
        options = {"kp": stiffness, "kd": damping, "weight": mass, "hold_out": held_out}
        result = _fit_measurements(robot, measured, output, priors=priors, **options)
    if style == "text":
        print_robot_notes(robot, everything=everything)
    step = _select_next_step(result, output)
    messages: list[Words] = []
    models: tuple[str, ...] = ()
    try:
        if output is not None and isinstance(result, Fit):
            messages, models = _write_models(robot, selection, result, output, anyway=anyway)
            if models:
                step = NextStep("stand" if robot.floating else "hold", models, robot_typed=False)
    finally:  # the result and its page are made even if the model files cannot be written
        shared.show_results(
            [(robot.name, result)], style, robots=[robot], everything=everything, next_step=step
        )
        for message in messages:
            shared.print_text(message, err=True)
        shared.write_page(report_path, result, [robot])
    if output is not None and (mode == "--plan" or models):
        shared.confirm_written(output)
    passed = getattr(result, "explained", True) and getattr(result, "complete", True)
    shared.finish_command(json_path, result, passed=passed)


def _find_mode(modes: Mapping[str, bool]) -> str:
    """Return the typed option that selects the task of the command.

    Raises:
        ConfigurationError: If no or several such options were typed.
    """
    selected = [name for name, is_selected in modes.items() if is_selected]
    if len(selected) == 1:
        return selected[0]
    refused = ConfigurationError("fit", diagnose("fit-of-nothing"))
    if not selected:
        refused.add_note(complete_command(NextStep("fit", ("--plan", "12", "-o", "plan.csv"))))
    raise refused


def _check_stands(
    robot: Robot, mode: str, record: Path | None, stands: Path | None, *, has_kp: bool
) -> None:
    """Raise an error if the base is fixed, or if a file of stands is missing.

    The error about a fixed base contains the command that fits a log of motions.

    Args:
        robot: Robot that shall stand.
        mode: Typed option, such as ``--plan``.
        record: Plan that shall be recorded.
        stands: File of recorded stands.
        has_kp: Whether kp is typed.
    """

    def propose_log() -> str:
        """Return the command that fits a log of motions."""
        omitted = (*_MEASURING_OPTIONS, "--stands", "--weight")
        return complete_command(NextStep("fit", ("--log", "motion.csv"), omitted=omitted))

    check_base_is_free(robot, "stands-of-fixed-base", propose_log, mode=mode)
    if (planned := record or stands) is not None:
        plan = record or Path("plan.csv")
        _check_planned_file(planned, robot, plan, has_kp=has_kp, recorded=record is None)


def _check_planned_file(
    path: Path, robot: Robot, plan: Path, *, has_kp: bool, recorded: bool
) -> None:
    """Raise an error if a file of stands is missing.

    The error contains the command that records a plan, if stands are missing and a similar file or
    ``plan.csv`` is a plan of this robot; otherwise the command that plans stands. If kp is neither
    typed nor stated by a file, this command contains the kp of the added servos.

    Args:
        path: Plan, or file of recorded stands.
        robot: Robot that shall stand.
        plan: Output of the command that the error prints.
        has_kp: Whether kp is typed.
        recorded: Whether ``path`` is a file of recorded stands.
    """
    if path_exists(path):
        return
    from pupper_analysis.tools.fit.stands.fit import list_joints_without_kp

    needs_kp = not has_kp and bool(list_joints_without_kp(robot))
    alike = [str(file) for file in find_similar_files(path) if _has_column_of(file, robot)]
    default_kp = _describe_default_kp(robot) if needs_kp else None
    files = (*alike, str(plan)) if recorded else ()
    plans = [file for file in files if _is_plan(Path(file), robot)]
    found = bool(alike or plans)
    finding = diagnose(
        "planned-file-missing",
        record=plans[0] if plans else None,
        alike=() if plans else alike,
        plan=(not found and not recorded) or None,
        stands=(not found and recorded) or None,
        kp=(not found and needs_kp and default_kp is None) or None,
        default_kp=None if found else default_kp,
    )
    words: tuple[str, ...] = ("--plan", str(_PROPOSED_STANDS), "-o", str(plan))
    if default_kp is not None:
        words += _write_gain_options(robot, "kp")
    step = NextStep("fit", words, omitted=(*_MEASURING_OPTIONS, "--stands", "--weight"))
    if needs_kp and default_kp is None:
        step = NextStep("gains")
    if plans:
        step = _make_recording_step(plans[0], str(path))
    error = InputError(path, finding)
    error.add_note(complete_command(step))
    raise error


def _list_default_gains(robot: Robot, name: str) -> dict[str, float]:
    """Return the gains that loading a robot has given to joints whose gains no file states.

    Args:
        robot: Robot.
        name: ``kp`` [N m/rad, N/m] or ``kd`` [N m s/rad, N s/m].

    Returns:
        {pattern of joints, "" for all joints: gain}; empty if such a joint has no servo.
    """
    from pupper_analysis.robot.servos import list_position_servos
    from pupper_analysis.tools.fit.stands.fit import list_joints_without_kp

    servos, joints = list_position_servos(robot), list_joints_without_kp(robot)
    if any(joint not in servos for joint in joints):
        return {}
    values = {joint: servos[joint][("kp", "kd").index(name)] for joint in joints}
    gains: dict[str, float] = {}
    for gain in dict.fromkeys(values.values()):
        chosen = [joint for joint in joints if values[joint] == gain]
        for pattern in find_name_patterns(chosen, robot.joint_names):
            gains["" if pattern == "*" else pattern] = gain
    return gains


def _write_gain_options(robot: Robot, name: str) -> tuple[str, ...]:
    """Return the words of ``--kp`` or ``--kd`` with the gains of `_list_default_gains`."""
    gains = _list_default_gains(robot, name)
    texts = (f"{pattern}={gain:.4g}".removeprefix("=") for pattern, gain in gains.items())
    return tuple(word for text in texts for word in (f"--{name}", text))


def _describe_default_kp(robot: Robot) -> str | None:
    """Return the range of the default kp as text, such as ``320`` or ``20 to 320``.

    None if a joint whose kp no file states has no servo.
    """
    values = sorted(_list_default_gains(robot, "kp").values())
    texts = dict.fromkeys(f"{value:.4g}" for value in (*values[:1], *values[-1:]))
    return " to ".join(texts) or None


@contextmanager
def _propose_gains(robot: Robot, output: Path | None, *, is_log: bool = False) -> Iterator[None]:
    """Add a command to an error about unknown servo gains.

    The added command repeats the current command with the gains of the added servos. The user
    replaces these gains by the gains of the controller. Without added servos, the added command is
    `gains`, which prints bounds of kp.

    Args:
        robot: Robot.
        output: Typed output file or folder.
        is_log: Whether motions are fitted, which also requires kd.
    """
    try:
        yield
    except MeasurementError as error:
        if error.cause.code not in ("command-without-kp", "command-without-gains"):
            raise
        default_kp = _describe_default_kp(robot)
        if default_kp is None:
            error.add_note(complete_command(NextStep("gains", omitted=_MEASURING_OPTIONS)))
            raise
        values = {**error.cause.values, "default_kp": default_kp}
        named = MeasurementError(error.source, replace(error.cause, values=values))
        words: tuple[str, ...] = () if output is None else ("-o", str(output))
        for name in ("kp", "kd") if is_log else ("kp",):
            words += _write_gain_options(robot, name)
        named.add_note(complete_command(NextStep("fit", words)))
        raise named from error


def _has_column_of(path: Path, robot: Robot) -> bool:
    """Return True if the first line of a CSV file (commas) names a column of a robot joint."""
    names = _read_column_names(path)
    return any(
        f"{kind}.{joint}" in names
        for kind in ("command", "position")
        for joint in robot.joint_names
    )


def _read_column_names(path: Path) -> set[str]:
    """Return the names in the first line of a CSV file (commas), without units; else nothing."""
    with suppress(OSError, UnicodeError), path.open(encoding="utf-8") as file:
        return {name.partition("[")[0].strip() for name in file.readline().split(",")}
    return set()


def _is_plan(path: Path, robot: Robot) -> bool:
    """Return True if a file contains stands of a robot with commands, but without positions."""
    from pupper_analysis.tools.fit.measurements.stands import read_stands

    if not (path_exists(path) and _has_column_of(path, robot)):
        return False
    with suppress(PupperAnalysisError):
        return _has_only_commands(read_stands(path))
    return False


def _has_only_commands(stands: MeasuredStands) -> bool:
    """Return True if stands contain commands, but no measured positions."""
    import numpy as np

    return bool(np.isfinite(stands.command).any() and not np.isfinite(stands.position).any())


_PROPOSED_STANDS = 6
"""Number of stands in the proposed command that plans stands. Chosen, not tuned."""


def _read_measurements(
    stands: Path | None, logs: tuple[Path, ...], hold_out: tuple[str, ...]
) -> tuple[MeasuredStands | list[Log], float | list[Log] | None]:
    """Return stands or logs, and the held-out part: a share of each run [1], logs, or None."""
    from pupper_analysis.tools.fit.measurements.log import read_log
    from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, read_stands

    for path in logs:
        if not path_exists(path):
            alike = [str(file) for file in find_similar_files(path)]
            error = InputError(path, diagnose("log-file-missing", alike=alike))
            words = ("--log", alike[0]) if alike else ("--help",)
            omitted = ("--log",) if alike else (*_MEASURING_OPTIONS, "--log", "--kp", "--kd")
            error.add_note(complete_command(NextStep("fit", words, omitted=omitted)))
            raise error
        if "stand" in _read_column_names(path):
            swapped = MeasurementError(path, diagnose("log-has-stands"))
            omitted = (*_MEASURING_OPTIONS, "--log", "--kd", "--hold-out")
            swapped.add_note(
                complete_command(NextStep("fit", ("--stands", str(path)), omitted=omitted))
            )
            raise swapped
    measured = list(map(read_log, logs)) if stands is None else read_stands(stands)
    if stands is not None and isinstance(measured, MeasuredStands):
        _check_measured(stands, measured)
    shares = [float(value) for value in hold_out if value.replace(".", "", 1).isdecimal()]
    if shares and len(hold_out) > 1:
        finding = diagnose("hold-out-of-two-kinds", share=shares[0])
        raise ConfigurationError("--hold-out", finding)
    if shares and not shares[0] < 1:
        finding = diagnose("not-between", given=shares[0], low=0, high=1)
        raise ConfigurationError("--hold-out", finding)
    return measured, shares[0] if shares else list(map(read_log, hold_out)) or None


def _check_measured(path: Path, measured: MeasuredStands) -> None:
    """Raise an error if a file of stands has commands only: the plan has not been recorded yet.

    The error contains the command that records the plan.
    """
    if not _has_only_commands(measured):
        return
    error = MeasurementError(path, diagnose("stands-are-planned", count=len(measured)))
    error.add_note(complete_command(_make_recording_step(str(path), "stands.csv")))
    raise error


def _make_recording_step(plan: str, output: str) -> NextStep:
    """Create the next step that records a plan into a file of stands."""
    words = ("--record", plan, "--bridge", "typed", "-o", output)
    omitted = (*_MEASURING_OPTIONS, "--stands", "--weight", "--anyway", "--kp")
    return NextStep("fit", words, omitted=omitted)


_MEASURING_OPTIONS = (
    "--plan",
    "--record",
    "--listen",
    "--bridge",
    "--prior",
    "--added",
    "--added-at",
)
"""Options of the current command that are not repeated in the suggested next command, which refuses
these options, or specifies other values.
"""


def _select_next_step(
    result: Fit | StandPlan | Recording | TraceRecording, output: Path | None
) -> NextStep | None:
    """Return the command to run next, depending on the type of ``result``, or None.

    For example, a plan is followed by a recording of the planned stands. If more stands determine
    many more parameters, a plan without output is followed by a plan of twice as many stands.
    """
    from pupper_analysis.tools.fit.record.listen import TraceRecording
    from pupper_analysis.tools.fit.record.recorder import Recording
    from pupper_analysis.tools.fit.result import Determined
    from pupper_analysis.tools.fit.stands.fit import StandFit
    from pupper_analysis.tools.fit.stands.plan import StandPlan

    if isinstance(result, TraceRecording):
        return NextStep(
            "walk", ("--policy", "policy.json", "--trace", result.file), omitted=_MEASURING_OPTIONS
        )
    if isinstance(result, StandPlan):
        if output is None and result.more_stands_help:
            count = str(2 * len(result.stands))
            return NextStep("fit", ("--plan", count, "-o", "plan.csv"), omitted=("--plan",))
        if output is None:
            return NextStep("fit", ("-o", "plan.csv"))
        words = ("--record", str(output), "--bridge", "typed", "-o", "stands.csv")
        return NextStep("fit", words, omitted=(*_MEASURING_OPTIONS, "--kp"))
    if isinstance(result, Recording):
        if result.missing_stands and (result.recorded_stands or not result.existing_stands):
            return NextStep("fit", ("-o", result.file))
        return NextStep("fit", ("--stands", result.file), omitted=_MEASURING_OPTIONS)
    if not result.explained:
        return NextStep("fit", ("-v",))
    if output is None and isinstance(result, StandFit) and result.weight is None:
        mass = result.total_mass
        if mass.determined is not Determined.DATA:
            return NextStep("fit", ("--weight", f"{mass.stated:.4g}kg"))
    return NextStep("fit", ("-o", "fitted")) if output is None else None


def _plan_stands(robot: Robot, count: int, output: Path | None, **options: Any) -> StandPlan:
    """Choose ``count`` stands to be measured, and write the plan to ``output`` if given."""
    from pupper_analysis.tools.fit.stands.plan import plan_stands, write_plan

    with (
        _propose_gains(robot, output),
        shared.show_progress("choosing stands among those that the servos hold"),
    ):
        plan = plan_stands(robot, count, **options)
    if output is not None:
        write_plan(plan, output)
    return plan


def _fit_measurements(
    robot: Robot, measured: MeasuredStands | list[Log], output: Path | None, **options: Any
) -> Fit:
    """Fit a robot to stands, or to logs of motions, which also require kd.

    ``output`` is repeated in the command that an error about unknown servo gains contains.
    """
    from pupper_analysis.tools.fit.fit import fit

    with (
        _propose_gains(robot, output, is_log=isinstance(measured, list)),
        shared.show_progress("fitting the robot's numbers to the measurements"),
    ):
        return fit(robot, measured, **options)


def _record_plan(robot: Robot, plan: Path, output: Path | None, bridge: str | None) -> Recording:
    """Record the stands of the file ``plan`` with the robot to which ``bridge`` connects."""
    from pupper_analysis.tools.fit.record.bridge import open_bridge
    from pupper_analysis.tools.fit.record.recorder import record_stands

    if bridge is None or output is None:
        option = "--bridge" if bridge is None else "--output"
        raise ConfigurationError(option, diagnose("recording-needs"))
    # A real robot's operator types on the terminal; a simulated robot needs seconds of silence.
    simulated = bridge.partition(":")[0] == "mujoco"
    progress = "recording the stands of a simulated robot"
    with shared.show_progress(progress) if simulated else nullcontext():
        bridge_handle, operator = open_bridge(bridge, robot)
        return record_stands(robot, plan, output, bridge_handle, operator)


def _record_policy(
    robot: Robot, seconds: float, output: Path | None, bridge: str | None
) -> TraceRecording:
    """Record the observations and actions of a policy for ``seconds`` [s], to ``output``."""
    from pupper_analysis.tools.fit.record.listen import record_policy

    if bridge is None or output is None:
        option = "--bridge" if bridge is None else "--output"
        raise ConfigurationError(option, diagnose("listening-needs"))
    with shared.show_progress(text("fit-listening", seconds=f"{seconds:g}")):
        return record_policy(robot, bridge, seconds, output)


def _write_models(
    robot: Robot,
    selection: str | VariantSpec | RobotFiles,
    found: Fit,
    folder: Path,
    *,
    anyway: bool,
) -> tuple[list[Words], tuple[str, ...]]:
    """Write a fit of the selected robot to a folder; return notes, and the paths of the models.

    A fit that does not explain the measurements is written only if ``anyway`` is True, with
    inflated intervals. There are no paths if nothing was written.
    """
    from pupper_analysis.tools.fit.write import write_fit

    posterior, messages = found.posterior, list[Words]()
    if not found.explained and anyway:
        posterior = replace(posterior, covariance=found.noise_inflation**2 * posterior.covariance)
        inflated = diagnose("fit-written-anyway", times=found.noise_inflation)
        messages.append(text("note-line", note=diagnostic_text(inflated)))
    elif not found.explained:
        return [diagnostic_text(diagnose("fit-not-written", folder=str(folder)))], ()
    with write_selected_variant(selection) as files:
        written = write_fit(robot, posterior, folder, fit=found, files=files)
    first_notes = {note.code: note for note in reversed(written.diagnostics)}  # one of each kind
    for note in reversed(first_notes.values()):
        num_similar = sum(similar.code == note.code for similar in written.diagnostics) - 1
        words = diagnostic_text(note)
        if num_similar:
            words = text("and-more-of-this-kind", note=words, count=num_similar)
        messages.append(text("note-line", note=words))
    models = (written.models.urdf, written.models.mjcf)
    return messages, tuple(str(folder / path) for path in models if path is not None)
