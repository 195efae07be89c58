"""Left and right: which names are each other's mirror image, and in which plane."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pupper_analysis.models.stated.model import Array, RobotModel

_SIDES = (
    *(("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")),
    *(("FL", "FR"), ("RL", "RR"), ("HL", "HR"), ("BL", "BR"), ("LF", "RF"), ("LH", "RH")),
    *(("fl", "fr"), ("rl", "rr"), ("hl", "hr"), ("bl", "br"), ("lf", "rf"), ("lh", "rh")),
    *(("L", "R"), ("l", "r")),
)
_OPPOSITE_SIDE = {a: b for left, right in _SIDES for a, b in ((left, right), (right, left))}
_WORD = re.compile("left|right|Left|Right|LEFT|RIGHT")
_SIDE_PATTERN = re.compile(
    rf"(?<![A-Za-z])({'|'.join(sorted(_OPPOSITE_SIDE, key=len, reverse=True))})(?![A-Za-z])"
    "|^[LR](?=[A-Z][a-z])"
)

NOT_MIRRORED = re.compile("gripper|finger|camera|imu|sensor", re.IGNORECASE)
"""Parts that are mounted as they are, or turned, on both sides."""


def mirror_name(name: str) -> str:
    """Returns a name with left and right exchanged, wherever it says so."""
    pattern = _WORD if _WORD.search(name) else _SIDE_PATTERN
    return pattern.sub(lambda match: _OPPOSITE_SIDE[match[0]], name)


def mirror_pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """Returns the pairs of names that differ only in saying left and right, in their order."""
    known = dict.fromkeys(names)
    pairs: dict[str, str] = {}
    for name in known:
        other = mirror_name(name)
        if (
            other != name
            and other in known
            and other not in pairs
            and not NOT_MIRRORED.search(name)
        ):
            pairs[name] = other
    return list(pairs.items())


@dataclass(frozen=True, eq=False)
class Mirror:
    """The plane between left and right, normal to one of the base's axes.

    Attributes:
        axis: 0, 1 or 2: which; 1 (y) by the usual convention.
        offset: Where it cuts that axis (m).
    """

    axis: int
    offset: float

    @property
    def matrix(self) -> Array:
        """The reflection S = S^T (3, 3) of vectors."""
        matrix = np.eye(3)
        matrix[self.axis, self.axis] = -1.0
        return matrix

    def point(self, point: Array) -> Array:
        """Returns the mirror image of a point (3,) in the base frame (m)."""
        image: Array = self.matrix @ point
        image[self.axis] += 2 * self.offset
        return image


def mirror_plane(robot: RobotModel, tolerance: float = 1e-3) -> Mirror | None:
    """Finds the plane in which most pairs of bodies are mirror images of each other at zero angles.

    Returns:
        The plane; None if a third of the pairs, or more, is not explained by any.
    """
    pairs = mirror_pairs(robot.links)
    if not pairs:
        return None
    left = np.array([robot.links[name].pose.position for name, _ in pairs])
    right = np.array([robot.links[name].pose.position for _, name in pairs])
    best, most = None, 0
    for axis in (1, 0, 2):
        for offset in (0.0, float(np.median(left[:, axis] + right[:, axis])) / 2):
            mirror = Mirror(axis, offset)
            images = np.array([mirror.point(point) for point in left])
            away = np.abs(left[:, axis] - right[:, axis]) > tolerance
            close = np.linalg.norm(images - right, axis=1) < tolerance
            agreeing = int(np.sum(close & away))
            if agreeing > most:
                best, most = mirror, agreeing
    return best if 3 * most >= len(pairs) else None
