"""Figures of an analysis, as PNG files. No pyplot: no window, and nobody's backend is touched."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MultipleLocator, NullLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.proj3d import proj_transform  # type: ignore[import-untyped]
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.errors import ConfigurationError
from pupper_analysis.files import whole_file
from pupper_analysis.robot.feet import foot_site
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from pupper_analysis.analysis.robot import Analysis
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation

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

_plain = FuncFormatter(lambda value, _: f"{value:g}")
WIDTH = 178 / 25.4
"""A page's text (inch)."""
_COLUMNS = 3
_LEAST_UTILISATION = 0.1  # %, where the axis of the torques begins

_ELEVATION, _AZIMUTH = 16, -33  # deg: from the front and the right
_ARROW = 0.35  # length of the largest force's arrow / length of the support polygon
BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
_NEAR, _FAR = "#374151", "#A3AAB5"
_BASE_FACE, _BASE_EDGE = "#FBE3AE", "#7A5300"
_SUPPORT = "#CFE8F7"
_PREDICTED: dict[str, Any] = {
    "color": BLUE,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 1.6,
    "ms": 7,
}
_SIMULATED: dict[str, Any] = {"color": BLACK, "marker": "x", "ls": "", "mew": 1.3, "ms": 4.5}
_WITH: dict[str, Any] = {"color": BLUE, "lw": 1.5, "marker": "o", "ms": 4, "mfc": "white"}
_WITHOUT: dict[str, Any] = {"color": RED, "lw": 1.5, "ls": (0, (5, 1.5)), "marker": "s", "ms": 4}
_COM: dict[str, Any] = {
    "color": GREEN,
    "marker": "o",
    "ls": "",
    "mfc": "white",
    "mew": 2.2,
    "ms": 8,
}
_PROJECTION: dict[str, Any] = {"color": GREEN, "marker": "x", "ls": "", "mew": 2.2, "ms": 7}


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

    def points(self) -> Array:
        """Returns all points (n, 3) (m)."""
        return np.concatenate([self.boxes.reshape(-1, 3), *self.legs.values()])


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


def support_polygon(points: Iterable[Array]) -> Array:
    """Returns the corners (n, 2) of the convex hull of points (3,), seen from above (m)."""
    hull = shapely.MultiPoint([point[:2] for point in points]).convex_hull
    line = hull.exterior if hull.geom_type == "Polygon" else hull
    return np.array(line.coords)


def nearest_edge_point(polygon: Array, place: Array) -> Array:
    """Returns the point (2,) on a polygon's edge (n, 2) that is nearest to a place (2,) (m)."""
    edge = shapely.LineString(polygon) if len(polygon) > 1 else shapely.Point(polygon[0])
    nearest = shapely.shortest_line(shapely.Point(place), edge)
    return np.array(nearest.coords[-1])


# ------------------------------------------------------------------------------------- pose


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
    lines = skeleton(robot, stand.qpos)
    figure = Figure(figsize=(WIDTH, 0.6 * WIDTH), dpi=DPI)
    put_title(figure, f"{robot.name}: how it stands")
    text = f"{stand.task}; mass {robot.total_mass:.2f} kg; the contact forces that last"
    figure.text(0.012, 0.925, textwrap.fill(text, 120), size=FONT, va="top")
    _draw_in_space(figure, lines, statics)
    _draw_from_above(figure, lines, statics)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_NEAR, lw=3, marker="o", mfc="white", mec=BLACK, ms=4, label="leg"),
        Line2D([], [], color=BLACK, marker="o", ls="", ms=6, label="foot"),
        Patch(facecolor=_BASE_FACE, edgecolor=_BASE_EDGE, label="base"),
        Line2D([], [], color=RED, marker=r"$\uparrow$", ls="", ms=9, label="contact force"),
        Line2D([], [], **_COM, label="com"),
        Line2D([], [], **_PROJECTION, label="com's projection"),
        Patch(facecolor=_SUPPORT, edgecolor=BLUE, hatch="//", label="support polygon"),
    ]
    put_legend(figure, handles)
    save(figure, path)


