"""Slips of contact points as those of the rigid soles that have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.stance.sag.solution import Anchor

Array = NDArray[np.float64]


def rigid_slips(
    anchors: Mapping[str, Anchor], soles: Mapping[str, str], frame: Array
) -> Array | None:
    """Returns the projection (n, 2, n, 2) of slips on those of rigid soles; None without soles.

    A sole is rigid: its points slip along the ground by what moves and turns it. What is left of
    their slips, micrometres by which it tilts, would have them rub against each other as hard as
    friction lets them, which creeps away at once.

    Args:
        anchors: {point that touches: where it did so first}.
        soles: {point: the foot that has it}.
        frame: (3, 3) rotation from the world to the ground's frame.
    """
    rows: dict[str, list[int]] = {}
    for row, point in enumerate(anchors):
        rows.setdefault(soles[point], []).append(row)
    shared = [own for own in rows.values() if len(own) > 1]
    if not shared:
        return None
    size = len(anchors)
    whole: Array = np.eye(2 * size).reshape(size, 2, size, 2)
    places = np.array([anchor.place for anchor in anchors.values()]) @ frame.T
    for own in shared:
        x, y = (places[own, :2] - places[own, :2].mean(axis=0)).T
        ways = np.zeros((len(own), 2, 3))
        ways[:, 0, 0] = ways[:, 1, 1] = 1.0
        ways[:, 0, 2], ways[:, 1, 2] = -y, x
        flat = ways.reshape(-1, 3)
        part = (flat @ np.linalg.pinv(flat)).reshape(len(own), 2, len(own), 2)
        whole[np.ix_(own, range(2), own, range(2))] = part
    return whole
