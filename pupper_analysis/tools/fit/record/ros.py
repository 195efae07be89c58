"""Bridge over ROS 2 topics: ``sensor_msgs/JointState`` and a forward position controller.

``JointState`` messages contain ``name`` and ``position`` [rad, m] of some or all joints, in any
order. The controller accepts ``std_msgs/Float64MultiArray`` with ``data`` in the joint order of the
controller. The order is the actuator order, unless ``ros2:order=a,b,c`` states another.

`RosListener` records a running policy: joint states, IMU, velocity commands, observations and
actions. The controller publishes observations and actions as ``Float32MultiArray`` or
``Float64MultiArray``.
"""

from __future__ import annotations

import math
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.record.bridge import WallClock
from pupper_analysis.tools.fit.record.terminal import Terminal

STATE_TOPIC, COMMAND_TOPIC = "/joint_states", "/forward_position_controller/commands"
"""Default ROS topics of measured joint positions and of commanded joint positions."""

_SPIN_INTERVAL = 0.02
"""Time [s] between two checks for messages while the bridge is opened. Chosen, not tuned."""

_DISCOVERY_TIMEOUT = 5.0
"""Time limit [s] for opening the bridge: all joints have a position, and a node subscribes to the
commands. Chosen, not tuned.
"""


class RosBridge(WallClock):
    """Bridge that subscribes to joint states and publishes commands.

    Args:
        robot: Robot.
        ros: Module ``rclpy`` with the modules ``qos`` and ``signals``.
        messages: Message classes ``JointState`` and ``Float64MultiArray``.
        state: Topic of the joint states.
        command: Topic of the commands.
        order: Joints of the controller; actuator order by default.

    Raises:
        ConfigurationError: If ``order`` does not contain each joint of the robot exactly once. Also
            if, after five seconds, the state of a joint is missing or no node subscribes to the
            commands.
    """

    ramps = True

    def __init__(
        self,
        robot: Robot,
        ros: Any,
        messages: tuple[Any, Any],
        state: str = STATE_TOPIC,
        command: str = COMMAND_TOPIC,
        order: tuple[str, ...] = (),
    ) -> None:
        names = robot.joint_names
        differing = sorted(
            name for name in {*order, *names} if order and order.count(name) != names.count(name)
        )
        if differing:
            finding = diagnose("bridge-of-other-joints", joints=differing)
            raise ConfigurationError("--bridge", finding)
        self._robot, self._ros, self._message = robot, ros, messages[1]
        self._order = [names.index(name) for name in order or names]
        self._positions: dict[str, float] = {}
        self._reception_times = dict.fromkeys(names, -math.inf)
        if not ros.ok():  # rclpy's signal handler would close the topic before the last command
            ros.init(signal_handler_options=ros.signals.SignalHandlerOptions.NO)
        self._node = ros.create_node("pupper_analysis_fit")
        # "Best effort" subscribers receive from reliable publishers as well; the reverse fails.
        quality = ros.qos.qos_profile_sensor_data
        self._node.create_subscription(messages[0], state, self._receive_state, quality)
        self._publisher = self._node.create_publisher(messages[1], command, 10)
        end = self.now() + _DISCOVERY_TIMEOUT
        while (silent := [name for name, at in self._reception_times.items() if at < 0]) or (
            self._publisher.get_subscription_count() == 0
        ):
            if self.now() > end:
                self.close()
                finding = diagnose(
                    "topic-is-silent", joints=silent or None, state=state, command=command
                )
                raise ConfigurationError("--bridge", finding)
            self.wait(_SPIN_INTERVAL)

    def _receive_state(self, message: Any) -> None:
        """Store the joint positions of a ``JointState`` message, with the time of reception."""
        for name, value in zip(message.name, message.position, strict=False):
            if name in self._reception_times:
                self._positions[name], self._reception_times[name] = float(value), self.now()

    def read(self) -> tuple[float, Array]:
        """Return the last received joint positions and the oldest time of reception.

        Returns:
            1. Time on the clock of ``now`` [s]; -inf if the position of a joint is missing.
            2. Joint positions in actuator order, shape (nu,) [rad, m]; NaN if not received.
        """
        self._ros.spin_once(self._node, timeout_sec=0.0)
        positions = [self._positions.get(name, math.nan) for name in self._robot.joint_names]
        return min(self._reception_times.values()), np.array(positions)

    def wait(self, seconds: float) -> None:
        """Wait for a duration [s], and process ROS messages during this time."""
        end = self.now() + seconds
        while (remaining := end - self.now()) > 0:
            self._ros.spin_once(self._node, timeout_sec=remaining)

    def send(self, command: Array) -> None:
        """Publish commanded joint positions in the joint order of the controller.

        ``command`` has the shape (nu,) [rad, m], in actuator order.
        """
        message = self._message()
        message.data = [float(command[joint]) for joint in self._order]
        self._publisher.publish(message)

    def close(self) -> None:
        """Destroy the ROS node."""
        self._node.destroy_node()


