"""The document of a conversion states a recovery only if the robot recovers within the simulated
time.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pupper_analysis.tools.convert.document import _describe_recovery


def conversion(frequency: float, damping_ratio: float, left: float, *, stands: bool = True) -> Any:
    mode = SimpleNamespace(frequency=frequency, damping_ratio=damping_ratio)
    nudge = SimpleNamespace(speed=1e-3, duration=12.0, left=left)
    stability = SimpleNamespace(least_damped=mode)
    kept = SimpleNamespace(failures=(), stability=stability, nudge=nudge)
    return SimpleNamespace(kept=kept, verification=SimpleNamespace(passed=stands))


@pytest.mark.parametrize(
    ("frequency", "damping_ratio", "left", "start"),
    [
        # SpotMicro with links of 1000 kg m^2: 1 / (2 pi 0.018 0.0036) = 2456 s to 1/e
        (0.018, 0.0036, 7e-4, "DOES NOT RECOVER within the simulated 12 s"),
        (0.018, 0.0036, 1e-6, "RECOVERS"),  # dry friction has stopped it
        (3.0, 0.05, 7e-4, "RECOVERS"),
    ],
)
def test_recovery_is_stated_only_if_it_is_faster_than_the_simulation(
    frequency: float, damping_ratio: float, left: float, start: str
) -> None:
    """Closed form: the time to 1/e is 1 / (2 pi frequency damping ratio) [s]; the simulation has 12
    s.
    """
    (line,) = _describe_recovery(conversion(frequency, damping_ratio, left))
    assert str(line.en).startswith(start)


def test_recovery_is_not_stated_of_a_robot_that_does_not_stand() -> None:
    assert not list(_describe_recovery(conversion(3.0, 0.05, 1e-6, stands=False)))
