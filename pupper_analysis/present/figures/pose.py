"""Figure of a robot in a stand: skeleton, contact forces, centre of mass and support polygon.

Both panels are parallel projections of the same lines: obliquely from the front right, and from
above.
"""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

from pupper_analysis.base.array_types import Array
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.scene import StandingScene, describe_scene
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import shapely
from numpy.typing import ArrayLike

from pupper_analysis.robot.contact import foot_site

BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corner indices of the six faces of a box, with the corners in the order of
``Skeleton.boxes``."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Lines that represent a robot, from MuJoCo's kinematics of the MJCF, in the world frame [m].

    Attributes:
        legs: {foot: points of shape (n, 3)}. The points are the joints from the base to the foot,
            then the contact point of the foot. If the foot has a contact sphere, the last point is
            the centre of the sphere.
        boxes: Corners of the boxes of the base, shape (n, 8, 3). The boxes are the box geoms of the
            base. Without box geoms, the boxes are the bounding boxes of all geoms of the base.
            Corner 4 i + 2 j + k has the signs i, j, k along the edges (0: negative side, 1:
            positive side).
    """

    legs: dict[str, Array]
    boxes: Array

    def points(self) -> Array:
        """Return all points of the skeleton, shape (n, 3) [m], expressed in the world frame.

        The first points are the corners of the boxes of the base, followed by the points of the
        legs.
        """
        return np.concatenate([self.boxes.reshape(-1, 3), *self.legs.values()])


def compute_skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
    """Compute the legs and the boxes of the base that a figure draws for a configuration.

    Args:
        robot: Robot.
        qpos: Configuration in MuJoCo's coordinates, shape (nq,).

    Returns:
        Points of each leg and corners of the boxes, expressed in the world frame [m].
    """
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    base = model.body(robot.mj_base).id
    legs: dict[str, Array] = {}
    for foot, (_, frame) in robot.description.contact_points.items():
        body, position = foot_site(model, frame, robot.name)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        legs[foot] = np.array([*_list_joint_positions(model, data, base, body), tip])
    geoms = np.flatnonzero(model.geom_bodyid == base)
    drawn = geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX.value]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    boxes = []
    for geom in drawn if len(drawn) else geoms:
        centre, half_size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        boxes.append(data.geom_xpos[geom] + (centre + signs * half_size) @ rotation.T)
    return Skeleton(legs, np.array(boxes).reshape(-1, 8, 3))


def _list_joint_positions(
    model: mujoco.MjModel, data: mujoco.MjData, base: int, body: int
) -> list[Array]:
    """Return the positions (3,) [m] of the joints between the base and a body, base first."""
    points: list[Array] = []
    while body not in (base, 0):
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        points += [data.xanchor[joint].copy() for joint in reversed(joints)]
        body = int(model.body_parentid[body])
    return points[::-1]


def hull_corners(points: Iterable[Array]) -> Array:
    """Compute the corners of the convex hull of points in the x-y plane, shape (n, 2) [m].

    If the hull is a polygon, the last corner is equal to the first. Points on a line give the two
    end points, equal points one corner.

    Args:
        points: Points, shape (2,) or (3,) [m]; z is ignored.
    """
    hull = shapely.MultiPoint([point[:2] for point in points]).convex_hull
    line = hull.exterior if hull.geom_type == "Polygon" else hull
    return np.array(line.coords)


def _make_projection(elevation: float, azimuth: float) -> Array:
    """Return the matrix of a parallel projection, shape (2, 3), from the world to the image.

    The rows are the image's right and up directions in world axes.

    Args:
        elevation: Angle of the viewer above the horizontal [deg]; at 90, the view is from above.
        azimuth: Horizontal angle of the viewer about z, counterclockwise from +x [deg]: at 0, the
            viewer is on the +x side.
    """
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array(
        [
            (-math.sin(around), math.cos(around), 0.0),
            (-math.sin(up) * math.cos(around), -math.sin(up) * math.sin(around), math.cos(up)),
        ]
    )


_PROJECTIONS = (
    (_make_projection(16, -33), "from the front"),
    (_make_projection(90, 180), "from above"),
)
"""Projection matrix and title of each panel. Seen from above, +x is up and +y is left."""

_MAX_ARROW_RATIO = 0.35
"""Length of the arrow of the largest force, relative to the length of the support polygon. Chosen,
not tuned."""
_NEAR_COLOUR, _FAR_COLOUR = "#374151", "#A3AAB5"
"""Colours of the legs on the side of the viewer, and on the other side of the base."""
_BASE_FILL_COLOUR, _BASE_EDGE_COLOUR = "#FBE3AE", "#7A5300"
"""Colours of the boxes of the base: faces, and edges with the polygon of the hips."""
_SUPPORT_COLOUR = "#CFE8F7"
"""Fill colour of the support polygon."""
_RING_STYLE: dict[str, Any] = {"marker": "o", "ls": "", "mfc": "white"}
"""Options of Matplotlib for a ring without a line."""
_COM_STYLE: dict[str, Any] = {**_RING_STYLE, "color": drawing.GREEN_COLOUR, "mew": 2.2, "ms": 8}
"""Options of Matplotlib for the mark of the centre of mass."""
_SWING_STYLE: dict[str, Any] = {**_RING_STYLE, "color": drawing.BLACK_COLOUR, "mew": 1.6}
"""Options of Matplotlib for the mark of a swing foot."""
_COM_PROJECTION_STYLE: dict[str, Any] = {
    "color": drawing.GREEN_COLOUR,
    "marker": "x",
    "ls": "",
    "mew": 2.2,
    "ms": 7,
}
"""Options of Matplotlib for the mark of the projected centre of mass."""


def write_pose_figure(
    robot: Robot, stand: Stand, statics: GravityCompensation, path: str | Path
) -> None:
    """Draw legs, base, contact forces, centre of mass and support polygon of a stand.

    The left panel is an oblique view, the right panel a view from above.

    Args:
        robot: Robot.
        stand: Stand.
        statics: Static equilibrium.
        path: PNG file.

    Raises:
        OutputError: If the file cannot be written.
    """
    drawing.save_figure(make_pose_figure(robot, stand, statics), path)


def make_pose_figure(
    robot: Robot,
    stand: Stand,
    statics: GravityCompensation,
    create: Callable[..., Figure] = Figure,
) -> Figure:
    """Draw a stand with contact forces in a new figure: oblique view, and view from above.

    Both panels show legs, base, contact forces, centre of mass and support polygon.

    Args:
        robot: Robot.
        stand: Stand.
        statics: Static equilibrium.
        create: Function that creates an empty figure: ``Figure``, or ``pyplot.figure`` for
            notebooks.
    """
    lines, seen = compute_skeleton(robot, stand.qpos), describe_scene(robot, stand, statics)
    title, height = f"{robot.name}: stance", 0.6 * drawing.PAGE_WIDTH
    figure = drawing.make_page_figure(title, height, create=create)
    text = f"{stand.task}; mass {robot.total_mass:.2f} kg; minimum tangential contact forces"
    figure.text(0.012, 0.925, textwrap.fill(text, 120), size=drawing.FONT_SIZE, va="top",
                parse_math=False)  # fmt: skip
    for place, (projection, side) in zip((0.01, 0.6), _PROJECTIONS, strict=True):
        axes = figure.add_axes((place, 0.09, 0.57 if place < 0.5 else 0.39, 0.74))
        _draw_stand(axes, projection, lines, stand, seen)
        _draw_forces(axes, projection, seen)
        largest = f", forces up to {_find_largest_force(seen):.3g} N" if place < 0.5 else ""
        drawing.title_panel(axes, f"{side}{largest}")
        axes.set_axis_off()
    _draw_scale(axes, seen)
    leg: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": drawing.BLACK_COLOUR, "ms": 4}
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_NEAR_COLOUR, lw=3, **leg, label="leg"),
        Line2D([], [], color=drawing.BLACK_COLOUR, marker="o", ls="", ms=6, label="foot"),
        *([Line2D([], [], **_SWING_STYLE, label="swing foot")] if stand.task.swing else []),
        Patch(facecolor=_BASE_FILL_COLOUR, edgecolor=_BASE_EDGE_COLOUR, label="base (boxes)"),
        Line2D(
            [],
            [],
            color=drawing.RED_COLOUR,
            marker=r"$\uparrow$",
            ls="",
            ms=9,
            label="contact force",
        ),
        Line2D([], [], **_COM_STYLE, label="CoM"),
        Line2D([], [], **_COM_PROJECTION_STYLE, label="projection of the CoM"),
        Patch(
            facecolor=_SUPPORT_COLOUR,
            edgecolor=drawing.BLUE_COLOUR,
            hatch="//",
            label="support polygon",
        ),
    ]
    drawing.add_legend(figure, handles)
    return figure


def make_skeleton_figure(
    robot: Robot, qpos: ArrayLike, create: Callable[..., Figure] = Figure
) -> Figure:
    """Draw the joints and links of a robot in a configuration, without forces, in two panels.

    Each line connects a joint, or the frame of a body at the end of a chain, with the next joint
    towards the base. The views are oblique and from above.

    Args:
        robot: Robot.
        qpos: Configuration in MuJoCo's coordinates, shape (nq,).
        create: Creates an empty figure from ``figsize``, ``dpi`` and ``layout``, such as ``Figure``
            or ``pyplot.figure``.
    """
    segments = _list_links(robot, qpos)
    title, height = f"{robot.name}: joints and links", 0.6 * drawing.PAGE_WIDTH
    figure = drawing.make_page_figure(title, height, create=create)
    for place, (projection, side) in zip((0.08, 0.6), _PROJECTIONS, strict=True):
        axes = figure.add_axes((place, 0.12, 0.46 if place < 0.5 else 0.36, 0.74))
        for segment in segments:
            axes.plot(*(projection @ segment.T) * 1e3, color=_NEAR_COLOUR, lw=3, zorder=2)
            axes.plot(*(projection @ segment[1]) * 1e3, "o", color="white",
                      mec=drawing.BLACK_COLOUR, mew=0.8, ms=5, zorder=3)  # fmt: skip
        drawing.title_panel(axes, side)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("horizontal (mm)" if place < 0.5 else "-y (mm)")
        axes.set_ylabel("vertical in the view (mm)" if place < 0.5 else "x (mm)")
    return figure


def _list_links(robot: Robot, qpos: ArrayLike) -> list[Array]:
    """Return the lines between successive joints of a robot, each of shape (2, 3) [m].

    The first point of a line is the joint nearer to the base, or the base frame. A chain ends at
    the frame of the last body. If a body has several joints, the first joint is used.
    """
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    base = model.body(robot.mj_base).id
    jointed = {
        body
        for body in range(1, model.nbody)
        if body != base and model.body_jntnum[body] and model.body_rootid[body] ==
        model.body_rootid[base]
    }  # fmt: skip
    parents = {int(model.body_parentid[body]) for body in range(1, model.nbody)}
    lines = []
    for body in range(1, model.nbody):
        if body not in jointed and (body in parents or body == base):
            continue
        ancestor = int(model.body_parentid[body])
        while ancestor not in jointed and ancestor not in (base, 0):
            ancestor = int(model.body_parentid[ancestor])
        if ancestor == 0 and base != 0:
            continue  # another object
        ends = [
            data.xanchor[model.body_jntadr[place]] if place in jointed else data.xpos[place]
            for place in (ancestor, body)
        ]
        lines.append(np.array(ends))
    return lines


def _draw_stand(
    axes: Axes, projection: Array, lines: Skeleton, stand: Stand, seen: StandingScene
) -> None:
    """Draw the parts of a stand other than forces, from the world frame [m] into axes.

    The parts are the boxes of the base, legs, support polygon, feet and centre of mass.
    ``projection`` is the matrix, shape (2, 3), from the world to the image.
    """

    def line(points: Array, *marks: str, **how: Any) -> None:
        """Draw a polyline through ``points``, shape (n, 3) [m], in the projection."""
        axes.plot(*(projection @ np.atleast_2d(points).T), *marks, **how)

    for box in lines.boxes:
        outline = hull_corners(box @ projection.T)
        base = Polygon(
            outline, fc=_BASE_FILL_COLOUR, ec=_BASE_EDGE_COLOUR, alpha=0.4, lw=0.8, zorder=3
        )
        axes.add_patch(base)
    support: dict[str, Any] = {
        "fc": _SUPPORT_COLOUR,
        "ec": drawing.BLUE_COLOUR,
        "hatch": "//",
        "zorder": 1,
    }
    axes.add_patch(Polygon(seen.polygon @ projection.T, alpha=0.7, lw=1.2, **support))
    hips = np.array([leg[0] for leg in lines.legs.values()])
    # Feet with several contact points have smaller marks.
    small = 1.0 if len(seen.contacts) >= len(seen.contact_positions) else 0.45
    for foot, leg in lines.legs.items():
        # The viewer is on the right: legs on this side are drawn over the base, the others below.
        near = leg[0, 1] < hips[:, 1].mean()
        order = 4 if near else 2
        colour = _NEAR_COLOUR if near else _FAR_COLOUR
        line(leg, color=colour, lw=4, solid_capstyle="round", zorder=order)
        line(leg[:-1], "o", color="white", mec=drawing.BLACK_COLOUR, mew=0.8, ms=4, zorder=order)
        mark = (
            _SWING_STYLE
            if foot in stand.task.swing
            else {"color": drawing.BLACK_COLOUR, "marker": "o"}
        )
        line(leg[-1], **mark, ms=7 * small, zorder=order)
    around = hips[np.argsort(np.arctan2(*(hips - hips.mean(axis=0))[:, :2].T))]
    line(np.concatenate([around, around[:1]]), color=_BASE_EDGE_COLOUR, lw=2.2, zorder=3)
    line(
        np.array([seen.com, seen.com_projection]),
        color=drawing.GREEN_COLOUR,
        ls="--",
        lw=1.2,
        zorder=6,
    )
    line(seen.com, **_COM_STYLE, zorder=6)
    line(seen.com_projection, **_COM_PROJECTION_STYLE, zorder=6)
    axes.set_aspect("equal")
    axes.margins(0.06)


def _draw_forces(axes: Axes, projection: Array, seen: StandingScene) -> None:
    """Draw contact forces as arrows that end at the feet.

    ``projection`` is the matrix, shape (2, 3), from the world to the image.
    """
    scale = _MAX_ARROW_RATIO * _measure_support(seen) / _find_largest_force(seen)
    arrow = {
        "arrowstyle": "-|>",
        "color": drawing.RED_COLOUR,
        "lw": 1.8,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    for contact in seen.contacts:
        tail = contact.point - scale * contact.force
        tip, end = (tuple(projection @ place) for place in (contact.point, tail))
        axes.annotate("", tip, end, zorder=7, arrowprops=arrow)
        axes.plot(*end, alpha=0.0)  # so that there is room for it


def _find_largest_force(seen: StandingScene) -> float:
    """Return the magnitude of the largest contact force [N]."""
    return max(float(np.linalg.norm(contact.force)) for contact in seen.contacts)


def _measure_support(seen: StandingScene) -> float:
    """Return the longer horizontal side [m] of the box around the support polygon."""
    return float(np.ptp(seen.polygon[:, :2], axis=0).max())


def _draw_scale(axes: Axes, seen: StandingScene) -> None:
    """Draw a scale bar (one of `_SCALE_LENGTHS`), labelled in mm, below the view from above.

    The lower limit of the y axis is moved to make space for the bar.
    """
    limit = 0.6 * _measure_support(seen)
    fitting = (length for length in _SCALE_LENGTHS if length <= limit)
    length = max(fitting, default=_SCALE_LENGTHS[0])
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.12 * (high - low), high)  # room below the feet
    label = f"{1e3 * length:g} mm"
    font = FontProperties(size=drawing.FONT_SIZE)
    style = {"frameon": False, "pad": 0.0, "sep": 3.0, "fontproperties": font}
    bar = AnchoredSizeBar(axes.transData, length, label, "lower left", **style)
    axes.add_artist(bar)


_SCALE_LENGTHS = (0.001, 0.01, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Possible lengths of the scale bar [m]. The longest length up to 0.6 times the size of the support
polygon is drawn. If all lengths are longer, the shortest is drawn. Chosen, not tuned.
"""
