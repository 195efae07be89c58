"""ROS bags, written with the library `rosbags` in the test and read as logs."""

from __future__ import annotations

import os
import sys
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lz4 import frame as lz4_frame
from rosbags import rosbag1
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    storage_mcap,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pupper_analysis.base.errors import ConfigurationError, MeasurementError, MissingPackageError
from pupper_analysis.tools.fit.measurements import bags
from pupper_analysis.tools.fit.measurements.log import read_log

STATE, ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
JOINTS = ("knee", "hip")
TIME = 0.005 * np.arange(240)
POSITION = np.column_stack([0.4 * np.sin(5 * TIME), 0.1 + 0.3 * np.sin(7 * TIME)])
EFFORT = np.column_stack([2 * np.cos(5 * TIME), 3 * np.cos(7 * TIME)])
STARTED, LATE = 1_700_000_000, 0.002  # [s]: start of the stamps; delay of the recording

STORE = get_typestore(Stores.ROS2_JAZZY)
POINT = "trajectory_msgs/JointTrajectoryPoint"
STORE.register(
    get_types_from_msg(
        f"std_msgs/Header header\nstring[] joint_names\n{POINT} reference\n{POINT} feedback",
        CONTROLLER,
    )
)


def stamp(moment: float) -> Any:
    seconds = STARTED + int(moment)
    header, clock = STORE.types["std_msgs/msg/Header"], STORE.types["builtin_interfaces/msg/Time"]
    return header(clock(seconds, round(1e9 * (moment - int(moment)))), "")


def state(names: Sequence[str], position: Any, effort: Any = (), moment: float = 0.0) -> Any:
    arrays = (np.array(one, dtype=float) for one in (position, (), effort))
    return STORE.types[STATE](stamp(moment), list(names), *arrays)


def array(values: Any) -> Any:
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    return STORE.types[ARRAY](layout, np.array(values, dtype=float))


def point(positions: Any) -> Any:
    duration = STORE.types["builtin_interfaces/msg/Duration"](0, 0)
    empty, values = np.zeros(0), np.array(positions, dtype=float)
    kind = STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    return kind(values, empty, empty, empty, duration)


def trajectory(moment: float, *positions: Any) -> Any:
    return STORE.types[TRAJECTORY](stamp(moment), list(JOINTS[::-1]), [*map(point, positions)])


Message = tuple[str, str, float, Any]
"""Topic, type, moment of recording (s), message."""


def bag(
    folder: Path,
    messages: Sequence[Message],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    path = folder / "bag"
    connections: dict[str, Any] = {}
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for topic, kind, moment, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            raw = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], round(1e9 * (STARTED + moment)), raw)
    return path


def states(
    *, effort: bool = True, topic: str = "/joint_states"
) -> list[tuple[str, str, float, Any]]:
    return [
        (topic, STATE, now + LATE, state(JOINTS, POSITION[row], EFFORT[row] if effort else (), now))
        for row, now in enumerate(TIME.tolist())
    ]


def commands() -> list[Message]:
    """Return a command for each fourth sample, with hip and knee in the other order."""
    return [
        ("/command", ARRAY, now, array(POSITION[row, ::-1]))
        for row, now in enumerate(TIME.tolist())
        if row % 4 == 0
    ]


