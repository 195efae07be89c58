"""Stands at rest as they were measured: commands, positions, and what else was read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeasuredStands:
    """Stands at rest, one a row, with joints in a robot's actuator order. NaN is not measured.

    Attributes:
        source: Where they are from: a file, or ``predicted``.
        names: (m,) of the stands.
        joints: (n,) names of the joints.
        command: (m, n) commanded joint positions, as the servos have them (rad).
        position: (m, n) measured joint positions, as the encoders have them (rad).
        torque: (m, n) measured motor torques (N m).
        force: {foot: (m,)} normal force under a foot (N).
        tilt: (m, 2) roll and pitch of the base against the vertical, as an IMU has them (rad).
        swing: (m,) the feet that are in the air.
        approach: (m,) from which side it was come to rest: ``above``, ``below``, or empty.
    """

    source: str
    names: tuple[str, ...]
    joints: tuple[str, ...]
    command: Array
    position: Array
    torque: Array
    force: Mapping[str, Array]
    tilt: Array
    swing: tuple[tuple[str, ...], ...]
    approach: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)
