"""Linear measurements whose posterior and combined estimates have closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from pupper_analysis.tools.fit.estimate import LinearisedResiduals, Posterior, estimate_parameters
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable
from pupper_analysis.tools.fit.result import (
    Determined,
    classify_determination,
    estimate_kp_over_mass,
)

Array = NDArray[np.float64]

MASS = Parameter("mass", "base", "", 2.0, 1.0)
KP = Parameter("kp", "knee", "", 4.0, 2.0)


def fit_linear(
    parameters: tuple[Parameter, ...], rows: Array, values: Array, noise: float
) -> Posterior:
    """Return the fit of linear measurements rows @ x = values, with the given noise."""
    table = ParameterTable(parameters)

    def linearise(x: Array, _: Array) -> LinearisedResiduals:
        return LinearisedResiduals.from_residuals((rows @ x - values) / noise, rows / noise)

    return estimate_parameters(table, linearise)


def test_ratio_is_determined_if_neither_parameter_is() -> None:
    """Reference: closed form. In prior widths z, the residual 2 m - kp is 2 (z_m - z_k).

    With noise s, the information about (z_m - z_k) / sqrt(2) is 8 / s^2, and about z_m + z_k zero:
    var(z_m) = (1 + v) / 2 with v = 1 / (1 + 8 / s^2). The logarithm of the ratio, here half of z_k
    - z_m, has the variance v / 2.
    """
    noise = 0.2
    found = fit_linear((MASS, KP), np.array([[2.0, -1.0]]), np.array([0.0]), noise)
    left = 1 / (1 + 8 / noise**2)
    np.testing.assert_allclose(found.variance_ratios, (1 + left) / 2, rtol=1e-9)
    np.testing.assert_allclose(found.mean, [2.0, 4.0], atol=1e-12)
    ratio, alone = estimate_kp_over_mass(found), estimate_kp_over_mass(found, kp_only=True)
    assert (ratio.mean, ratio.stated) == pytest.approx((1.0, 1.0))
    assert ratio.std == pytest.approx(math.sqrt(left / 2))
    assert ratio.determined is Determined.DATA
    assert [classify_determination(share) for share in (0.09, 0.11, 0.89, 0.91)] == [
        *(Determined.DATA, Determined.PARTLY),
        *(Determined.PARTLY, Determined.PRIOR),
    ]
    assert alone.std == pytest.approx(0.5 * math.sqrt((1 + left) / 2))
    # Of a servo that is half as stiff on a robot of the same mass.
    soft = fit_linear((MASS, KP), np.eye(2), np.array([2.0, 2.0]), 1e-6)
    assert estimate_kp_over_mass(soft).mean == pytest.approx(0.5, rel=1e-3)
    assert estimate_kp_over_mass(fit_linear((MASS,), np.eye(1), np.array([2.0]), 1.0)) is None
