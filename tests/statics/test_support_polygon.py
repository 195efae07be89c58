"""The support polygon against shapely's convex hull: sides, distances, and which side is inside."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from pupper_analysis.statics.support_polygon import (
    SIDES,
    com_margin,
    find_extreme_positions,
    polygon_sides,
    support_polygon,
)


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


def test_a_region_is_not_empty_if_the_program_of_a_single_direction_fails() -> None:
    """Reference: the region of the same contacts, rotated about the vertical by half a step.

    In the third of these sets of contacts, Clarabel found no solution in one of 48 directions.
    """
    random, half = np.random.default_rng(5), np.pi / SIDES
    turn = np.array(
        [[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1.0]]
    )
    compared = 0
    for number in range(59):
        count = int(random.integers(2, 6))
        points, normals = random.uniform(-0.3, 0.3, (count, 3)), random.normal(size=(count, 3))
        normals[:, 2] = np.abs(normals[:, 2]) * random.uniform(0, 2)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        friction = random.uniform(0.1, 1.2, count)
        if number < 54:  # the other sets are drawn, but not evaluated
            continue
        no_limits = np.zeros((0, 4))
        areas = [
            shapely.MultiPoint(
                find_extreme_positions(points @ way.T, normals @ way.T, friction, None, no_limits)
            ).convex_hull.area
            for way in (np.eye(3), turn)
        ]
        assert areas[0] == pytest.approx(areas[1], rel=0.05, abs=1e-6)
        compared += areas[0] > 1e-4
    assert compared >= 2
