"""Draw a figure of a robot in a stand: skeleton, contact forces, CoM and support polygon.

Both panels are parallel projections of the same lines: obliquely from the front right, and from
above.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch, PathPatch, Polygon
from matplotlib.path import Path as Path2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import ScaledTranslation
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.models.shapes import Mesh, Shape, get_mesh, read_shape
from pupper_analysis.present import colours
from pupper_analysis.present.document import Words, format_widened, get_english
from pupper_analysis.present.documents.standing import ground_word
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.scene import (
    NUM_VISIBLE_GROUPS,
    StandingScene,
    coarsen_mesh,
    describe_scene,
    select_visible_geoms,
)
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from pupper_analysis.stance.stand import Stand
    from pupper_analysis.statics.equilibrium import GravityCompensation
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import shapely
from numpy.typing import ArrayLike

from pupper_analysis.robot.contact import foot_site

_FINEST_CELLS, _COARSEST_CELLS = 64, 16
"""Numbers of cells along the longest side of the base's largest mesh, in grids in which vertices
are merged: number in the first grid, and lower bound in further grids. Each further grid has 3/4
of the cells per side. Chosen, not tuned.
"""
_MAX_BASE_FACES, _MAX_LINK_FACES = 2500, 600
"""Numbers of triangles of the base's meshes, and of another link's meshes, above which the vertices
are merged in a coarser grid, as far as `_COARSEST_CELLS` permits. Chosen, not tuned: they bound the
computing time of the silhouettes.
"""
_MIN_DETAIL = 1 / 80
"""Largest width of the gaps and needles that a silhouette of meshes omits, divided by the longer
side of the silhouette [1]. Chosen, not tuned.
"""

_NUM_GLOBE_POINTS = 200
"""Number of points that represent a ball or an ellipsoid. Chosen, not tuned."""


def _make_globe_points() -> Array:
    """Return points on the unit sphere with about equal distances, shape (n, 3)."""
    numbers = np.arange(_NUM_GLOBE_POINTS)
    height = 1.0 - (2.0 * numbers + 1.0) / _NUM_GLOBE_POINTS
    angle = numbers * math.pi * (3.0 - math.sqrt(5.0))  # golden angle
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


_GLOBE_POINTS = _make_globe_points()
"""Points of the unit sphere, shape (n, 3), that represent a ball or an ellipsoid."""
_CIRCLE_POINTS = np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * np.pi, 49)[:-1]])
"""Points of the unit circle, shape (48, 2), that represent an ellipse."""


@dataclass(frozen=True, eq=False)
class BodyPart:
    """Convex shape of a link, or all meshes of a link, in the world frame.

    Attributes:
        points: Points, shape (n, 3) [m]: vertices of the meshes, or points on the surface of the
            convex shape.
        faces: Triangles, shape (m, 3), as row indices of ``points``. None: the shape is the convex
            hull of the points.
    """

    points: Array
    faces: IntArray | None

    def silhouette(self, project: Callable[[Array], Array]) -> shapely.Geometry:
        """Compute the outline of this part in a parallel projection, as polygons.

        Args:
            project: Function that projects points, shape (n, 3) [m], from the world into the image,
                shape (n, 2).

        Returns:
            Polygons in the units of the image, with holes; separate areas are separate polygons. A
            line or a point if the projection of a convex shape has no area.
        """
        seen = project(self.points)
        if self.faces is None:
            return shapely.MultiPoint(seen).convex_hull
        corners = seen[self.faces]
        (x, y), (u, v) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
        whole = shapely.union_all(shapely.polygons(corners[x * v != y * u]))
        margin = _MIN_DETAIL / 2 * float(np.ptp(seen, axis=0).max())
        closed = whole.buffer(margin, join_style="mitre").buffer(-2 * margin, join_style="mitre")
        return closed.buffer(margin, join_style="mitre")


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Lines and shapes that a figure draws for a robot in a configuration: limbs and base.

    Attributes:
        legs: {contact point: points of shape (n, 3) [m], in the world frame}. The points are the
            joints from the base to the foot, then the contact point. If the contact point has a
            sphere, the last point is the centre of the sphere.
        links: Lines of the limbs without feet, such as arms, each of shape (2, 3) [m], in the world
            frame: from a joint, or the base frame, to the next joint, or to the frame of the last
            body.
        base: Geoms of the base, and of the bodies without joints on the base.
        others: Visible geoms of the bodies that are neither part of the base nor between the base
            and a foot, such as torso, head and arms of a humanoid.
        forward: Horizontal direction of the base's x axis, shape (3,), in the world frame. Zeros if
            the axis is within 30 degrees of the vertical.
        has_visuals: True if ``base`` contains visual geoms (groups 0 to 2). False: the base has no
            such geoms, and ``base`` contains its other geoms.
    """

    legs: dict[str, Array]
    links: tuple[Array, ...]
    base: tuple[BodyPart, ...]
    others: tuple[BodyPart, ...]
    forward: Array
    has_visuals: bool

    def points(self) -> Array:
        """Return all points of parts and limbs, shape (n, 3) [m], expressed in the world frame."""
        parts = (part.points for part in (*self.base, *self.others))
        return np.concatenate([*parts, *self.legs.values(), *self.links])


