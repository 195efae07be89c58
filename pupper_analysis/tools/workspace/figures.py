"""The figure of how far a robot's base can go with its feet planted."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pupper_analysis.present.figures import drawing
from pupper_analysis.present.figures.pose import Skeleton, draw_skeleton, hull_corners
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.workspace import BaseWorkspace, solve_stand_at

Array = NDArray[np.float64]

_VIEWS = {
    "height": ("from the right", 0, 2),
    "roll": ("from behind", 1, 2),
    "pitch": ("from the right", 0, 2),
    "yaw": ("from above", 1, 0),
    "x": ("from the right", 0, 2),
    "y": ("from behind", 1, 2),
}
"""{direction: where it is seen from, which axes are drawn to the right (y: to the left) and up}."""

_AXES = ("x, forward (mm)", "y, left (mm)", "z, up (mm)")
_END_COLOURS = {"low": drawing.BLUE, "high": drawing.RED}


def workspace_figure(robot: Robot, workspace: BaseWorkspace, path: str | Path) -> None:
    """Draws the robot at both ends of every direction of its workspace, over where it started.

    Args:
        robot: The robot.
        workspace: Its workspace.
        path: The PNG to write.

    Raises:
        OutputError: If the file cannot be written.
    """
    title = f"{robot.name}: how far the base can go with its feet planted, each way alone"
    figure = drawing.page_figure(title, 0.68 * drawing.WIDTH, layout="constrained")
    start = workspace.start
    panels = figure.subplots(2, 3).flat
    for axes, (direction, interval) in zip(panels, workspace.intervals.items(), strict=True):
        view, across, up = _VIEWS[direction]
        low, high = interval.low, interval.high
        if direction in ("roll", "pitch", "yaw"):
            title = f"{math.degrees(low):+.1f}° to {math.degrees(high):+.1f}°"
        elif direction == "height":
            title = f"{1e3 * low:.1f} to {1e3 * high:.1f} mm"
        else:
            title = f"{1e3 * low:+.1f} to {1e3 * high:+.1f} mm"
        drawing.title_panel(axes, f"{direction}: {title}")
        drawn = [draw_skeleton(robot, start.qpos)]
        _draw(axes, drawn[0], drawing.GREY, across, up)
        for end, value in (("low", low), ("high", high)):
            drawn.append(draw_skeleton(robot, solve_stand_at(robot, start, direction, value).qpos))
            _draw(axes, drawn[-1], _END_COLOURS[end], across, up)
        shown = 1e3 * np.concatenate([lines.points() for lines in drawn])
        if up == 2:
            _draw_ground(axes, start.task.ground, shown[:, across], across)
        axes.set_aspect("equal")
        if across == 1:
            axes.invert_xaxis()
        axes.set_xlabel(f"{_AXES[across]}; {view}", size=drawing.FONT)
        axes.set_ylabel(_AXES[up], size=drawing.FONT)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
    names = {"start": drawing.GREY, "least value": drawing.BLUE, "greatest value": drawing.RED}
    drawing.put_legend(
        figure, [Line2D([], [], color=color, lw=2, label=name) for name, color in names.items()]
    )
    drawing.save_figure(figure, path)


def _draw(axes: Axes, lines: Skeleton, color: str, across: int, up: int) -> None:
    for box in lines.boxes:
        outline = 1e3 * hull_corners(box[:, [across, up]])
        axes.fill(outline[:, 0], outline[:, 1], fc=color, ec=color, alpha=0.15, lw=0)
        axes.plot(*np.vstack([outline, outline[:1]]).T, color=color, lw=0.8)
    for leg in lines.legs.values():
        points = 1e3 * leg[:, [across, up]]
        axes.plot(points[:, 0], points[:, 1], color=color, lw=1.3, solid_capstyle="round")
        axes.plot(*points[-1], "o", color=color, ms=3)


def _draw_ground(axes: Axes, ground: Ground, shown: Array, across: int) -> None:
    """Draws the plane, which passes through the world's origin, as a line."""
    ends = np.array([shown.min(), shown.max()])
    places = np.zeros((2, 2))
    places[:, across] = ends
    axes.plot(ends, [ground.height(place) for place in places], color="black", lw=0.8)