def _draw_in_space(figure: Figure, lines: Skeleton, statics: GravityCompensation) -> None:
    # mpl_toolkits has no type information.
    axes: Any = figure.add_axes((-0.03, 0.165, 0.74, 0.76), projection="3d", computed_zorder=False)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_proj_type("ortho")
    polygon = support_polygon(statics.contact_points.values())
    ground = 1e3 * np.column_stack([polygon, _heights_below(statics, polygon)])
    axes.add_collection3d(
        Poly3DCollection([ground], facecolor=_SUPPORT, alpha=0.6, edgecolor=BLUE, lw=1.2, zorder=1)
    )
    hips = 1e3 * np.array([leg[0] for leg in lines.legs.values()])
    for leg in lines.legs.values():
        # The viewer stands on the right: the legs of that side hide the base, it hides the others.
        near = leg[0, 1] < hips[:, 1].mean() / 1e3
        order = 4 if near else 2
        x, y, z = 1e3 * leg.T
        axes.plot(
            x, y, z, color=_NEAR if near else _FAR, lw=4.5, solid_capstyle="round", zorder=order
        )
        axes.plot(
            x[:-1], y[:-1], z[:-1], "o", color="white", mec=BLACK, mew=0.8, ms=4, zorder=order
        )
        axes.plot(x[-1:], y[-1:], z[-1:], "o", color=BLACK, ms=7, zorder=order)
    for box in lines.boxes:
        faces = [1e3 * box[list(face)] for face in BOX_FACES]
        axes.add_collection3d(
            Poly3DCollection(faces, fc=_BASE_FACE, alpha=0.45, ec=_BASE_EDGE, lw=0.9, zorder=3)
        )
    around = hips[np.argsort(np.arctan2(*(hips - hips.mean(axis=0))[:, :2].T))]
    axes.plot(*np.concatenate([around, around[:1]]).T, color=_BASE_EDGE, lw=2.2, zorder=3)
    com = 1e3 * statics.center_of_mass
    below = 1e3 * _heights_below(statics, statics.center_of_mass[np.newaxis, :2])
    ends = np.array([com, [*com[:2], below[0]]])
    axes.plot(*ends.T, color=GREEN, ls="--", lw=1.2, zorder=6)
    axes.plot(com[:1], com[1:2], com[2:], **_COM, zorder=6)
    axes.plot(com[:1], com[1:2], below, **_PROJECTION, zorder=6)

    forces, tips = statics.contact_forces, statics.contact_points
    largest = max(float(np.linalg.norm(force)) for force in forces.values())
    scale = _ARROW * float(np.ptp(polygon, axis=0).max()) / largest
    tails = {foot: tips[foot] - scale * force for foot, force in forces.items()}
    _fit(axes, 1e3 * np.concatenate([lines.points(), list(tails.values())]))
    # In the projection that the axes have now: an arrow's head in space would be seen askew.
    projection = axes.get_proj()
    for foot, force in forces.items():
        arrow = (1e3 * tails[foot], 1e3 * tips[foot])
        (x0, y0, _), (x1, y1, _) = (proj_transform(*end, projection) for end in arrow)
        axes.annotate(
            f"{foot}\n{np.linalg.norm(force):.2f} N",
            (x1, y1),
            (x0, y0),
            size=FONT,
            color=RED,
            ha="center",
            va="top",
            zorder=7,
            parse_math=False,
            bbox={"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.75},
            arrowprops={
                "arrowstyle": "-|>",
                "color": RED,
                "lw": 1.8,
                "shrinkA": 0,
                "shrinkB": 0,
                "relpos": (0.5, 1),
            },
        )


def _heights_below(statics: GravityCompensation, places: Array) -> Array:
    """Returns z (n,) of the plane through the contact points at places (n, 2) (m)."""
    points = np.array(list(statics.contact_points.values()))
    known = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = np.linalg.lstsq(known, points[:, 2], rcond=None)[0]
    heights: Array = places @ plane[:2] + plane[2]
    return heights


def _fit(axes: Any, shown: Array) -> None:
    """Gives axes in space equal scales, and limits around points (n, 3) (mm)."""
    room = float(np.ptp(shown, axis=0).max()) / 300
    low = shown.min(axis=0) - room * np.array([35, 20, 50])
    high = shown.max(axis=0) + room * np.array([20, 35, 10])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.02)
    # No ticks in the corners, where those of two axes meet, nor below the ground.
    first, last = low + 30 * room, high - 15 * room
    first[2] = 0.0
    step = _tick_step(shown)
    names = ("x, forward", "y, left", "z, up")
    for index, axis in enumerate((axes.xaxis, axes.yaxis, axes.zaxis)):
        axis.set_ticks(np.arange(step * np.ceil(first[index] / step), last[index], step))
        axis.set_tick_params(labelsize=FONT, pad=-2)
        axis.set_label_text(f"{names[index]} (mm)", fontsize=FONT)
        axis.labelpad = 0
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))


