"""The picture of robots side by side, rendered by MuJoCo.

All robots are drawn at the same scale, each on a piece of ground. Name, leg length (if known) and
mass are written below each robot. A scale bar is in the lower left corner of the picture.
"""

from __future__ import annotations

import math
import os
import platform
import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pupper_analysis.base.array_types import Array, Pixels
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.models.mjcf import JointKind, add_geom, compile_spec
from pupper_analysis.models.shapes import get_mesh, read_shape
from pupper_analysis.present.document import format_widened
from pupper_analysis.present.figures.drawing import choose_bar_length, save_figure
from pupper_analysis.present.figures.pose import (
    Skeleton,
    compute_skeleton,
    draw_silhouette,
    list_visible_geoms,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.analyze.analysis import measure_leg_lengths

CAMERA_ELEVATION = math.radians(20)
"""Angle between the camera's line of sight and the horizontal plane [rad]. Chosen, not tuned."""
CAMERA_AZIMUTH = math.radians(140)
"""Angle between the x axis and the camera's line of sight, seen from above [rad]. Chosen, not
tuned."""
CAMERA_FORWARD = np.array([math.cos(CAMERA_AZIMUTH), math.sin(CAMERA_AZIMUTH), 0.0])
"""Horizontal direction of the camera's line of sight, in the world frame."""
IMAGE_RIGHT = np.array([math.sin(CAMERA_AZIMUTH), -math.cos(CAMERA_AZIMUTH), 0.0])
"""Direction of the image's x axis, in the world frame."""
IMAGE_UP = math.sin(CAMERA_ELEVATION) * CAMERA_FORWARD + math.cos(CAMERA_ELEVATION) * np.array(
    [0.0, 0.0, 1.0]
)
"""Direction upwards in the image, in the world frame."""
_TILE_MARGIN = 0.09
"""Smallest margin around the drawn robot and its ground in the tile (part of the picture), relative
to the tile width [1]. Chosen, not tuned.
"""
_MAX_TILE_RATIO = 1.5
"""Largest height of a tile, relative to its width [1]. A single tile is at most as high as wide.
Chosen, not tuned: a humanoid in its stand is about 2.4 times as high as wide.
"""
_LABEL_MARGIN = 0.02
"""Smallest margin on both sides of a name below a robot, relative to the tile width [1]; longer
names have a smaller font. Chosen, not tuned.
"""
LABEL_HEIGHT = 0.125
"""Height of the strip for the text below a robot, relative to the width of the robot's tile [1].
Chosen, not tuned."""
_GROUND_MARGIN = 0.5
"""Margin of the drawn ground around the outermost feet, divided by the radius of the largest foot
[1]. Chosen, not tuned.
"""
GROUND_COLOUR = "#DDE2E9"
"""Colour of the drawn ground."""
_MAX_BAR_LENGTH = 0.3
"""Upper bound of the length of the scale bar, relative to the width of a tile. Chosen, not
tuned."""
_BAR_MARGIN = 0.07
"""Height of the strip for the scale bar at the lower edge, relative to the width of a tile [1].
Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Tile:
    """Rectangular part of the picture that shows one robot, in a parallel projection.

    Attributes:
        robot: Robot.
        qpos: Configuration, shape (nq,), with the joints in actuator order.
        lines: Skeleton in this configuration.
        ground: Corners of the drawn piece of ground, shape (4, 3) [m], in the world frame.
        left: Left edge of the tile in the picture [pixels].
        top: Upper edge of the tile in the picture [pixels].
        width: Width of the tile [pixels].
        height: Height of the tile [pixels].
        scale: Pixels per metre.
        centre: Point in the middle of the tile, shape (2,) [m], along `IMAGE_RIGHT` and `IMAGE_UP`.
    """

    robot: Robot
    qpos: Array
    lines: Skeleton
    ground: Array
    left: int
    top: int
    width: int
    height: int
    scale: float
    centre: Array

    def pixels(self, points: Array) -> Array:
        """Project points in the world frame, shape (n, 3) [m], into the picture.

        Returns:
            Shape (n, 2) [pixels]: x to the right and y downwards from the upper left corner.
        """
        offset = self.scale * (project_points(points) - self.centre) * (1, -1)
        middle = (self.left + self.width / 2, self.top + self.height / 2)
        place: Array = middle + offset
        return place


def project_points(points: Array) -> Array:
    """Project world points, shape (n, 3) [m], orthographically onto the image plane of the figures.

    Returns:
        Shape (n, 2) [m]: components along `IMAGE_RIGHT` and `IMAGE_UP`.
    """
    seen: Array = points @ np.array([IMAGE_RIGHT, IMAGE_UP]).T
    return seen


def lay_out_tiles(poses: Sequence[tuple[Robot, Array]], width: int, columns: int) -> list[Tile]:
    """Assign a tile of the picture to each robot, in rows, all at the same scale.

    ``poses`` contains pairs of a robot and its configuration, shape (nq,), with the joints in
    actuator order. ``width`` is that of the picture [pixels], ``columns`` the number of tiles in a
    row. A tile contains all visible geoms of the robot. The widest or the highest robot determines
    the scale (`_MAX_TILE_RATIO`).
    """
    lines = [compute_skeleton(robot, qpos) for robot, qpos in poses]
    grounds = []
    low, high = np.empty((len(poses), 2)), np.empty((len(poses), 2))
    for index, ((robot, qpos), line) in enumerate(zip(poses, lines, strict=True)):
        radius = max(robot.contact_radius.values())
        ground = _bound_ground(line, radius)
        body = project_points(line.points())
        shown = [body - radius, body + radius, project_points(ground), _outline_geoms(robot, qpos)]
        points = np.concatenate(shown)
        low[index], high[index] = points.min(axis=0), points.max(axis=0)
        grounds.append(ground)
    size = high - low
    tile_width = width // columns
    max_height = min(_MAX_TILE_RATIO * tile_width, width)
    scale = min(
        (1 - 2 * _TILE_MARGIN) * tile_width / float(size[:, 0].max()),
        (max_height - (2 * _TILE_MARGIN + LABEL_HEIGHT) * tile_width) / float(size[:, 1].max()),
    )
    gap, label = _TILE_MARGIN * tile_width / scale, LABEL_HEIGHT * tile_width / scale
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
            drawn = lines[index], grounds[index]
            tiles.append(Tile(*poses[index], *drawn, left, top, tile_width, height, scale, middle))
        top += height
    return tiles


def _outline_geoms(robot: Robot, qpos: Array) -> Array:
    """Return image points, shape (n, 2) [m], whose bounding box is that of the visible geoms.

    Geoms of other objects in the MJCF, such as a wall, are not included. ``qpos`` has the shape
    (nq,), with the joints in actuator order.
    """
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    points = [np.empty((0, 2))]
    for geom in list_visible_geoms(robot):
        shape = read_shape(model, geom, data)
        if shape.kind == "mesh":  # all vertices: a mesh need not have a convex hull
            mesh = get_mesh(model, int(model.geom_dataid[geom]))
            points.append(project_points(shape.pose.point(mesh.vertices)))
            continue
        # Support function in the directions of the image's axes.
        directions = np.array([IMAGE_RIGHT, IMAGE_UP])
        high, low = shape.support(directions), shape.support(-directions)
        if high is not None and low is not None:
            points.append(np.array([high, -low]))
    return np.concatenate(points)


def _bound_ground(lines: Skeleton, radius: float) -> Array:
    """Return the corners of the drawn ground: a rectangle at z = 0, shape (4, 3) [m].

    The rectangle contains all feet with a margin. ``radius`` is the radius of the largest foot [m].
    """
    feet = np.array([leg[-1, :2] for leg in lines.legs.values()])
    margin = (1 + _GROUND_MARGIN) * radius
    (x_low, y_low), (x_high, y_high) = feet.min(axis=0) - margin, feet.max(axis=0) + margin
    corners = [(x_low, y_low), (x_high, y_low), (x_high, y_high), (x_low, y_high)]
    return np.array([(x, y, 0.0) for x, y in corners])


BACKGROUND_COLOUR = "#EEF1F5"
"""Colour of the picture's background."""
_OVERSAMPLING_FACTOR = 2
"""Number of rendered pixels per pixel of the picture, in each direction. Averaging these pixels
avoids jagged edges. Chosen, not tuned.
"""
_HIDDEN_GROUP = 5
"""Geom group to which the planes of the MJCF are moved. The picture omits this group, because the
renderer shows only groups 0 to 2.
"""
_DISABLING_VALUES = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL that disable OpenGL."""


def _compile_model(tile: Tile) -> mujoco.MjModel:
    """Compile a robot's MJCF for the picture: with the ground of the tile, and other lights."""
    robot = tile.robot
    spec = robot.description.mjcf.copy()
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.group = _HIDDEN_GROUP
    free = [joint for joint in spec.joints if joint.type == JointKind.FREE]
    for element in (*spec.lights, *(() if robot.floating else (*free, *spec.keys))):
        spec.delete(element)
    low, high = tile.ground[0], tile.ground[2]
    add_geom(
        spec.worldbody,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(low + high) / 2,
        size=(*(high - low)[:2] / 2, 1.0),
        rgba=(*to_rgb(GROUND_COLOUR), 1.0),
        contype=0,
        conaffinity=0,
    )
    sun = spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False)
    sun.dir, sun.diffuse = (-0.30, 0.24, -1.0), (0.45,) * 3
    visual = spec.visual
    visual.headlight.ambient, visual.headlight.diffuse = (0.42,) * 3, (0.25,) * 3
    visual.global_.offwidth = _OVERSAMPLING_FACTOR * tile.width
    visual.global_.offheight = _OVERSAMPLING_FACTOR * tile.height
    visual.global_.orthographic = True
    visual.quality.offsamples = 0
    spec.stat.extent = max(tile.width, tile.height) / tile.scale / 2
    return compile_spec(spec, robot.description.mjcf_source)


