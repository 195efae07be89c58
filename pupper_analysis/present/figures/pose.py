"""The figure of how a robot stands: its links as lines, and the polygons under it."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.proj3d import proj_transform  # type: ignore[import-untyped]
from numpy.typing import NDArray

from pupper_analysis.present.figures import style
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

from pupper_analysis.robot.contact import foot_site, limb_ends

Array = NDArray[np.float64]

BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot as lines, by MuJoCo's kinematics of the MJCF. In the world (m).

    Attributes:
        legs: {foot: (n, 3)} the joints from base to foot, and last the centre of the foot's sphere.
        arms: (n, 3) each: the joints of the limbs that have no foot.
        boxes: (n, 8, 3) corners of the boxes of the base: of its box geoms or, if it has none, of
            those around its geoms. Corner 4 i + 2 j + k has the signs i, j, k along the edges.
    """

    legs: dict[str, Array]
    arms: tuple[Array, ...]
    boxes: Array

    def points(self) -> Array:
        """Returns all points (n, 3) (m)."""
        return np.concatenate([self.boxes.reshape(-1, 3), *self.legs.values(), *self.arms])


def draw_skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
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
    for foot, (_, frame) in robot.description.contact_points.items():
        body, position = foot_site(model, frame, robot.name)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        legs[foot] = np.array([*_joints_to(model, data, base, body), tip])
    walked = {int(model.body_weldid[body]) for body, _ in robot.contact_places.values()}
    arms = [_joints_to(model, data, base, body) for body in limb_ends(model) if body not in walked]
    geoms = np.flatnonzero(model.geom_bodyid == base)
    drawn = geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX.value]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    boxes = []
    for geom in drawn if len(drawn) else geoms:
        centre, half_size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        boxes.append(data.geom_xpos[geom] + (centre + signs * half_size) @ rotation.T)
    long = tuple(np.array(arm) for arm in arms if len(arm) > 1)
    return Skeleton(legs, long, np.array(boxes).reshape(-1, 8, 3))


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


def nearest_edge_point(polygon: Array, place: Array) -> Array:
    """Returns the point (2,) on a polygon's edge (n, 2) that is nearest to a place (2,) (m)."""
    edge = shapely.LineString(polygon) if len(polygon) > 1 else shapely.Point(polygon[0])
    nearest = shapely.shortest_line(shapely.Point(place), edge)
    return np.array(nearest.coords[-1])


_AROUND = 0.25
"""How far the plane is drawn beyond the feet, in parts of their distance."""

_PLANE, _STEP, _EDGE = "#ECEEF1", "#D5D9DF", "#8A929E"


def ground_corners(stand: Stand) -> Array:
    """Returns the corners (4, 3) of the piece of the ground's plane that is drawn (m)."""
    places = np.array([place[:2] for place in stand.foot_targets.values()])
    low, high = places.min(axis=0), places.max(axis=0)
    margin = _AROUND * float((high - low).max())
    low, high = low - margin, high + margin
    ground = stand.task.ground
    around = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([[x, y, ground.height((x, y))] for x, y in around])