def _draw_from_above(figure: Figure, lines: Skeleton, statics: GravityCompensation) -> None:
    axes = figure.add_axes((0.735, 0.17, 0.255, 0.66))
    put_style(axes, "from above")
    points = {foot: 1e3 * point[:2] for foot, point in statics.contact_points.items()}
    polygon = 1e3 * support_polygon(statics.contact_points.values())
    # Forward is up and left is left: y is drawn to the left, x upwards.
    axes.add_patch(Polygon(polygon[:, ::-1], fc=_SUPPORT, ec=BLUE, hatch="//", lw=1.2, zorder=1))
    for box in lines.boxes:
        outline = 1e3 * support_polygon(box)
        axes.plot(outline[:, 1], outline[:, 0], color=_BASE_EDGE, lw=1.0, zorder=2)
    for leg in lines.legs.values():
        axes.plot(
            1e3 * leg[:, 1], 1e3 * leg[:, 0], color=_FAR, lw=3, solid_capstyle="round", zorder=2
        )
    middle = np.mean(list(points.values()), axis=0)
    for foot, (x, y) in points.items():
        axes.plot(y, x, "o", color=BLACK, ms=6, zorder=3)
        left = y > middle[1]
        axes.annotate(
            foot,
            (y, x),
            (-7 if left else 7, 0),
            textcoords="offset points",
            size=FONT,
            ha="right" if left else "left",
            va="center",
            parse_math=False,
        )
    com = 1e3 * statics.center_of_mass[:2]
    axes.plot(com[1], com[0], **_PROJECTION, zorder=5)
    if statics.com_margin is not None:
        edge = nearest_edge_point(polygon, com)
        axes.plot((com[1], edge[1]), (com[0], edge[0]), color=GREEN, lw=1.6, zorder=4)
        axes.plot(edge[1], edge[0], "o", color=GREEN, ms=4, zorder=4)
        axes.annotate(
            f"margin {1e3 * statics.com_margin:.1f} mm",
            (com[1], com[0]),
            (0, 8),
            textcoords="offset points",
            size=FONT,
            ha="center",
            va="bottom",
            color="#00644A",
            bbox={"fc": "white", "ec": "none", "pad": 1.5, "alpha": 0.9},
            zorder=6,
        )
    shown = 1e3 * lines.points()
    axes.set_aspect("equal")
    room = float(np.ptp(shown, axis=0).max()) / 300
    axes.set_xlim(shown[:, 1].max() + 55 * room, shown[:, 1].min() - 55 * room)
    axes.set_ylim(shown[:, 0].min() - 15 * room, shown[:, 0].max() + 15 * room)
    axes.xaxis.set_major_locator(MultipleLocator(_tick_step(shown)))
    axes.yaxis.set_major_locator(MultipleLocator(_tick_step(shown)))
    axes.set_xlabel("y, left (mm)", size=FONT)
    axes.set_ylabel("x, forward (mm)", size=FONT)


def _tick_step(points: Array) -> float:
    """Returns a round distance of ticks, at most half of the span of points (n, 3) (mm)."""
    span = float(np.ptp(points, axis=0).max()) / 2
    power = 10.0 ** math.floor(math.log10(span))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= span)


# ------------------------------------------------------------------------------------- torques


