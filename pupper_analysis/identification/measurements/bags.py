"""Logs in MCAP files and ROS bags: what drivers and controllers publish, on one clock."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Quantity, diagnose
from pupper_analysis.errors import ConfigurationError, MeasurementError, MissingPackageError

Array = NDArray[np.float64]

SUFFIXES = (".mcap", ".db3", ".bag")
"""Of files that are bags; a folder is one with its ``metadata.yaml``."""

ROLES = ("state", "command")
"""What a topic may be: what joints do, or what they are asked for."""

_GAP = 1.5
"""Median intervals of a series: beyond, something is missing, and nothing is put between."""

_BACK = 1.0
"""s: stamps that go back by less are those of two publishers; by more, of a clock that was set."""

_KINDS = ("position", "velocity", "torque", "command")


@dataclass(frozen=True)
class _Reading:
    """What a message says: {kind of number: {joint: value}}, and when by its own header (s)."""

    values: Mapping[str, Mapping[str, float]]
    stamp: float | None = None


@dataclass(frozen=True)
class _MessageType:
    """How messages of a type are read.

    Attributes:
        roles: What they tell.
        read: Called with a message, and the names of joints that were given.
        named: Whether they name their joints.
    """

    roles: tuple[str, ...]
    read: Callable[[Any, Sequence[str]], _Reading]
    named: bool = True


def is_bag(path: Path) -> bool:
    """Says whether a path is one of a bag: an MCAP, a ROS 1 or a ROS 2 bag."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path, topics: Mapping[str, str], joints: Sequence[str]
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Reads what joints did, and were asked for, from a bag.

    States are ``sensor_msgs/JointState`` (position, velocity, effort), the feedback of a
    ``control_msgs/JointTrajectoryControllerState``, or Unitree's ``LowState``; commands the
    reference of such a controller, a ``trajectory_msgs/JointTrajectory`` of single points, a
    ``std_msgs/Float64MultiArray``, or ``LowCmd``. Topics are found by their types.

    Moments are those of the messages' headers, or if one topic has none, those at which all were
    recorded. They are those of the joint that is told most often: numbers of others are put between
    theirs, but not where one of these is missing, and a command holds until the next.

    Args:
        path: The bag.
        topics: {``"state"`` or ``"command"``: the topic}, where there are several.
        joints: Names of what has none in messages: of arrays, and of Unitree's motors.

    Returns:
        Moments (n,) from the first on (s), and {kind: {joint: (n,)}}, of positions (rad, m),
        velocities, torques and commands; NaN where there is none.

    Raises:
        ConfigurationError: If a topic is asked for that is none, or none of that role.
        MeasurementError: If it cannot be read, or tells nothing of joints.
        MissingPackageError: If rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingPackageError("rosbags", "bags") from error
    for role in topics:
        if role not in ROLES:
            raise ConfigurationError("topic", diagnose("topic-without-role", role=role))
    try:
        # Bags of Humble and before hold no definitions.
        known = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=known) as reader:
            chosen = _choose(str(path), reader.connections, topics)
            return _on_one_clock(str(path), list(_series(reader, chosen, str(path), joints)))
    except MeasurementError:
        raise
    except (AnyReaderError, OSError) as error:
        problem = str(error).replace(str(path), path.name).splitlines()[0]
        raise MeasurementError(str(path), diagnose("no-bag", problem=problem)) from error
    except Exception as error:  # of damaged files readers raise whatever they come upon
        if isinstance(error, ConfigurationError):
            raise
        problem = f"{type(error).__name__}: {error}".splitlines()[0]
        raise MeasurementError(str(path), diagnose("no-bag", problem=problem)) from error


