"""Who stands beside the robot, at a terminal; and a robot whose positions that person types."""

from __future__ import annotations

import select
import sys
import termios
from collections.abc import Mapping, Sequence

import click
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.record.bridge import WallClock
from pupper_analysis.tools.fit.stands.plan import PlannedStand

Array = NDArray[np.float64]


class Terminal:
    """Asks at a terminal. While the robot moves, any key stops it."""

    def prepare(
        self,
        stand: PlannedStand,  # noqa: ARG002 - words say it
        loads: Mapping[str, Array],  # noqa: ARG002
        todo: Sequence[str],
    ) -> bool:
        """See ``Operator``."""
        for line in todo:
            click.echo(f"  {line}", err=True)
        said: str = click.prompt(
            "  [Enter], or s to leave it out", default="", show_default=False, err=True
        )
        return said.strip().lower() != "s"

    def feet_up(self, feet: Sequence[str], planned: Sequence[str]) -> tuple[str, ...] | None:
        """See ``Operator``."""
        known = {foot.lower(): foot for foot in feet}
        while True:
            default = " ".join(planned) or "none"
            said: str = click.prompt(
                "  which feet are up? (s leaves it out)", default=default, err=True
            )
            words = said.replace(",", " ").lower().split()
            if words == ["s"]:
                return None
            if words == ["none"] or all(word in known for word in words):
                return tuple(known[word] for word in words if word != "none")
            click.echo(f"  {' '.join(feet)}, or none", err=True)

    def stops(self) -> bool:
        """See ``Operator``."""
        if not sys.stdin.isatty():
            return False
        # A terminal hands over lines; without that a key is there once it is pressed.
        before = termios.tcgetattr(sys.stdin)
        single = [*before[:3], before[3] & ~(termios.ICANON | termios.ECHO), *before[4:]]
        termios.tcsetattr(sys.stdin, termios.TCSANOW, single)
        try:
            pressed = bool(select.select([sys.stdin], [], [], 0)[0])
            if pressed:
                termios.tcflush(sys.stdin, termios.TCIFLUSH)
        finally:
            termios.tcsetattr(sys.stdin, termios.TCSANOW, before)
        return pressed


class Typed(WallClock):
    """A robot that a person commands by other means, and whose positions are typed.

    Args:
        robot: The robot.
    """

    ramps = False

    def __init__(self, robot: Robot) -> None:
        self._names = robot.joint_names

    def read(self) -> tuple[float, Array]:
        """See ``Bridge``."""
        found = [
            click.prompt(f"  position of {name} (deg)", type=float, err=True)
            for name in self._names
        ]
        return self.now(), np.radians(found)

    def send(self, command: Array) -> None:
        """See ``Bridge``."""
        for name, value in zip(self._names, np.degrees(command).tolist(), strict=True):
            click.echo(f"  command {name} {value:.3f} deg", err=True)

    def close(self) -> None:
        """See ``Bridge``."""


def open_typed(robot: Robot, _: str) -> tuple[Typed, Terminal]:
    """Returns the bridge."""
    return Typed(robot), Terminal()
