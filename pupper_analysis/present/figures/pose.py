"""The figure of how a robot stands, from the right and from above: its links, and what holds it.

Both are the same drawing in two parallel projections.
"""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from pupper_analysis.present.figures import drawing
from pupper_analysis.present.scene import StandingScene, describe_scene
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import shapely
from numpy.typing import ArrayLike

from pupper_analysis.robot.contact import foot_site

Array = NDArray[np.float64]

BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


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

    def points(self) -> Array:
        """Returns all points (n, 3) (m)."""
        return np.concatenate([self.boxes.reshape(-1, 3), *self.legs.values()])


def draw_skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
    """Returns a robot as lines.

    Args:
        robot: The robot.
        qpos: (nq,) where it is.
    """
    model, data = robot.mj_model, robot.placed(qpos)
    base = model.body(robot.mj_base).id
    legs: dict[str, Array] = {}
    for foot, (_, frame) in robot.description.contact_points.items():
        body, position = foot_site(model, frame, robot.name)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        legs[foot] = np.array([*_joints_to(model, data, base, body), tip])
    geoms = np.flatnonzero(model.geom_bodyid == base)
    drawn = geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX.value]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    boxes = []
    for geom in drawn if len(drawn) else geoms:
        centre, half_size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        boxes.append(data.geom_xpos[geom] + (centre + signs * half_size) @ rotation.T)
    return Skeleton(legs, np.array(boxes).reshape(-1, 8, 3))


def _joints_to(model: mujoco.MjModel, data: mujoco.MjData, base: int, body: int) -> list[Array]:
    """Returns where the joints (3,) are that move a body against the base, from the base on (m)."""
    points: list[Array] = []
    while body not in (base, 0):
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        points += [data.xanchor[joint].copy() for joint in reversed(joints)]
        body = int(model.body_parentid[body])
    return points[::-1]


def hull_corners(points: Iterable[Array]) -> Array:
    """Returns the corners (n, 2) of the convex hull of points (3,), seen from above (m)."""
    hull = shapely.MultiPoint([point[:2] for point in points]).convex_hull
    line = hull.exterior if hull.geom_type == "Polygon" else hull
    return np.array(line.coords)


def _seen_from(elevation: float, azimuth: float) -> Array:
    """Returns the projection (2, 3) to who is in that direction, to the right and upwards (deg)."""
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array(
        [
            (-math.sin(around), math.cos(around), 0.0),
            (-math.sin(up) * math.cos(around), -math.sin(up) * math.sin(around), math.cos(up)),
        ]
    )


_SIDES = ((_seen_from(16, -33), "from the front"), (_seen_from(90, 180), "from above"))
"""How it is seen: in space from the right; and with forward up, and left on the left."""

_ARROW = 0.35  # length of the largest force's arrow / length of the support polygon
_NEAR_COLOUR, _FAR_COLOUR = "#374151", "#A3AAB5"
_BASE_FACE, _BASE_EDGE = "#FBE3AE", "#7A5300"
_SUPPORT = "#CFE8F7"
_RING: dict[str, Any] = {"marker": "o", "ls": "", "mfc": "white"}
_COM: dict[str, Any] = {**_RING, "color": drawing.GREEN, "mew": 2.2, "ms": 8}
_SWING: dict[str, Any] = {**_RING, "color": drawing.BLACK, "mew": 1.6}
_PROJECTION: dict[str, Any] = {"color": drawing.GREEN, "marker": "x", "ls": "", "mew": 2.2, "ms": 7}