def hold_rows(rows: int = 4) -> Any:
    return POSITION[rows * (np.arange(len(TIME)) // rows)]


NAMED = JOINTS[::-1]


@pytest.mark.slow
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_states_are_read_and_a_command_holds_until_the_next(
    tmp_path: Path, plugin: StoragePlugin
) -> None:
    """Commands have no stamps, so that their time of recording counts; states are recorded 2 ms
    after their stamps.
    """
    path = bag(tmp_path, [*states(), *commands()], plugin)
    found = read_log(path, joints=NAMED)
    assert found.joints == JOINTS
    assert found.time == pytest.approx(TIME, abs=1e-6)
    assert found.position == pytest.approx(POSITION)
    assert found.command == pytest.approx(hold_rows())
    (file,) = (one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
    assert read_log(file, joints=NAMED).position == pytest.approx(POSITION)
    for names, code in (((), "joints-not-named"), (("knee",), "message-of-other-joints")):
        with pytest.raises(MeasurementError) as refused:
            read_log(path, joints=names)
        assert refused.value.cause.code == code


def test_states_without_names_have_the_names_of_the_option(tmp_path: Path) -> None:
    """Drivers publish JointState messages whose list of names is empty."""
    nameless = [
        (topic, kind, moment, state((), message.position, (), moment - LATE))
        for topic, kind, moment, message in states(effort=False)
    ]
    found = read_log(bag(tmp_path, [*nameless, *commands()]), joints=NAMED)
    assert found.joints == NAMED
    assert found.position == pytest.approx(POSITION)


def test_lost_messages_leave_gaps_in_the_log(tmp_path: Path) -> None:
    """The hip has its own messages: half as many, 1 ms later, and ten of them are lost."""
    messages: list[Message] = []
    for row, now in enumerate(TIME.tolist()):
        messages.append(("/joint_states", STATE, now, state(["knee"], POSITION[row, :1],
                                                            EFFORT[row, :1], now)))  # fmt: skip
        if row % 2 == 0 and not 100 <= row < 120:
            angle = 0.1 + 0.3 * np.sin(7 * (now + 0.001))
            messages.append(
                ("/joint_states", STATE, now + 0.001, state(["hip"], [angle], [1.0], now + 0.001))
            )
    found = read_log(bag(tmp_path, [*messages, *commands()]), joints=NAMED)
    assert found.position[:, 0] == pytest.approx(POSITION[:, 0])
    lost = np.isnan(found.position[:, 1])
    assert lost[0]  # before its first
    assert np.flatnonzero(lost[1:-2]).tolist() == list(range(98, 120))
    assert found.position[~lost, 1] == pytest.approx(POSITION[~lost, 1], abs=2e-4)


def test_bag_without_commands_is_refused_despite_efforts(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError) as refused:
        read_log(bag(tmp_path, states()))
    assert refused.value.cause.code == "joint-without-command"


def test_several_topics_require_a_choice(tmp_path: Path) -> None:
    other = [(*one[:1], *one[1:3], state(JOINTS, [9, 9], [1, 1], one[2])) for one in
             states(topic="/sim/joint_states")]  # fmt: skip
    path = bag(tmp_path, [*states(), *other])
    with pytest.raises(MeasurementError) as refused:
        read_log(path)
    assert refused.value.cause.code == "topics-of-one-kind"
    chosen = read_log(path, topics={"state": "/joint_states", "command": "/sim/joint_states"})
    assert chosen.command[-1] == pytest.approx([9, 9])
    assert chosen.position == pytest.approx(POSITION)
    for wrong in ({"state": "/tf"}, {"torque": "/joint_states"}):
        with pytest.raises(ConfigurationError):
            read_log(path, topics=wrong)


def test_command_of_a_trajectory_with_one_point_holds_until_the_next(tmp_path: Path) -> None:
    """The message names the joints, in another order than the states."""
    messages = [
        ("/command", TRAJECTORY, now + LATE, trajectory(now, POSITION[row, ::-1]))
        for row, now in enumerate(TIME.tolist())
        if row % 4 == 0
    ]
    found = read_log(bag(tmp_path, [*states(), *messages]))
    assert found.position == pytest.approx(POSITION)
    assert found.command == pytest.approx(hold_rows())


@pytest.mark.parametrize("driver", [False, True])
def test_state_of_a_controller_contains_command_and_position(tmp_path: Path, driver: bool) -> None:
    """With a driver's ``JointState``, the controller's own positions (here 9 rad) are not read."""
    kind = STORE.types[CONTROLLER]
    messages = [
        ("/controller_state", CONTROLLER, now,
         kind(stamp(now), list(JOINTS), point(POSITION[row] + 0.01),
              point([9, 9] if driver else POSITION[row])))
        for row, now in enumerate(TIME.tolist())
    ]  # fmt: skip
    found = read_log(bag(tmp_path, [*messages, *(states() if driver else ())]))
    assert found.position == pytest.approx(POSITION)
    assert found.command == pytest.approx(POSITION + 0.01)


def _write_trajectory_of_points(folder: Path) -> Path:
    points = trajectory(0.0, [0, 0], [1, 1])
    return bag(folder, [*states(), ("/trajectory", TRAJECTORY, 0.0, points)])


def _write_backwards(folder: Path) -> Path:
    messages = states()
    messages.append(("/joint_states", STATE, 2.0, state(JOINTS, [0, 0], [1, 1], -30.0)))
    return bag(folder, messages)


def _write_without_states(folder: Path) -> Path:
    return bag(folder, [("/numbers", ARRAY, 0.0, array([1.0]))])


def _write_broken(folder: Path, name: str = "broken.mcap") -> Path:
    path = folder / name
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(range(200)) if name == "broken.mcap" else b"")
    return path


def _make_pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.bag")
    return folder / "pipe.bag"


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (_write_backwards, "stamps-go-back"),
        (_write_trajectory_of_points, "trajectory-of-points"),
        (_write_without_states, "bag-without-states"),
        (_write_broken, "no-bag"),
        (lambda folder: _write_broken(folder, "empty.db3"), "no-bag"),
        (lambda folder: folder / "none.mcap", "no-such-file"),
        (_make_pipe, "file-not-regular"),
    ],
)
def test_invalid_bag_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Path], code: str
) -> None:
    with pytest.raises(MeasurementError) as refused:
        read_log(make(tmp_path))
    assert refused.value.cause.code == code
    assert "\n" not in str(refused.value)


