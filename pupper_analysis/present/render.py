"""Rendered pictures of standing robots: MuJoCo off screen or, without OpenGL, line drawings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.figures.skeleton import BOX_FACES, hull_corners
from pupper_analysis.present.figures.style import save_figure
from pupper_analysis.present.opengl import GROUND, render_tiles
from pupper_analysis.present.tiles import LABEL, Tile, tiles_of
from pupper_analysis.robot.joints import leg_lengths
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]
_DPI = 100


@dataclass(frozen=True)
class Picture:
    """A picture that has been written.

    Attributes:
        path: The PNG.
        method: Who drew it: ``egl``, ``osmesa``, ``glfw`` or ``cgl`` (OpenGL), or ``lines``.
        note: Why it is a line drawing, if it is one.
    """

    path: Path
    method: str
    note: str | None


def render_robot(robot: Robot, qpos: ArrayLike, path: str | Path, *, width: int = 1000) -> Picture:
    """Renders one robot.

    Args:
        robot: The robot.
        qpos: (nq,) where it is.
        path: The PNG to write.
        width: Of the picture (pixels).

    Returns:
        What was written. Without OpenGL it is a line drawing, and the note says why.

    Raises:
        ConfigurationError: If ``width`` is out of range.
        OutputError: If the file cannot be written.
    """
    return _picture([(robot, np.array(qpos, dtype=float))], Path(path), width, columns=1)


def render_variants(
    robots_and_stands: Sequence[tuple[Robot, Stand]],
    path: str | Path,
    *,
    width: int = 1500,
    columns: int = 3,
) -> Picture:
    """Renders robots standing side by side, to one scale, with names, leg lengths and masses.

    Args:
        robots_and_stands: The robots, each with its stand.
        path: The PNG to write.
        width: Of the picture (pixels).
        columns: Robots in a row.

    Returns:
        What was written. Without OpenGL it is a line drawing, and the note says why.

    Raises:
        ConfigurationError: If there is no robot, or ``width`` or ``columns`` is out of range.
        OutputError: If the file cannot be written.
    """
    poses = [(robot, stand.qpos) for robot, stand in robots_and_stands]
    return _picture(poses, Path(path), width, columns)


def _picture(poses: Sequence[tuple[Robot, Array]], path: Path, width: int, columns: int) -> Picture:
    if not poses:
        raise ConfigurationError("robots_and_stands", diagnose("no-robot-to-draw"))
    if not 200 <= width <= 4096:
        raise ConfigurationError(
            "width", diagnose("pixels-out-of-range", pixels=width, least=200, most=4096)
        )
    if columns < 1:
        raise ConfigurationError("columns", diagnose("not-positive", value=columns))
    tiles = tiles_of(poses, width, min(columns, len(poses)))
    images, method, note = render_tiles(tiles)
    width = max(tile.left + tile.width for tile in tiles)
    height = max(tile.top + tile.height for tile in tiles)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=GROUND)
    canvas = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
    canvas.set_axis_off()
    if images:
        picture = np.full((height, width, 3), images[0][0, 0])
        for tile, image in zip(tiles, images, strict=True):
            picture[tile.top :, tile.left :][: tile.height, : tile.width] = image
        figure.figimage(picture, origin="upper")
    for tile in tiles:
        if not images:
            _draw_lines(canvas, tile)
        _write_label(canvas, tile)
    save_figure(figure, path)
    return Picture(path, method, note)


def _write_label(canvas: Axes, tile: Tile) -> None:
    robot = tile.robot
    # Letters that fit the tile, in points.
    size = 0.03 * tile.width * 72 / _DPI
    x, y = tile.left + tile.width / 2, tile.top + tile.height - (LABEL + 0.02) * tile.width
    legs = sum(length or 0.0 for length in leg_lengths(robot))
    numbers = f"legs {1e3 * legs:.0f} mm, mass {robot.total_mass:.2f} kg"
    below = y + 2.0 * size * _DPI / 72
    common: dict[str, Any] = {"ha": "center", "va": "top", "parse_math": False}
    canvas.text(x, y, robot.name, size=1.35 * size, weight="bold", color="#1F2937", **common)
    canvas.text(x, below, numbers, size=size, color="#4B5563", **common)


def _draw_lines(canvas: Axes, tile: Tile) -> None:
    """Draws a robot as lines, in the projection of the rendered picture."""
    lines = tile.lines
    thick = 0.035 * tile.width * 72 / _DPI
    legs = np.array([leg[[0, -1]] for leg in lines.legs.values()])
    feet = hull_corners(legs[:, -1])
    ground = tile.pixels(np.column_stack([feet, np.zeros(len(feet))]))
    canvas.fill(*ground.T, color="#DDE2E9", zorder=1)
    for leg in lines.legs.values():
        # The camera is on the right: the legs of that side hide the base, it hides the others.
        near = leg[0, 1] < legs[:, 0, 1].mean()
        order, colour = (4, "#374151") if near else (2, "#9CA3AF")
        seen = tile.pixels(leg).T
        canvas.plot(*seen, color=colour, lw=thick, solid_capstyle="round", zorder=order)
        canvas.plot(*seen[:, -1:], "o", color="#111827", ms=2 * thick, zorder=order)
    for box in lines.boxes:
        for face in BOX_FACES:
            corners = tile.pixels(box[list(face)]).T
            canvas.fill(*corners, fc="#F3C453", ec="#7A5300", alpha=0.6, lw=thick / 10, zorder=3)