def _choose(
    source: str, connections: Sequence[Any], wanted: Mapping[str, str]
) -> dict[str, tuple[str, ...]]:
    """Returns which topics are read, and for which roles.

    Raises:
        ConfigurationError: If one is asked for that is none of the role.
        MeasurementError: If several could be, or none tells a state.
    """
    types = {one.topic: one.msgtype for one in connections}
    chosen: dict[str, list[str]] = defaultdict(list)
    for role in ROLES:
        able = [topic for topic, kind in types.items() if role in _roles(kind)]
        if role in wanted:
            topic = wanted[role]
            # A state of joints may be one that is asked for.
            if topic not in able and not (role == "command" and types.get(topic) == _STATE):
                found = tuple(f"{name} ({kind})" for name, kind in sorted(types.items()))
                told = diagnose("topic-of-another-kind", topic=topic, role=role, topics=found)
                raise ConfigurationError("topic", told)
            able = [topic]
        if role == "state":
            able = [topic for topic in able if topic != wanted.get("command")]
            plain = [topic for topic in able if types[topic] == _STATE]
            able = plain or able  # drivers tell efforts, too
        if len(able) > 1:
            raise MeasurementError(source, diagnose("topics-of-one-kind", role=role, topics=able))
        for topic in able:
            chosen[topic].append(role)
    if not any("state" in roles for roles in chosen.values()):
        found = tuple(f"{name} ({kind})" for name, kind in sorted(types.items()))
        raise MeasurementError(source, diagnose("bag-without-states", topics=found))
    return {topic: tuple(roles) for topic, roles in chosen.items()}


def _roles(kind: str) -> tuple[str, ...]:
    return _TYPES[kind].roles if kind in _TYPES else ()


@dataclass(eq=False)
class _Series:
    """What a topic tells of a joint.

    Attributes:
        kind: Of number.
        joint: Whose.
        recorded: When each was recorded (s).
        stamps: When it was, by its header (s); NaN if it has none.
        values: Each.
    """

    kind: str
    joint: str
    recorded: list[float] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


def _series(
    reader: Any, chosen: Mapping[str, tuple[str, ...]], source: str, joints: Sequence[str]
) -> Iterator[_Series]:
    """Yields what chosen topics tell, of each joint.

    Raises:
        MeasurementError: If a message names no joints, and none are given.
    """
    found: dict[tuple[str, str], _Series] = {}
    connections = [one for one in reader.connections if one.topic in chosen]
    for connection, moment, raw in reader.messages(connections=connections):
        roles, kind = chosen[connection.topic], _TYPES[connection.msgtype]
        if not kind.named and not joints:
            told = diagnose("joints-not-named", topic=connection.topic, type=connection.msgtype)
            raise MeasurementError(source, told)
        try:
            reading = kind.read(reader.deserialize(raw, connection.msgtype), joints)
        except _MessageError as error:
            told = diagnose(
                "trajectory-of-points" if error.points else "message-of-other-joints",
                topic=connection.topic,
            )
            raise MeasurementError(source, told) from error
        for what, by_joint in reading.values.items():
            if ("command" if what == "command" else "state") not in roles:
                if connection.msgtype != _STATE or what != "position" or "command" not in roles:
                    continue
                what = "command"  # a state that is asked for
            for joint, value in by_joint.items():
                one = found.setdefault((what, joint), _Series(what, joint))
                one.recorded.append(1e-9 * moment)
                one.stamps.append(math.nan if reading.stamp is None else reading.stamp)
                one.values.append(value)
    yield from found.values()


def _on_one_clock(
    source: str, series: Sequence[_Series]
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Returns moments of the joint that is told most often, and all at those.

    Raises:
        MeasurementError: If there are none, or the clock was set back.
    """
    stamped = all(np.isfinite(one.stamps).all() for one in series)
    told = [
        (one, *_rising(source, one, np.array(one.stamps if stamped else one.recorded)))
        for one in series
        if one.kind != "torque" or np.nan_to_num(one.values).any()  # else there is no sensor
    ]
    positions = [moments for one, moments, _ in told if one.kind == "position"]
    if not positions:
        raise MeasurementError(source, diagnose("column-missing", column="position.<joint>"))
    clock = max(positions, key=len)
    found: dict[str, dict[str, Array]] = {kind: {} for kind in _KINDS}
    for one, moments, values in told:
        put = _held if one.kind == "command" else _between
        found[one.kind][one.joint] = put(clock, moments, values)
    return clock - clock[0], found


def _rising(source: str, one: _Series, moments: Array) -> tuple[Array, Array]:
    """Returns moments that rise, and the numbers then; what was told again is left out.

    Raises:
        MeasurementError: If the clock was set back.
    """
    back = -float(np.diff(moments).min(initial=0.0))
    if back > _BACK:
        told = diagnose("stamps-go-back", kind=one.kind, joint=one.joint, back=Quantity(back, "s"))
        raise MeasurementError(source, told)
    rising, first = np.unique(moments, return_index=True)
    return rising, np.array(one.values)[first]


def _between(clock: Array, moments: Array, values: Array) -> Array:
    """Returns numbers on a clock, on lines between those that are near each other in time."""
    if len(moments) < 2:
        return np.where(np.isin(clock, moments), values[0], np.nan)
    after = np.clip(np.searchsorted(moments, clock), 1, len(moments) - 1)
    steps = np.diff(moments)
    near = steps[after - 1] <= _GAP * np.median(steps)
    inside = (clock >= moments[0]) & (clock <= moments[-1])
    exact = np.isin(clock, moments)
    return np.where(inside & (near | exact), np.interp(clock, moments, values), np.nan)


def _held(clock: Array, moments: Array, values: Array) -> Array:
    """Returns commands on a clock: each holds until the next."""
    before = np.searchsorted(moments, clock, side="right") - 1
    return np.where(before >= 0, values[np.maximum(before, 0)], np.nan)


# --- what messages say -----------------------------------------------------------------------


class _MessageError(Exception):
    """A message has other numbers than joints, or ``points`` of a whole trajectory."""

    def __init__(self, *, points: bool = False) -> None:
        self.points = points
        super().__init__()


def _stamp(message: Any) -> float | None:
    """Returns when a message's header says that it was (s); None if it says nothing."""
    stamp = message.header.stamp
    nanoseconds = getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))  # of ROS 2, of ROS 1
    moment = float(stamp.sec) + 1e-9 * float(nanoseconds)
    return moment if moment > 0 else None


