"""Balls at the ends of legs: a sphere that is fitted to points has their centre and radius."""

from __future__ import annotations

import numpy as np
import pytest

from pupper_analysis.prepare.contact_points import fit_sphere


def test_a_sphere_far_from_the_origin_is_found() -> None:
    centre, radius, down = np.array([0.4, -0.3, 0.2]), 0.021, np.array([0.0, 0.0, -1.0])
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    points = centre + radius * directions / np.linalg.norm(directions, axis=1)[:, None]
    found, size = fit_sphere(points, centre + radius * down, down)
    np.testing.assert_allclose(found, centre, atol=1e-9)
    assert size == pytest.approx(radius, abs=1e-9)