def step_corners(seen: StandingScene) -> list[Array]:
    """Returns the corners (8, 3) of each step's box (m), in the order of ``BOX_FACES``."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return [step.centre + (signs * step.half) @ step.rotation.T for step in seen.steps]


def draw_ground(axes: Any, stand: Stand, seen: StandingScene) -> None:
    """Draws the plane, where it is no level one, and the steps on it (mm)."""
    if seen.ground.slope:
        corners = [1e3 * ground_corners(stand)]
        axes.add_collection3d(
            Poly3DCollection(
                corners, facecolor=_PLANE, alpha=0.8, edgecolor=_EDGE, lw=0.8, zorder=0
            )
        )
    for box in step_corners(seen):
        faces = [1e3 * box[list(face)] for face in BOX_FACES]
        axes.add_collection3d(
            Poly3DCollection(faces, facecolor=_STEP, alpha=0.8, edgecolor=_EDGE, lw=0.7, zorder=0.5)
        )


_ELEVATION, _AZIMUTH = 16, -33  # deg: from the front and the right
_ARROW = 0.35  # length of the largest force's arrow / length of the support polygon
_LABEL = (4.6, 2.6)  # width and height of a force's label, in heights of its letters
_MOST_LABELS = 8  # letters of a foot's name: what there is room for beside the polygon
_TALL = 1.5  # height / width of what needs room below for what the axes say
_NEAR_COLOUR, _FAR_COLOUR = "#374151", "#A3AAB5"
_BASE_FACE, _BASE_EDGE = "#FBE3AE", "#7A5300"
_SUPPORT = "#CFE8F7"
_COM: dict[str, Any] = {
    "color": style.GREEN,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 2.2,
    "ms": 8,
}

_SWING: dict[str, Any] = {
    "color": style.BLACK,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 1.6,
}
_PROJECTION: dict[str, Any] = {"color": style.GREEN, "marker": "x", "ls": "", "mew": 2.2, "ms": 7}


def pose_figure(robot: Robot, stand: Stand, statics: GravityCompensation, path: str | Path) -> None:
    """Draws how a robot stands: legs, base, contact forces, com and support polygon.

    On the left in space; on the right from above, with the com's margin to the polygon's edge.

    Args:
        robot: The robot.
        stand: How it stands.
        statics: What it takes.
        path: The PNG to write.

    Raises:
        OutputError: If the file cannot be written.
    """
    lines, seen = draw_skeleton(robot, stand.qpos), describe_scene(robot, stand, statics)
    figure = style.page_figure(f"{robot.name}: how it stands", 0.6 * style.WIDTH)
    text = f"{stand.task}; mass {robot.total_mass:.2f} kg; minimum tangential contact forces"
    figure.text(0.012, 0.925, textwrap.fill(text, 120), size=style.FONT, va="top")
    _draw_in_space(figure, lines, stand, seen)
    _draw_from_above(figure, lines, stand, seen, statics)
    handles: list[Line2D | Patch] = [
        Line2D(
            [],
            [],
            color=_NEAR_COLOUR,
            lw=3,
            marker="o",
            mfc="white",
            mec=style.BLACK,
            ms=4,
            label="leg",
        ),
        Line2D([], [], color=style.BLACK, marker="o", ls="", ms=6, label="foot"),
        *([Line2D([], [], **_SWING, label="swing foot")] if stand.task.swing else []),
        Patch(facecolor=_BASE_FACE, edgecolor=_BASE_EDGE, label="base"),
        Line2D([], [], color=style.RED, marker=r"$\uparrow$", ls="", ms=9, label="contact force"),
        Line2D([], [], **_COM, label="com"),
        Line2D([], [], **_PROJECTION, label="com's projection"),
        Patch(facecolor=_SUPPORT, edgecolor=style.BLUE, hatch="//", label="support polygon"),
    ]
    style.put_legend(figure, handles)
    style.save_figure(figure, path)


def _draw_in_space(figure: Figure, lines: Skeleton, stand: Stand, seen: StandingScene) -> None:
    # mpl_toolkits has no type information.
    axes: Any = figure.add_axes((-0.03, 0.165, 0.74, 0.76), projection="3d", computed_zorder=False)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_proj_type("ortho")
    draw_ground(axes, stand, seen)
    axes.add_collection3d(
        Poly3DCollection(
            [1e3 * seen.polygon],
            facecolor=_SUPPORT,
            alpha=0.6,
            edgecolor=style.BLUE,
            lw=1.2,
            zorder=1,
        )
    )
    hips = 1e3 * np.array([leg[0] for leg in lines.legs.values()])
    for foot, leg in lines.legs.items():
        # The viewer stands on the right: the legs of that side hide the base, it hides the others.
        near = leg[0, 1] < hips[:, 1].mean() / 1e3
        order = 4 if near else 2
        x, y, z = 1e3 * leg.T
        axes.plot(
            x,
            y,
            z,
            color=_NEAR_COLOUR if near else _FAR_COLOUR,
            lw=4.5,
            solid_capstyle="round",
            zorder=order,
        )
        axes.plot(
            x[:-1], y[:-1], z[:-1], "o", color="white", mec=style.BLACK, mew=0.8, ms=4, zorder=order
        )
        mark = _SWING if foot in stand.task.swing else {"color": style.BLACK, "marker": "o"}
        axes.plot(x[-1:], y[-1:], z[-1:], **mark, ms=7 * _small(seen), zorder=order)
    for arm in lines.arms:
        axes.plot(*(1e3 * arm.T), color=_FAR_COLOUR, lw=2.5, solid_capstyle="round", zorder=2)
    for box in lines.boxes:
        faces = [1e3 * box[list(face)] for face in BOX_FACES]
        axes.add_collection3d(
            Poly3DCollection(faces, fc=_BASE_FACE, alpha=0.45, ec=_BASE_EDGE, lw=0.9, zorder=3)
        )
    around = hips[np.argsort(np.arctan2(*(hips - hips.mean(axis=0))[:, :2].T))]
    axes.plot(*np.concatenate([around, around[:1]]).T, color=_BASE_EDGE, lw=2.2, zorder=3)
    com, below = 1e3 * seen.com, 1e3 * seen.below
    axes.plot(*np.array([com, below]).T, color=style.GREEN, ls="--", lw=1.2, zorder=6)
    axes.plot(com[:1], com[1:2], com[2:], **_COM, zorder=6)
    axes.plot(below[:1], below[1:2], below[2:], **_PROJECTION, zorder=6)
    _draw_forces(axes, lines, seen)


def _draw_forces(axes: Any, lines: Skeleton, seen: StandingScene) -> None:
    """Draws the contact forces as arrows that end at the feet, after the axes (mm) are fitted."""
    forces = {one.foot: one.force for one in seen.contacts}
    tips = {one.foot: one.point for one in seen.contacts}
    largest = max(float(np.linalg.norm(force)) for force in forces.values())
    scale = _ARROW * float(np.ptp(seen.polygon[:, :2], axis=0).max()) / largest
    tails = {foot: tips[foot] - scale * force for foot, force in forces.items()}
    _fit(axes, 1e3 * np.concatenate([lines.points(), list(tails.values())]))
    # In the projection that the axes have now: an arrow's head in space would be seen askew.
    projection = axes.get_proj()
    drawn = {
        foot: [proj_transform(*(1e3 * end), projection)[:2] for end in (tails[foot], tips[foot])]
        for foot in forces
    }
    aside = _aside(axes, {foot: tail for foot, (tail, _) in drawn.items()})
    for foot, force in forces.items():
        tail, tip = drawn[foot]
        axes.annotate(
            f"{_named(foot)}\n{np.linalg.norm(force):.2f} N",
            tail,
            (aside[foot], -1),
            textcoords="offset points",
            size=style.FONT,
            color=style.RED,
            ha="center",
            va="top",
            zorder=7,
            parse_math=False,
            bbox={"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.75},
        )
        axes.annotate(
            "",
            tip,
            tail,
            zorder=7,
            arrowprops={
                "arrowstyle": "-|>",
                "color": style.RED,
                "lw": 1.8,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )


def _aside(axes: Any, labels: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Returns by how much labels are moved to the side, in points, so that none hides another.

    Args:
        axes: In space.
        labels: {foot: the middle of its label's top}, in the axes' projection.
    """
    axes.apply_aspect()  # which drawing does, too late for this
    places = {foot: axes.transData.transform(place) for foot, place in labels.items()}  # pixels
    wide, high = (size * style.FONT * style.DPI / 72 for size in _LABEL)
    moved = dict.fromkeys(labels, 0.0)
    for _ in labels:  # to move one aside may bring it to the next
        for one, two in itertools.combinations(labels, 2):
            across = places[two][0] + moved[two] - places[one][0] - moved[one]
            lacks = wide - abs(across)
            if lacks > 0 and abs(places[two][1] - places[one][1]) < high:
                way = math.copysign(lacks / 2, across)
                moved[one], moved[two] = moved[one] - way, moved[two] + way
    return {foot: 72 / style.DPI * by for foot, by in moved.items()}