def render_tiles(tiles: Sequence[Tile]) -> tuple[list[Pixels], str, str | None]:
    """Render the robot of each tile with the first OpenGL backend that works.

    Returns:
        Pixels of each tile, shape (height, width, 3); name of the backend; None. Without OpenGL: an
        empty list; ``"lines"``, for a line drawing instead; the reason.
    """
    reasons = []
    for backend in _list_backends():
        try:
            with _quiet_attempt():
                return _render_with(backend, tiles), backend, None
        except PupperAnalysisError:
            raise
        except Exception as error:  # every driver fails in its own way
            reasons.append(f"{backend}: {textwrap.shorten(str(error), 100, placeholder='...')}")
    why = "; ".join(reasons) or "MUJOCO_GL switches it off"
    return [], "lines", f"no OpenGL ({why}): a line drawing instead of a rendered picture"


def _list_backends() -> tuple[str, ...]:
    """Return the modules of ``mujoco`` that may provide OpenGL, in the order in which to try them.

    Empty if MUJOCO_GL disables OpenGL.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in _DISABLING_VALUES:
        return ()
    if wanted in ("egl", "osmesa", "glfw", "cgl"):
        return (wanted,)
    if platform.system() == "Linux":
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        return ("egl", "osmesa", "glfw") if display else ("egl", "osmesa")
    return ("cgl", "glfw") if platform.system() == "Darwin" else ("glfw",)


@contextmanager
def _quiet_attempt() -> Iterator[None]:
    """Suppress warnings while an OpenGL backend is tried, and undo side effects afterwards.

    PyOpenGL binds to a single backend on import, by a variable that MuJoCo sets. Therefore new
    modules of PyOpenGL and MuJoCo are removed from ``sys.modules`` after an exception.
    """
    variables = {name: os.environ.get(name) for name in ("PYOPENGL_PLATFORM", "EGL_LOG_LEVEL")}
    modules = set(sys.modules)
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Exception:
        for name in set(sys.modules) - modules:
            if name.startswith(("OpenGL", "mujoco.")):
                del sys.modules[name]
        raise
    finally:
        for name, value in variables.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _render_with(backend: str, tiles: Sequence[Tile]) -> list[Pixels]:
    """Render the picture of each robot with an OpenGL backend of MuJoCo, such as ``egl``.

    An exception of any type is raised if the backend does not work.

    Returns:
        Pixels of each tile, shape (height, width, 3).
    """
    size = tiles[0].width, max(tile.height for tile in tiles)
    window: Any = import_module(f"mujoco.{backend}").GLContext(*size)
    try:
        window.make_current()
        if backend == "glfw" and not import_module("glfw").get_current_context():
            # Without a context, MuJoCo's second attempt would end the process.
            raise RuntimeError("it cannot open a window")
        return [_render_tile(tile) for tile in tiles]
    finally:
        window.free()


def _render_tile(tile: Tile) -> Pixels:
    """Render the picture of one robot, shape (height, width, 3) of the tile, 8 bits per colour.

    Empty pixels have the `BACKGROUND_COLOUR`. An OpenGL context must be active.
    """
    model = _compile_model(tile)
    data = mujoco.MjData(model)
    tile.robot.mj_convention.set_state(data, tile.qpos)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    model.vis.global_.fovy = tile.height / tile.scale
    camera.lookat[:] = tile.centre @ np.array([IMAGE_RIGHT, IMAGE_UP])
    camera.distance = 2 * tile.height / tile.scale
    camera.azimuth, camera.elevation = math.degrees(CAMERA_AZIMUTH), -math.degrees(CAMERA_ELEVATION)
    camera.orthographic = 1
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, everything, scene)
    scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX.value] = 0
    height, width = _OVERSAMPLING_FACTOR * tile.height, _OVERSAMPLING_FACTOR * tile.width
    image, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
    frame = mujoco.MjrRect(0, 0, width, height)
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    try:
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        mujoco.mjr_render(frame, scene, context)
        mujoco.mjr_readPixels(image, depth, frame, context)
    finally:
        context.free()
    image[depth == 1.0] = np.round(255 * np.array(to_rgb(BACKGROUND_COLOUR)))
    # Pixels on an outline are shared by robot and ground.
    parts = image[::-1].reshape(
        tile.height, _OVERSAMPLING_FACTOR, tile.width, _OVERSAMPLING_FACTOR, 3
    )
    return np.asarray(np.round(parts.mean(axis=(1, 3))), dtype=np.uint8)


_PICTURE_DPI = 100
"""Resolution of the picture [pixels per inch], which relates font sizes to pixels. Chosen, not
tuned."""
_NUM_COLUMNS = 3
"""Largest number of robots in a row of the picture. Chosen, not tuned."""


@dataclass(frozen=True)
class Picture:
    """Picture file that was written, and the method by which it was drawn.

    Attributes:
        path: PNG file.
        method: ``egl``, ``osmesa``, ``glfw`` or ``cgl`` (OpenGL backends), or ``lines``.
        note: Reason for a line drawing; None if the picture was rendered.
    """

    path: Path
    method: str
    note: str | None


def render_variants(
    robots_and_stands: Sequence[tuple[Robot, Stand]], path: str | Path, *, width: int = 1500
) -> Picture:
    """Render robots side by side at the same scale, with names, leg lengths (if known) and masses.

    Args:
        robots_and_stands: (robot, stand) pairs.
        path: PNG file.
        width: Width of the picture [pixels], rounded down to a multiple of the number of columns
            (at most three).

    Returns:
        Picture that was written. Without OpenGL it is a line drawing, and the note states the
        reason.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    if not robots_and_stands:
        raise ConfigurationError("robots_and_stands", diagnose("no-robot-to-draw"))
    poses = [(robot, stand.qpos) for robot, stand in robots_and_stands]
    tiles = lay_out_tiles(poses, width, min(_NUM_COLUMNS, len(poses)))
    images, method, note = render_tiles(tiles)
    width = max(tile.left + tile.width for tile in tiles)
    height = max(tile.top + tile.height for tile in tiles)
    height += round(_BAR_MARGIN * tiles[0].width)
    figure = Figure(
        figsize=(width / _PICTURE_DPI, height / _PICTURE_DPI),
        dpi=_PICTURE_DPI,
        facecolor=BACKGROUND_COLOUR,
    )
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
    _draw_scale_bar(canvas, tiles[0], height)
    save_figure(figure, path)
    return Picture(Path(path), method, note)


