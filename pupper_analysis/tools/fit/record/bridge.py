"""Ways to a robot: positions are read from it, and commands sent to it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.stands.plan import PlannedStand

Array = NDArray[np.float64]

GROUP = "pupper_analysis.bridges"
"""Entry points of other packages: a function of the robot and of what follows a colon."""


class Operator(Protocol):
    """Who stands beside the robot."""

    def prepare(self, stand: PlannedStand, loads: Mapping[str, Array], todo: Sequence[str]) -> bool:
        """Lets a stand be set down: lifted, turned, loaded; False to leave it out."""

    def feet_up(self, feet: Sequence[str], planned: Sequence[str]) -> tuple[str, ...] | None:
        """Returns the feet that are in the air; None to leave the stand out."""

    def stops(self) -> bool:
        """Says whether a key was pressed."""


class Bridge(Protocol):
    """A robot: joints are in the order of the robot's model.

    Attributes:
        ramps: Whether commands are sent to it, so that it moves.
    """

    ramps: bool

    def read(self) -> tuple[float, Array]:
        """Returns when positions were measured (s, as ``now``), and these (nu,) (rad)."""

    def send(self, command: Array) -> None:
        """Commands positions (nu,) (rad)."""

    def now(self) -> float:
        """Returns the time (s)."""

    def wait(self, seconds: float) -> None:
        """Lets time pass."""

    def close(self) -> None:
        """Lets the robot go, which holds what it was commanded last."""


def open_bridge(name: str, robot: Robot) -> tuple[Bridge, Operator]:
    """Returns a bridge and who stands beside the robot, by ``NAME`` or ``NAME:WORDS``.

    Raises:
        ConfigurationError: If there is none of that name.
    """
    key, _, words = name.partition(":")
    others = {point.name: point for point in entry_points(group=GROUP)}
    if key in _OWN:
        module, function = _OWN[key].split(":")
        made = getattr(import_module(module), function)(robot, words)
    elif key in others:
        made = others[key].load()(robot, words)
    else:
        known = (*_OWN, *others)
        raise ConfigurationError("--bridge", diagnose("no-bridge", name=key, known=known))
    bridge, person = made
    return bridge, person


_OWN = {
    "mujoco": "pupper_analysis.tools.fit.record.simulated:open_simulated",
    "ros2": "pupper_analysis.tools.fit.record.ros:open_ros",
    "typed": "pupper_analysis.tools.fit.record.terminal:open_typed",
}


@dataclass
class WallClock:
    """Time as it passes, for bridges to what is real."""

    def now(self) -> float:
        """Returns the time (s)."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Lets time pass."""
        time.sleep(seconds)