def _named(foot: str) -> str:
    """Returns a foot's name, or its beginning."""
    return foot if len(foot) <= _MOST_LABELS else f"{foot[: _MOST_LABELS - 1]}…"


def _small(seen: StandingScene) -> float:
    """Returns the size of a foot's mark: smaller where feet have several contact points."""
    return 1.0 if len(seen.contacts) == len(seen.points) else 0.45


def _fit(axes: Any, shown: Array) -> None:
    """Gives axes in space equal scales, and limits around points (n, 3) (mm)."""
    room = float(np.ptp(shown, axis=0).max()) / 300
    low = shown.min(axis=0) - room * np.array([35, 20, 50])
    high = shown.max(axis=0) + room * np.array([20, 35, 10])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    tall = (high - low)[2] > _TALL * (high - low)[:2].max()
    axes.set_box_aspect(high - low, zoom=0.87 if tall else 1.02)
    # No ticks in the corners, where those of two axes meet, nor below the ground.
    first, last = low + 30 * room, high - 15 * room
    first[2] = 0.0
    step = _tick_step(shown)
    names = ("x, forward", "y, left", "z, up")
    for index, axis in enumerate((axes.xaxis, axes.yaxis, axes.zaxis)):
        axis.set_ticks(np.arange(step * np.ceil(first[index] / step), last[index], step))
        axis.set_tick_params(labelsize=style.FONT, pad=-2)
        axis.set_label_text(f"{names[index]} (mm)", fontsize=style.FONT)
        axis.labelpad = 0
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))


