"""Operator at a terminal, and a bridge with joint positions that a person types.

Prompts appear at the terminal. The operator confirms stands, and types feet in the air or joint
positions. Both classes need no software of the robot.
"""

from __future__ import annotations

import select
import sys
import termios
from collections.abc import Mapping, Sequence

import click
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.runs import current_language
from pupper_analysis.base.units import READ_IN
from pupper_analysis.present.document import Name, Text, text, translate
from pupper_analysis.robot.joints import list_position_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.record.bridge import WallClock
from pupper_analysis.tools.fit.stands.plan import PlannedStand


def _format_line(words: Text) -> str:
    """Return a text in the language of the command, indented."""
    return f"  {translate(words, current_language())}"


class Terminal:
    """Operator who answers prompts at a terminal, and stops the recording by any key."""

    def prepare(
        self,
        stand: PlannedStand,  # noqa: ARG002 - the instructions contain it
        loads: Mapping[str, Array],  # noqa: ARG002
        instructions: Sequence[str],
    ) -> bool:
        """Print the instructions of a stand, and wait for the user.

        Returns:
            True to record the stand, False to skip it.
        """
        for line in instructions:
            click.echo(f"  {line}", err=True)
        prompt = _format_line(text("record-enter"))
        answer: str = click.prompt(prompt, default="", show_default=False, err=True)
        return answer.strip().lower() != "s"

    def feet_up(self, feet: Sequence[str], planned: Sequence[str]) -> tuple[str, ...] | None:
        """Ask the operator for the feet in the air; the default answer is ``planned``.

        Returns:
            Names of the feet; None if the operator skips the stand.
        """
        foot_names = {foot.lower(): foot for foot in feet}
        while True:
            default = " ".join(planned) or "none"
            prompt = _format_line(text("record-feet"))
            answer: str = click.prompt(prompt, default=default, err=True)
            words = answer.replace(",", " ").lower().split()
            if words == ["s"]:
                return None
            if words == ["none"] or all(word in foot_names for word in words):
                return tuple(foot_names[word] for word in words if word != "none")
            valid = text("record-valid-feet", feet=Name(" ".join(feet)))
            click.echo(_format_line(valid), err=True)

    def stops(self) -> bool:
        """Return True if a key was pressed since the last read; False without a terminal."""
        if not sys.stdin.isatty():
            return False
        # Terminals buffer lines; without buffering a key is available at once.
        settings = termios.tcgetattr(sys.stdin)
        unbuffered = [*settings[:3], settings[3] & ~(termios.ICANON | termios.ECHO), *settings[4:]]
        termios.tcsetattr(sys.stdin, termios.TCSANOW, unbuffered)
        try:
            pressed = bool(select.select([sys.stdin], [], [], 0)[0])
            if pressed:
                termios.tcflush(sys.stdin, termios.TCIFLUSH)
        finally:
            termios.tcsetattr(sys.stdin, termios.TCSANOW, settings)
        return pressed


class TypedBridge(WallClock):
    """Bridge to a robot that a person commands by other means; the positions are typed.

    Args:
        robot: Robot.
    """

    ramps = False

    def __init__(self, robot: Robot) -> None:
        shown = (READ_IN[unit] for unit in list_position_units(robot))
        self._joints = [
            (name, *units) for name, units in zip(robot.joint_names, shown, strict=True)
        ]

    def read(self) -> tuple[float, Array]:
        """Prompt for the joint positions in deg or mm.

        Returns:
            Time [s]; joint positions in actuator order, shape (nu,) [rad, m].
        """
        positions = [
            click.prompt(
                _format_line(text("record-position", joint=Name(name), unit=unit)),
                type=float,
                err=True,
            )
            / scale
            for name, scale, unit in self._joints
        ]
        return self.now(), np.array(positions)

    def send(self, command: Array) -> None:
        """Print the commanded joint positions, shape (nu,) [rad, m], in deg or mm."""
        for (name, scale, unit), value in zip(self._joints, command.tolist(), strict=True):
            shown = f"{scale * value:.3f}"
            line = text("record-command", joint=Name(name), value=shown, unit=unit)
            click.echo(_format_line(line), err=True)

    def close(self) -> None:
        """Do nothing: typed positions need no connection."""


def open_typed(robot: Robot, _: str) -> tuple[TypedBridge, Terminal]:
    """Open a bridge with joint positions that a person types, and an operator at the terminal.

    The second argument (``ARGUMENTS`` of ``NAME:ARGUMENTS``) is ignored.

    Returns:
        Bridge; operator.
    """
    return TypedBridge(robot), Terminal()
