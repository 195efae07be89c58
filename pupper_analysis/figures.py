"""Figures of an analysis, as PNG files. No pyplot: no window, and nobody's backend is touched."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import mujoco
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import FuncFormatter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.robot import Robot, foot_site

if TYPE_CHECKING:
    from pupper_analysis.analysis import Analysis

Array = NDArray[np.float64]

DPI = 180
FONT = 8  # pt

# Okabe and Ito's colours, which the colour-blind can tell apart.
BLUE, ORANGE, GREEN, RED, SKY, BLACK, GREY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#56B4E9",
    "#000000",
    "#6B7280",
)

_WIDTH = 178 / 25.4  # inch: a page's text
_COLUMNS = 3
_LEAST_UTILISATION = 0.1  # %, where the axis of the torques ends
_BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


# ------------------------------------------------------------------------------------- geometry


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot as lines, by MuJoCo's kinematics of the MJCF. In the world (m).

    Attributes:
        legs: {foot: (n, 3)} the joints from base to foot, and last the centre of the foot's sphere.
        boxes: (n, 8, 3) corners of the boxes of the base: of its box geoms or, if it has none, of
            those around its geoms. Corner 4 i + 2 j + k has the signs i, j, k along the edges.
    """

    legs: dict[str, Array]
    boxes: Array


def skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
    """Returns a robot as lines.

    Args:
        robot: The robot.
        qpos: (nq,) where it is.
    """
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, np.asarray(qpos, dtype=float))
    mujoco.mj_kinematics(model, data)
    base = model.body(robot.mj_base).id
    legs: dict[str, Array] = {}
    for foot, (_, frame) in robot.description.feet.items():
        body, position = foot_site(model, frame, robot.name)
        points = [data.xpos[body] + data.xmat[body].reshape(3, 3) @ position]
        while body not in (base, 0):
            first = int(model.body_jntadr[body])
            joints = range(first, first + int(model.body_jntnum[body]))
            points += [data.xanchor[joint] for joint in reversed(joints)]
            body = int(model.body_parentid[body])
        legs[foot] = np.array(points[::-1])
    geoms = np.flatnonzero(model.geom_bodyid == base)
    drawn = geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX.value]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    boxes = []
    for geom in drawn if len(drawn) else geoms:
        centre, half_size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        boxes.append(data.geom_xpos[geom] + (centre + signs * half_size) @ rotation.T)
    return Skeleton(legs, np.array(boxes).reshape(-1, 8, 3))


def support_polygon(points: Mapping[str, Array]) -> Array:
    """Returns the corners (n, 2) of the convex hull of contact points, seen from above (m)."""
    hull = shapely.MultiPoint([point[:2] for point in points.values()]).convex_hull
    line = hull.exterior if hull.geom_type == "Polygon" else hull
    return np.array(line.coords)


def nearest_edge_point(polygon: Array, place: Array) -> Array:
    """Returns the point (2,) on a polygon's edge (n, 2) that is nearest to a place (2,) (m)."""
    edge = shapely.LineString(polygon) if len(polygon) > 1 else shapely.Point(polygon[0])
    nearest = shapely.shortest_line(shapely.Point(place), edge)
    return np.array(nearest.coords[-1])


# ------------------------------------------------------------------------------------- figures


def pose_figure(robot: Robot, analysis: Analysis, path: Path) -> None:
    """Draws how a robot stands: legs, base, contact forces, com and support polygon.

    On the left in space; on the right from above, with the com's margin to the polygon's edge.

    Args:
        robot: The robot.
        analysis: Its analysis; ``stand`` and ``statics`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If the file cannot be written.
    """
    lines = skeleton(robot, analysis.stand.qpos)
    statics = analysis.statics
    figure = Figure(figsize=(_WIDTH, 0.6 * _WIDTH), dpi=DPI)
    figure.text(
        0.02, 0.955, f"{analysis.name}: stand", size=FONT + 3, weight="bold", parse_math=False
    )
    figure.text(
        0.02,
        0.915,
        f"base {1e3 * analysis.stand.qpos[robot.nq - robot.nu - 5]:.1f} mm above the ground, "
        f"mass {robot.total_mass:.2f} kg, "
        f"contact forces of least motor torque",
        size=FONT,
        color=GREY,
    )
    _draw_in_space(figure, robot, lines, statics)
    _draw_from_above(figure, lines, statics)
    _save(figure, path)