def open_ros(robot: Robot, arguments: str) -> tuple[RosBridge, Terminal]:
    """Open a bridge over ROS 2 topics, with an operator at the terminal.

    Args:
        robot: Robot.
        arguments: ``state=TOPIC;command=TOPIC;order=JOINT,...``, each part optional.

    Returns:
        Bridge; operator.

    Raises:
        ConfigurationError: If ROS 2 is not installed, an argument is unknown, the order does not
            contain each joint of the robot once, joint states are missing, or nothing subscribes to
            commands.
    """
    try:
        ros = import_module("rclpy")
        for name in ("qos", "signals"):
            import_module(f"rclpy.{name}")
        state_class = import_module("sensor_msgs.msg").JointState
        array_class = import_module("std_msgs.msg").Float64MultiArray
    except ImportError as error:
        raise ConfigurationError("--bridge", diagnose("no-rclpy")) from error
    options = dict(word.partition("=")[::2] for word in arguments.split(";") if word)
    if not {*options} <= {"state", "command", "order"}:
        raise ConfigurationError("--bridge", diagnose("no-bridge-words", words=arguments))
    order = tuple(options.get("order", "").split(",")) if options.get("order") else ()
    topics = options.get("state", STATE_TOPIC), options.get("command", COMMAND_TOPIC)
    return RosBridge(robot, ros, (state_class, array_class), *topics, order), Terminal()


LISTENED_TOPICS = {
    "observation": "/neural_controller/observation",
    "action": "/neural_controller/policy_output",
    "target": "/neural_controller/position_command",
    "state": STATE_TOPIC,
    "imu": "/imu_sensor_broadcaster/imu",
    "velocity": "/cmd_vel",
}
"""{key in the arguments of a listener: default topic}. The first three topics are those of Pupper's
neural_controller."""

_ARRAY_SIGNALS = {"observation": "observations", "action": "actions", "target": "targets"}
"""{topic of an array: signal of a trace}."""


