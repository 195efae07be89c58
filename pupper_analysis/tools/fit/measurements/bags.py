"""Logs from MCAP files and ROS bags: joint positions and commands, resampled to a common clock.

A bag contains messages of several topics, each with separate times. `read_bag` selects the topics
of joint states and commands. It returns the values of all joints at common times: the sample times
of the joint that is measured most frequently. Positions are interpolated, and commands hold until
the next message.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, MissingPackageError

BAG_SUFFIXES = (".mcap", ".db3", ".bag")
"""File suffixes of MCAP files, of the storage of ROS 2 bags (SQLite) and of ROS 1 bags."""
_MAX_GAP_RATIO = 1.5
"""Largest time between two samples, in units of the median sampling interval, within which
positions are interpolated. In longer gaps the positions are missing. Chosen, not tuned.
"""

_MAX_STEP_BACK = 1.0
"""Largest backward step of time stamps that is accepted [s]. Two publishers cause smaller steps. A
larger step means that the clock was set, and the bag is refused. Chosen, not tuned.
"""

_STATE_TYPE, _ARRAY_TYPE = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
"""ROS message types: joint positions with joint names; commands without names, in a fixed joint
order.
"""

_TRAJECTORY_TYPE = "trajectory_msgs/msg/JointTrajectory"
"""ROS type of messages with commanded joint positions and names."""

_CONTROLLER_TYPE = "control_msgs/msg/JointTrajectoryControllerState"
"""ROS type of messages with measured and commanded joint positions."""

_ROLE_TYPES = {
    "state": (_STATE_TYPE, _CONTROLLER_TYPE),
    "command": (_ARRAY_TYPE, _TRAJECTORY_TYPE, _CONTROLLER_TYPE),
}
"""{role of a topic: message types}. Topics of these types are selected automatically. The role is
``state`` for measured and ``command`` for commanded joint positions. A topic of commands that the
user selects may also have the type `_STATE_TYPE`.
"""

_CONTROLLER_FIELDS = {"state": ("feedback", "actual"), "command": ("reference", "desired")}
"""{role: names of the field with the joint positions in a controller's state message}: the current
name, then the older name. The role is ``state`` (measured) or ``command``."""

MAX_BAG_BYTES: Final = 2_000_000_000
"""Largest accepted size of a file of a bag, packed and unpacked [bytes]. A larger file is refused.
Such files usually contain camera topics, which can be left out. Chosen, not tuned.
"""

MAX_MESSAGE_BYTES: Final = 500_000_000
"""Largest accepted total size of the messages that are read [bytes]. A bag with more is refused.
Chosen, not tuned.
"""


MAX_CHUNK_BYTES: Final = 500_000_000
"""Largest accepted size of an unpacked chunk or message [bytes]. A bag with a larger chunk or
message is refused. Usual chunks have some MB. The bound is necessary since 500 kB of packed zeros
can be unpacked to 2 GB. Chosen, not tuned.
"""


def is_bag(path: Path) -> bool:
    """Return True if a path is an MCAP file, a ROS 1 bag or a ROS 2 bag.

    The suffix decides (`BAG_SUFFIXES`); a folder is a ROS 2 bag if it contains ``metadata.yaml``.
    """
    return path.suffix in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path, topics: Mapping[str, str], joints: Sequence[str]
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Read joint positions and commands from an MCAP file or ROS bag, at common sample times.

    Args:
        path: Bag.
        topics: {role: topic}, chosen by the user. The role is ``state`` (measured positions) or
            ``command``. For a role without an entry, the bag must have a single topic with a
            suitable message type.
        joints: Names of the joints, in order, for messages that contain no joint names.

    Returns:
        Times from the first sample on, shape (n,) [s]. Values {kind: {joint: values, shape (n,)
        [rad, m]}}, with the kinds ``position`` and ``command``; NaN if missing.

    Raises:
        ConfigurationError: If a topic in ``topics`` has an unknown role or an unsuitable type.
        MeasurementError: For example, if the bag cannot be read or is too large, has no joint
            states or no joint names, or the topic of a role is ambiguous.
        MissingPackageError: If rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingPackageError("rosbags", "bags") from error
    try:  # bags before ROS 2 Iron contain no message definitions
        with (
            limit_unpacking(),
            AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            types = {connection.topic: connection.msgtype for connection in reader.connections}
            return _resample_to_common_clock(
                _read_series(reader, _choose_topics(types, topics), joints)
            )
    except ConfigurationError:
        raise
    except MeasurementError as error:
        raise MeasurementError(str(path), error.cause) from error
    except Exception as error:  # readers of damaged files raise any exception
        reason = f"{type(error).__name__}: {error}".replace(str(path), path.name).splitlines()[0]
        raise MeasurementError(str(path), diagnose("no-bag", problem=reason)) from error


# A bag is unpacked within limits: rosbags unpacks each chunk, message or file as a whole.


@contextmanager
def limit_unpacking() -> Iterator[None]:
    """Make rosbags refuse data that are too large when unpacked, within a ``with`` block.

    The decompression functions of rosbags are replaced while the block runs.

    Raises:
        MeasurementError: In the block, if a chunk or message exceeds ``MAX_CHUNK_BYTES``, or if a
            file exceeds ``MAX_BAG_BYTES``.
    """
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2_module
    from rosbags.rosbag2 import storage_mcap as mcap

    ros2: Any = ros2_module
    zstd = ros2.zstd  # of Python, or its backport
    unpack_lz4 = limit_decompressor(LZ4FrameDecompressor)
    unpack_bz2 = limit_decompressor(bz2.BZ2Decompressor)
    unpack_zstd = limit_decompressor(zstd.ZstdDecompressor)

    class LimitedZstd:
        """Functions of the module ``zstd`` that rosbags uses."""

        decompress = staticmethod(unpack_zstd)

        @staticmethod
        @contextmanager
        def open(file: IO[bytes], mode: str) -> Iterator[_LimitedFile]:
            with zstd.open(file, mode) as unpacked:
                yield _LimitedFile(unpacked)

    tables: tuple[dict[str, Any], ...] = (ros1.decompressors, mcap.DECOMPRESSORS)
    before = [dict(table) for table in tables]
    tables[0].update({"bz2": unpack_bz2, "lz4": unpack_lz4})
    tables[1].update(
        {"lz4": lambda data, _: unpack_lz4(data), "zstd": lambda data, _: unpack_zstd(data)}
    )
    ros2.zstd = LimitedZstd
    try:
        yield
    finally:
        for table, own in zip(tables, before, strict=True):
            table.update(own)
        ros2.zstd = zstd


def limit_decompressor(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Create a function that unpacks packed data frame by frame, up to ``MAX_CHUNK_BYTES``.

    The returned function raises a MeasurementError if the unpacked data are larger than
    ``MAX_CHUNK_BYTES``, and a ValueError if a frame is incomplete.

    Args:
        decompressor: Function that creates an object for the unpacking of a single frame.
    """

    def unpack(data: bytes) -> bytes:
        """Unpack a chunk of frames; raise an error if the chunk is too large or incomplete."""
        parts, size = [], 0
        while data:
            frame = decompressor()
            part = frame.decompress(data, MAX_CHUNK_BYTES + 1 - size)
            size += len(part)
            _check_unpacked_size(size, MAX_CHUNK_BYTES)
            if not frame.eof:
                raise ValueError("a chunk ends in the midst of a frame")
            parts.append(part)
            data = frame.unused_data or b""
        return b"".join(parts)

    return unpack


class _LimitedFile:
    """Unpacked file; reading more than `MAX_BAG_BYTES` bytes raises a MeasurementError."""

    def __init__(self, file: Any) -> None:
        self._file, self._size = file, 0

    def read(self, size: int) -> bytes:
        """Return up to ``size`` further bytes of the unpacked file.

        Raises:
            MeasurementError: If more than `MAX_BAG_BYTES` bytes are read in total.
        """
        data: bytes = self._file.read(size)
        self._size += len(data)
        _check_unpacked_size(self._size, MAX_BAG_BYTES)
        return data


def _check_unpacked_size(size: int, maximum: int) -> None:
    """Raise a MeasurementError if a size [bytes] exceeds ``maximum`` [bytes]."""
    if size > maximum:
        raise MeasurementError("", diagnose("bag-too-large", most=maximum / 1e6))


def _choose_topics(types: Mapping[str, str], requested: Mapping[str, str]) -> dict[str, str]:
    """Choose the topic for each role: the requested topic, or the only topic with a suitable type.

    The result is {role: topic}. The role is ``state`` (measured positions) or ``command``. If the
    bag has no topic of commands, ``command`` is left out. For ``state``, a ``JointState`` topic is
    preferred to the state topic of a controller, which may be late. This does not apply to a topic
    that is selected for ``command``.

    Args:
        types: {topic of the bag: message type}.
        requested: {role: topic} as typed by the user.

    Raises:
        ConfigurationError: If a requested role is unknown, or a requested topic is missing or has
            an unsuitable type.
        MeasurementError: If several topics fit a role, or no topic fits ``state``.
    """
    topics: dict[str, str] = {}
    listing = tuple(f"{name} ({kind})" for name, kind in sorted(types.items()))
    if wrong := [role for role in requested if role not in _ROLE_TYPES]:
        raise ConfigurationError("topic", diagnose("topic-without-role", role=wrong[0]))
    for role, kinds in _ROLE_TYPES.items():
        matching = [topic for topic in types if types[topic] in kinds]
        if role in requested:
            # Commands may be published as JointState as well.
            if types.get(requested[role]) not in (*kinds, _STATE_TYPE):
                named = requested[role]
                finding = diagnose("topic-of-another-kind", topic=named, role=role, topics=listing)
                raise ConfigurationError("topic", finding)
            matching = [requested[role]]
        elif role == "state":
            states = [topic for topic in matching if types[topic] == _STATE_TYPE]
            states = [topic for topic in states if topic != requested.get("command")]
            matching = states or [topic for topic in matching if types[topic] != _STATE_TYPE]
        if len(matching) > 1:
            raise MeasurementError("", diagnose("topics-of-one-kind", role=role, topics=matching))
        topics |= dict.fromkeys([role], matching[0]) if matching else {}
    if "state" not in topics:
        raise MeasurementError("", diagnose("bag-without-states", topics=listing))
    return topics


def _read_series(reader: Any, chosen: Mapping[str, str], joints: Sequence[str]) -> dict[Any, Array]:
    """Read the samples of each joint from the messages of a bag: {(kind, joint): shape (n, 3)}.

    The kind is ``position`` (measured) or ``command``. The columns are recording time [s], header
    time [s] and value [rad, m]. The header time is NaN if missing.

    Args:
        reader: Reader of the bag, already open.
        chosen: {role: topic}, with the roles of `_ROLE_TYPES`.
        joints: Joint names of messages without names.

    Raises:
        MeasurementError: If the total size of the messages exceeds `MAX_MESSAGE_BYTES`. If a
            message has no joint names, or the numbers of positions and names differ. If a
            trajectory does not have a single point.
    """
    series: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    used = chosen.values()
    connections = [connection for connection in reader.connections if connection.topic in used]
    size = 0
    for connection, recorded, raw in reader.messages(connections=connections):
        size += len(raw)
        if size > MAX_MESSAGE_BYTES:
            raise MeasurementError("", diagnose("bag-too-large", most=MAX_MESSAGE_BYTES / 1e6))
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)  # nsec in ROS 1
        nanoseconds = 0 if stamp is None else getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        moment = (stamp.sec + 1e-9 * nanoseconds if stamp else 0.0) or np.nan
        own_names = getattr(message, "name", getattr(message, "joint_names", ()))
        names = own_names if len(own_names) else joints  # a JointState may have empty names
        if not len(names):
            error = diagnose("joints-not-named", topic=connection.topic, type=connection.msgtype)
            raise MeasurementError("", error)
        for role in [role for role, topic in chosen.items() if topic == connection.topic]:
            values = _get_message_positions(message, connection, role)
            if len(values) not in (0, len(names)):
                error = diagnose("message-of-other-joints", topic=connection.topic)
                raise MeasurementError("", error)
            kind = "command" if role == "command" else "position"
            for joint, value in zip(names, values, strict=False):
                row = (1e-9 * recorded, moment, float(value))
                series.setdefault((kind, joint), []).append(row)
    return {key: np.array(rows) for key, rows in series.items()}