def _write_ros1(folder: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(folder / "ros1.bag")
    header = store.types["std_msgs/msg/Header"]
    clock, kind = store.types["builtin_interfaces/msg/Time"], store.types[STATE]
    with writer:
        connection = writer.add_connection("/joint_states", STATE, typestore=store)
        for row, now in enumerate(TIME.tolist()):
            at = clock(STARTED + int(now), round(1e9 * (now - int(now))))
            empty = np.zeros(0)
            message = kind(header(row, at, ""), list(JOINTS), POSITION[row], empty, empty)
            raw = store.serialize_ros1(message, STATE)
            writer.write(connection, round(1e9 * (STARTED + now)), raw)
    return folder / "ros1.bag"


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    time, kinds = bags.read_bag(_write_ros1(tmp_path), {}, ())
    np.testing.assert_allclose(time, TIME, atol=1e-6)
    np.testing.assert_array_equal(kinds["position"]["hip"], POSITION[:, 1])


def test_bag_beyond_the_size_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bag(tmp_path, states())
    monkeypatch.setattr(bags, "MAX_MESSAGE_BYTES", 10_000)
    with pytest.raises(MeasurementError) as refused:
        read_log(path)
    assert refused.value.cause.code == "bag-too-large"


def test_chunk_of_zeros_is_refused_before_it_is_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two frames of 10 MB are unpacked; of 200 frames no more than the limit of 25 MB is in memory.
    Without a limit 2 GB are allocated.
    """
    piece = lz4_frame.compress(bytes(10_000_000))
    unpack = bags.limit_decompressor(lz4_frame.LZ4FrameDecompressor)
    assert unpack(piece + piece) == bytes(20_000_000)
    with pytest.raises(ValueError, match="in the midst"):
        unpack(piece[:-10])
    monkeypatch.setattr(bags, "MAX_CHUNK_BYTES", 25_000_000)
    tracemalloc.start()
    with pytest.raises(MeasurementError) as refused:
        unpack(piece * 200)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refused.value.cause.code == "bag-too-large"
    assert peak < 100_000_000


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_packed_chunk_is_unpacked_within_the_limit_and_refused_beyond(
    compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The decompression functions of rosbags are restored."""
    before = dict(storage_mcap.DECOMPRESSORS)
    monkeypatch.setattr(bags, "MAX_CHUNK_BYTES", 1000)
    with bags.limit_unpacking():
        packed = {"lz4": lz4_frame.compress, "zstd": storage_mcap.zstd.compress}[compression]
        unpack = storage_mcap.DECOMPRESSORS[compression]
        assert unpack(packed(bytes(900)), 900) == bytes(900)
        with pytest.raises(MeasurementError):
            unpack(packed(bytes(1100)), 1100)
    assert before == storage_mcap.DECOMPRESSORS


@pytest.mark.parametrize(
    ("mode", "limit"),
    [
        (CompressionMode.FILE, "MAX_BAG_BYTES"),
        (CompressionMode.MESSAGE, "MAX_CHUNK_BYTES"),
        (CompressionMode.STORAGE, "MAX_CHUNK_BYTES"),
    ],
)
def test_packed_bag_is_read_unless_it_is_too_large_when_unpacked(
    mode: CompressionMode, limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the written positions."""
    path = bag(tmp_path, states(), mode=mode)
    _, kinds = bags.read_bag(path, {}, ())
    np.testing.assert_array_equal(kinds["position"]["hip"], POSITION[:, 1])
    monkeypatch.setattr(bags, limit, 20)
    with pytest.raises(MeasurementError) as refused:
        bags.read_bag(path, {}, ())
    assert refused.value.cause.code == "bag-too-large"


def test_missing_package_is_named_by_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingPackageError) as refused:
        read_log(_write_broken(tmp_path))
    assert refused.value.extra == "bags"


def test_topics_are_refused_for_logs_that_are_no_bags(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError):
        read_log(tmp_path / "log.csv", topics={"state": "/joint_states"})
    with pytest.raises(ConfigurationError):
        read_log(tmp_path / "log.csv", joints=JOINTS)
