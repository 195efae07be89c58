"""Recording of a running policy: ROS messages of a stub, and the trace that `walk` reads."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError, MeasurementError, OutputError
from pupper_analysis.tools.fit.record.listen import assemble_trace, record_policy
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.trace import check_trace, read_trace, record_trace
from tests.support.commands import run_command
from tests.support.variants import load
from tests.tools.walk import made

COMMANDS = [(0.1, 0.0, 0.0), (0.0, 0.1, 0.4)]
KINDS = {
    "sensor_msgs.msg": ("JointState", "Imu"),
    "std_msgs.msg": ("Float32MultiArray", "Float64MultiArray"),
    "geometry_msgs.msg": ("Twist",),
}


class Node:
    """Replacement of ``rclpy`` with its node: delivers messages of a simulation to subscribers."""

    qos = SimpleNamespace(qos_profile_sensor_data="best effort")
    signals = SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="none"))

    def __init__(self, messages: list[tuple[str, str, Any]], period: float) -> None:
        self.messages, self.time, self.period = messages, 0.0, period
        self.subscribers: dict[tuple[str, str], Any] = {}

    def ok(self) -> bool:
        return True

    def create_node(self, _: str) -> Node:
        return self

    def create_subscription(self, kind: str, topic: str, hear: Any, quality: str) -> None:
        assert quality == "best effort"
        self.subscribers[kind, topic] = hear

    def spin_once(self, _: Any, timeout_sec: float) -> None:
        if not self.messages:
            self.time += timeout_sec
            return
        kind, topic, message = self.messages.pop(0)
        if topic == "tick":
            self.time += self.period
        elif (kind, topic) in self.subscribers:
            self.subscribers[kind, topic](message)

    def destroy_node(self) -> None:
        self.subscribers.clear()


def make_messages(arrays: dict[str, Any], order: list[str]) -> list[tuple[str, str, Any]]:
    """Messages as neural_controller and its broadcasters publish them, two updates of the sensors
    per action; joint states in two parts, commanded positions in the order of the controller.
    """
    messages: list[tuple[str, str, Any]] = []
    joints = [str(name) for name in arrays["joints"]]
    columns = [joints.index(name) for name in order]
    for row in range(len(arrays["time"])):
        positions, velocities = arrays["positions"][row], arrays["velocities"][row]
        for part in (slice(6, None), slice(0, 6)):
            state = SimpleNamespace(
                name=joints[part], position=positions[part], velocity=velocities[part]
            )
            messages.append(("JointState", "/joint_states", state))
        w, x, y, z = arrays["quaternion"][row]
        rate = SimpleNamespace(**dict(zip("xyz", arrays["angular_velocity"][row], strict=True)))
        turn = SimpleNamespace(w=w, x=x, y=y, z=z)
        imu = SimpleNamespace(orientation=turn, angular_velocity=rate)
        messages.append(("Imu", "/imu_sensor_broadcaster/imu", imu))
        forward, left, turning = arrays["commands"][row]
        twist = SimpleNamespace(
            linear=SimpleNamespace(x=forward, y=left), angular=SimpleNamespace(z=turning)
        )
        messages.append(("Twist", "/cmd_vel", twist))
        for name, key, chosen in (
            ("observation", "observations", slice(None)),
            ("policy_output", "actions", slice(None)),
            ("position_command", "targets", columns),
        ):
            data = arrays[key][row][chosen].astype(np.float32)
            topic = f"/neural_controller/{name}"
            messages.append(("Float32MultiArray", topic, SimpleNamespace(data=data)))
        messages += [("", "tick", None)]
    return messages


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Policy, dict[str, Any]]:
    """Return the trotting policy and the arrays of its simulation."""
    policy = Policy.load(made.trot(tmp_path_factory.mktemp("policy") / "trot.json"))
    return policy, record_trace(load("v3"), policy, COMMANDS)


def install(monkeypatch: pytest.MonkeyPatch, node: Node) -> None:
    """Let imports of ROS return the stub, and its clock count the updates."""
    modules: dict[str, Any] = {"rclpy": node, "rclpy.qos": node.qos, "rclpy.signals": node.signals}
    for module, kinds in KINDS.items():
        modules[module] = SimpleNamespace(**{kind: kind for kind in kinds})
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    clock = "pupper_analysis.tools.fit.record.ros.RosListener.now"
    monkeypatch.setattr(clock, lambda _: node.time)


@pytest.mark.slow
def test_recorded_policy_matches_its_trace(
    walked: tuple[Policy, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Reference: the simulation that published the messages; the controller's order is reversed."""
    policy, arrays = walked
    robot, order = load("v3"), [str(name) for name in reversed(arrays["joints"])]
    period = float(arrays["time"][1] - arrays["time"][0])
    install(monkeypatch, Node(make_messages(arrays, order), period))
    path = tmp_path / "trace.npz"
    recording = record_policy(robot, f"ros2:order={','.join(order)}", 2.0, path)
    assert recording.complete
    assert recording.samples == len(arrays["time"])
    assert recording.period == pytest.approx(period)
    trace = read_trace(path)
    for name in ("observations", "targets", "positions", "quaternion", "commands"):
        np.testing.assert_allclose(trace.arrays[name], arrays[name], atol=1e-6)
    found = check_trace(robot, policy, trace)
    assert found.passed
    checked = {check.term for check in found.checks if check.mistake == ""}
    assert {"network", "joint-positions", "gravity", "command", "targets"} <= checked