class RosListener(WallClock):
    """Listener that subscribes to the ROS 2 topics of a running policy.

    Args:
        robot: Robot.
        ros: Module ``rclpy`` with the modules ``qos`` and ``signals``.
        messages: {class name: message class}.
        topics: {key of `LISTENED_TOPICS`: topic}.
        order: Joints in the order of the commanded positions of the controller; actuator order by
            default.

    Raises:
        ConfigurationError: If ``order`` does not contain each joint of the robot exactly once.
    """

    def __init__(
        self,
        robot: Robot,
        ros: Any,
        messages: dict[str, Any],
        topics: dict[str, str],
        order: tuple[str, ...] = (),
    ) -> None:
        names = robot.joint_names
        if order and sorted(order) != sorted(names):
            differing = sorted({*order} ^ {*names}) or sorted(names)
            raise ConfigurationError(
                "--bridge", diagnose("bridge-of-other-joints", joints=differing)
            )
        self._robot, self._ros = robot, ros
        self._order = [list(order or names).index(name) for name in names]
        self._series: dict[str, list[tuple[float, Array]]] = {}
        self._state = {kind: dict.fromkeys(names, math.nan) for kind in ("position", "velocity")}
        if not ros.ok():
            ros.init(signal_handler_options=ros.signals.SignalHandlerOptions.NO)
        self._node = ros.create_node("pupper_analysis_listen")
        quality = ros.qos.qos_profile_sensor_data
        for key, signal in _ARRAY_SIGNALS.items():
            for kind in ("Float32MultiArray", "Float64MultiArray"):  # only the published type fits
                hear = partial(self._receive_array, signal)
                self._node.create_subscription(messages[kind], topics[key], hear, quality)
        for key, kind, receive in (
            ("state", "JointState", self._receive_state),
            ("imu", "Imu", self._receive_imu),
            ("velocity", "Twist", self._receive_velocity),
        ):
            self._node.create_subscription(messages[kind], topics[key], receive, quality)

    def _append_values(self, signal: str, values: Any) -> None:
        """Append the values of a message to a signal of the trace, with the time of reception."""
        row = self.now(), np.array(values, dtype=np.float64)
        self._series.setdefault(signal, []).append(row)

    def _receive_array(self, signal: str, message: Any) -> None:
        """Append an array of observations, actions or targets (commanded joint positions).

        Targets are stored in actuator order; an array with another number of joints is ignored.
        """
        values = np.array(message.data, dtype=np.float64)
        if signal == "targets":
            if len(values) != len(self._order):
                return
            values = values[self._order]
        self._append_values(signal, values)

    def _receive_state(self, message: Any) -> None:
        """Update joint positions [rad, m] and velocities [rad/s, m/s]; append them to the trace.

        A signal begins when the values of all joints are known.
        """
        for kind, state in self._state.items():
            for name, value in zip(message.name, getattr(message, kind), strict=False):
                if name in state:
                    state[name] = float(value)
            values = list(state.values())
            if np.isfinite(values).all():
                self._append_values("positions" if kind == "position" else "velocities", values)

    def _receive_imu(self, message: Any) -> None:
        """Append orientation (quaternion w, x, y, z) and angular velocity [rad/s] of the IMU."""
        turn, rate = message.orientation, message.angular_velocity
        self._append_values("quaternion", (turn.w, turn.x, turn.y, turn.z))
        self._append_values("angular_velocity", (rate.x, rate.y, rate.z))

    def _receive_velocity(self, message: Any) -> None:
        """Append the commanded velocity: x and y [m/s], and rotation about z [rad/s]."""
        self._append_values("commands", (message.linear.x, message.linear.y, message.angular.z))

    def listen(self, seconds: float) -> dict[str, list[tuple[float, Array]]]:
        """Receive messages for ``seconds`` [s], destroy the ROS node, and return the messages.

        Returns:
            {signal: [(time of reception [s], values), ...]}, with the signals and units of
            `Listener.listen`.
        """
        end = self.now() + seconds
        try:
            while (remaining := end - self.now()) > 0:
                self._ros.spin_once(self._node, timeout_sec=remaining)
        finally:
            self._node.destroy_node()
        return self._series


def open_ros_listener(robot: Robot, arguments: str) -> RosListener:
    """Open a listener over ROS 2 topics.

    Args:
        robot: Robot.
        arguments: ``KEY=TOPIC;...`` with keys of `LISTENED_TOPICS`, and ``order=JOINT,...``, each
            part optional.

    Raises:
        ConfigurationError: If ROS 2 is not installed, an argument is unknown, or the order does not
            contain each joint of the robot once.
    """
    try:
        ros = import_module("rclpy")
        for name in ("qos", "signals"):
            import_module(f"rclpy.{name}")
        modules = {
            "sensor_msgs.msg": ("JointState", "Imu"),
            "std_msgs.msg": ("Float32MultiArray", "Float64MultiArray"),
            "geometry_msgs.msg": ("Twist",),
        }
        messages = {
            kind: getattr(import_module(module), kind)
            for module, kinds in modules.items()
            for kind in kinds
        }
    except ImportError as error:
        raise ConfigurationError("--bridge", diagnose("no-rclpy")) from error
    options = dict(word.partition("=")[::2] for word in arguments.split(";") if word)
    if not {*options} <= {"order", *LISTENED_TOPICS}:
        raise ConfigurationError("--bridge", diagnose("no-bridge-words", words=arguments))
    order = tuple(options.pop("order", "").split(",")) if options.get("order") else ()
    return RosListener(robot, ros, messages, {**LISTENED_TOPICS, **options}, order)
