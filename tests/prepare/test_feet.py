"""Fits of contact points."""

from __future__ import annotations

import numpy as np
import pytest

from pupper_analysis.prepare.contact_points import ContactPoint
from pupper_analysis.prepare.feet import Foot, have_contact_points_moved


@pytest.mark.parametrize(
    ("name", "geom", "displacement", "moved"),
    [
        ("FL", 3, 0.0, False),
        ("FL", 3, 5e-7, False),
        ("FL", 3, 1e-5, True),
        ("FL", 4, 1e-5, False),
        ("FR", 3, 1e-5, False),
    ],
)
def test_contact_points_have_moved_if_the_same_points_are_displaced(
    name: str, geom: int, displacement: float, moved: bool
) -> None:
    """Other feet or geoms are no displacement; displacements up to 1 um are none either."""

    def foot(name: str, geom: int, x: float) -> Foot:
        return Foot(name, 2, (ContactPoint(geom, np.array([x, 0.0, 0.0]), 0.02),))

    assert (
        have_contact_points_moved([foot("FL", 3, 0.0)], [foot(name, geom, displacement)]) is moved
    )
