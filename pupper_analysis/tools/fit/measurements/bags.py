"""Logs in MCAP files and ROS bags: positions and commands that were published, on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, MissingPackageError

Array = NDArray[np.float64]
BAG_SUFFIXES = (".mcap", ".db3", ".bag")
_GAP = 1.5  # median intervals: beyond, samples are missing, and nothing is put between
_BACK = 1.0  # s: stamps go back by less with two publishers; by more, where a clock was set
_STATE, _ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
_ROLES = {"state": _STATE, "command": _ARRAY}
MAX_BAG_BYTES: Final = 2_000_000_000
"""Bytes of a file of a bag: larger ones have cameras' topics, which can be left out."""

MAX_MESSAGE_BYTES: Final = 500_000_000
"""Bytes of messages that are read."""


def is_bag(path: Path) -> bool:
    """Says whether a path is one of a bag: an MCAP, a ROS 1 or a ROS 2 bag."""
    return path.suffix in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path, topics: Mapping[str, str], joints: Sequence[str]
) -> tuple[Array, dict[str, dict[str, Array]]]:
    """Reads what joints did, and were asked for, from a bag; ``read_log`` says how.

    Returns:
        Moments (n,) from the first on (s), and {kind: {joint: (n,)}} (rad, m); NaN of none.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingPackageError("rosbags", "bags") from error
    try:  # bags of Humble and before hold no definitions
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
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
    if wrong := [role for role in wanted if role not in _ROLES]:
        raise ConfigurationError("topic", diagnose("topic-without-role", role=wrong[0]))
    for role, kind in _ROLES.items():
        able = [one for one in types if types[one] == kind]
        if role in wanted:
            # A state of joints may be one that is asked for.
            if types.get(wanted[role]) not in (kind, _STATE):
                named = wanted[role]
                finding = diagnose("topic-of-another-kind", topic=named, role=role, topics=shown)
                raise ConfigurationError("topic", finding)
            able = [wanted[role]]
        elif role == "state":
            able = [one for one in able if one != wanted.get("command")]
        if len(able) > 1:
            raise MeasurementError("", diagnose("topics-of-one-kind", role=role, topics=able))
        found |= dict.fromkeys([role], able[0]) if able else {}
    if "state" not in found:
        raise MeasurementError("", diagnose("bag-without-states", topics=shown))
    return found


def _series(reader: Any, chosen: Mapping[str, str], joints: Sequence[str]) -> dict[Any, Array]:
    """Returns {(kind, joint): (n, 3) when recorded, when by its header (s), and the number}."""
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    kinds = {chosen[role]: kind for role, kind in (("command", "command"), ("state", "position"))
             if role in chosen}  # fmt: skip
    connections, size = [one for one in reader.connections if one.topic in kinds], 0
    for one, recorded, raw in reader.messages(connections=connections):
        size += len(raw)
        if size > MAX_MESSAGE_BYTES:
            raise MeasurementError("", diagnose("bag-too-large", most=MAX_MESSAGE_BYTES / 1e6))
        message = reader.deserialize(raw, one.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)  # nsec is ROS 1's
        nano = 0 if stamp is None else getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        moment = (stamp.sec + 1e-9 * nano if stamp else 0.0) or np.nan
        names = getattr(message, "name", joints)
        values = message.position if one.msgtype == _STATE else message.data
        if not len(names):
            finding = diagnose("joints-not-named", topic=one.topic, type=one.msgtype)
            raise MeasurementError("", finding)
        if len(values) not in (0, len(names)):
            raise MeasurementError("", diagnose("message-of-other-joints", topic=one.topic))
        for joint, value in zip(names, values, strict=False):
            row = (1e-9 * recorded, moment, float(value))
            found.setdefault((kinds[one.topic], joint), []).append(row)
    return {key: np.array(rows) for key, rows in found.items()}


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
    found: dict[str, dict[str, Array]] = {"position": {}, "command": {}}
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
