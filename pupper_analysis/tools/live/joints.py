"""Sliders of joints: of an arm's, of a stand's posture, and of legs that hang."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.present.formats import escape_control
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import joint_ranges, joint_units

Array = NDArray[np.float64]

_SHOWN = {"rad": (180.0 / math.pi, "deg", math.pi), "m": (1e3, "mm", 1.0)}
"""{unit of a joint: (how many of what the page shows it is, what that is, the end of a slider of a
joint without limits)}."""

_STEP = 0.5
"""From notch to notch of a slider (deg, mm): half of what one tells apart on the page."""

_FINE = 2
"""Digits of a slider's value (deg, mm) where a program sets it."""

_DIGITS = 6
"""Of a position (rad, m): what is finer than a micrometre or microradian nobody types."""


class JointSliders:
    """A slider for each of some joints, in degrees, or in mm of those that slide.

    Args:
        gui: viser's interface of one page.
        robot: The robot.
        joints: Which.
        start: (nu,) where they are (rad, m).
        moved: Is told a joint and its position (rad, m) when somebody moves a slider.

    Attributes:
        sliders: {joint: viser's slider}.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        joints: Iterable[str],
        start: Array,
        moved: Callable[[str, float], None],
    ) -> None:
        self._moved = moved
        self.sliders: dict[str, Any] = {}
        self._scales: dict[str, float] = {}
        ranges, units = joint_ranges(robot), joint_units(robot)
        for name in joints:
            index = robot.joint_names.index(name)
            scale, unit, end = _SHOWN[units[index]]
            ends = np.clip(ranges[index], -end, end) * scale
            # Inwards, so that no end of a slider is beyond the joint's.
            low, high = math.ceil(ends[0] / _STEP) * _STEP, math.floor(ends[1] / _STEP) * _STEP
            value = float(np.clip(round(float(start[index]) * scale, _FINE), low, max(high, low)))
            name_and_unit = f"{escape_control(name)} ({unit})"
            slider = gui.add_slider(name_and_unit, low, max(high, low + _STEP), _STEP, value)
            slider.on_update(partial(self._by_hand, name))
            self.sliders[name], self._scales[name] = slider, scale
        self._begin = {name: slider.value for name, slider in self.sliders.items()}

    def _by_hand(self, joint: str, event: Any) -> None:
        if event.client is not None:  # what a program sets is known
            self._moved(joint, self._position(joint))

    def _position(self, joint: str) -> float:
        value = float(self.sliders[joint].value) / self._scales[joint]
        return round(value, _DIGITS) + 0.0  # never -0

    def positions(self) -> dict[str, float]:
        """Returns where all of these joints are told to be (rad, m)."""
        return {joint: self._position(joint) for joint in self.sliders}

    def changed(self) -> dict[str, float]:
        """Returns where those are told to be that are not where they began (rad, m)."""
        begin, sliders = self._begin, self.sliders
        return {n: p for n, p in self.positions().items() if sliders[n].value != begin[n]}

    def show(self, positions: Mapping[str, float]) -> None:
        """Moves sliders to where joints are (rad, m); the others to where they began."""
        for joint, slider in self.sliders.items():
            value = self._begin[joint]
            if joint in positions:
                value = round(positions[joint] * self._scales[joint], _FINE)
            value = min(max(value, slider.min), slider.max)
            if slider.value != value:
                slider.value = value


def led_joints(robot: Robot) -> tuple[str, ...]:
    """Returns the joints that follow no other, in actuator order."""
    follows = () if robot.closure is None else {int(one) for one in robot.closure.following}
    return tuple(name for index, name in enumerate(robot.joint_names) if index not in follows)