def _write_label(canvas: Axes, tile: Tile) -> None:
    """Write name, leg length and mass below a robot; no leg length if a part is unknown."""
    robot = tile.robot
    # Letters that fit the tile, in points.
    size = 0.03 * tile.width * 72 / _PICTURE_DPI
    x, y = tile.left + tile.width / 2, tile.top + tile.height - (LABEL_HEIGHT + 0.02) * tile.width
    thigh, calf = measure_leg_lengths(robot)
    legs = "" if thigh is None or calf is None else f"legs {1e3 * (thigh + calf):.0f} mm, "
    numbers = f"{legs}mass {format_widened(robot.total_mass, '.2f')} kg"
    below = y + 2.0 * size * _PICTURE_DPI / 72
    common: dict[str, Any] = {"ha": "center", "va": "top", "parse_math": False}
    name = canvas.text(x, y, robot.name, size=1.35 * size, weight="bold", color="#1F2937", **common)
    widest = (1 - 2 * _LABEL_MARGIN) * tile.width  # one pixel per unit of the canvas
    name.set_fontsize(1.35 * size * min(1.0, widest / name.get_window_extent().width))
    canvas.text(x, below, numbers, size=size, color="#4B5563", **common)


def _draw_scale_bar(canvas: Axes, tile: Tile, picture_height: int) -> None:
    """Draw a bar of a round length in the lower left corner of the picture.

    The bar is to scale for lengths parallel to the image's x axis. Vertical lengths are shortened
    by the cosine of `CAMERA_ELEVATION`.
    """
    longest = _MAX_BAR_LENGTH * tile.width / tile.scale
    length = choose_bar_length(longest)
    start = tile.left + _TILE_MARGIN * tile.width / 2
    end, level = start + length * tile.scale, picture_height - 0.4 * _BAR_MARGIN * tile.width
    thick = 0.006 * tile.width * 72 / _PICTURE_DPI
    canvas.plot([start, end], [level, level], color="#1F2937", lw=thick, solid_capstyle="butt")
    size = 0.026 * tile.width * 72 / _PICTURE_DPI
    text = f"{1e3 * length:g} mm"
    canvas.text((start + end) / 2, level - 0.012 * tile.width, text, size=size, ha="center")


