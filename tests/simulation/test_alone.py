"""Search for the largest payload with position commands alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.tool import find_place, with_payload
from pupper_analysis.simulation.alone import find_mass_by_commands_alone
from pupper_analysis.simulation.verify import SETTLED_DRIFT
from tests.support.stubs import Stub
from tests.support.variants import load


class Simulations:
    """Simulations of a robot whose base sinks at a rate that depends on the payload [kg]."""

    def __init__(self, rate: Callable[[float], float], breaking_mass: float = 1e9) -> None:
        self.rate, self.breaking_mass = rate, breaking_mass
        self.masses: list[float] = []

    def __call__(self, mass: float) -> Any:
        self.masses.append(mass)
        drift = -self.rate(mass)
        passed = abs(drift) < SETTLED_DRIFT and mass < self.breaking_mass
        return Stub(
            passed=passed, stays=passed, is_lifted=False, collapses=False, height_drift=drift
        )


@pytest.mark.parametrize(
    ("rate", "breaking_mass", "limit", "most"),
    [
        (lambda mass: 2.5e-4 + 2.3e-5 * mass, 1e9, 2.5 / 0.23, 6),
        (lambda mass: 1e-4 + 1e-6 * mass**2, 1e9, 20.0, 8),
        (lambda mass: 1e-4 + 4e-12 * mass**5, 1e9, 1e8**0.2, 12),
        (lambda _: 1e-5, 37.3, 37.3, 8),
        (lambda _: 1e-5, 0.4, 0.4, 13),
        (lambda _: 1e-5, 0.01, 0.01, 14),
        (lambda mass: 1e-4 + 1e-5 * mass, 12.34, 12.34, 9),
    ],
    ids=["linear", "quadratic", "steep", "contact", "small", "zero", "contact before drift"],
)
def test_mass_is_found_within_the_tolerance(
    rate: Callable[[float], float], breaking_mass: float, limit: float, most: int
) -> None:
    """References: the mass at which the rate is 0.5 mm/s, or at which the robot breaks down."""
    simulations = Simulations(rate, breaking_mass)
    found = find_mass_by_commands_alone(simulations, 60.0, 0.024, 0.02)  # type: ignore[arg-type]
    assert found <= limit <= found + max(0.024, 0.02 * found) + 1e-9
    assert found in simulations.masses
    assert len(simulations.masses) <= most


@pytest.mark.parametrize("is_solvable", [True, False])
def test_payload_is_zero_if_commands_alone_do_not_hold_the_unloaded_robot(
    is_solvable: bool,
) -> None:
    """Without payload, the robot sinks too fast, or (not ``is_solvable``) there is no stand."""
    simulations = Simulations(lambda _: 1e-3)

    def simulate(mass: float) -> Any:
        """Return a failing simulation, or None as if there were no stand."""
        run = simulations(mass)
        return run if is_solvable else None

    assert find_mass_by_commands_alone(simulate, 60.0, 0.024, 0.02) == 0.0
    assert 0.0 in simulations.masses
    assert len(simulations.masses) <= 3


@pytest.mark.slow
def test_simulation_until_failure_has_no_nudge_after_a_failure() -> None:
    """Reference: the complete simulation, which also fails.

    v3 with 3.6 kg creeps by 0.7 mm/s without gravity compensation.
    """
    robot = load("v3")
    loaded = with_payload(robot, 3.6, find_place(robot, (0.0, 0.0, 0.0)))
    stand = pa.solve_stand_as_simulated(loaded)
    short = pa.verify_stand(loaded, stand, feedforward=False, until_failure=True)
    full = pa.verify_stand(loaded, stand, feedforward=False)
    assert not short.passed
    assert not full.passed
    assert (short.stays, short.height_drift) == (full.stays, full.height_drift)
    assert short.nudge is None
    assert full.nudge is not None
    assert len(short.motion_time) < len(full.motion_time)