def torque_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws what every motor holds, in percent of its effort limit: one panel per robot.

    The axis is logarithmic, so that motors at 0.2 % and at 30 % can both be read.

    Args:
        analyses: The robots; ``statics``, ``verification`` and ``joints`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    rows = max((len(analysis.joints) for analysis in analyses), default=0)
    figure, panels = _panels(
        analyses,
        "Motor torques of the stand (at the left edge: up to 0.1 % of the limit)",
        0.16 * rows + 0.62,
    )
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        limits = np.array([joint.effort for joint in analysis.joints])
        names = [joint.name for joint in analysis.joints]
        places = np.arange(len(names))
        predicted = utilisation(analysis.statics.joint_torques, limits)
        simulated = utilisation(analysis.verification.joint_torques, limits)
        greatest = np.fmax(predicted, simulated)
        floor = _LEAST_UTILISATION
        axes.hlines(places, floor, greatest.clip(floor), color="#C9CED6", lw=1)
        axes.plot(predicted.clip(floor), places, **_PREDICTED, clip_on=False, zorder=3)
        axes.plot(simulated.clip(floor), places, **_SIMULATED, clip_on=False, zorder=4)
        axes.axvline(100, color=RED, lw=2)
        most = int(np.argmax(greatest > 0.999 * greatest.max()))
        torque = max(
            abs(analysis.statics.joint_torques[most]),
            abs(analysis.verification.joint_torques[most]),
        )
        axes.annotate(
            f"{torque:.3f} N m",
            (max(greatest[most], floor), most),
            (7, 0) if greatest[most] < 5 else (-7, 0),
            textcoords="offset points",
            size=FONT,
            ha="left" if greatest[most] < 5 else "right",
            va="center",
            zorder=5,
            bbox={"fc": "white", "ec": "none", "pad": 0.5},
        )
        low, high = limits.min(), limits.max()
        put_style(
            axes,
            f"{analysis.name}: limit {low:g}" + (f" to {high:g}" if high > low else "") + " N m",
        )
        axes.set_xscale("log")
        axes.set_xlim(floor, 200)
        axes.xaxis.set_major_locator(FixedLocator((0.1, 1, 10, 100)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(_plain)
        axes.grid(axis="x", color="#E3E6EB", lw=0.6)
        axes.set_axisbelow(True)
        axes.set_ylim(len(names) - 0.4, -0.6)
        before = [joint.name for joint in analyses[index - 1].joints] if index % _COLUMNS else None
        axes.set_yticks(places, names if names != before else [""] * len(names), parse_math=False)
        if index + _COLUMNS >= len(analyses):
            axes.set_xlabel("torque / limit (%)", size=FONT)
    put_legend(
        figure,
        [
            Line2D([], [], **_PREDICTED, label="predicted (Pinocchio)"),
            Line2D([], [], **_SIMULATED, label="simulated (MuJoCo, with feed-forward)"),
            Line2D([], [], color=RED, lw=2, label="limit"),
        ],
    )
    save(figure, path)


def utilisation(torques: Array, limits: Array) -> Array:
    """Returns |torque| / limit in percent; 0 where there is no limit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((limits > 0) & np.isfinite(limits), 100 * np.abs(torques) / limits, 0.0)


# ------------------------------------------------------------------------------------- heights


def height_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the base's height over the simulated time, with and without feed-forward.

    Args:
        analyses: The robots; ``stand``, ``verification`` and ``sagging`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    figure, panels = _panels(analyses, "Height of the simulated base", 1.75)
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        task = 1e3 * analysis.stand.qpos[2]
        axes.axhline(task, color=BLACK, lw=1.2, ls=":")
        low = high = task
        for run, style in ((analysis.verification, _WITH), (analysis.sagging, _WITHOUT)):
            label = f"{1e3 * run.height_loss:.2f} mm"
            axes.plot(run.time, 1e3 * run.height, **style, markevery=(0.1, 0.2), label=label)
            low = min(low, float(np.nanmin(1e3 * run.height)))
            high = max(high, float(np.nanmax(1e3 * run.height)))
        span = max(high - low, 1.0)
        axes.set_ylim(high - 1.3 * span, high + 0.1 * span)
        axes.legend(
            loc="lower right",
            ncols=2,
            fontsize=FONT,
            handlelength=1.8,
            columnspacing=1.0,
            frameon=False,
            borderpad=0.1,
        )
        put_style(axes, f"{analysis.name}: task {task:.1f} mm")
        axes.set_xlim(0, max(analysis.verification.time[-1], analysis.sagging.time[-1]))
        axes.grid(color="#E3E6EB", lw=0.6)
        if index + _COLUMNS >= len(analyses):
            axes.set_xlabel("time (s)", size=FONT)
        if index % _COLUMNS == 0:
            axes.set_ylabel("base height (mm)", size=FONT)
    put_legend(
        figure,
        [
            Line2D([], [], color=BLACK, lw=1.2, ls=":", label="task"),
            Line2D([], [], **_WITH, label="with feed-forward"),
            Line2D([], [], **_WITHOUT, label="without"),
            Line2D([], [], ls="", label="in the panels: height lost, mean of the last second"),
        ],
    )
    save(figure, path)


# ------------------------------------------------------------------------------------- gains


