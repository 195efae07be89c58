"""Most probable parameters, compared with closed forms of linear, curved and bounded problems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pupper_analysis.base.errors import FitError
from pupper_analysis.tools.fit.estimate import (
    LinearisedResiduals,
    Posterior,
    estimate_parameters,
)
from pupper_analysis.tools.fit.motions.rollouts import MomentCoordinates
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable

Array = np.ndarray


def table(*kinds: str) -> ParameterTable:
    """Parameters about 2, 3 ..., of widths 0.5, 0.7 ..."""
    return ParameterTable(
        Parameter(kind, f"part {place}", "", 2.0 + place, 0.5 + 0.2 * place)
        for place, kind in enumerate(kinds)
    )


def make_linear_problem(size: int, rows: int = 40) -> tuple[Array, Array]:
    """Return whitened rows A and right sides b of A x = b, with noise of variance 1."""
    random = np.random.default_rng(3)
    rows_of = random.normal(size=(rows, size))
    return rows_of, rows_of @ random.uniform(1, 4, size) + random.normal(size=rows)


def test_estimate_of_linear_residuals_solves_the_normal_equations() -> None:
    """Reference: normal equations in closed form.

    Half of the prior variance of the kp is common to all joints.
    """
    given = table("kp", "kp", "offset")
    rows, right = make_linear_problem(3)
    found = estimate_parameters(
        given, lambda x, _: LinearisedResiduals.from_residuals(rows @ x - right, rows)
    )
    common = np.array([[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]])
    prior = np.linalg.inv(common * np.outer(given.width, given.width))
    covariance = np.linalg.inv(rows.T @ rows + prior)
    mean = covariance @ (rows.T @ right + prior @ given.stated)
    assert found.mean == pytest.approx(mean, rel=1e-9)
    assert found.covariance == pytest.approx(covariance, rel=1e-9)
    assert found.interval[0] == pytest.approx(
        mean[0] + 1.959964 * np.sqrt(covariance[0, 0]) * np.array([-1, 1]), rel=1e-6
    )
    assert found.chi2 == pytest.approx(((rows @ mean - right) ** 2).sum())
    off = mean - given.stated
    assert found.moved == pytest.approx(off / given.width)
    trace = np.trace(covariance @ rows.T @ rows)
    assert found.degrees_of_freedom == pytest.approx(40 - trace)
    assert found.variance_ratios == pytest.approx(np.diag(covariance) / given.width**2)


def test_estimate_without_measurements_is_the_prior() -> None:
    """Reference: stated values and widths; half of the prior variance of the kp is common."""
    given = table("kp", "kp", "mass")
    found = estimate_parameters(given, lambda _, __: LinearisedResiduals.empty(3))
    prior = Posterior.from_prior(given)
    common = np.array([[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]])
    for estimate in (found, prior):
        assert estimate.mean == pytest.approx(given.stated)
        assert estimate.variance_ratios == pytest.approx([1, 1, 1])
        assert estimate.covariance == pytest.approx(common * np.outer(given.width, given.width))


@pytest.mark.parametrize("kind", ["mass", "kp", "friction", "damping", "armature", "delay", "lag"])
def test_bounded_parameter_stops_at_zero_and_others_stay_optimal(kind: str) -> None:
    """Unbounded, the value is -3. Reference: the optimum of the offset with a value of zero."""
    given = table(kind, "offset")
    rows = np.array([[10.0, 6.0], [0.0, 5.0], [3.0, -4.0]])
    right = rows @ [-3.0, 2.0]
    found = estimate_parameters(
        given, lambda x, _: LinearisedResiduals.from_residuals(rows @ x - right, rows)
    )
    weight = 1 / given.width[1] ** 2
    alone = (rows[:, 1] @ right + weight * given.stated[1]) / (rows[:, 1] @ rows[:, 1] + weight)
    assert found.mean == pytest.approx([0.0, alone], abs=1e-6)


def test_several_bounds_are_fixed_and_released_as_the_cost_requires() -> None:
    """Half of the parameters are bounded and coupled. Reference: scipy's interior-point solver of
    the same bounded problem, and a case in which a step beyond both bounds must release one.
    """
    random = np.random.default_rng(0)
    problems = [random.normal(size=(8, 6)) * random.uniform(0.3, 3, 6) for _ in range(30)]
    problems.append(np.array([[100.0, -99.0], [0.0, 14.1]]))
    for rows in problems:
        size = rows.shape[1]
        given = table(*(["damping", "friction"] * size)[:size])
        right = rows @ (np.array([-0.5, -4.0]) if size == 2 else 3 * random.normal(size=size))
        # Rows whose squares sum up to z^T P z, z = (x - x0) / width: P = L L^T.
        prior = np.linalg.cholesky(given.precision).T / given.width
        reference = lsq_linear(
            np.vstack([rows, prior]),
            np.concatenate([right, prior @ given.stated]),
            (0, np.inf),
            method="trf",
            tol=1e-14,
        ).x
        found = estimate_parameters(
            given,
            lambda x, _, a=rows, b=right: LinearisedResiduals.from_residuals(a @ x - b, a),
        )
        assert found.mean == pytest.approx(reference, abs=1e-3)


def test_stalled_minimisation_gives_a_wide_interval() -> None:
    """A wrong derivative predicts a decrease by 4 % of the cost, and no step realises it.

    Closed form: variance of the undamped step added to the posterior variance. By default the limit
    is 1 % of the cost.
    """
    given = ParameterTable([Parameter("offset", "x", "", 0.0, 1.0)])

    def linearise(x: Array, _: Array) -> LinearisedResiduals:
        left = np.array([3.0 + 0.1 * np.abs(x[0]), 13.0])
        return LinearisedResiduals.from_residuals(left, np.array([[-2.0], [0.0]]))

    found = estimate_parameters(given, linearise, stall_rtol=0.1)
    assert found.covariance[0, 0] == pytest.approx(1 / 5 + (6 / 5) ** 2)
    assert found.unrealised_decrease == pytest.approx(6**2 / 5)
    with pytest.raises(FitError):
        estimate_parameters(given, linearise)


def test_extra_cost_moves_the_minimum() -> None:
    """Closed form: the minimum of x^2 - 2 a x is at a."""
    given = ParameterTable([Parameter("offset", "x", "", 0.0, 1.0)])

    def linearise(x: Array, _: Array) -> LinearisedResiduals:
        return LinearisedResiduals(
            np.zeros((1, 1)), np.array([-0.7]), 0.0, 0, extra_cost=-1.4 * x[0]
        )

    assert estimate_parameters(given, linearise).mean == pytest.approx([0.7])


def evaluate_rosenbrock(x: Array) -> tuple[Array, Array]:
    """Return the residuals 10 (y - x^2) and 1 - x of Rosenbrock's function, and their
    derivative.
    """
    return (
        np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    )


WIDE = ParameterTable(
    [Parameter("offset", "x", "", -1.2, 1e4), Parameter("offset", "y", "", 1.0, 1e4)]
)


def test_curved_valley_is_followed_to_the_minimum() -> None:
    """Reference: minimum of Rosenbrock's function at (1, 1)."""
    found = estimate_parameters(
        WIDE,
        lambda x, _: LinearisedResiduals.from_residuals(*evaluate_rosenbrock(x)),
        min_decrease=1e-8,
    )
    assert found.mean == pytest.approx([1, 1], abs=1e-5)