@pytest.mark.slow
def test_command_states_signals_that_were_not_received(
    walked: tuple[Policy, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """Without an IMU; the file may be replaced by the next recording, not another file."""
    _, arrays = walked
    messages = [
        message for message in make_messages(arrays, list(arrays["joints"])) if message[0] != "Imu"
    ]
    path = tmp_path / "trace.npz"
    for _ in range(2):
        install(monkeypatch, Node(messages[:], 0.02))
        words = ("fit", "v3", "--listen", "2", "--bridge", "ros2", "-o", str(path))
        status, out, err = run_command(capfd, *words)
        assert (status, err) == (1, "")
        assert "INCOMPLETE" in out
        assert "not received: angular_velocity, quaternion" in out
        assert f"--trace {path}" in out
    (tmp_path / "other.npz").write_bytes(b"mine")
    with pytest.raises(OutputError):
        record_policy(load("v3"), "ros2", 2.0, tmp_path / "other.npz")


def make_series(count: int) -> dict[str, list[tuple[float, Any]]]:
    """Observations every 20 ms, each with its number, and actions 3 ms later."""
    return {
        "observations": [(0.02 * k, np.array([float(k)])) for k in range(count)],
        "actions": [(0.02 * k + 0.003, np.array([float(k)])) for k in range(count)],
    }


def test_rows_pair_an_action_with_its_observation_and_the_signals_before() -> None:
    """A lost observation, a lost action, an extra action, and a signal that starts late."""
    series = make_series(40)
    del series["observations"][20], series["actions"][30]
    series["actions"].insert(10, (0.02 * 10 - 0.004, np.array([99.0])))
    series["positions"] = [(0.02 * k - 0.001, np.array([float(k)])) for k in range(5, 40)]
    arrays, left_out = assemble_trace(series, "made")
    assert (arrays["observations"] == arrays["actions"]).all()
    assert (arrays["observations"] == arrays["positions"]).all()
    numbers = arrays["observations"][:, 0].tolist()
    assert numbers == [k for k in range(5, 40) if k not in (20, 30)]
    assert left_out == len(series["actions"]) - len(numbers)
    assert all(first < second for first, second in itertools.pairwise(arrays["time"]))
    with pytest.raises(MeasurementError, match="19 observations and 19 actions"):
        assemble_trace(make_series(19), "made")


@pytest.mark.parametrize(
    ("bridge", "seconds", "message"),
    [
        ("ros2:topic=/x", 2.0, "topic=/x"),
        ("ros2:order=elbow", 2.0, "elbow"),
        ("serial", 2.0, "serial"),
        ("ros2", 0.0, "--listen"),
        ("ros2", float("nan"), "--listen"),
    ],
)
def test_listener_that_cannot_be_opened_is_refused(
    bridge: str, seconds: float, message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    install(monkeypatch, Node([], 0.02))
    with pytest.raises(ConfigurationError, match=message):
        record_policy(load("v3"), bridge, seconds, tmp_path / "trace.npz")
    assert not (tmp_path / "trace.npz").exists()


def test_silent_policy_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install(monkeypatch, Node([], 0.02))
    with pytest.raises(MeasurementError, match="check whether the policy is active"):
        record_policy(load("v3"), "ros2", 2.0, tmp_path / "trace.npz")