def gain_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the gain sweeps as heat maps: how much the height deviates, for each kp and kd.

    Args:
        analyses: The robots; ``sweep`` is drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    rows = max((len(analysis.sweep.kp) for analysis in analyses), default=0)
    figure, panels = _panels(
        analyses,
        "Gain sweep: standard deviation of the height in the last second",
        0.26 * rows + 0.65,
    )
    finite = np.concatenate(
        [1e3 * a.sweep.height_deviation[np.isfinite(a.sweep.height_deviation)] for a in analyses]
    )
    positive = finite[finite > 0]
    low, high = (positive.min(), positive.max()) if len(positive) else (0.1, 1.0)
    norm = LogNorm(low, max(high, 1.01 * low))
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        sweep = analysis.sweep
        image = axes.imshow(
            np.where(sweep.fell, np.nan, 1e3 * sweep.height_deviation).clip(low),
            norm=norm,
            cmap="cividis",
            aspect="auto",
            origin="lower",
        )
        for row, column in np.ndindex(sweep.height_deviation.shape):
            if sweep.fell[row, column]:
                axes.add_patch(
                    Rectangle(
                        (column - 0.5, row - 0.5), 1, 1, fc="#F1F1F1", ec=GREY, hatch="////", lw=0
                    )
                )
                axes.text(
                    column,
                    row,
                    "fell",
                    size=FONT,
                    ha="center",
                    va="center",
                    bbox={"fc": "white", "ec": "none", "pad": 1.0},
                )
                continue
            value = 1e3 * sweep.height_deviation[row, column]
            best = sweep.kp[row] == sweep.best_kp and sweep.kd[column] == sweep.best_kd
            axes.text(
                column,
                row,
                f"{value:.3f}" if value < 10 else f"{value:.0f}",
                size=FONT,
                ha="center",
                va="center",
                color="white" if norm(value) < 0.5 else BLACK,
            )
            if best:
                axes.add_patch(
                    Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, fill=False, ec=RED, lw=2.2)
                )
        put_style(axes, analysis.name)
        axes.set_xticks(range(len(sweep.kd)), [f"{value:g}" for value in sweep.kd])
        axes.set_yticks(range(len(sweep.kp)), [f"{value:g}" for value in sweep.kp])
        axes.tick_params(length=0)
        if index + _COLUMNS >= len(analyses):
            axes.set_xlabel("kd (N m s/rad)", size=FONT)
        if index % _COLUMNS == 0:
            axes.set_ylabel("kp (N m/rad)", size=FONT)
    colours = figure.colorbar(
        image, ax=panels, shrink=0.9, pad=0.015, aspect=20 * -(-len(panels) // _COLUMNS)
    )
    colours.set_label("deviation (mm)", size=FONT)
    colours.ax.tick_params(labelsize=FONT, which="both")
    colours.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    colours.ax.yaxis.set_minor_locator(NullLocator())
    colours.ax.yaxis.set_major_formatter(_plain)
    put_legend(
        figure,
        [
            Patch(fill=False, edgecolor=RED, lw=2, label="steadiest"),
            Patch(facecolor="#F1F1F1", edgecolor=GREY, hatch="////", label="fell"),
            Line2D(
                [],
                [],
                ls="",
                label=f"vertical disturbance of {sweep.amplitude:g} N at {sweep.frequency:g} Hz",
            ),
        ],
    )
    save(figure, path)


# ------------------------------------------------------------------------------------- shared


def _panels(
    analyses: Sequence[Analysis], title: str, row_height: float
) -> tuple[Figure, list[Axes]]:
    """Returns a figure with one panel (of ``row_height`` inches) per robot, in rows of three."""
    if not analyses:
        raise ConfigurationError("analyses", "there is no robot to draw")
    columns = min(_COLUMNS, len(analyses))
    rows = -(-len(analyses) // columns)
    figure = Figure(figsize=(WIDTH, rows * row_height + 0.75), dpi=DPI, layout="constrained")
    put_title(figure, title)
    grid = figure.add_gridspec(rows, columns)
    panels = [figure.add_subplot(grid[divmod(index, columns)]) for index in range(len(analyses))]
    return figure, panels


def put_title(figure: Figure, title: str) -> None:
    """Puts a title over a figure."""
    figure.suptitle(title, x=0.012, ha="left", size=FONT + 2, weight="bold", parse_math=False)


def put_style(axes: Axes, title: str) -> None:
    """Gives a panel its title, and the look of all panels."""
    axes.set_title(title, size=FONT, weight="bold", loc="left", pad=4, parse_math=False)
    axes.tick_params(labelsize=FONT)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)


def put_legend(figure: Figure, handles: Sequence[Line2D | Patch]) -> None:
    """Puts a legend in one line under a figure."""
    figure.legend(
        handles=handles,
        loc="outside lower center" if figure.get_layout_engine() else "lower center",
        ncols=len(handles),
        fontsize=FONT,
        frameon=False,
        handletextpad=0.5,
        columnspacing=1.4,
    )


def save(figure: Figure, path: str | Path) -> None:
    """Writes a figure as a PNG, and its folder if need be; no half-written file is ever there.

    Raises:
        OutputError: If the file cannot be written.
    """
    FigureCanvasAgg(figure)
    with whole_file(Path(path)) as temporary:
        figure.savefig(temporary, format="png")