def write_pose_figure(
    robot: Robot, stand: Stand, statics: GravityCompensation, path: str | Path
) -> None:
    """Draws how a robot stands: legs, base, contact forces, com and support polygon.

    On the left in space, on the right from above.

    Args:
        robot: The robot.
        stand: How it stands.
        statics: What it takes.
        path: The PNG to write.

    Raises:
        OutputError: If the file cannot be written.
    """
    lines, seen = draw_skeleton(robot, stand.qpos), describe_scene(robot, stand, statics)
    figure = drawing.make_page_figure(f"{robot.name}: how it stands", 0.6 * drawing.PAGE_WIDTH)
    text = f"{stand.task}; mass {robot.total_mass:.2f} kg; minimum tangential contact forces"
    figure.text(0.012, 0.925, textwrap.fill(text, 120), size=drawing.FONT_SIZE, va="top")
    for place, (projection, side) in zip((0.01, 0.6), _SIDES, strict=True):
        axes = figure.add_axes((place, 0.09, 0.57 if place < 0.5 else 0.39, 0.74))
        _draw_stand(axes, projection, lines, stand, seen)
        _draw_forces(axes, projection, seen)
        drawing.title_panel(axes, side)
        axes.set_axis_off()
    leg: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": drawing.BLACK, "ms": 4}
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_NEAR_COLOUR, lw=3, **leg, label="leg"),
        Line2D([], [], color=drawing.BLACK, marker="o", ls="", ms=6, label="foot"),
        *([Line2D([], [], **_SWING, label="swing foot")] if stand.task.swing else []),
        Patch(facecolor=_BASE_FACE, edgecolor=_BASE_EDGE, label="base"),
        Line2D([], [], color=drawing.RED, marker=r"$\uparrow$", ls="", ms=9, label="contact force"),
        Line2D([], [], **_COM, label="com"),
        Line2D([], [], **_PROJECTION, label="com's projection"),
        Patch(facecolor=_SUPPORT, edgecolor=drawing.BLUE, hatch="//", label="support polygon"),
    ]
    drawing.add_legend(figure, handles)
    drawing.save_figure(figure, path)


def _draw_stand(
    axes: Axes, projection: Array, lines: Skeleton, stand: Stand, seen: StandingScene
) -> None:
    """Draws a robot that stands, its com and ground, in a projection (2, 3)."""

    def line(points: Array, *marks: str, **how: Any) -> None:
        axes.plot(*(projection @ np.atleast_2d(points).T), *marks, **how)

    for box in lines.boxes:
        outline = hull_corners(box @ projection.T)
        base = Polygon(outline, fc=_BASE_FACE, ec=_BASE_EDGE, alpha=0.4, lw=0.8, zorder=3)
        axes.add_patch(base)
    support: dict[str, Any] = {"fc": _SUPPORT, "ec": drawing.BLUE, "hatch": "//", "zorder": 1}
    axes.add_patch(Polygon(seen.polygon @ projection.T, alpha=0.7, lw=1.2, **support))
    hips = np.array([leg[0] for leg in lines.legs.values()])
    # Feet with several contact points have smaller marks.
    small = 1.0 if len(seen.contacts) >= len(seen.contact_positions) else 0.45
    for foot, leg in lines.legs.items():
        # The viewer stands on the right: the legs of that side hide the base, it hides the others.
        near = leg[0, 1] < hips[:, 1].mean()
        order = 4 if near else 2
        colour = _NEAR_COLOUR if near else _FAR_COLOUR
        line(leg, color=colour, lw=4, solid_capstyle="round", zorder=order)
        line(leg[:-1], "o", color="white", mec=drawing.BLACK, mew=0.8, ms=4, zorder=order)
        mark = _SWING if foot in stand.task.swing else {"color": drawing.BLACK, "marker": "o"}
        line(leg[-1], **mark, ms=7 * small, zorder=order)
    around = hips[np.argsort(np.arctan2(*(hips - hips.mean(axis=0))[:, :2].T))]
    line(np.concatenate([around, around[:1]]), color=_BASE_EDGE, lw=2.2, zorder=3)
    line(np.array([seen.com, seen.com_projection]), color=drawing.GREEN, ls="--", lw=1.2, zorder=6)
    line(seen.com, **_COM, zorder=6)
    line(seen.com_projection, **_PROJECTION, zorder=6)
    axes.set_aspect("equal")
    axes.margins(0.06)


def _draw_forces(axes: Axes, projection: Array, seen: StandingScene) -> None:
    """Draws the contact forces as arrows that end at the feet, in a projection (2, 3)."""
    largest = max(float(np.linalg.norm(one.force)) for one in seen.contacts)
    scale = _ARROW * float(np.ptp(seen.polygon[:, :2], axis=0).max()) / largest
    arrow = {"arrowstyle": "-|>", "color": drawing.RED, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    for one in seen.contacts:
        tail = one.point - scale * one.force
        tip, end = (tuple(projection @ place) for place in (one.point, tail))
        axes.annotate("", tip, end, zorder=7, arrowprops=arrow)
        axes.plot(*end, alpha=0.0)  # so that there is room for it
