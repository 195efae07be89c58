"""Connections to a robot for recordings: interface, and selection by name.

A recording needs a `Bridge`, which commands and measures joint positions in actuator order. It also
needs an `Operator`, who sets the robot down and lifts feet. `open_bridge` returns both for a name.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.stands.plan import PlannedStand

ENTRY_POINT_GROUP = "pupper_analysis.bridges"
"""Name of the entry point group with which other packages add bridges (connections to robots). An
entry point is a function that returns a `Bridge` and an `Operator`. The function has two arguments:
the robot, and the text after the colon in ``NAME:ARGUMENTS``.
"""


class Operator(Protocol):
    """Person beside the robot who prepares the robot for each stand of a recording."""

    def prepare(
        self, stand: PlannedStand, loads: Mapping[str, Array], instructions: Sequence[str]
    ) -> bool:
        """Let the operator lift, turn and load the robot for a stand.

        Args:
            stand: Stand for which the robot is prepared.
            loads: {link: mass [kg] and position (x, y, z) [m] of a known load, shape (4,)}.
            instructions: Steps for the operator, as text.

        Returns:
            False if the operator skips the stand.
        """

    def feet_up(
        self, feet: Sequence[str], planned: Sequence[str]
    ) -> tuple[str, ...] | Diagnostic | None:
        """Return the feet in the air, as the operator reports.

        If the operator skips the stand, the result is the reason, or None if no reason is known.

        Args:
            feet: All feet of the robot.
            planned: Feet that are in the air according to the plan.
        """

    def stops(self) -> bool:
        """Return True if the operator stops the recording, for example by a key."""


class Bridge(Protocol):
    """Connection to a robot that sends joint commands and reads positions, in actuator order.

    Attributes:
        ramps: Whether commands move the robot. If True, the recorder ramps the commands and checks
            the response.
    """

    ramps: bool

    def read(self) -> tuple[float, Array]:
        """Return the time of the measurement [s], and joint positions, shape (nu,) [rad, m].

        The time is on the clock of ``now``. The joints are in actuator order. A position without a
        measurement is NaN.
        """

    def send(self, command: Array) -> None:
        """Command joint positions, shape (nu,) [rad, m], in actuator order."""

    def now(self) -> float:
        """Return the time on the clock of the bridge [s]; only differences have a meaning."""

    def wait(self, seconds: float) -> None:
        """Wait for a duration [s] on the clock of the bridge."""

    def close(self) -> None:
        """Close the connection, without a change of the last command."""


def open_bridge(name: str, robot: Robot) -> tuple[Bridge, Operator]:
    """Open a connection to a robot, and return the bridge and the operator.

    Args:
        name: ``NAME`` or ``NAME:ARGUMENTS`` of a bridge of this package or of an entry point.
        robot: Robot, with the values of the files.

    Returns:
        Bridge; operator.

    Raises:
        ConfigurationError: If there is no bridge of this name, or it cannot be opened.
        ModelError: If the bridge is ``mujoco``, and a joint has no position servo.
    """
    bridge, operator = open_connection(name, robot, _BUILTIN_BRIDGES, ENTRY_POINT_GROUP)
    return bridge, operator


def open_connection(name: str, robot: Robot, builtin: Mapping[str, str], group: str) -> Any:
    """Open a connection to a robot by name: call the function that the name selects.

    Args:
        name: ``NAME`` or ``NAME:ARGUMENTS``.
        robot: Robot, with the values of the files.
        builtin: {name: ``module:function``} of this package.
        group: Group of the entry points of other packages.

    Returns:
        Result of the function: for example a `Bridge` and an `Operator`.

    Raises:
        ConfigurationError: If there is no connection of this name. The function that opens the
            connection may raise other errors.
    """
    key, _, arguments = name.partition(":")
    points = {point.name: point for point in entry_points(group=group)}
    if key in builtin:
        module, function = builtin[key].split(":")
        return getattr(import_module(module), function)(robot, arguments)
    if key in points:
        return points[key].load()(robot, arguments)
    known = (*builtin, *points)
    raise ConfigurationError("--bridge", diagnose("no-bridge", name=key, known=known))


_BUILTIN_BRIDGES = {
    "mujoco": "pupper_analysis.tools.fit.record.simulated:open_simulated",
    "ros2": "pupper_analysis.tools.fit.record.ros:open_ros",
    "typed": "pupper_analysis.tools.fit.record.terminal:open_typed",
}
"""{name of a bridge of this package: ``module:function`` that opens the bridge}."""


@dataclass
class WallClock:
    """Real time, for bridges to real robots."""

    def now(self) -> float:
        """Return the time of the monotonic system clock [s]; only differences have a meaning."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Wait for a duration [s]."""
        time.sleep(seconds)