def test_intervals_are_widened_if_no_step_reduces_the_cost() -> None:
    """A derivative of the wrong sign: the cost rises whichever way it goes."""
    given = ParameterTable([Parameter("offset", "x", "", 0.0, 1.0)])

    def linearise(x: Array, _: Array) -> LinearisedResiduals:
        left = np.array([3.0 + 0.1 * np.abs(x[0]), 100.0])
        return LinearisedResiduals.from_residuals(left, np.array([[0.5], [0.0]]))

    found = estimate_parameters(given, linearise)
    assert found.covariance[0, 0] == pytest.approx(1 / 1.25 + (1.5 / 1.25) ** 2)


@pytest.mark.parametrize("left", [np.nan, np.inf])
def test_residual_that_is_not_finite_does_not_converge(left: float) -> None:
    rows = np.array([[1.0]])
    with pytest.raises(FitError):
        estimate_parameters(
            table("kp"), lambda _, __: LinearisedResiduals.from_residuals(np.array([left]), rows)
        )


def test_first_moments_convert_to_masses_and_coms_and_back() -> None:
    """Closed form m c = m c0 + m0 (y - c0), and a finite difference of the conversion."""
    given = ParameterTable(
        [
            Parameter("com", "bar", "x", 0.1, 0.03),
            Parameter("mass", "bar", "", 2.0, 1.0),
            Parameter("com", "bar", "z", -0.2, 0.03),
            Parameter("com", "lamp", "x", 0.4, 0.03),
            Parameter("kp", "turn", "", 5.0, 1.5),
        ]
    )
    moments = MomentCoordinates(given)
    x = np.array([0.13, 2.6, -0.17, 0.42, 6.0])
    y = moments.from_parameters(x)
    assert moments.to_parameters(y) == pytest.approx(x)
    assert moments.from_parameters(given.stated) == pytest.approx(given.stated)
    # m c = m c0 + m0 (y - c0): at twice the mass the same coordinate is half as far off.
    assert x[1] * x[0] == pytest.approx(x[1] * 0.1 + 2.0 * (y[0] - 0.1))
    # The mass of the lamp is no parameter, so that its coordinates are unchanged.
    assert y[3:] == pytest.approx(x[3:])
    step = 1e-6
    jacobian = np.column_stack(
        [(moments.to_parameters(y + step * unit) - x) / step for unit in np.eye(5)]
    )
    assert moments.differentiate_parameters(y) == pytest.approx(jacobian, abs=1e-5)
    y[1] = 0.01  # 0.5 % of the stated mass: the conversion uses 1 %
    start = moments.to_parameters(y)
    jacobian = np.column_stack(
        [(moments.to_parameters(y + step * unit) - start) / step for unit in np.eye(5)]
    )
    assert moments.differentiate_parameters(y) == pytest.approx(jacobian, abs=1e-5)