def compute_skeleton(robot: Robot, qpos: ArrayLike) -> Skeleton:
    """Compute the lines and shapes that a figure of a robot draws: limbs, base, and other links.

    ``qpos`` has the shape (nq,), with the joints in actuator order.
    """
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    base = model.body(robot.mj_base).id
    legs: dict[str, Array] = {}
    leg_bodies: set[int] = set()
    for foot, (_, frame) in robot.description.contact_points.items():
        body, position = foot_site(model, frame, robot.name)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ position
        legs[foot] = np.array([*_list_joint_positions(model, data, base, body), tip])
        while body not in (base, 0):
            leg_bodies.add(body)
            body = int(model.body_parentid[body])
    on_base = model.body_weldid[model.geom_bodyid] == model.body_weldid[base]
    own = [geom for geom in range(model.ngeom) if on_base[geom] and model.geom_bodyid[geom] > 0]
    visible = [geom for geom in own if model.geom_group[geom] < NUM_VISIBLE_GROUPS]
    of_legs = {int(model.body_weldid[body]) for body in leg_bodies}
    links: dict[int, list[int]] = {}  # {rigid body outside of base and legs: geoms}
    for geom in list_visible_geoms(robot):
        link = int(model.body_weldid[model.geom_bodyid[geom]])
        if not on_base[geom] and link not in of_legs:
            links.setdefault(link, []).append(geom)
    link_parts = [_read_parts(model, data, geoms, _MAX_LINK_FACES) for geoms in links.values()]
    lines = [
        line
        for body, line in _list_links(robot, qpos)
        if int(model.body_weldid[body]) not in of_legs
    ]
    return Skeleton(
        legs,
        tuple(lines),
        tuple(_read_parts(model, data, visible or own, _MAX_BASE_FACES)),
        tuple(itertools.chain.from_iterable(link_parts)),
        _find_forward_direction(data.xmat[base].reshape(3, 3)),
        bool(visible),
    )


def _find_forward_direction(rotation: Array) -> Array:
    """Return the horizontal direction of a frame's x axis; zeros if the axis is almost vertical."""
    x, y, _ = rotation[:, 0]
    length = math.hypot(x, y)
    return np.array([x, y, 0.0]) / length if length > _MIN_HORIZONTAL_PART else np.zeros(3)


_MIN_HORIZONTAL_PART = 0.5
"""Smallest horizontal component of the base's x axis [1] for which the front is marked. Chosen, not
tuned."""


def _read_parts(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], max_faces: int
) -> list[BodyPart]:
    """Return the shapes of geoms in the world frame: one part for all meshes, then convex shapes.

    The meshes are simplified to about ``max_faces`` triangles. Shapes without a finite surface are
    omitted.
    """
    shapes = [(geom, read_shape(model, geom, data)) for geom in geoms]
    meshes = [
        Mesh(shape.pose.point(mesh.vertices), mesh.faces)
        for geom, shape in shapes
        if shape.kind == "mesh"
        for mesh in [get_mesh(model, int(model.geom_dataid[geom]))]
    ]
    convex = [_sample_surface(shape) for _, shape in shapes if shape.kind != "mesh"]
    parts = [BodyPart(points, None) for points in convex if points is not None]
    return [_merge_meshes(meshes, max_faces), *parts] if meshes else parts


