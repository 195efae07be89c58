"""What was simulated, to be looked at at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class PlayedMotion:
    """What was simulated.

    Attributes:
        times: (n,) of its samples (s).
        motion: (n, nq) configurations.
    """

    times: Any
    motion: Any

    @property
    def duration(self) -> float:
        """How long it lasts (s)."""
        return float(self.times[-1] - self.times[0])

    def at(self, seconds: float) -> Any:
        """Returns the configuration (nq,) at a time (s) after its begin."""
        return interpolate_motion(self.times - self.times[0], self.motion, seconds)


def interpolate_motion(times: Any, motion: Any, at: float) -> Any:
    """Returns a configuration (nq,) of a motion (n, nq) at a time, between its samples."""
    after = int(np.clip(np.searchsorted(times, at), 1, len(times) - 1))
    before = after - 1
    share = (at - times[before]) / (times[after] - times[before])
    one, other = motion[before].copy(), motion[after].copy()
    if one[3:7] @ other[3:7] < 0:  # the same rotation, on the nearer side
        other[3:7] *= -1
    qpos = one + np.clip(share, 0.0, 1.0) * (other - one)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos
