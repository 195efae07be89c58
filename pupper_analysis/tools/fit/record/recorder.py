"""Takes planned stands one after the other: ramps to each, waits for rest, averages, asks, writes.

The robot holds what it was commanded last, whenever this ends: at the plan's end, by a key, by a
message that does not come, by a servo that does not follow. A row is in the file before the next
stand begins, and stands that are there are not taken again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, OutputError
from pupper_analysis.base.files import (
    Writing,
    describe_os_error,
    remove_stale_files,
    resolve_target,
    write_all,
)
from pupper_analysis.base.kinds import RECORD_KIND
from pupper_analysis.base.locks import lock_file
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands, read_stands
from pupper_analysis.tools.fit.record.bridge import Bridge, Operator
from pupper_analysis.tools.fit.stands.plan import PlannedStand, compute_com_std

Array = NDArray[np.float64]

MAX_JOINT_SPEED = 0.5
"""rad/s, at most: from one stand of a plan to the next it takes two seconds."""

_TICK = 0.02
"""s between two commands of a ramp."""

_LOST = 0.3
"""s without a position: no message, or a controller that has stopped."""

_BEHIND = 0.5
"""rad: a position that is so far from its command is of a servo that gives nothing."""

_ASKED, _FOLLOWS = 0.25, 0.25
"""A joint that was led so far (rad) and went less than that part of it does not follow."""

_LIVES = 0.6
"""Of its way: a joint that went so far was not only pressed there by another load."""

_STILL, _WINDOW, _PATIENCE = 1e-3, 1.0, 20.0
"""rad within which positions stay over so many seconds, at rest; and how long that may take (s)."""

_EDGE = 0.02
"""Of the stand's height: how far within the carrying feet the com is, at least, by the file."""


@dataclass(frozen=True)
class Recording(Result):
    """What was taken of a plan.

    Attributes:
        name: The robot's name.
        file: Where the rows are.
        taken: Stands that were taken now.
        had: Stands that were in the file before.
        left: Stands that are still to be taken.
        findings: Why stands were left out, or it ended.
    """

    name: str
    file: str
    taken: tuple[str, ...]
    had: tuple[str, ...]
    left: tuple[str, ...]
    findings: tuple[Diagnostic, ...]

    @property
    def complete(self) -> bool:
        """Whether no stand is left."""
        return not self.left


class _EndError(Exception):
    """The recording ends here, and the robot holds.

    Args:
        finding: Why.
        rows: So many of those that were taken now are sound.
    """

    def __init__(self, finding: Diagnostic, rows: int | None = None) -> None:
        super().__init__(finding)
        self.finding, self.rows = finding, rows


class _LeftOutError(_EndError):
    """This stand is not taken; the next may be."""