def _get_message_positions(message: Any, connection: Any, role: str) -> Sequence[float]:
    """Return the joint positions of a ROS message [rad, m], in the joint order of the message.

    Args:
        message: Decoded message.
        connection: Connection of the bag's reader, with topic and type of the message.
        role: ``state`` for measured, ``command`` for commanded positions. The role only selects
            the field of a controller's state; the result is empty if this field has no positions.

    Raises:
        MeasurementError: If a trajectory does not have a single point.
    """
    if connection.msgtype == _STATE_TYPE:
        return message.position  # type: ignore[no-any-return]
    if connection.msgtype == _ARRAY_TYPE:
        return message.data  # type: ignore[no-any-return]
    if connection.msgtype == _TRAJECTORY_TYPE:
        if len(message.points) != 1:
            raise MeasurementError("", diagnose("trajectory-of-points", topic=connection.topic))
        return message.points[0].positions  # type: ignore[no-any-return]
    fields = [name for name in _CONTROLLER_FIELDS[role] if hasattr(message, name)]
    return next((found for name in fields if len(found := getattr(message, name).positions)), ())


def _resample_to_common_clock(
    series: dict[Any, Array],
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Return sample times of the most frequently measured joint, and all values at these times.

    Times start at 0, shape (n,) [s]. Values are {kind: {joint: shape (n,) [rad, m]}}; NaN if
    missing. Positions are interpolated, and commands hold until the next message. ``series`` is the
    result of `_read_series`.

    Raises:
        MeasurementError: If there are no positions, or time stamps go back by more than
            `_MAX_STEP_BACK`.
    """
    time_column = 1 if all(np.isfinite(rows[:, 1]).all() for rows in series.values()) else 0
    samples: dict[Any, tuple[Array, Array]] = {}
    for (kind, joint), rows in series.items():
        step_back = -float(np.diff(rows[:, time_column]).min(initial=0.0))
        if step_back > _MAX_STEP_BACK:
            error = diagnose(
                "stamps-go-back", kind=kind, joint=joint, back=Quantity(step_back, "s")
            )
            raise MeasurementError("", error)
        moments, first = np.unique(rows[:, time_column], return_index=True)
        samples[kind, joint] = moments, rows[first, 2]
    clocks = [moments for (kind, _), (moments, _) in samples.items() if kind == "position"]
    if not clocks:
        raise MeasurementError("", diagnose("column-missing", column="position.<joint>"))
    clock = max(clocks, key=len)
    resampled: dict[str, dict[str, Array]] = {"position": {}, "command": {}}
    for (kind, joint), (moments, values) in samples.items():
        next_index = np.searchsorted(moments, clock, side="right")
        if kind == "command":  # a command holds until the next
            resampled[kind][joint] = np.where(next_index > 0, values[next_index - 1], np.nan)
            continue
        gaps = np.diff(moments, prepend=-np.inf, append=np.inf)[next_index]
        is_close = (
            gaps <= _MAX_GAP_RATIO * np.median(np.diff(moments)) if len(moments) > 1 else False
        )
        is_close |= np.isin(clock, moments)
        resampled[kind][joint] = np.where(is_close, np.interp(clock, moments, values), np.nan)
    return clock - clock[0], resampled
