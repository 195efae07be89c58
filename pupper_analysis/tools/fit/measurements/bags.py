"""Logs in MCAP files and ROS bags: positions and commands that were published, on one clock."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, MissingPackageError

Array = NDArray[np.float64]
SUFFIXES = (".mcap", ".db3", ".bag")
_GAP = 1.5  # median intervals: beyond, samples are missing, and nothing is put between
_BACK = 1.0  # s: stamps go back by less with two publishers; by more, where a clock was set
_KINDS = {"state": ("position", "velocity"), "command": ("command",)}
_STATE = "sensor_msgs/msg/JointState"
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
_PATH, _ARRAY = "trajectory_msgs/msg/JointTrajectory", "std_msgs/msg/Float64MultiArray"
_ROLES = {_STATE: "state", _CONTROLLER: "state command", _PATH: "command", _ARRAY: "command"}


def is_bag(path: Path) -> bool:
    """Says whether a path is one of a bag: an MCAP, a ROS 1 or a ROS 2 bag."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path, topics: Mapping[str, str], joints: Sequence[str]
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Reads what joints did, and were asked for, from a bag; ``read_log`` says how.

    Returns:
        Moments (n,) from the first on (s), and {kind: {joint: (n,)}} (rad, m; rad/s); NaN of none.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingPackageError("rosbags", "bags") from error
    try:  # bags of Humble and before hold no definitions
        with (
            bounded_unpacking(),
            AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            types = {one.topic: one.msgtype for one in reader.connections}
            return _on_one_clock(_series(reader, _choose(types, topics), joints))
    except ConfigurationError:
        raise
    except MeasurementError as error:
        raise MeasurementError(str(path), error.cause) from error
    except Exception as error:  # of damaged files readers raise whatever they come upon
        finding = f"{type(error).__name__}: {error}".replace(str(path), path.name).splitlines()[0]
        raise MeasurementError(str(path), diagnose("no-bag", problem=finding)) from error


def _choose(types: Mapping[str, str], wanted: Mapping[str, str]) -> dict[str, str]:
    """Returns {role: topic}: the only one of its kind, or the one that is wanted."""
    found: dict[str, str] = {}
    shown = tuple(f"{name} ({kind})" for name, kind in sorted(types.items()))
    if wrong := [role for role in wanted if role not in _KINDS]:
        raise ConfigurationError("topic", diagnose("topic-without-role", role=wrong[0]))
    for role in _KINDS:
        able = [one for one, kind in types.items() if role in _ROLES.get(kind, "")]
        if role == "state":  # a driver's before a controller's, which may be late
            able = [one for one in able if one != wanted.get("command")]
            able = [one for one in able if types[one] == _STATE] or able
        if role in wanted:
            # A state of joints may be one that is asked for.
            if wanted[role] not in able and types.get(wanted[role]) != _STATE:
                finding = diagnose(
                    "topic-of-another-kind", topic=wanted[role], role=role, topics=shown
                )
                raise ConfigurationError("topic", finding)
            able = [wanted[role]]
        if len(able) > 1:
            raise MeasurementError("", diagnose("topics-of-one-kind", role=role, topics=able))
        found |= dict.fromkeys([role], able[0]) if able else {}
    if "state" not in found:
        raise MeasurementError("", diagnose("bag-without-states", topics=shown))
    return found


def _series(reader: Any, chosen: Mapping[str, str], joints: Sequence[str]) -> dict[Any, Array]:
    """Returns {(kind, joint): (n, 3) when recorded, when by its header (s), and the number}."""
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    connections = [one for one in reader.connections if one.topic in chosen.values()]
    size = 0
    for one, recorded, raw in reader.messages(connections=connections):
        size += len(raw)
        check_size(size, MOST_CHUNK)
        message = reader.deserialize(raw, one.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)  # nsec is ROS 1's
        nano = 0 if stamp is None else getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        moment = (stamp.sec + 1e-9 * nano if stamp else 0.0) or np.nan
        names = getattr(message, "name", getattr(message, "joint_names", joints))
        if one.msgtype == _ARRAY and not len(names):
            finding = diagnose("joints-not-named", topic=one.topic, type=one.msgtype)
            raise MeasurementError("", finding)
        for kind in [kind for role in chosen if chosen[role] == one.topic for kind in _KINDS[role]]:
            values = _values(message, one, kind)
            if len(values) not in (0, len(names)):
                raise MeasurementError("", diagnose("message-of-other-joints", topic=one.topic))
            for joint, value in zip(names, values, strict=False):
                row = (1e-9 * recorded, moment, float(value))
                found.setdefault((kind, joint), []).append(row)
    return {key: np.array(rows) for key, rows in found.items()}


def _values(message: Any, connection: Any, kind: str) -> Sequence[float]:
    """Returns a message's numbers of a kind, of each joint; none if it has none."""
    if connection.msgtype == _ARRAY:
        return message.data  # type: ignore[no-any-return]
    if connection.msgtype == _STATE:
        return message.velocity if kind == "velocity" else message.position  # type: ignore[no-any-return]
    if connection.msgtype == _PATH:
        if len(message.points) != 1:
            raise MeasurementError("", diagnose("trajectory-of-points", topic=connection.topic))
        return message.points[0].positions  # type: ignore[no-any-return]
    names = ("reference", "desired") if kind == "command" else ("feedback", "actual")
    points = [getattr(message, name) for name in names if hasattr(message, name)]
    field = "velocities" if kind == "velocity" else "positions"
    return next((found for one in points if len(found := getattr(one, field))), ())


def _on_one_clock(series: dict[Any, Array]) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Returns moments of the joint whose position is there most often, and all at those."""
    at = 1 if all(np.isfinite(rows[:, 1]).all() for rows in series.values()) else 0
    finding: dict[Any, tuple[Array, Array]] = {}
    for (kind, joint), rows in series.items():
        back = -float(np.diff(rows[:, at]).min(initial=0.0))
        if back > _BACK:
            went = diagnose("stamps-go-back", kind=kind, joint=joint, back=Quantity(back, "s"))
            raise MeasurementError("", went)
        moments, first = np.unique(rows[:, at], return_index=True)
        finding[kind, joint] = moments, rows[first, 2]
    clocks = [moments for (kind, _), (moments, _) in finding.items() if kind == "position"]
    if not clocks:
        raise MeasurementError("", diagnose("column-missing", column="position.<joint>"))
    clock = max(clocks, key=len)
    found: dict[str, dict[str, Array]] = {"position": {}, "velocity": {}, "command": {}}
    for (kind, joint), (moments, values) in finding.items():
        after = np.searchsorted(moments, clock, side="right")
        if kind == "command":  # holds until the next
            found[kind][joint] = np.where(after > 0, values[after - 1], np.nan)
            continue
        steps = np.diff(moments, prepend=-np.inf, append=np.inf)[after]
        near = steps <= _GAP * np.median(np.diff(moments)) if len(moments) > 1 else False
        near |= np.isin(clock, moments)
        found[kind][joint] = np.where(near, np.interp(clock, moments, values), np.nan)
    return clock - clock[0], found


# Bags are unpacked within limits: rosbags unpacks each chunk, message or file as a whole.

MOST_CHUNK: Final = 500_000_000
"""Bytes of a chunk or a message, unpacked. Writers make chunks of some MB; 500 kB of zeros, packed,
are 2 GB."""

MOST_FILE: Final = 2_000_000_000
"""Bytes of a file of a bag, packed or unpacked: larger ones have cameras' topics, which can be left
out."""


@contextmanager
def bounded_unpacking() -> Iterator[None]:
    """Has rosbags refuse, while the block runs, what is larger than the limits when unpacked.

    Raises:
        MeasurementError: If something is.
    """
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader
    from rosbags.rosbag2 import storage_mcap as mcap

    ros2: Any = reader

    zstd = ros2.zstd  # of Python, or its backport
    lz4, bzip = _bounded(LZ4FrameDecompressor), _bounded(bz2.BZ2Decompressor)
    standard = _bounded(zstd.ZstdDecompressor)

    class Zstd:
        """What is used of zstd, bounded."""

        decompress = staticmethod(standard)

        @staticmethod
        @contextmanager
        def open(file: IO[bytes], mode: str) -> Iterator[_Counted]:
            with zstd.open(file, mode) as unpacked:
                yield _Counted(unpacked)

    tables: tuple[dict[str, Any], ...] = (ros1.decompressors, mcap.DECOMPRESSORS)
    before = [dict(table) for table in tables]
    tables[0].update({"bz2": bzip, "lz4": lz4})
    tables[1].update({"lz4": lambda data, _: lz4(data), "zstd": lambda data, _: standard(data)})
    ros2.zstd = Zstd
    try:
        yield
    finally:
        for table, own in zip(tables, before, strict=True):
            table.update(own)
        ros2.zstd = zstd


def check_size(size: int, most: int) -> None:
    """Refuses what is larger.

    Raises:
        MeasurementError: If it is.
    """
    if size > most:
        raise MeasurementError("", diagnose("bag-too-large", most=most / 1e6))


def _bounded(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Returns what unpacks a chunk, frame by frame, and no more of it than the limit."""

    def unpack(data: bytes) -> bytes:
        parts, size = [], 0
        while data:
            frame = decompressor()
            part = frame.decompress(data, MOST_CHUNK + 1 - size)
            size += len(part)
            check_size(size, MOST_CHUNK)
            if not frame.eof:
                raise ValueError("a chunk ends in the midst of a frame")
            parts.append(part)
            data = frame.unused_data or b""
        return b"".join(parts)

    return unpack


class _Counted:
    """A file that is read up to the limit."""

    def __init__(self, file: Any) -> None:
        self._file, self._size = file, 0

    def read(self, size: int) -> bytes:
        """Returns the next bytes."""
        data: bytes = self._file.read(size)
        self._size += len(data)
        check_size(self._size, MOST_FILE)
        return data