def _named(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Returns {joint: value}; an empty list says nothing.

    Raises:
        _MessageError: If there are more or fewer than names.
    """
    if len(values) == 0:
        return {}
    if len(values) != len(names):
        raise _MessageError
    return {str(name): float(value) for name, value in zip(names, values, strict=True)}


def _joint_state(message: Any, _: Sequence[str]) -> _Reading:
    kinds = {
        "position": message.position,
        "velocity": message.velocity,
        "torque": message.effort,
    }
    values = {kind: _named(message.name, found) for kind, found in kinds.items()}
    return _Reading(values, _stamp(message))


def _controller_state(message: Any, _: Sequence[str]) -> _Reading:
    asked, does = _point(message, "reference", "desired"), _point(message, "feedback", "actual")
    kinds = {
        "command": asked.positions,
        "position": does.positions,
        "velocity": does.velocities,
        "torque": getattr(does, "effort", ()),
    }
    values = {kind: _named(message.joint_names, found) for kind, found in kinds.items()}
    return _Reading(values, _stamp(message))


def _point(message: Any, name: str, before: str) -> Any:
    """Returns a point that ROS 2 has renamed: for a time messages had both, and one was empty."""
    found = getattr(message, name, None)
    older = getattr(message, before, None)
    return older if found is None or (older is not None and not len(found.positions)) else found


def _trajectory(message: Any, _: Sequence[str]) -> _Reading:
    if len(message.points) != 1:
        raise _MessageError(points=True)
    (point,) = message.points
    return _Reading({"command": _named(message.joint_names, point.positions)}, _stamp(message))


def _array(message: Any, joints: Sequence[str]) -> _Reading:
    return _Reading({"command": _named(joints, message.data)})


def _low_state(message: Any, joints: Sequence[str]) -> _Reading:
    motors = message.motor_state[: len(joints)]  # of 20, those that are there
    kinds = {"position": "q", "velocity": "dq", "torque": "tau_est"}
    return _Reading(
        {
            kind: _named(joints, [getattr(motor, name) for motor in motors])
            for kind, name in kinds.items()
        }
    )


def _low_command(message: Any, joints: Sequence[str]) -> _Reading:
    motors = message.motor_cmd[: len(joints)]
    return _Reading({"command": _named(joints, [motor.q for motor in motors])})


_STATE = "sensor_msgs/msg/JointState"

_TYPES: Mapping[str, _MessageType] = {
    _STATE: _MessageType(("state",), _joint_state),
    "control_msgs/msg/JointTrajectoryControllerState": _MessageType(ROLES, _controller_state),
    "trajectory_msgs/msg/JointTrajectory": _MessageType(("command",), _trajectory),
    "std_msgs/msg/Float64MultiArray": _MessageType(("command",), _array, named=False),
    **{
        f"{package}/msg/{name}": kind
        for package in ("unitree_go", "unitree_hg")
        for name, kind in {
            "LowState": _MessageType(("state",), _low_state, named=False),
            "LowCmd": _MessageType(("command",), _low_command, named=False),
        }.items()
    },
}
"""{type of message: how it is read}."""