def _draw_lines(canvas: Axes, tile: Tile) -> None:
    """Draw a robot as legs and base on its piece of ground, in place of a rendered picture.

    The projection is that of the rendered picture. ``canvas`` has the picture's pixels as unit.
    """
    lines = tile.lines
    thick = 0.035 * tile.width * 72 / _PICTURE_DPI
    legs = np.array([leg[[0, -1]] for leg in lines.legs.values()])
    canvas.fill(*tile.pixels(tile.ground).T, color=GROUND_COLOUR, zorder=1)
    for leg in lines.legs.values():
        # The camera is on the right: legs on this side are drawn over the base, the others below.
        near = leg[0, 1] < legs[:, 0, 1].mean()
        order, colour = (4, "#374151") if near else (2, "#9CA3AF")
        seen = tile.pixels(leg).T
        canvas.plot(*seen, color=colour, lw=thick, solid_capstyle="round", zorder=order)
        canvas.plot(*seen[:, -1:], "o", color="#111827", ms=2 * thick, zorder=order)
    for parts, face, edge in (
        (lines.others, "#C5CAD3", "#4B5563"),
        (lines.base, "#F3C453", "#7A5300"),
    ):
        style = {"fc": face, "ec": edge, "alpha": 0.6, "lw": thick / 10, "zorder": 3}
        for part in parts:
            draw_silhouette(canvas, part.silhouette(tile.pixels), **style)