def _draw_in_space(figure: Figure, robot: Robot, lines: Skeleton, statics: Any) -> None:
    axes: Any = figure.add_axes((-0.04, -0.05, 0.72, 1.02), projection="3d", computed_zorder=False)
    axes.view_init(elev=16, azim=-52)
    axes.set_proj_type("ortho")
    towards_viewer = np.array([math.cos(math.radians(-52)), math.sin(math.radians(-52)), 0.0])
    points = statics.contact_points
    polygon = 1e3 * np.column_stack([support_polygon(points), np.zeros(len(support_polygon(points)))])
    com = 1e3 * statics.center_of_mass

    axes.add_collection3d(
        Poly3DCollection([polygon], facecolor=SKY, alpha=0.35, edgecolor=BLUE, lw=1.2, zorder=1)
    )
    middle = np.mean([leg[0] for leg in lines.legs.values()], axis=0)
    for foot, leg in lines.legs.items():
        x, y, z = 1e3 * leg.T
        near = (leg[0] - middle) @ towards_viewer > 0
        order = 5 if near else 2
        axes.plot(x, y, z, color="#374151" if near else "#9CA3AF", lw=4.5, zorder=order,
                  solid_capstyle="round", solid_joinstyle="round")
        axes.plot(x[:-1], y[:-1], z[:-1], "o", color="white", mec=BLACK, mew=0.8, ms=4, zorder=order)
        axes.plot(x[-1:], y[-1:], z[-1:], "o", color=BLACK, ms=7, zorder=order)
    for box in lines.boxes:
        faces = [1e3 * box[list(face)] for face in _BOX_FACES]
        axes.add_collection3d(
            Poly3DCollection(faces, facecolor=ORANGE, alpha=0.25, edgecolor="#7A5300", lw=0.9, zorder=3)
        )

    largest = max(float(np.linalg.norm(force)) for force in statics.contact_forces.values())
    length = 0.45 * max(float(com[2]), 1.0) / largest
    for foot, force in statics.contact_forces.items():
        tip = 1e3 * points[foot]
        tail = tip - length * force
        axes.quiver(*tail, *(tip - tail), color=RED, lw=1.8, arrow_length_ratio=0.22, zorder=6)
        label = axes.text(
            *tail, f"{foot}\n{np.linalg.norm(force):.2f} N", size=FONT, color=RED, zorder=8,
            ha="center", va="top", parse_math=False,
        )
        label.set_linespacing(1.1)
    axes.plot(*zip(com, (com[0], com[1], 0.0), strict=True), color=GREEN, ls=(0, (3, 2)), lw=1.4, zorder=7)
    axes.plot(*com[:, None], "o", color="white", mec=GREEN, mew=2.0, ms=8, zorder=7)
    axes.plot(*com[:, None], "+", color=GREEN, mew=1.4, ms=7, zorder=7)
    axes.plot(com[:1], com[1:2], [0.0], "x", color=GREEN, mew=2.2, ms=7, zorder=7)

    _fit_in_space(axes, lines, polygon)
    figure.legend(
        handles=[
            Line2D([], [], color="#374151", lw=3.5, marker="o", mfc="white", mec=BLACK, ms=4, label="leg, joints"),
            Patch(facecolor=ORANGE, alpha=0.5, edgecolor="#7A5300", label="base"),
            Line2D([], [], color=RED, marker=r"$\uparrow$", ls="", ms=9, label="contact force"),
            Line2D([], [], color=GREEN, marker="o", mfc="white", mew=2, ms=7, ls="--", label="com, projection ×"),
            Patch(facecolor=SKY, alpha=0.5, edgecolor=BLUE, label="support polygon"),
        ],
        loc="lower left", bbox_to_anchor=(0.0, 0.0), ncols=5, fontsize=FONT, frameon=False,
        handletextpad=0.5, columnspacing=1.4,
    )


def _fit_in_space(axes: Any, lines: Skeleton, polygon: Array) -> None:
    everything = 1e3 * np.concatenate([*lines.legs.values(), lines.boxes.reshape(-1, 3)])
    everything = np.concatenate([everything, polygon])
    low, high = everything.min(axis=0) - 15, everything.max(axis=0) + 15
    low[2] = 0.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.98)
    for axis, name in ((axes.xaxis, "x, forward"), (axes.yaxis, "y, left"), (axes.zaxis, "z, up")):
        axis.set_major_locator(matplotlib.ticker.MultipleLocator(100))
        axis.set_tick_params(labelsize=FONT, pad=-1)
        axis.set_label_text(f"{name} (mm)", fontsize=FONT)
        axis.labelpad = 2
        axis.set_pane_color((0.97, 0.97, 0.98, 1.0))
        axis._axinfo["grid"].update(color="#D8DCE3", linewidth=0.5)


def _draw_from_above(figure: Figure, lines: Skeleton, statics: Any) -> None:
    axes = figure.add_axes((0.73, 0.2, 0.25, 0.62))
    axes.set_title("from above", size=FONT + 1)
    polygon = 1e3 * support_polygon(statics.contact_points)
    axes.add_patch(
        Polygon(polygon, facecolor=SKY, alpha=0.35, edgecolor=BLUE, hatch="....", lw=0)
    )
    # Forward is up, left is left.
    axes.plot(*polygon.T, color=BLUE)
    _save


def _save(figure: Figure, path: Path) -> None:
    pass
