"""Heights of the ground that pictures draw under a stand."""

from __future__ import annotations

import numpy as np

from pupper_analysis.present.scene import evaluate_plane_height


def test_height_at_a_place_is_that_of_the_plane_through_the_points() -> None:
    """The plane is z = 0.5 + 0.1 x - 0.4 y, in m."""
    places = np.array([[0.2, 0.1], [-0.2, 0.1], [0.1, -0.3], [-0.1, -0.1]])
    points = np.column_stack([places, 0.5 + 0.1 * places[:, 0] - 0.4 * places[:, 1]])
    for x, y in ((0.0, 0.0), (0.3, -0.2)):
        height = evaluate_plane_height(points, np.array([x, y]))
        np.testing.assert_allclose(height, 0.5 + 0.1 * x - 0.4 * y)
