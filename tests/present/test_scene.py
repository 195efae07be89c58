"""What scenes draw: the ground under a place, and contact forces from the ground up."""

from __future__ import annotations

import numpy as np

from pupper_analysis.present.scene import Contact, height_at
from pupper_analysis.tools.live.scene import force_arrows
from tests.support.variants import load


def test_the_height_of_a_plane_at_a_place() -> None:
    places = np.array([[0.2, 0.1], [-0.2, 0.1], [0.1, -0.3], [-0.1, -0.1]])
    points = np.column_stack([places, 0.5 + 0.1 * places[:, 0] - 0.4 * places[:, 1]])
    for x, y in ((0.0, 0.0), (0.3, -0.2)):
        np.testing.assert_allclose(height_at(points, np.array([x, y])), 0.5 + 0.1 * x - 0.4 * y)


def test_arrows_begin_on_the_ground_and_point_as_forces_do() -> None:
    point, force = np.array([0.1, 0.2, 0.0]), np.array([1.0, -2.0, 8.0])
    ((begin, end),) = force_arrows(load("v3"), [Contact("FL", point, force)])
    np.testing.assert_array_equal(begin, point)
    along = end - begin
    np.testing.assert_allclose(np.cross(along, force), 0.0, atol=1e-15)
    assert along @ force > 0
