"""A robot over ROS 2 topics: ``sensor_msgs/JointState``, and a forward position controller.

Assumed of the messages: ``JointState`` has ``name`` and ``position`` (rad), in any order, of some
or of all joints; the controller takes ``std_msgs/Float64MultiArray`` with ``data`` in the order of
its own joints, which ``ros2:order=a,b,c`` says (the robot's order by default).
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.record.bridge import WallClock
from pupper_analysis.tools.fit.record.terminal import Terminal

Array = NDArray[np.float64]

STATE, COMMAND = "/joint_states", "/forward_position_controller/commands"

_TICK, _DISCOVERY = 0.02, 5.0
"""s until nodes of a network have found each other: on one machine it is 0.1 to 1 s."""


class Topics(WallClock):
    """Subscribes to the joints' state, and publishes commands.

    Args:
        robot: The robot.
        ros: ``rclpy``, with its modules ``qos`` and ``signals``.
        messages: The classes ``JointState`` and ``Float64MultiArray``.
        state: Topic of the state.
        command: Topic of the commands.
        order: The controller's joints.

    Raises:
        ConfigurationError: If joints and order differ, or nobody publishes states of all joints, or
            hears commands.
    """

    ramps = True

    def __init__(
        self,
        robot: Robot,
        ros: Any,
        messages: tuple[Any, Any],
        state: str = STATE,
        command: str = COMMAND,
        order: tuple[str, ...] = (),
    ) -> None:
        names = robot.joint_names
        unknown = sorted({*order} ^ {*names}) if order else []
        if unknown:
            raise ConfigurationError("--bridge", diagnose("bridge-of-other-joints", joints=unknown))
        self._robot, self._ros, self._message = robot, ros, messages[1]
        self._order = [names.index(name) for name in order or names]
        self._positions: dict[str, float] = {}
        self._seen = dict.fromkeys(names, -math.inf)
        if not ros.ok():  # its own handler of Ctrl-C would end the topic before the last command
            ros.init(signal_handler_options=ros.signals.SignalHandlerOptions.NO)
        self._node = ros.create_node("pupper_analysis_fit")
        # "Best effort" hears reliable publishers, too; the other way round nothing comes.
        quality = ros.qos.qos_profile_sensor_data
        self._node.create_subscription(messages[0], state, self._hear, quality)
        self._publisher = self._node.create_publisher(messages[1], command, 10)
        end = self.now() + _DISCOVERY
        while (silent := [name for name, at in self._seen.items() if at < 0]) or (
            self._publisher.get_subscription_count() == 0
        ):
            if self.now() > end:
                self.close()
                finding = diagnose(
                    "topic-is-silent", joints=silent or None, state=state, command=command
                )
                raise ConfigurationError("--bridge", finding)
            self.wait(_TICK)

    def _hear(self, message: Any) -> None:
        for name, value in zip(message.name, message.position, strict=False):
            if name in self._seen:
                self._positions[name], self._seen[name] = float(value), self.now()

    def read(self) -> tuple[float, Array]:
        """See ``Bridge``: as old as the joint that was heard of longest ago."""
        self._ros.spin_once(self._node, timeout_sec=0.0)
        there = [self._positions.get(name, math.nan) for name in self._robot.joint_names]
        return min(self._seen.values()), np.array(there)

    def wait(self, seconds: float) -> None:
        """Lets time pass, and hears."""
        end = self.now() + seconds
        while (left := end - self.now()) > 0:
            self._ros.spin_once(self._node, timeout_sec=left)

    def send(self, command: Array) -> None:
        """See ``Bridge``."""
        message = self._message()
        message.data = [float(command[joint]) for joint in self._order]
        self._publisher.publish(message)

    def close(self) -> None:
        """See ``Bridge``."""
        self._node.destroy_node()


def open_ros(robot: Robot, words: str) -> tuple[Topics, Terminal]:
    """Returns the bridge, of ``state=TOPIC;command=TOPIC;order=JOINT,...``.

    Raises:
        ConfigurationError: If ROS 2 is not there, or a word says nothing.
    """
    try:
        ros = import_module("rclpy")
        for name in ("qos", "signals"):
            import_module(f"rclpy.{name}")
        state = import_module("sensor_msgs.msg").JointState
        numbers = import_module("std_msgs.msg").Float64MultiArray
    except ImportError as error:
        raise ConfigurationError("--bridge", diagnose("no-rclpy")) from error
    said = dict(word.partition("=")[::2] for word in words.split(";") if word)
    if not {*said} <= {"state", "command", "order"}:
        raise ConfigurationError("--bridge", diagnose("no-bridge-words", words=words))
    order = tuple(said.get("order", "").split(",")) if said.get("order") else ()
    topics = said.get("state", STATE), said.get("command", COMMAND)
    return Topics(robot, ros, (state, numbers), *topics, order), Terminal()
