"""Record planned stands with a robot: ramp, wait for rest, average and write positions.

Each stand is approached twice: with commands beyond the planned commands, and with commands short
of the planned commands. Dry friction acts with opposite signs in both approaches, and hardly
changes the mean of both positions at rest. Typed positions are read once.

When the recording ends, the last command of a ramp is sent again. Each row is written
before the next stand begins. Stands that are already in the file are not recorded again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, OutputError
from pupper_analysis.base.files import (
    Writing,
    check_writable,
    describe_os_error,
    remove_stale_files,
    resolve_target,
    write_all,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.base.kinds import RECORD_KIND
from pupper_analysis.base.locks import lock_file
from pupper_analysis.base.results import Result
from pupper_analysis.base.runs import current_language
from pupper_analysis.base.units import POSITION_UNIT
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands, read_stands
from pupper_analysis.tools.fit.record.bridge import Bridge, Operator
from pupper_analysis.tools.fit.stands.plan import PlannedStand, compute_com_std

MAX_JOINT_SPEED = 0.5
"""Upper bound of the commanded joint speed [rad/s, m/s] in ramps. With this speed, Pupper v3 moves
from one stand of a plan to the next in a few seconds. Chosen, not tuned.
"""

_COMMAND_INTERVAL = 0.02
"""Time [s] between two commands of a ramp, and between two readings of the positions. Chosen, not
tuned."""

_MAX_POSITION_AGE = 0.3
"""Largest accepted age of a measured position, and longest wait for such a position [s]. Older
positions may be due to lost messages or a stopped controller. Chosen, not tuned.
"""

_MAX_TRACKING_ERROR = 0.5
"""Largest accepted difference [rad, m] between measured position and command. With a larger
difference, for example of a servo without torque, the recording ends. Chosen, not tuned.
"""

_MIN_COMMANDED_TRAVEL = 0.25
"""Lower bound of the commanded travel [rad, m] of a joint from one stand to the next, above which
the response of the joint is checked (`_MIN_TRAVEL_RATIO`). Chosen, not tuned.
"""

_MIN_TRAVEL_RATIO = 0.25
"""Lower bound of (measured travel / commanded travel) of a joint from one stand to the next, below
which the servo does not follow. Positions are compared after the robot was lifted: feet that stick
to the ground can limit the travel of a working joint to 0.1 of the commanded travel. Chosen, not
tuned.
"""

_LIVE_TRAVEL_RATIO = 0.6
"""Lower bound of (measured travel / commanded travel) of a joint whose servo counts as working. If
the servo fails later, the rows recorded since that time are withdrawn. Chosen, not tuned.
"""

_REST_RANGE = 1e-3
"""Upper bound of the range (largest minus smallest value) of each joint position [rad, m] within
`_REST_WINDOW` of a robot at rest. Chosen, not tuned.
"""

_REST_WINDOW = 1.0
"""Duration [s] of the latest measurements of a stand. The range of these measurements decides if
the robot is at rest; the mean is the measured joint position. Chosen, not tuned.
"""

LEAD_RATIOS = (1.3, 0.7)
"""Factors on the lead (planned command minus position at rest) in the two approaches to a stand.
Measured in simulations: if dry friction at rest is 0.65 of its limit, 0.15 of the limit remains in
the mean of both readings.
"""

_RETURN_SECONDS = 2.0
"""Shortest duration [s] of the ramp back to the planned command after an approach (`LEAD_RATIOS`).
Chosen, not tuned.
"""

_REST_TIMEOUT = 20.0
"""Time [s] after which a stand that does not come to rest is skipped. Chosen, not tuned."""

_MIN_COM_MARGIN_RATIO = 0.02
"""Smallest accepted CoM margin of a planned stand, as a fraction of `Robot.stand_height`, with the
masses of the model files and the known masses of the stand. Chosen, not tuned.
"""


@dataclass(frozen=True)
class Recording(Result):
    """Result of recording the stands of a plan with a robot.

    Attributes:
        name: Robot name.
        file: Output file.
        recorded_stands: Names of the stands that were recorded now.
        existing_stands: Names of the stands that were in the file before.
        missing_stands: Names of the stands that are still missing.
        friction_angles: {joint: half the absolute difference of the positions at rest after a
            larger and after a smaller command, median over the stands recorded now [rad, m]}. The
            product with the servo stiffness is an estimate of the dry friction. Empty if positions
            are typed, or no stand was recorded now.
        findings: Reasons for skipped stands, for withdrawn rows, or for an early end of the
            recording.
    """

    name: str
    file: str
    recorded_stands: tuple[str, ...]
    existing_stands: tuple[str, ...]
    missing_stands: tuple[str, ...]
    friction_angles: Mapping[str, float] = field(metadata={"unit": POSITION_UNIT})
    findings: tuple[Diagnostic, ...]

    @property
    def complete(self) -> bool:
        """Whether all stands of the plan are recorded."""
        return not self.missing_stands


class _RecordingEndedError(Exception):
    """Error that ends a recording before the end of the plan, with the reason.

    Args:
        finding: Reason.
        rows: Number of the first rows of this recording that are reliable; None if all rows are.
    """

    def __init__(self, finding: Diagnostic, rows: int | None = None) -> None:
        super().__init__(finding)
        self.finding, self.rows = finding, rows


class _StandSkippedError(_RecordingEndedError):
    """Error that skips a stand without a row in the file; the next stand may be recorded."""


def record_stands(
    robot: Robot, plan: str | Path, output: str | Path, bridge: Bridge, operator: Operator
) -> Recording:
    """Record the stands of a plan: move the robot to each stand, and append a row to a file.

    Args:
        robot: Robot, with the values of the files.
        plan: File of ``write_plan``.
        output: Output file. Stands named in this file are not recorded again.
        bridge: Connection to the robot. Closed at the end of the recording, also after an error.
        operator: Person who lifts the robot and reports the feet in the air.

    Raises:
        ConfigurationError: If the output is the plan itself, the command of a joint without limits
            is missing, or the mass or the place of a known load is invalid.
        MeasurementError: If the plan or the output cannot be read, or cannot be used with this
            robot; for example, a stand is not balanced with the masses of the model.
        OutputError: If the output cannot be written, or another recording writes to the file.
        UnknownNameError: If the plan names a joint, foot or link that the robot lacks.
        ModelError: If the model with a known load cannot be built.
    """
    path = Path(output)
    with closing(bridge):
        if path_exists(path) and path_exists(plan) and path.samefile(plan):
            raise ConfigurationError("output", diagnose("recording-into-the-plan"))
        with _lock_output(path):
            return _record_missing_stands(robot, plan, path, bridge, operator)


@contextmanager
def _lock_output(path: Path) -> Iterator[None]:
    """Lock an output file in a ``with`` block, so that no other recording writes to the file."""
    target, _ = resolve_target(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            lock = target.with_name(f".{target.name}.lock")
            if not stack.enter_context(lock_file(lock, temporary=True)):
                raise OutputError(path, diagnose("recording-is-running"))
            released_stack = stack.pop_all()
    except OSError as error:
        raise OutputError(path, describe_os_error(error)) from error
    with released_stack:
        remove_stale_files(target.parent)
        yield


def _record_missing_stands(
    robot: Robot, plan: str | Path, path: Path, bridge: Bridge, operator: Operator
) -> Recording:
    """Record the stands of the file ``plan`` that the output file ``path`` does not contain yet."""
    planned = read_stands(plan).order_joints(robot)
    check_writable(path, RECORD_KIND)
    margins = list(_check_plan(robot, planned))  # before anything moves
    com_std = compute_com_std(robot, ())
    recorded_names = _read_recorded_names(path, planned)
    rows = [
        row for row, name in enumerate(planned.names) if planned.names[row] not in recorded_names
    ]
    taken: list[str] = []
    sizes: list[int] = []
    findings: list[Diagnostic] = []
    previous: PlannedStand | None = None
    session = _RecordingSession(robot, bridge, operator)
    try:
        for row in rows:
            stand = _make_planned_stand(planned, row)
            loads = {link: load[row] for link, load in planned.added.items() if load[row, 0]}
            try:
                instructions = list(_list_instructions(stand, loads, previous))
                if margins[row] < com_std:
                    margin, deviation = Quantity(margins[row], "m"), Quantity(com_std, "m")
                    warning = diagnose(
                        "keep-a-hand-on-it", stand=stand.name, margin=margin, aside=deviation
                    )
                    instructions.append(_translate_message(warning))
                position, swing = session.take_stand(stand, loads, instructions, len(taken))
            except _StandSkippedError as error:
                findings.append(error.finding)
                continue
            finally:
                previous = stand
            sizes.append(_append_row(path, planned, row, position, swing))
            taken.append(stand.name)
    except _RecordingEndedError as error:
        findings.append(error.finding)
        if unreliable := taken[error.rows :] if error.rows is not None else []:
            findings.append(diagnose("rows-withdrawn", stands=unreliable))
            _truncate_file(path, sizes[len(taken) - len(unreliable)])
            del taken[-len(unreliable) :]
    except KeyboardInterrupt:
        findings.append(diagnose("recording-stopped"))
    finally:
        session.hold_position()
    missing = [planned.names[row] for row in rows if planned.names[row] not in taken]
    names = tuple(name for name in planned.names if name in recorded_names)
    angles = session.compute_friction_angles(len(taken))
    return Recording(
        *(robot.name, str(path), tuple(taken), names, tuple(missing), angles, tuple(findings))
    )


class _RecordingSession:
    """Recording of stands: moves the robot from stand to stand, and reads joint positions at rest.

    Args:
        robot: Robot, with the values of the files.
        bridge: Connection to the robot.
        operator: Person who prepares the robot for each stand.
    """

    def __init__(self, robot: Robot, bridge: Bridge, operator: Operator) -> None:
        self._robot, self._bridge, self._operator = robot, bridge, operator
        self._command: Array | None = None
        # Number of rows that were recorded when each servo last worked (`_LIVE_TRAVEL_RATIO`).
        self._last_live_rows = np.zeros(robot.nu, dtype=int)
        # Half differences of the two readings of each recorded stand, (nu,) [rad, m].
        self._half_differences: list[Array] = []

    def compute_friction_angles(self, num_stands: int) -> FrozenDict[str, float]:
        """Measure the dry friction of each joint as an angle, from the two readings of each stand.

        The result is {joint: median of |half the difference of both readings| [rad, m]} over the
        first ``num_stands`` recorded stands; empty if no stand was read twice.
        """
        differences = self._half_differences[:num_stands]
        if not differences:
            return FrozenDict()
        medians = np.median(np.abs(differences), axis=0).tolist()
        return FrozenDict(zip(self._robot.joint_names, medians, strict=True))

    def hold_position(self) -> None:
        """Let the robot hold its position: send the last commanded joint positions again.

        Nothing is sent if no ramp has begun.
        """
        if self._command is not None:
            self._bridge.send(self._command)

    def take_stand(
        self,
        stand: PlannedStand,
        loads: Mapping[str, Array],
        instructions: Sequence[str],
        rows: int,
    ) -> tuple[Array, Sequence[str]]:
        """Move the robot to a stand, and return joint positions at rest and the feet in the air.

        Args:
            stand: Planned stand.
            loads: {link: mass [kg] and position (x, y, z) [m] of a known load, shape (4,)}.
            instructions: Steps for the operator, as text.
            rows: Number of rows that this recording has written before this stand.

        Returns:
            Joint positions, shape (nu,) [rad, m], in actuator order; names of the feet in the air.

        Raises:
            _StandSkippedError: If the operator skips the stand, or the robot does not come to rest.
            _RecordingEndedError: If the recording cannot continue; for example, a servo does not
                follow.
        """
        target = np.array([stand.command[name] for name in self._robot.joint_names])
        if self._bridge.ramps:
            start, first_position = self._ramp_commands(stand, target)
        else:
            self._bridge.send(target)
        if not self._operator.prepare(stand, loads, instructions):
            raise _StandSkippedError(diagnose("recording-left-out", stand=stand.name, reason=None))
        half_difference: Array | None = None
        if self._bridge.ramps:
            rest = self._average_at_rest(stand)
            self._check_travel(stand, target - start, rest - first_position, rows)
            position, half_difference = self._average_from_both_sides(stand, target, rest)
        else:
            position = self._bridge.read()[1]
        swing = self._operator.feet_up(tuple(self._robot.feet), stand.swing)
        if swing is None or isinstance(swing, Diagnostic):
            raise _StandSkippedError(diagnose("recording-left-out", stand=stand.name, reason=swing))
        if half_difference is not None:
            self._half_differences.append(half_difference)
        return position, swing

    def _check_travel(
        self, stand: PlannedStand, commanded_travel: Array, travel: Array, rows: int
    ) -> None:
        """Check that the joints followed the commands from the previous stand.

        The travels have the shape (nu,) [rad, m]. ``rows``, the number of rows before this stand,
        is stored for servos that worked.
        """
        is_commanded = np.abs(commanded_travel) > _MIN_COMMANDED_TRAVEL
        ratio = np.divide(travel, commanded_travel, out=np.ones(self._robot.nu), where=is_commanded)
        if ratio.min() < _MIN_TRAVEL_RATIO:
            joint = int(ratio.argmin())
            raise self._make_tracking_error(stand, joint, abs(commanded_travel - travel)[joint])
        self._last_live_rows[is_commanded & (ratio > _LIVE_TRAVEL_RATIO)] = rows

    def _make_tracking_error(
        self, stand: PlannedStand, joint: int, error: float
    ) -> _RecordingEndedError:
        """Create the error that ends the recording because a servo does not follow.

        ``error`` is the deviation of the joint [rad, m].
        """
        finding = diagnose(
            "servo-does-not-follow",
            joint=self._robot.joint_names[joint],
            stand=stand.name,
            off=Quantity(float(error), joint_unit(self._robot, self._robot.joint_names[joint])),
        )
        return _RecordingEndedError(finding, int(self._last_live_rows[joint]))

    def _average_from_both_sides(
        self, stand: PlannedStand, target: Array, rest: Array
    ) -> tuple[Array, Array]:
        """Return mean and half difference of the positions after two opposite approaches.

        Each has the shape (nu,) [rad, m], as the commands ``target`` and the positions ``rest`` at
        rest with these commands.
        """
        lower, upper = self._robot.lower_limits, self._robot.upper_limits
        readings = []
        for ratio in LEAD_RATIOS:
            beyond = np.clip(rest + ratio * (target - rest), lower, upper)
            self._move_command(stand, beyond)
            self._move_command(stand, target, _RETURN_SECONDS)
            readings.append(self._average_at_rest(stand))
        first, second = readings
        return (first + second) / 2, (first - second) / 2

    def _ramp_commands(self, stand: PlannedStand, target: Array) -> tuple[Array, Array]:
        """Ramp the command to ``target``; return command and positions before, (nu,) [rad, m]."""
        if self._command is None:  # start at the measured positions
            self._command = self._read_positions(stand)
            self._bridge.send(self._command)
            self._average_at_rest(stand)  # the previous command is unknown
        start, first_position = self._command, self._read_positions(stand)
        self._move_command(stand, target)
        return start, first_position

    def _move_command(self, stand: PlannedStand, target: Array, min_seconds: float = 0.0) -> None:
        """Ramp the command to ``target``, shape (nu,) [rad, m], and check the servos.

        The ramp is limited by `MAX_JOINT_SPEED`, and takes about ``min_seconds`` [s] or longer.
        """
        assert self._command is not None
        start = self._command
        seconds = max(min_seconds, float(np.abs(target - start).max()) / MAX_JOINT_SPEED)
        steps = max(1, math.ceil(seconds / _COMMAND_INTERVAL))
        for step in range(1, steps + 1):
            self._command = start + step / steps * (target - start)
            self._bridge.send(self._command)
            self._bridge.wait(_COMMAND_INTERVAL)
            self._check_tracking(stand)

    def _check_tracking(self, stand: PlannedStand) -> None:
        """Check that the joints are near the commands, and that the operator does not stop."""
        assert self._command is not None
        error = np.abs(self._read_positions(stand) - self._command)
        if error.max() > _MAX_TRACKING_ERROR:
            joint = int(error.argmax())
            raise self._make_tracking_error(stand, joint, error[joint])
        if self._operator.stops():
            raise _RecordingEndedError(diagnose("recording-stopped"))

    def _read_positions(self, stand: PlannedStand) -> Array:
        """Wait for recent joint positions (`_MAX_POSITION_AGE`), shape (nu,) [rad, m]."""
        start = self._bridge.now()
        while True:
            time, position = self._bridge.read()
            if self._bridge.now() - time <= _MAX_POSITION_AGE and np.isfinite(position).all():
                return position
            if self._bridge.now() - start > _MAX_POSITION_AGE:
                raise _RecordingEndedError(diagnose("positions-lost", stand=stand.name))
            self._bridge.wait(_COMMAND_INTERVAL)

    def _average_at_rest(self, stand: PlannedStand) -> Array:
        """Wait until the robot is at rest; return mean joint positions, shape (nu,) [rad, m].

        Raises:
            _StandSkippedError: If the robot is not at rest within `_REST_TIMEOUT`.
        """
        assert self._command is not None
        count = round(_REST_WINDOW / _COMMAND_INTERVAL)
        window: list[Array] = []
        deadline = self._bridge.now() + _REST_TIMEOUT
        while self._bridge.now() < deadline:
            self._bridge.wait(_COMMAND_INTERVAL)
            window = [*window[-count + 1 :], self._read_positions(stand)]
            self._check_tracking(stand)
            if len(window) == count and np.ptp(window, axis=0).max() < _REST_RANGE:
                return np.asarray(np.mean(window, axis=0))
        moving_joint = int(np.ptp(window, axis=0).argmax())
        joint = self._robot.joint_names[moving_joint]
        raise _StandSkippedError(diagnose("stand-does-not-rest", stand=stand.name, joint=joint))


def _translate_message(message: Diagnostic) -> str:
    """Return the text of a message in the language of the command."""
    return message.text(current_language())


def _list_instructions(
    stand: PlannedStand, loads: Mapping[str, Array], previous: PlannedStand | None
) -> Iterator[str]:
    """Yield the instructions for the operator: heading, known masses, feet in the air.

    ``loads`` maps the link of a known mass to the mass [kg] and the position in the link frame [m],
    shape (4,).
    """
    if previous is None or previous.heading != stand.heading:
        heading = Quantity(stand.heading, "rad")
        yield _translate_message(diagnose("turn-the-robot", stand=stand.name, heading=heading))
    if (0.0 if previous is None else previous.added) != stand.added:
        if not loads:
            yield _translate_message(diagnose("take-the-mass-off", stand=stand.name))
        for link, (mass, *position) in loads.items():
            position_text, mass_quantity = (
                ", ".join(f"{1e3 * coordinate:.4g}" for coordinate in position),
                Quantity(mass, "kg"),
            )
            yield _translate_message(
                diagnose(
                    "put-the-mass-on",
                    stand=stand.name,
                    mass=mass_quantity,
                    link=link,
                    place=position_text,
                )
            )
    yield _translate_message(
        diagnose("set-the-robot-down", stand=stand.name, swing=list(stand.swing))
    )


def _check_plan(robot: Robot, planned: MeasuredStands) -> Iterator[float]:
    """Check all stands of a plan with the masses of model and loads; yield the CoM margins [m]."""
    # An empty command is beyond any finite limit.
    planned.check_limits(robot, np.nan_to_num(planned.command, nan=np.inf))
    for row, name in enumerate(planned.names):
        command, loaded = planned.command[row], robot
        for link, load in planned.added.items():
            mass, *position = load[row].tolist()
            loaded = with_payload(loaded, mass, (link, *position))
        margin = _compute_com_margin(loaded, command, planned.swing[row])
        if margin < _MIN_COM_MARGIN_RATIO * robot.stand_height:
            finding = diagnose("stand-out-of-balance", stand=name, margin=Quantity(margin, "m"))
            raise MeasurementError(planned.source, finding)
        yield margin


def _compute_com_margin(robot: Robot, command: Array, swing: Sequence[str]) -> float:
    """Return the CoM margin [m] of a robot with all feet except ``swing`` on level ground.

    The joints are at ``command``, shape (nu,) [rad, m]. The base is rotated such that a plane
    through the centres of the contact points is level.
    """
    config = Configuration(robot, robot.make_qpos(command))
    points = [
        point
        for foot, foot_points in robot.feet.items()
        if foot not in swing
        for point in foot_points
    ]
    positions = config.foot_centres(points)
    plane = np.column_stack([positions[:, :2], np.ones(len(points))])
    a, b, _ = np.linalg.lstsq(plane, positions[:, 2])[0]
    normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
    rotation = pin.Quaternion.FromTwoVectors(normal, np.array([0.0, 0.0, 1.0])).matrix()
    level_positions = dict(zip(points, positions @ rotation.T, strict=True))
    return com_margin(rotation @ config.center_of_mass(), level_positions)


# Output file: one row is appended per stand.


def _read_recorded_names(path: Path, planned: MeasuredStands) -> set[str]:
    """Return the names of the recorded stands in a file; check that the plan contains the stands.

    Raises:
        MeasurementError: If a stand is not in the plan, or has other commands or joints.
    """
    if not path.exists():
        return set()
    recorded = read_stands(path)
    for row in range(len(recorded)):
        rows = [index for index, name in enumerate(planned.names) if name == recorded.names[row]]
        matches = rows and np.allclose(
            recorded.command[row], planned.command[rows[0]], atol=_COMMAND_ATOL
        )
        if recorded.joints != planned.joints or not matches:
            finding = diagnose("recording-of-another-plan", stand=recorded.names[row])
            raise MeasurementError(str(path), finding)
    return set(recorded.names)


_COMMAND_ATOL = 2e-6
"""Absolute tolerance [rad, m] of the difference between recorded and planned commands, in addition
to a relative tolerance of 1e-5. Files contain six decimals. Chosen, not tuned.
"""


def _make_planned_stand(planned: MeasuredStands, row: int) -> PlannedStand:
    """Return the stand in a row of a plan file."""
    added = float(sum(load[row, 0] for load in planned.added.values()))
    command = dict(zip(planned.joints, planned.command[row].tolist(), strict=True))
    heading = float(planned.heading[row])
    return PlannedStand(planned.names[row], planned.swing[row], command, None, heading, added)


def _append_row(
    path: Path, planned: MeasuredStands, row: int, position: Array, swing: Sequence[str]
) -> int:
    """Append a measured stand to a CSV file; the file is replaced atomically.

    ``position`` contains the measured joint positions, shape (nu,) [rad, m]. The result is the
    length of the file before, with a final line end [bytes].
    """
    row_stand = replace(planned.select_rows([row]), position=position[None], swing=(tuple(swing),))
    content_before = path.read_bytes() if path.exists() else None
    existing = content_before or b""
    if existing and not existing.endswith(b"\n"):
        existing += b"\n"
    content = existing + format_stands(row_stand, header=not existing).encode()
    write_all([Writing(path, content, RECORD_KIND, before=content_before)])
    return len(existing)


def _truncate_file(path: Path, size: int) -> None:
    """Truncate a file to a length [bytes]. If the length is 0, delete the file."""
    if not size:
        path.unlink()
        return
    content = path.read_bytes()
    write_all([Writing(path, content[:size], RECORD_KIND, before=content)])
