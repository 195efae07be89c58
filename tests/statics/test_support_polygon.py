"""The support polygon against shapely's convex hull: sides, distances, and which side is inside."""

from __future__ import annotations

import numpy as np
import shapely

from pupper_analysis.statics.support_polygon import com_margin, polygon_sides, support_polygon


def test_sides_and_margins_equal_the_convex_hull_of_shapely() -> None:
    """Reference: shapely's convex hull of random contacts, and distances to its edge."""
    random = np.random.default_rng(0)
    for count in (3, 4, 6, 12):
        contacts = random.uniform(-0.3, 0.3, (count, 3))
        hull = shapely.MultiPoint(contacts[:, :2]).convex_hull
        corners = support_polygon(contacts)
        sides = polygon_sides(contacts)
        assert len(sides) == count
        assert len(np.unique(sides, axis=0)) == len(corners)
        inside = np.array(hull.centroid.coords[0])
        for place in (inside, *random.uniform(-0.4, 0.4, (20, 2)), *(corners + inside) / 2):
            point = shapely.Point(place)
            distance = hull.exterior.distance(point) * (1 if hull.contains(point) else -1)
            least = float((sides[:, :2] @ place + sides[:, 2]).min())
            assert (least > 0) == (distance > 0)
            if distance > 0:
                np.testing.assert_allclose(least, distance, atol=1e-12)
            points = {str(index): contact for index, contact in enumerate(contacts)}
            margin = com_margin(np.append(place, 0.2), points)
            np.testing.assert_allclose(margin, distance, atol=1e-12)