def _draw_from_above(
    figure: Figure, lines: Skeleton, stand: Stand, seen: StandingScene, statics: GravityCompensation
) -> None:
    axes = figure.add_axes((0.735, 0.17, 0.255, 0.66))
    style.title_panel(axes, "from above")
    points, polygon = 1e3 * seen.points[:, :2], 1e3 * seen.polygon[:, :2]
    # Forward is up and left is left: y is drawn to the left, x upwards.
    axes.add_patch(
        Polygon(polygon[:, ::-1], fc=_SUPPORT, ec=style.BLUE, hatch="//", lw=1.2, zorder=1)
    )
    for box in lines.boxes:
        outline = 1e3 * hull_corners(box)
        axes.plot(outline[:, 1], outline[:, 0], color=_BASE_EDGE, lw=1.0, zorder=2)
    for leg in lines.legs.values():
        axes.plot(
            1e3 * leg[:, 1],
            1e3 * leg[:, 0],
            color=_FAR_COLOUR,
            lw=3,
            solid_capstyle="round",
            zorder=2,
        )
    for box in step_corners(seen):
        outline = 1e3 * hull_corners(box)
        axes.plot(outline[:, 1], outline[:, 0], color=_FAR_COLOUR, lw=1.0, ls="--", zorder=1.5)
    for foot in stand.task.swing:
        for point in stand.foot_targets if foot not in stand.foot_targets else (foot,):
            x, y = 1e3 * stand.foot_targets[point][:2]
            axes.plot(y, x, **_SWING, ms=6 * _small(seen), zorder=3)
    middle = points.mean(axis=0)
    for x, y in points:
        axes.plot(y, x, "o", color=style.BLACK, ms=6 * _small(seen), zorder=3)
    for contact in seen.contacts:
        foot, (x, y) = contact.foot, 1e3 * contact.point[:2]
        left = y > middle[1]
        axes.annotate(
            _named(foot),
            (y, x),
            (-7 if left else 7, 0),
            textcoords="offset points",
            size=style.FONT,
            ha="right" if left else "left",
            va="center",
            parse_math=False,
        )
    _draw_margin(axes, seen, statics.com_margin)
    shown = 1e3 * lines.points()
    axes.set_aspect("equal")
    room = float(np.ptp(shown, axis=0).max()) / 300
    axes.set_xlim(shown[:, 1].max() + 55 * room, shown[:, 1].min() - 55 * room)
    axes.set_ylim(shown[:, 0].min() - 15 * room, shown[:, 0].max() + 15 * room)
    axes.xaxis.set_major_locator(MultipleLocator(_tick_step(shown)))
    axes.yaxis.set_major_locator(MultipleLocator(_tick_step(shown)))
    axes.set_xlabel("y, left (mm)", size=style.FONT)
    axes.set_ylabel("x, forward (mm)", size=style.FONT)


def _draw_margin(axes: Axes, seen: StandingScene, margin: float | None) -> None:
    """Draws the com from above (mm), and its margin (m) to the edge of the support polygon."""
    com = 1e3 * seen.com[:2]
    axes.plot(com[1], com[0], **_PROJECTION, zorder=5)
    if margin is not None:
        ring = np.concatenate([seen.polygon, seen.polygon[:1]])[:, :2]
        edge = nearest_edge_point(1e3 * ring, com)
        axes.plot((com[1], edge[1]), (com[0], edge[0]), color=style.GREEN, lw=1.6, zorder=4)
        axes.plot(edge[1], edge[0], "o", color=style.GREEN, ms=4, zorder=4)
        axes.annotate(
            f"margin {1e3 * margin:.1f} mm",
            (com[1], com[0]),
            (0, 8),
            textcoords="offset points",
            size=style.FONT,
            ha="center",
            va="bottom",
            color="#00644A",
            bbox={"fc": "white", "ec": "none", "pad": 1.5, "alpha": 0.9},
            zorder=6,
        )


def _tick_step(points: Array) -> float:
    """Returns a round distance of ticks, at most half of the span of points (n, 3) (mm)."""
    span = float(np.ptp(points, axis=0).max()) / 2
    power = 10.0 ** math.floor(math.log10(span))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= span)