def record_stands(
    robot: Robot, plan: str | Path, output: str | Path, bridge: Bridge, person: Operator
) -> Recording:
    """Takes the stands of a plan, and adds a row for each to a file.

    Args:
        robot: The robot, as its files have it.
        plan: A file of ``write_plan``.
        output: The file; stands whose names it has are not taken again.
        bridge: The way to the robot.
        person: Who lifts it, and sees which feet carry.

    Raises:
        ConfigurationError: If the file is the plan itself.
        MeasurementError: If a command is beyond a joint's limits, or a stand out of balance, by the
            robot's file: before anything moves; or the file is of another plan.
        OutputError: If it cannot be written, or another recording writes to it.
    """
    path = Path(output)
    if path.exists() and path.samefile(plan):
        raise ConfigurationError("output", diagnose("recording-into-the-plan"))
    with _locked(path):
        return _record_stands(robot, plan, path, bridge, person)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Let no other recording add rows to a file.

    Raises:
        OutputError: If another recording does, or the folder cannot be written to.
    """
    target, _ = resolve_target(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            lock = target.with_name(f".{target.name}.lock")
            if not stack.enter_context(lock_file(lock, temporary=True)):
                raise OutputError(path, diagnose("recording-is-running"))
            held = stack.pop_all()
    except OSError as error:
        raise OutputError(path, describe_os_error(error)) from error
    with held:
        remove_stale_files(target.parent)
        yield


def _record_stands(
    robot: Robot, plan: str | Path, path: Path, bridge: Bridge, person: Operator
) -> Recording:
    """Take the stands of a plan while no other recording writes to the file."""
    planned = read_stands(plan).order_joints(robot)
    margins = list(_check(robot, planned))  # before anything moves
    aside = compute_com_std(robot, ())
    had = _names_in(path, planned)
    rows = [row for row, name in enumerate(planned.names) if planned.names[row] not in had]
    taken: list[str] = []
    sizes: list[int] = []
    findings: list[Diagnostic] = []
    before: PlannedStand | None = None
    session = _Session(robot, bridge, person)
    try:
        for row in rows:
            stand = _stand(planned, row)
            loads = {link: own[row] for link, own in planned.added.items() if own[row, 0]}
            try:
                todo = list(_todo(stand, loads, before))
                if margins[row] < aside:
                    margin, off = Quantity(margins[row], "m"), Quantity(aside, "m")
                    said = diagnose("keep-a-hand-on-it", stand=stand.name, margin=margin, aside=off)
                    todo.append(str(said))
                read, up = session.take(stand, loads, todo, len(taken))
            except _LeftOutError as error:
                findings.append(error.finding)
                continue
            finally:
                before = stand
            sizes.append(_append(path, planned, row, read, up))
            taken.append(stand.name)
    except _EndError as error:
        findings.append(error.finding)
        if doubtful := taken[error.rows :] if error.rows is not None else []:
            findings.append(diagnose("rows-withdrawn", stands=doubtful))
            _cut(path, sizes[len(taken) - len(doubtful)])
            del taken[-len(doubtful) :]
    except KeyboardInterrupt:
        findings.append(diagnose("recording-stopped"))
    finally:
        session.hold()
        bridge.close()
    left = [planned.names[row] for row in rows if planned.names[row] not in taken]
    names = tuple(name for name in planned.names if name in had)
    return Recording(robot.name, str(path), tuple(taken), names, tuple(left), tuple(findings))


class _Session:
    """A robot that is led from stand to stand."""

    def __init__(self, robot: Robot, bridge: Bridge, person: Operator) -> None:
        self._robot, self._bridge, self._person = robot, bridge, person
        self._command: Array | None = None
        self._lived = np.zeros(robot.nu, dtype=int)  # rows there were as a servo last did its work

    def hold(self) -> None:
        """Commands again what was commanded last."""
        if self._command is not None:
            self._bridge.send(self._command)

    def take(
        self, stand: PlannedStand, loads: Mapping[str, Array], todo: Sequence[str], rows: int
    ) -> tuple[Array, Sequence[str]]:
        """Returns positions at rest (nu,), and the feet in the air, after so many rows."""
        target = np.array([stand.command[name] for name in self._robot.joint_names])
        if self._bridge.ramps:
            self._ramp(stand, target, rows)
        else:
            self._bridge.send(target)
        if not self._person.prepare(stand, loads, todo):
            raise _LeftOutError(diagnose("recording-left-out", stand=stand.name))
        read = self._rest(stand) if self._bridge.ramps else self._bridge.read()[1]
        up = self._person.feet_up(tuple(self._robot.feet), stand.swing)
        if up is None:
            raise _LeftOutError(diagnose("recording-left-out", stand=stand.name))
        return read, up

    def _ramp(self, stand: PlannedStand, target: Array, rows: int) -> None:
        if self._command is None:  # where it is, and not where anybody thinks that it is
            self._command = self._positions(stand)
            self._bridge.send(self._command)
            self._rest(stand)  # what it was commanded before, which carried it, is not known
        begin, first = self._command, self._positions(stand)
        steps = max(1, math.ceil(np.abs(target - begin).max() / (MAX_JOINT_SPEED * _TICK)))
        for step in range(1, steps + 1):
            self._command = begin + step / steps * (target - begin)
            self._bridge.send(self._command)
            self._bridge.wait(_TICK)
            self._watch(stand, begin, first)
        asked, moved = target - begin, self._positions(stand) - first
        lives = (np.abs(asked) > _ASKED) & (moved * np.sign(asked) > _LIVES * np.abs(asked))
        self._lived[lives] = rows

    def _watch(self, stand: PlannedStand, begin: Array, first: Array) -> None:
        """Looks whether it may go on: servos follow from where they were, and no key is pressed."""
        assert self._command is not None
        read = self._positions(stand)
        off, asked = np.abs(read - self._command), np.abs(self._command - begin)
        idle = (asked > _ASKED) & (np.abs(read - first) < _FOLLOWS * asked)
        if (idle | (off > _BEHIND)).any():
            joint = int(np.where(idle | (off > _BEHIND), off, 0.0).argmax())
            finding = diagnose(
                "servo-does-not-follow",
                joint=self._robot.joint_names[joint],
                stand=stand.name,
                off=Quantity(float(off[joint]), "rad"),
            )
            raise _EndError(finding, int(self._lived[joint]))
        if self._person.stops():
            raise _EndError(diagnose("recording-stopped"))

    def _positions(self, stand: PlannedStand) -> Array:
        begin = self._bridge.now()
        while True:
            at, read = self._bridge.read()
            if self._bridge.now() - at <= _LOST and np.isfinite(read).all():
                return read
            if self._bridge.now() - begin > _LOST:
                raise _EndError(diagnose("positions-lost", stand=stand.name))
            self._bridge.wait(_TICK)

    def _rest(self, stand: PlannedStand) -> Array:
        """Returns the average of positions (nu,) once they stay."""
        assert self._command is not None
        count = round(_WINDOW / _TICK)
        window: list[Array] = []
        end = self._bridge.now() + _PATIENCE
        while self._bridge.now() < end:
            self._bridge.wait(_TICK)
            window = [*window[-count + 1 :], self._positions(stand)]
            self._watch(stand, self._command, window[-1])
            if len(window) == count and np.ptp(window, axis=0).max() < _STILL:
                return np.asarray(np.mean(window, axis=0))
        moves = int(np.ptp(window, axis=0).argmax())
        joint = self._robot.joint_names[moves]
        raise _LeftOutError(diagnose("stand-does-not-rest", stand=stand.name, joint=joint))


def _todo(
    stand: PlannedStand, loads: Mapping[str, Array], before: PlannedStand | None
) -> Iterator[str]:
    if before is None or before.heading != stand.heading:
        heading = Quantity(stand.heading, "rad")
        yield str(diagnose("turn-the-robot", stand=stand.name, heading=heading))
    if (0.0 if before is None else before.added) != stand.added:
        if not loads:
            yield str(diagnose("take-the-mass-off", stand=stand.name))
        for link, (mass, *place) in loads.items():
            at, much = ", ".join(f"{1e3 * one:.4g}" for one in place), Quantity(mass, "kg")
            yield str(diagnose("put-the-mass-on", stand=stand.name, mass=much, link=link, place=at))
    yield str(diagnose("set-the-robot-down", stand=stand.name, swing=list(stand.swing)))


def _check(robot: Robot, planned: MeasuredStands) -> Iterator[float]:
    """Checks all stands by the robot's file, and yields how far each com is within its feet (m).

    Raises:
        MeasurementError: If one is beyond a limit, or out of balance.
    """
    # What is empty in a plan is nowhere: it is beyond any limit.
    planned.check_limits(robot, np.nan_to_num(planned.command, nan=np.inf))
    for row, name in enumerate(planned.names):
        command, loaded = planned.command[row], robot
        for link, own in planned.added.items():
            mass, *place = own[row].tolist()
            loaded = with_payload(loaded, mass, (link, *place))
        margin = _margin(loaded, command, planned.swing[row])
        if margin < _EDGE * robot.stand_height:
            finding = diagnose("stand-out-of-balance", stand=name, margin=Quantity(margin, "m"))
            raise MeasurementError(planned.source, finding)
        yield margin


def _margin(robot: Robot, command: Array, swing: Sequence[str]) -> float:
    """Returns how far the com is within the feet that carry, of a robot on them (m)."""
    config = Configuration(robot, robot.posed(command))
    points = [p for foot, own in robot.feet.items() if foot not in swing for p in own]
    places = config.foot_places(points)
    plane = np.column_stack([places[:, :2], np.ones(len(points))])
    a, b, _ = np.linalg.lstsq(plane, places[:, 2])[0]
    up = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
    level = pin.Quaternion.FromTwoVectors(up, np.array([0.0, 0.0, 1.0])).matrix()
    at = dict(zip(points, places @ level.T, strict=True))
    return com_margin(level @ config.center_of_mass(), at)


# The file: a row more each time, and never one less.


def _names_in(path: Path, planned: MeasuredStands) -> set[str]:
    """Returns the stands that a file has.

    Raises:
        MeasurementError: If they are not those of the plan.
    """
    if not path.exists():
        return set()
    found = read_stands(path)
    for row in range(len(found)):
        rows = [at for at, name in enumerate(planned.names) if name == found.names[row]]
        same = rows and np.allclose(found.command[row], planned.command[rows[0]], atol=_SAME)
        if found.joints != planned.joints or not same:
            finding = diagnose("recording-of-another-plan", stand=found.names[row])
            raise MeasurementError(str(path), finding)
    return set(found.names)


_SAME = 2e-6
"""rad: what six digits round."""


def _stand(planned: MeasuredStands, row: int) -> PlannedStand:
    added = float(sum(own[row, 0] for own in planned.added.values()))
    command = dict(zip(planned.joints, planned.command[row].tolist(), strict=True))
    turned = float(planned.heading[row])
    return PlannedStand(planned.names[row], planned.swing[row], command, None, turned, added)


def _append(path: Path, planned: MeasuredStands, row: int, read: Array, up: Sequence[str]) -> int:
    """Adds a row: the whole file is written anew beside it, and takes its place at once.

    Returns:
        How long it was before.
    """
    one = replace(planned.select_rows([row]), position=read[None], swing=(tuple(up),))
    there = path.read_bytes() if path.exists() else None
    had = there or b""
    if had and not had.endswith(b"\n"):
        had += b"\n"
    content = had + format_stands(one, header=not had).encode()
    write_all([Writing(path, content, RECORD_KIND, before=there)])
    return len(had)


def _cut(path: Path, size: int) -> None:
    """Takes rows back: what was there before them stays, and a file of nothing goes."""
    if not size:
        path.unlink()
        return
    there = path.read_bytes()
    write_all([Writing(path, there[:size], RECORD_KIND, before=there)])
