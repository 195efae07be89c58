"""What scenes draw: the ground under a place, and contact forces from the ground up."""

from __future__ import annotations

import numpy as np

from pupper_analysis.present.scene import height_at


def test_the_height_of_a_plane_at_a_place() -> None:
    places = np.array([[0.2, 0.1], [-0.2, 0.1], [0.1, -0.3], [-0.1, -0.1]])
    points = np.column_stack([places, 0.5 + 0.1 * places[:, 0] - 0.4 * places[:, 1]])
    for x, y in ((0.0, 0.0), (0.3, -0.2)):
        np.testing.assert_allclose(height_at(points, np.array([x, y])), 0.5 + 0.1 * x - 0.4 * y)
