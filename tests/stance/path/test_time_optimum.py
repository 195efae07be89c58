"""The least time of a mass on a line: closed forms of bounded force, speed and jerk."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pupper_analysis.stance.path.geometry import minimum_jerk
from pupper_analysis.stance.path.time_optimum import (
    Demands,
    Grid,
    Optimum,
    free_grid,
    least_time,
    smooth_grid,
)

MASS, WAY = 2.0, 0.3
"""kg, m."""


def line(
    grid: Grid, force: float, *, drag: float = 0.0, speed: float = math.inf, rates: np.ndarray
) -> Demands:
    """A mass that a motor moves along a line: x = WAY s(u), |MASS x'' + drag| <= force.

    ``rates`` are ds/du and d2s/du2 at the places.
    """
    count = len(grid.speed)
    first, second = rates.T
    motors = np.zeros((count, 1, 3))
    motors[:, 0, 0], motors[:, 0, 1] = MASS * WAY * first / force, MASS * WAY * second / force
    motors[:, 0, 2] = drag / force
    with np.errstate(divide="ignore"):
        fastest = (speed / (WAY * first)) ** 2
    nothing = np.zeros((count, 0))
    return Demands(
        base=np.zeros((count, 0, 3)),
        base_forces=np.zeros((count, 0, 0)),
        motors=motors,
        motor_forces=np.zeros((count, 1, 0)),
        fastest=fastest,
        normals=np.zeros((0, 3)),
        friction=np.zeros(0),
        least=nothing,
        most=nothing,
    )


def free(force: float, *, drag: float = 0.0, speed: float = math.inf) -> Optimum:
    progress = np.linspace(0, 1, 129)
    grid = free_grid(np.array([minimum_jerk(x)[0] for x in progress]))
    guess = np.array([minimum_jerk(x)[1] for x in progress[::2]]) ** 2
    rates = np.tile([1.0, 0.0], (64, 1))
    found = least_time(grid, line(grid, force, drag=drag, speed=speed, rates=rates), guess)
    assert found is not None
    return found


def smooth(force: float, jerk: float) -> float:
    """By tangents, until they settle; ``jerk`` in m/s^3."""
    progress = np.linspace(0, 1, 65)
    along = np.array([minimum_jerk(x)[1:] for x in progress])
    grid, guess = smooth_grid(progress, along), np.full(33, 1.0)
    demands = line(grid, force, rates=along)
    for _ in range(10):
        found = least_time(grid, demands, guess, jerk=jerk / WAY)
        assert found is not None
        guess = found.square
    return found.seconds


@pytest.mark.parametrize("force", [0.5, 20.0])
def test_bounded_force_has_the_closed_forms_time(force: float) -> None:
    """Half of the way with all force forwards, half backwards: T = 2 sqrt(m d / F)."""
    found = free(force)
    assert found.seconds == pytest.approx(2 * math.sqrt(MASS * WAY / force), rel=1e-3)
    # T goes with F^-1/2: the price of the motor's limit, per its own size, is T/2.
    assert found.prices["torque"].sum() == pytest.approx(found.seconds / 2, rel=1e-2)
    assert found.prices["velocity"].sum() == pytest.approx(0, abs=1e-9)


def test_a_force_that_helps_one_way_only() -> None:
    """With (F - c)/m forwards and (F + c)/m backwards: T = sqrt(2 d (1/a + 1/b)) ."""
    there, back = (5.0 - 2.0) / MASS, (5.0 + 2.0) / MASS
    closed = math.sqrt(2 * WAY * (1 / there + 1 / back))
    assert free(5.0, drag=2.0).seconds == pytest.approx(closed, rel=1e-3)


def test_bounded_speed_has_the_closed_forms_time() -> None:
    """Up to v, on at v, and down: T = d/v + m v/F."""
    found = free(20.0, speed=1.0)
    assert found.seconds == pytest.approx(WAY / 1.0 + MASS * 1.0 / 20.0, rel=3e-3)
    # What T is less by, per relative increase of v, and of F.
    assert found.prices["velocity"].sum() == pytest.approx(WAY / 1.0 - MASS * 1.0 / 20.0, rel=1e-2)
    assert found.prices["torque"].sum() == pytest.approx(MASS * 1.0 / 20.0, rel=1e-2)


@pytest.mark.parametrize("rise", [0.05, 0.15])
def test_bounded_jerk_where_the_force_is_reached(rise: float) -> None:
    """With t_r = a/j that the acceleration takes to rise: T = t_r + sqrt(t_r^2 + 4 d/a)."""
    acceleration = 20.0 / MASS
    closed = rise + math.sqrt(rise**2 + 4 * WAY / acceleration)
    assert smooth(20.0, acceleration / rise) == pytest.approx(closed, rel=1e-2)


def test_bounded_jerk_alone() -> None:
    """T = (32 d / j)^(1/3), where the force is never reached."""
    assert smooth(1e3, 40.0) == pytest.approx((32 * WAY / 40.0) ** (1 / 3), rel=1e-2)


def test_what_cannot_be_held_has_no_time() -> None:
    progress = np.linspace(0, 1, 17)
    grid = free_grid(progress)
    demands = line(grid, 1.0, drag=1.5, rates=np.tile([1.0, 0.0], (8, 1)))
    assert least_time(grid, demands, np.ones(9)) is None
