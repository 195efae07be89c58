"""Estimates that no body can have go to the nearest one that can, by the posterior's metric."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.fit.consistency import hull_of, make_consistent
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import Parameter

LINK = "base_link"


@pytest.fixture(scope="module")
def v3() -> pa.Robot:
    return pa.load_variant("v3")


def posterior(parameters: list[Parameter], mean: np.ndarray, covariance: np.ndarray) -> Posterior:
    return Posterior(
        tuple(parameters), mean, covariance, np.eye(len(mean)), np.eye(len(mean)), 0.0, 0.0, 0, 1
    )


def of_base() -> list[Parameter]:
    stated = {"x": 0.025, "y": 0.0, "z": 0.015}
    return [
        Parameter("mass", LINK, "", 1.506, 0.75),
        *(Parameter("com", LINK, axis, value, 0.03) for axis, value in stated.items()),
    ]


def test_what_is_consistent_stays(v3: pa.Robot) -> None:
    mean = np.array([1.7, 0.03, 0.001, 0.02])
    found, messages = make_consistent(
        v3, posterior(of_base(), mean, np.diag([0.1, 0.01, 0.01, 0.01]))
    )
    assert np.array_equal(found, mean)
    assert not messages


def test_a_com_outside_of_its_link_is_brought_to_it_as_the_covariance_says(v3: pa.Robot) -> None:
    """One face holds it: x - C a (a x - b) / (a C a), which takes the mass along."""
    normals, reach = hull_of(v3, LINK)
    face = int(np.argmax(normals @ [0.0, 0.0, 1.0]))
    limit = reach[face] + 0.005
    spread = np.array([0.1, 0.01, 0.01, 0.02])
    covariance = np.diag(spread**2)
    covariance[0, 3] = covariance[3, 0] = 0.8 * spread[0] * spread[3]
    mean = np.array([1.5, 0.0, 0.0, limit + 0.01])
    found, messages = make_consistent(v3, posterior(of_base(), mean, covariance))
    np.testing.assert_allclose(found, mean - covariance[:, 3] * 0.01 / spread[3] ** 2, atol=1e-7)
    assert [one.code for one in messages] == ["com-held-in-hull", "estimate-moved"]
    assert messages[1].values["deviations"] == pytest.approx(0.5, rel=1e-4)


def test_hulls_are_around_what_mujoco_has(v3: pa.Robot) -> None:
    """A foot's sphere is inside and touches the face across z; what is beyond it is outside."""
    normals, reach = hull_of(v3, "leg_front_r_3")
    foot, radius = np.array([0.06231, -0.06216, 0.018]), 0.01995
    assert (normals @ foot + radius <= reach + 1e-9).all()
    below = int(np.argmin(normals[:, 2]))
    np.testing.assert_allclose(normals[below], (0.0, 0.0, -1.0), atol=1e-6)
    assert reach[below] == pytest.approx(radius - foot[2], abs=1e-4)
    assert (normals @ (2 * foot) > reach).any()


def test_a_mass_below_zero_is_none(v3: pa.Robot) -> None:
    mean = np.array([-0.4, 0.025, 0.0, 0.015])
    found, messages = make_consistent(
        v3, posterior(of_base(), mean, np.diag([0.5, 0.01, 0.01, 0.01]))
    )
    np.testing.assert_allclose(found, [0.01506, *mean[1:]], atol=1e-7)
    assert messages[0].code == "held-above-zero"
