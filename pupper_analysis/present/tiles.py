"""Where each robot of a picture is: to one scale, in a parallel projection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.present.figures.skeleton import Skeleton, draw_skeleton
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
ELEVATION, AZIMUTH = math.radians(20), math.radians(140)  # of the camera's line of sight
AHEAD = np.array([math.cos(AZIMUTH), math.sin(AZIMUTH), 0.0])
RIGHT = np.array([math.sin(AZIMUTH), -math.cos(AZIMUTH), 0.0])
UP = math.sin(ELEVATION) * AHEAD + math.cos(ELEVATION) * np.array([0.0, 0.0, 1.0])
SUN = np.array([-0.30, 0.24, -1.0])  # where the light that casts shadows goes
_GAP = 0.09  # around a robot, in tile widths
LABEL = 0.125  # for the text below it, in tile widths


@dataclass(frozen=True, eq=False)
class Tile:
    """The part of the picture that shows one robot, in a parallel projection.

    Attributes:
        robot: The robot.
        qpos: (nq,) where it is.
        lines: The same as lines.
        left: Where the tile begins (pixels from the picture's left edge).
        top: Likewise, from its top edge.
        width: Of the tile (pixels).
        height: Of the tile (pixels).
        scale: Pixels per metre.
        centre: (2,) what is in the tile's middle: m along ``RIGHT`` and ``UP``.
    """

    robot: Robot
    qpos: Array
    lines: Skeleton
    left: int
    top: int
    width: int
    height: int
    scale: float
    centre: Array

    def pixels(self, points: Array) -> Array:
        """Returns where points (n, 3) in the world are in the picture (n, 2), y downwards."""
        offset = self.scale * (project_points(points) - self.centre) * (1, -1)
        middle = (self.left + self.width / 2, self.top + self.height / 2)
        place: Array = middle + offset
        return place


def project_points(points: Array) -> Array:
    """Returns points (n, 3) in the plane of the picture (n, 2) (m)."""
    seen: Array = points @ np.array([RIGHT, UP]).T
    return seen


def tiles_of(poses: Sequence[tuple[Robot, Array]], width: int, columns: int) -> list[Tile]:
    """Gives each robot a tile: all to one scale, and those of a row on one line."""
    lines = [draw_skeleton(robot, qpos) for robot, qpos in poses]
    low, high = np.empty((len(poses), 2)), np.empty((len(poses), 2))
    for index, ((robot, _), line) in enumerate(zip(poses, lines, strict=True)):
        points = line.points()
        shadow = points - np.outer(points[:, 2] / SUN[2], SUN)
        seen = project_points(np.concatenate([points, shadow]))
        radius = max(robot.contact_radius.values())
        low[index], high[index] = seen.min(axis=0) - radius, seen.max(axis=0) + radius
    size = high - low
    tile_width = width // columns
    scale = (1 - 2 * _GAP) * tile_width / float(size[:, 0].max())
    gap, label = _GAP * tile_width / scale, LABEL * tile_width / scale
    tiles: list[Tile] = []
    top = 0
    for first in range(0, len(poses), columns):
        row = range(first, min(first + columns, len(poses)))
        extent = float(size[row, 1].max()) + 2 * gap + label
        height = round(extent * scale)
        for index in row:
            across = (low[index, 0] + high[index, 0]) / 2
            middle = np.array([across, low[index, 1] + extent / 2 - label - gap])
            left = (index - first) * tile_width
            tiles.append(
                Tile(*poses[index], lines[index], left, top, tile_width, height, scale, middle)
            )
        top += height
    return tiles