def list_visible_geoms(robot: Robot) -> list[int]:
    """List the geoms of a robot that MuJoCo's viewer shows by default, by index in MuJoCo's model.

    Geoms of other objects in the MJCF, such as a wall, are not listed. If no geom is visible, the
    other geoms of the robot are listed.
    """
    model = robot.mj_model
    root = model.body_rootid[model.body(robot.mj_base).id]
    return [
        geom
        for geom in select_visible_geoms(model)
        if not root or model.body_rootid[model.geom_bodyid[geom]] == root
    ]


def _merge_meshes(meshes: Sequence[Mesh], max_faces: int) -> BodyPart:
    """Merge meshes to one part, simplified to about ``max_faces`` triangles."""
    sizes = [float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes]
    longest, cells = max(sizes), _FINEST_CELLS
    while sum(len(mesh.faces) for mesh in meshes) > max_faces and cells >= _COARSEST_CELLS:
        meshes = [
            coarsen_mesh(mesh, max(round(cells * size / longest), 1)) if len(mesh.faces) else mesh
            for mesh, size in zip(meshes, sizes, strict=True)
        ]
        cells = round(0.75 * cells)
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
    return BodyPart(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _sample_surface(shape: Shape) -> Array | None:
    """Return points on the surface of a convex shape, (n, 3) [m]; None without a finite surface."""
    centres = shape.outline(_CIRCLE_POINTS, _GLOBE_POINTS)
    if centres is None or shape.minkowski_terms is None:
        return None
    ball = shape.minkowski_terms.ball
    globe = ball * _GLOBE_POINTS if ball else np.zeros((1, 3))
    return (centres[:, None] + globe).reshape(-1, 3)


def _list_joint_positions(
    model: mujoco.MjModel, data: mujoco.MjData, base: int, body: int
) -> list[Array]:
    """Return the positions (3,) [m] of the joints from the base to a body, base first."""
    points: list[Array] = []
    while body not in (base, 0):
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        points += [data.xanchor[joint].copy() for joint in reversed(joints)]
        body = int(model.body_parentid[body])
    return points[::-1]


def _make_projection(elevation: float, azimuth: float) -> Array:
    """Return the matrix of a parallel projection, shape (2, 3), from the world to the image.

    The rows are the image's right and up directions in world axes. The viewer is at the angle
    ``elevation`` above the horizontal, and ``azimuth`` about z, counterclockwise from +x [deg].
    """
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array(
        [
            (-math.sin(around), math.cos(around), 0.0),
            (-math.sin(up) * math.cos(around), -math.sin(up) * math.sin(around), math.cos(up)),
        ]
    )


DEFAULT_SUBJECT = "stance and static contact forces"
"""Part of the title of a pose figure after the name of the robot, unless a caller specifies it."""

_PROJECTIONS = (
    (_make_projection(16, -33), "from the front"),
    (_make_projection(90, 180), "from above"),
)
"""Projection matrix and title of each panel. Seen from above, +x is up and +y is left."""

_CAPTION_LETTERS, _MAX_CAPTION_ROWS = 110, 6
"""Largest numbers of characters in a row of the caption, and of rows. Chosen, not tuned."""
_TITLE_LETTERS, _TITLE_ROW_HEIGHT = 80, 0.045
"""Largest number of characters in a row of the title, and height of a row relative to the figure
[1]. Chosen for the bold font of the title."""
_MAX_ARROW_RATIO = 0.35
"""Length of the arrow of the largest contact force, divided by the longer horizontal side of the
box around the support polygon [1]. Chosen, not tuned.
"""
_MIN_ARROW_SIZE = 0.1
"""Smallest length of the arrow of the largest contact force, divided by the size of the robot [1].
Otherwise the arrow is in proportion to the support polygon (`_MAX_ARROW_RATIO`), which is small for
a humanoid. Chosen, not tuned.
"""
_NEAR_COLOUR, _FAR_COLOUR = "#374151", "#A3AAB5"
"""Dark and light colour of limbs. In a stand, the legs on the side of the viewer are dark, other
limbs are light."""
_BASE_FILL_COLOUR, _BASE_EDGE_COLOUR = "#FBE3AE", "#7A5300"
"""Colours of the base: faces, and edges with the polygon of the hips."""
_LINK_FILL_COLOUR, _LINK_EDGE_COLOUR = "#D5D9E0", "#4B5563"
"""Colours of the faces and edges of links that are part of neither base nor legs."""
_SUPPORT_FILL_COLOUR = "#CFE8F7"
"""Fill colour of the support polygon."""
_RING_STYLE: dict[str, Any] = {"marker": "o", "ls": "", "mfc": "white"}
"""Options of Matplotlib for a ring without a line."""
_COM_STYLE: dict[str, Any] = {**_RING_STYLE, "color": colours.COM_COLOUR, "mew": 2.2, "ms": 8}
"""Options of Matplotlib for the mark of the centre of mass."""
_SWING_STYLE: dict[str, Any] = {**_RING_STYLE, "color": colours.BLACK_COLOUR, "mew": 1.6}
"""Options of Matplotlib for the mark of a swing foot."""
_COM_PROJECTION_STYLE: dict[str, Any] = {
    "color": colours.COM_COLOUR,
    "marker": "x",
    "ls": "",
    "mew": 2.2,
    "ms": 7,
}
"""Options of Matplotlib for the mark of the projected centre of mass."""


def write_pose_figure(
    robot: Robot,
    stand: Stand,
    statics: GravityCompensation,
    path: str | Path,
    *,
    subject: str = DEFAULT_SUBJECT,
    verdict: Words | None = None,
) -> None:
    """Draw links, contact forces, centre of mass and support polygon of a stand as PNG.

    The left panel is an oblique view, the right panel a view from above. ``subject`` is the part of
    the title after the name of the robot, ``verdict`` the part before, such as FAILS.

    Raises:
        ConfigurationError: If the stand belongs to another robot.
        OutputError: If the file cannot be written, or is an existing file of another kind.
    """
    figure = make_pose_figure(robot, stand, statics, subject=subject, verdict=verdict)
    assert isinstance(figure, Figure)
    drawing.save_figure(figure, path)


def _make_title(robot: Robot, stand: Stand, subject: str, verdict: Words | None) -> str:
    """Return the title: verdict, robot, subject, ground, violated clearances and margins."""
    violations = "; ".join(map(str, stand.blocked))
    ground = f" {get_english(ground_word(stand.depths.values()))}" if stand.stance_feet else ""
    judged = "" if verdict is None else f"{get_english(verdict)} "
    return f"{judged}{robot.name}: {subject}{ground}{violations and f'; {violations}'}"


def _wrap_caption(caption: str) -> list[str]:
    """Divide a caption into rows after commas and semicolons, except inside parentheses."""
    kept = re.sub(r"(?<![,;]) |(?<=,) (?=[^()]*\))", "\N{NO-BREAK SPACE}", caption)
    return textwrap.wrap(
        kept,
        _CAPTION_LETTERS,
        max_lines=_MAX_CAPTION_ROWS,
        placeholder=" ...",
        break_on_hyphens=False,
    )


@drawing.silence_missing_letters()
def make_pose_figure(
    robot: Robot,
    stand: Stand,
    statics: GravityCompensation,
    create: Callable[..., Figure | SubFigure] = Figure,
    *,
    subject: str = DEFAULT_SUBJECT,
    verdict: Words | None = None,
) -> Figure | SubFigure:
    """Draw a stand with contact forces in a new figure: oblique view, and view from above.

    ``subject`` is the part of the title after the name of the robot, ``verdict`` the part before.
    ``create`` returns an empty figure, as ``pyplot.figure`` does.

    Raises:
        ConfigurationError: If the stand belongs to another robot.
    """
    lines, seen = compute_skeleton(robot, stand.qpos), describe_scene(robot, stand, statics)
    title = textwrap.wrap(_make_title(robot, stand, subject, verdict), _TITLE_LETTERS)
    height = 0.6 * drawing.PAGE_WIDTH
    figure = drawing.make_page_figure("\n".join(title), height, create=create)
    mass = format_widened(robot.total_mass, ".2f")
    text = f"{stand.task}; mass {mass} kg; minimum tangential contact forces"
    rows = _wrap_caption(text)
    top = 0.925 - _TITLE_ROW_HEIGHT * (len(title) - 1)
    caption = figure.text(
        drawing.TITLE_PLACE, top, "\n".join(rows), size=drawing.FONT_SIZE, va="top",
        parse_math=False,
    )  # fmt: skip
    bottom = figure.transSubfigure.inverted().transform(caption.get_window_extent())[0, 1]
    size = float(np.ptp(lines.points(), axis=0).max())
    longest = max(_MAX_ARROW_RATIO * _measure_support(seen), _MIN_ARROW_SIZE * size)
    for place, (projection, side) in zip((0.01, 0.6), _PROJECTIONS, strict=True):
        axes = figure.add_axes((place, 0.12, 0.57 if place < 0.5 else 0.39, bottom - 0.18))
        _draw_stand(axes, projection, lines, stand, seen)
        _draw_forces(axes, projection, seen, longest)
        _mark_front(axes, projection, lines.forward)
        names = _write_feet(axes, projection, lines, robot.feet)
        forces = f", forces up to {_find_largest_force(seen):.3g} N" if seen.contacts else ""
        largest = forces if place < 0.5 else ""
        drawing.title_panel(axes, f"{side}{largest}")
        axes.set_axis_off()
        _draw_scale(axes, seen)
        _make_room_for_texts(axes, names)
    drawing.add_legend(figure, _make_stand_handles(lines, has_swing=bool(stand.task.swing)))
    return figure


def _make_stand_handles(lines: Skeleton, *, has_swing: bool) -> list[Line2D | Patch]:
    """Create the legend entries of a stand; ``has_swing`` adds the entry of swing feet."""
    base_label = "base" if lines.has_visuals else "base (collision shapes)"
    leg: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": colours.BLACK_COLOUR, "ms": 4}
    return [
        Line2D([], [], color=_NEAR_COLOUR, lw=3, **leg, label="leg"),
        *_make_link_handles(lines, {**leg, "ms": 3}),
        Line2D([], [], color=colours.BLACK_COLOUR, marker="o", ls="", ms=6, label="foot"),
        *([Line2D([], [], **_SWING_STYLE, label="swing foot")] if has_swing else []),
        Patch(facecolor=_BASE_FILL_COLOUR, edgecolor=_BASE_EDGE_COLOUR, label=base_label),
        Line2D(
            [],
            [],
            color=colours.FORCE_COLOUR,
            marker=r"$\uparrow$",
            ls="",
            ms=9,
            label="contact force",
        ),
        Line2D([], [], **_COM_STYLE, label="CoM"),
        Line2D([], [], **_COM_PROJECTION_STYLE, label="projection of the CoM"),
        Patch(
            facecolor=_SUPPORT_FILL_COLOUR,
            edgecolor=colours.SUPPORT_COLOUR,
            hatch="//",
            label="support polygon",
        ),
    ]


def _make_link_handles(lines: Skeleton, joint: Mapping[str, Any]) -> list[Line2D | Patch]:
    """Create the legend entry of links outside of base and legs: silhouette, or line; or none."""
    if lines.others:
        return [Patch(facecolor=_LINK_FILL_COLOUR, edgecolor=_LINK_EDGE_COLOUR, label="other link")]
    if lines.links:
        return [Line2D([], [], color=_FAR_COLOUR, lw=2, **joint, label="other link")]
    return []


@drawing.silence_missing_letters()
def make_skeleton_figure(
    robot: Robot, qpos: ArrayLike, create: Callable[..., Figure | SubFigure] = Figure
) -> Figure | SubFigure:
    """Draw the joints and links of a robot in a configuration, without forces, in two panels.

    The views are oblique and from above. ``qpos`` has the shape (nq,); ``create`` returns an empty
    figure, as ``pyplot.figure`` does.
    """
    segments = [line for _, line in _list_links(robot, qpos)]
    title, height = f"{robot.name}: joints and links", 0.6 * drawing.PAGE_WIDTH
    figure = drawing.make_page_figure(title, height, create=create)
    for place, (projection, side) in zip((0.11, 0.62), _PROJECTIONS, strict=True):
        axes = figure.add_axes((place, 0.19, 0.42 if place < 0.5 else 0.34, 0.68))
        for segment in segments:
            axes.plot(*(projection @ segment.T) * 1e3, color=_NEAR_COLOUR, lw=3, zorder=2)
            axes.plot(*(projection @ segment[1]) * 1e3, "o", color="white",
                      mec=colours.BLACK_COLOUR, mew=0.8, ms=5, zorder=3)  # fmt: skip
        drawing.title_panel(axes, side)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("right in the view (mm)" if place < 0.5 else "-y (mm)")
        axes.set_ylabel("up in the view (mm)" if place < 0.5 else "x (mm)")
    joint: dict[str, Any] = {**_RING_STYLE, "mec": colours.BLACK_COLOUR, "mew": 0.8, "ms": 5}
    handles: list[Artist] = [
        Line2D([], [], color=_NEAR_COLOUR, lw=3, label="link"),
        Line2D([], [], **joint, label="joint, or frame of the last body"),
    ]
    drawing.add_legend(figure, handles)
    return figure


def _list_links(robot: Robot, qpos: ArrayLike) -> list[tuple[int, Array]]:
    """List the lines that draw the links of a robot: from joint to joint, or to the end of a limb.

    The end is a contact point, or the frame of the last body.

    Returns:
        Pairs: MuJoCo id of the body at the end of the line; line, shape (2, 3) [m], in the world
            frame, the end nearer to the base first.
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
    previous = dict[int, int]()  # joint, or base, before each body
    for body in range(1, model.nbody):
        ancestor = int(model.body_parentid[body])
        while ancestor not in jointed and ancestor not in (base, 0):
            ancestor = int(model.body_parentid[ancestor])
        if ancestor or not base:  # without other objects
            previous[body] = ancestor
    continued = {previous[body] for body in jointed}
    lines = list[tuple[int, Array]]()
    for body, ancestor in previous.items():
        is_end = body not in parents and body != base and ancestor not in continued
        if body not in jointed and not is_end:
            continue
        ends = [
            data.xanchor[model.body_jntadr[place]] if place in jointed else data.xpos[place]
            for place in (ancestor, body)
        ]
        lines.append((body, np.array(ends)))
    for _, frame in robot.description.contact_points.values():
        foot, position = foot_site(model, frame, robot.name)
        tip, body = data.xpos[foot] + data.xmat[foot].reshape(3, 3) @ position, foot
        while body not in jointed and body not in (base, 0):
            body = int(model.body_parentid[body])
        start = data.xanchor[model.body_jntadr[body]] if body in jointed else data.xpos[body]
        lines.append((foot, np.array([start, tip])))
    return lines


def _draw_stand(
    axes: Axes, projection: Array, lines: Skeleton, stand: Stand, seen: StandingScene
) -> None:
    """Draw a stand without its forces into Matplotlib axes, in a parallel projection.

    The matrix ``projection``, shape (2, 3), maps positions in the world [m] to the image.
    """

    def line(points: Array, *marks: str, **how: Any) -> None:
        """Draw a polyline through ``points``, shape (n, 3) [m], in the projection."""
        axes.plot(*(projection @ np.atleast_2d(points).T), *marks, **how)

    for parts, fill, edge, order in (
        (lines.others, _LINK_FILL_COLOUR, _LINK_EDGE_COLOUR, 2.5),
        (lines.base, _BASE_FILL_COLOUR, _BASE_EDGE_COLOUR, 3),
    ):
        for part in parts:
            silhouette = part.silhouette(lambda points: points @ projection.T)
            draw_silhouette(axes, silhouette, fc=fill, ec=edge, alpha=0.4, lw=0.8, zorder=order)
    support: dict[str, Any] = {
        "fc": _SUPPORT_FILL_COLOUR,
        "ec": colours.SUPPORT_COLOUR,
        "hatch": "//",
        "zorder": 1,
    }
    axes.add_patch(Polygon(seen.polygon @ projection.T, alpha=0.7, lw=1.2, **support))
    for segment in lines.links:
        line(segment, color=_FAR_COLOUR, lw=2, zorder=3)
        line(segment[1], "o", color="white", mec=colours.BLACK_COLOUR, mew=0.6, ms=3, zorder=3)
    hips = np.array([leg[0] for leg in lines.legs.values()])
    # Feet with several contact points have smaller marks.
    small = 1.0 if len(seen.contacts) >= len(seen.contact_positions) else 0.45
    for foot, leg in lines.legs.items():
        # The viewer is on the right: legs on this side are drawn over the base, the others below.
        near = leg[0, 1] < hips[:, 1].mean()
        order = 4 if near else 2
        colour = _NEAR_COLOUR if near else _FAR_COLOUR
        line(leg, color=colour, lw=4, solid_capstyle="round", zorder=order)
        line(leg[:-1], "o", color="white", mec=colours.BLACK_COLOUR, mew=0.8, ms=4, zorder=order)
        mark = (
            _SWING_STYLE
            if foot in stand.task.swing
            else {"color": colours.BLACK_COLOUR, "marker": "o"}
        )
        line(leg[-1], **mark, ms=7 * small, zorder=order)
    around = hips[np.argsort(np.arctan2(*(hips - hips.mean(axis=0))[:, :2].T))]
    line(np.concatenate([around, around[:1]]), color=_BASE_EDGE_COLOUR, lw=2.2, zorder=3)
    line(
        np.array([seen.com, seen.com_projection]),
        color=colours.COM_COLOUR,
        ls="--",
        lw=1.2,
        zorder=6,
    )
    line(seen.com, **_COM_STYLE, zorder=6)
    line(seen.com_projection, **_COM_PROJECTION_STYLE, zorder=6)
    axes.set_aspect("equal")
    axes.margins(_SIDE_MARGIN, 0.06)


_SIDE_MARGIN = 0.1
"""Margin on the left and right of a view, relative to the drawn width [1]. Chosen for the names of
the feet."""


def _mark_front(axes: Axes, projection: Array, forward: Array) -> None:
    """Draw an arrow along the forward direction of the base in the strip below a view.

    ``forward`` is a unit vector, shape (3,), in the world frame, or zero: nothing is drawn then.
    """
    direction = projection @ forward
    length = float(np.hypot(*direction))
    if not length:
        return
    half = _FRONT_ARROW_LENGTH / 2 * direction / length
    middle = np.array([_FRONT_ARROW_LENGTH / 2, _FRONT_ARROW_LENGTH / 2])
    figure = axes.get_figure(root=True)
    assert figure is not None
    corner = ScaledTranslation(_FRONT_ARROW_PLACE, 0, cast(Any, axes.transAxes))
    ends = [tuple((middle + side * half) / 72) for side in (-1, 1)]
    axes.add_patch(
        FancyArrowPatch(
            *ends, arrowstyle="-|>", mutation_scale=9, lw=1.4, shrinkA=0, shrinkB=0,
            color=colours.GREY_COLOUR, transform=figure.dpi_scale_trans + corner,
        )
    )  # fmt: skip
    axes.annotate("front", (_FRONT_ARROW_PLACE, 0), xycoords="axes fraction",
                  xytext=(_FRONT_ARROW_LENGTH + 4, middle[1]), textcoords="offset points",
                  ha="left", va="center", size=drawing.FONT_SIZE,
                  color=colours.GREY_COLOUR)  # fmt: skip


_FRONT_ARROW_LENGTH, _FRONT_ARROW_PLACE = 16.0, 0.68
"""Length of the arrow that marks the front [pt], and its left end relative to the width of the view
[1]. Chosen, not tuned."""


def _write_feet(
    axes: Axes, projection: Array, lines: Skeleton, feet: Mapping[str, Sequence[str]]
) -> list[Annotation]:
    """Write the name of each foot beside its outermost contact point in the view; return the texts.

    ``feet`` contains the contact points of each foot. Parts that all names contain are omitted.
    """
    tips = {point: projection @ leg[-1] for point, leg in lines.legs.items()}
    centre = float(np.mean([tip[0] for tip in tips.values()]))
    shown = {foot: [tips[point] for point in points if point in tips]
             for foot, points in feet.items()}  # fmt: skip
    shown = {foot: places for foot, places in shown.items() if places}
    names = drawing.cut_long_names(drawing.shorten_names(list(shown)), _MAX_FOOT_NAME_LENGTH)
    texts: list[Annotation] = []
    for name, places in zip(names, shown.values(), strict=True):
        side = 1 if np.mean([place[0] for place in places]) >= centre else -1
        outermost = places[int(np.argmax([side * place[0] for place in places]))]
        text = axes.annotate(name, tuple(outermost), xytext=(7 * side, 0),
                             textcoords="offset points", ha="left" if side > 0 else "right",
                             va="center", size=drawing.FONT_SIZE - 1, zorder=8,
                             parse_math=False)  # fmt: skip
        text.set_path_effects([withStroke(linewidth=2, foreground="white")])
        texts.append(text)
    return texts


_MAX_FOOT_NAME_LENGTH = 20
"""Largest number of letters of the displayed name of a foot. Chosen, not tuned."""

_NUM_SCALE_ITERATIONS = 100
"""Number of fixed-point iterations for the scale of a view. Chosen, not tuned: each iteration
multiplies the error by the fraction of the panel that names cover, 0.86 for names of 20 letters.
"""


def _make_room_for_texts(axes: Axes, texts: Sequence[Annotation]) -> None:
    """Widen the limits of x until all texts are within the panel of the view.

    The panel is the position of the axes before their aspect ratio is applied. Texts have a
    constant size in pixels, so the limits depend on the scale, and the scale on the limits.
    """
    figure = axes.get_figure()
    assert figure is not None
    panel = axes.get_position(original=True).transformed(figure.transSubfigure)
    axes.apply_aspect()
    low, high = axes.get_xlim()
    scale = axes.get_window_extent().width / (high - low)  # pixels per metre
    height_scale = panel.height / float(np.ptp(axes.get_ylim()))
    anchors = np.array([text.xy[0] for text in texts])
    boxes = [text.get_window_extent() for text in texts]
    places = axes.transData.transform([(anchor, 0.0) for anchor in anchors])[:, 0]
    before = np.array([box.x0 for box in boxes]) - places  # [pixels]
    behind = np.array([box.x1 for box in boxes]) - places
    start, end = low, high
    for _ in range(_NUM_SCALE_ITERATIONS):
        start = min(low, float(np.min(anchors + before / scale)))
        end = max(high, float(np.max(anchors + behind / scale)))
        scale = min(height_scale, panel.width / (end - start))
    axes.set_xlim(start, end)


def draw_silhouette(axes: Axes, silhouette: shapely.Geometry, **style: Any) -> None:
    """Fill a silhouette and draw its edges, with holes and separate parts.

    ``style`` contains options of Matplotlib's patches. Points and lines are omitted.
    """
    polygons = [part for part in shapely.get_parts(silhouette) if part.geom_type == "Polygon"]
    rings = [ring for part in polygons for ring in (part.exterior, *part.interiors)]
    if rings:
        paths = [Path2D(np.array(ring.coords), closed=True) for ring in rings]
        axes.add_patch(PathPatch(Path2D.make_compound_path(*paths), **style))


def _draw_forces(axes: Axes, projection: Array, seen: StandingScene, longest: float) -> None:
    """Draw contact forces as arrows that end at the contacts, in a parallel projection.

    The arrow of the largest force has the length ``longest`` [m] in the world.
    The matrix ``projection``, shape (2, 3), maps positions in the world [m] to the image.
    """
    largest = _find_largest_force(seen)
    scale = longest / largest if largest else 0.0
    arrow = {
        "arrowstyle": "-|>",
        "color": colours.FORCE_COLOUR,
        "lw": 1.8,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    for contact in seen.contacts:
        tail = contact.point - scale * contact.force
        tip, end = (tuple(projection @ place) for place in (contact.point, tail))
        if math.dist(tip, end) > _MIN_ARROW_RATIO * scale * largest:
            axes.annotate("", tip, end, zorder=7, arrowprops=arrow)
        axes.plot(*end, alpha=0.0)  # so that there is room for it


_MIN_ARROW_RATIO = 0.01
"""Smallest length in a view of the arrow of a contact force, relative to the length of the longest
arrow [1]. A shorter arrow is seen from its end, and is not drawn. Chosen, not tuned."""


def _find_largest_force(seen: StandingScene) -> float:
    """Return the magnitude of the largest contact force [N]; 0 without contacts."""
    return max((float(np.linalg.norm(contact.force)) for contact in seen.contacts), default=0.0)


def _measure_support(seen: StandingScene) -> float:
    """Return the longer horizontal side [m] of the box around the support polygon; 0 without."""
    return float(np.ptp(seen.polygon[:, :2], axis=0).max()) if len(seen.polygon) else 0.0


def _draw_scale(axes: Axes, seen: StandingScene) -> None:
    """Draw a scale bar with a round length, labelled in mm, below a view.

    The bar is to scale for lengths from left to right in the view.
    """
    width = float(np.ptp(axes.get_xlim()))
    limit = max(0.6 * _measure_support(seen), _MIN_BAR_RATIO * width)
    limit = min(limit, _MAX_BAR_RATIO * width)
    length = drawing.choose_bar_length(limit)
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.12 * (high - low), high)  # room below the feet
    label = f"{1e3 * length:g} mm"
    font = FontProperties(size=drawing.FONT_SIZE)
    style = {"frameon": False, "pad": 0.0, "sep": 3.0, "fontproperties": font}
    bar = AnchoredSizeBar(axes.transData, length, label, "lower left", **style)
    axes.add_artist(bar)


_MIN_BAR_RATIO, _MAX_BAR_RATIO = 0.3, 0.55
"""Smallest and largest length of the scale bar before rounding down, relative to the width of the
view [1]. The arrow that marks the front begins at `_FRONT_ARROW_PLACE`. Chosen, not tuned.
"""
