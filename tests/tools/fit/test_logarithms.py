"""Logarithms: there and back, their slopes, and a robot that nobody weighed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import Linearised, estimate_parameters
from pupper_analysis.tools.fit.logarithms import Logarithms
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable

Array = NDArray[np.float64]

MASS = Parameter("mass", "base", "", 2.0, 1.0)
OFFSET = Parameter("offset", "knee", "", 0.0, 0.03)
FRICTION = Parameter("friction", "knee", "", 0.1, 0.1)


def test_they_lead_back_and_have_the_slopes_of_finite_differences() -> None:
    logarithms = Logarithms(ParameterTable((MASS, OFFSET, FRICTION)))
    x = np.array([3.0, -0.02, 0.05])
    y = logarithms.of_parameters(x)
    assert logarithms.to_parameters(y) == pytest.approx(x)
    step = 1e-6
    slopes = (logarithms.to_parameters(y + step) - logarithms.to_parameters(y - step)) / (2 * step)
    assert logarithms.rates(y) == pytest.approx(slopes, rel=1e-6)
    assert y[1:] == pytest.approx(x[1:])  # what is off by an amount stays as it is


def test_twice_and_half_are_as_far_away_and_nothing_of_a_mass_is_below_zero() -> None:
    table = ParameterTable((MASS, FRICTION))
    logarithms = Logarithms(table)
    twice, half = (logarithms.of_parameters(np.array([x, 0.1]))[0] - 2.0 for x in (4.0, 1.0))
    assert twice == pytest.approx(-half)
    assert logarithms.to_parameters(np.array([-20.0, 0.1]))[0] > 0
    assert logarithms.least.tolist() == [-np.inf, 0.0]


def test_what_is_told_by_ratios_alone_is_drawn_to_no_side() -> None:
    """Twelve kp by their ratio to one mass: to 0.8 and 1.25 of it, as many each.

    The stated scale is the most probable one, by symmetry of factors. Of normal distributions it
    is 5 % less: what differs by a share differs by less if all is less.
    """
    factors = np.repeat([0.8, 1.25], 6)
    parameters = (
        Parameter("mass", "base", "", 1.0, 0.15),
        *(Parameter("kp", f"joint {joint}", "", 1.0, 0.15) for joint in range(12)),
    )
    table = ParameterTable(parameters)
    logarithms = Logarithms(table)

    def told(x: Array) -> Linearised:
        rows = np.column_stack([-x[1:] / x[0] ** 2, np.eye(12) / x[0]])
        return Linearised.of((x[1:] / x[0] - factors) / 1e-4, rows / 1e-4)

    def by_logarithms(y: Array, _: Array) -> Linearised:
        return logarithms.linearise(told(logarithms.to_parameters(y)), y)

    found = estimate_parameters(table, by_logarithms, least=logarithms.least)
    posterior = logarithms.of_posterior(found)
    assert posterior.mean == pytest.approx([1.0, *factors], abs=1e-3)
    # What is not known of it, of each in proportion.
    assert posterior.std / posterior.mean == pytest.approx(np.full(13, found.std[0]), rel=1e-3)
    assert posterior.shares == pytest.approx(found.shares)
    plain = estimate_parameters(table, lambda x, _: told(x))
    assert plain.mean[0] < 0.96
