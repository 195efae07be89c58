"""Soles of several points move as one body: what of their slips is left."""

from __future__ import annotations

import numpy as np

from pupper_analysis.stance.sag.equilibrium import Anchor, rigid_slips

PLACES = {"a/1": (0.1, 0.0, 0.0), "a/2": (-0.1, 0.0, 0.0), "b": (0.0, 0.3, 0.0)}
SOLES = {"a/1": "a", "a/2": "a", "b": "b"}


def test_two_points_of_a_sole_cannot_part() -> None:
    anchors = {name: Anchor(np.array(place), np.eye(3)) for name, place in PLACES.items()}
    whole = rigid_slips(anchors, SOLES, dict.fromkeys(PLACES, np.eye(3)))
    assert whole is not None

    def left(slips: list[tuple[float, float]]) -> np.ndarray:
        return np.asarray(np.tensordot(whole, np.array(slips), 2))

    np.testing.assert_allclose(
        left([(1, 0), (-1, 0), (2, 3)]), [(0, 0), (0, 0), (2, 3)], atol=1e-12
    )
    for way in ([(1, 2), (1, 2), (0, 0)], [(0, 1), (0, -1), (0, 0)]):  # along, and turning
        np.testing.assert_allclose(left(way), way, atol=1e-12)
