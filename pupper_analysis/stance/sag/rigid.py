"""Slips of contact points as those of the rigid soles that have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.stance.sag.solution import Anchor

Array = NDArray[np.float64]


class RigidSoles:
    """Slips of contact points, (n, 2, ...), with those of each sole as one body's.

    A sole is rigid: its points slip along the ground by what moves and turns it. What is left of
    their slips, micrometres by which it tilts, would have them rub against each other as hard as
    friction lets them, which creeps away at once.

    Args:
        soles: {point: the foot that has it}.
        frame: (3, 3) rotation from the world to the ground's frame.
    """

    def __init__(self, soles: Mapping[str, str], frame: Array) -> None:
        self._soles, self._frame = soles, frame
        self._found: tuple[tuple[str, ...], Array | None] | None = None

    def slips(self, anchors: Mapping[str, Anchor], slips: Array) -> Array:
        """Returns slips (n, 2, ...) of the points that touch, soles as one body.

        Args:
            anchors: {point that touches: where it did so first}.
            slips: (n, 2, ...) of each by itself.
        """
        key = tuple(anchors)
        if self._found is None or self._found[0] != key:
            self._found = key, rigid_slips(anchors, self._soles, self._frame)
        whole = self._found[1]
        return slips if whole is None else np.asarray(np.tensordot(whole, slips, 2), dtype=float)


def rigid_slips(
    anchors: Mapping[str, Anchor], soles: Mapping[str, str], frame: Array
) -> Array | None:
    """Returns the projection (n, 2, n, 2) of slips on those of rigid soles; None without soles.

    A sole moves along the ground and turns on it: three of the ways in which its points can slip.

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
