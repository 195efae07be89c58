"""With what a stand was simulated, as its results say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.results import Result

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SimulationSettings(Result):
    """What a stand was simulated with.

    Attributes:
        feedforward: Whether ctrl = q* + tau / kp (otherwise ctrl = q*).
        integrator: MuJoCo's integrator.
        timestep: s.
        duration: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
    """

    feedforward: bool
    integrator: str
    timestep: float
    duration: float
    kp: Array
    kd: Array
