"""The figures that put analyses beside each other: torques, heights and gains, a panel each."""

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
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray
from scipy import ndimage

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.models.mjcf import JointKind, compile_spec
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import in_english, text
from pupper_analysis.present.documents.loads import torque_plot
from pupper_analysis.present.documents.standing import height_plot
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.figures.drawing import save_figure, write_plots
from pupper_analysis.present.figures.pose import (
    BOX_FACES,
    Skeleton,
    draw_skeleton,
    hull_corners,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.analyze.analysis import leg_lengths
from pupper_analysis.tools.analyze.document import deviation_table

if TYPE_CHECKING:
    from pupper_analysis.tools.analyze.analysis import Analysis

_COLUMNS = 3
"""Panels beside each other."""

_ROOMY = 12
"""Columns of cells across a page in which five digits stand apart at the usual size."""


def torque_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws what every motor holds, beside its effort limit: one panel per robot.

    Args:
        analyses: The robots; ``statics``, ``verification`` and ``joints`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    plots, names = [], []
    for one in analyses:
        limits = [joint.effort for joint in one.joints]
        simulated = one.verification.joint_torques.tolist()
        plots.append(torque_plot(one.statics, simulated, limits))
        low, high = min(limits), max(limits)
        names.append(f"{one.name}: limit {low:g}{f' to {high:g}' if high > low else ''} N m")
    write_plots(plots, path, title=text("motor-torques-against-their-limits"), names=names)


def height_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draws the base's height over the simulated time, with and without feed-forward.

    Args:
        analyses: The robots; ``stand``, ``verification`` and ``sagging`` are drawn.
        path: The PNG to write.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    plots = [
        height_plot((one.verification, one.sagging), float(one.stand.qpos[2])) for one in analyses
    ]
    write_plots(plots, path, names=[one.name for one in analyses])


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
    title = "Gain sweep: standard deviation of the height in the last second"
    figure, panels = _panels(analyses, title, 0.26 * rows + 0.65)
    tables = [deviation_table(analysis.sweep) for analysis in analyses]
    shown = [_values(table) for table in tables]
    known = np.concatenate([values[values > 0] for values in shown])
    low, high = (known.min(), known.max()) if len(known) else (0.1, 1.0)
    norm = LogNorm(low, max(high, 1.01 * low))
    for index, (axes, analysis) in enumerate(zip(panels, analyses, strict=True)):
        image = axes.imshow(
            shown[index].clip(low), norm=norm, cmap="cividis", aspect="auto", origin="lower"
        )
        sweep = analysis.sweep
        columns = len(sweep.kd) * min(_COLUMNS, len(analyses))
        _write_cells(axes, tables[index], norm, drawing.FONT * min(1.0, _ROOMY / columns))
        drawing.title_panel(axes, analysis.name)
        axes.set_xticks(range(len(sweep.kd)), [f"{value:g}" for value in sweep.kd])
        axes.set_yticks(range(len(sweep.kp)), [f"{value:g}" for value in sweep.kp])
        axes.tick_params(length=0)
        axes.set_xlabel("kd (N m s/rad)", size=drawing.FONT)
        axes.set_ylabel("kp (N m/rad)", size=drawing.FONT)
        _label_outside(axes, index, len(analyses))
    colours = figure.colorbar(
        image, ax=panels, shrink=0.9, pad=0.015, aspect=20 * -(-len(panels) // _COLUMNS)
    )
    colours.set_label("deviation (mm)", size=drawing.FONT)
    colours.ax.tick_params(labelsize=drawing.FONT, which="both")
    colours.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    colours.ax.yaxis.set_minor_locator(NullLocator())
    colours.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    disturbance = f"vertical disturbance of {sweep.amplitude:g} N at {sweep.frequency:g} Hz"
    named = [
        Patch(fill=False, edgecolor=drawing.RED, lw=2, label="no stable rest"),
        Patch(facecolor="#F1F1F1", edgecolor=drawing.GREY, hatch="////", label="fell"),
        Line2D([], [], ls="", label=disturbance),
    ]
    drawing.put_legend(figure, named)
    drawing.save_figure(figure, path)


def _panels(analyses: Sequence[object], title: str, row_height: float) -> tuple[Figure, list[Axes]]:
    """Returns a figure with one panel (of ``row_height`` inches) per robot, in rows of three."""
    if not analyses:
        raise ConfigurationError("analyses", diagnose("no-robot-to-draw"))
    columns = min(_COLUMNS, len(analyses))
    rows = -(-len(analyses) // columns)
    figure = drawing.page_figure(title, rows * row_height + 0.75, layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    panels = [figure.add_subplot(grid[divmod(index, columns)]) for index in range(len(analyses))]
    return figure, panels


def _label_outside(axes: Axes, index: int, count: int) -> None:
    """Takes off what axes say that those below say too, or those on the left."""
    if index + _COLUMNS < count:
        axes.set_xlabel("")
    if index % _COLUMNS:
        axes.set_ylabel("")


def _values(table: doc.Table) -> doc.Array:
    """Returns the numbers of a table's cells but for the first column's; nan where one has none."""
    return np.array(
        [
            [cell.value if isinstance(cell, doc.Number) else np.nan for cell in row[1:]]
            for row in table.rows
        ]
    )


def _write_cells(axes: Axes, table: doc.Table, norm: LogNorm, size: float) -> None:
    """Writes the numbers of a table into its cells, or what is there; frames those marked."""
    for row, cells in enumerate(table.rows):
        for column, cell in enumerate(cells[1:]):
            # What is inside its cell makes no room for itself: it need not be measured for that.
            at: dict[str, Any] = {"size": size, "ha": "center", "va": "center", "in_layout": False}
            if not isinstance(cell, doc.Number):
                place = (column - 0.5, row - 0.5)
                look: dict[str, Any] = {
                    "fc": "#F1F1F1",
                    "ec": drawing.GREY,
                    "hatch": "////",
                    "lw": 0,
                }
                axes.add_patch(Rectangle(place, 1, 1, **look))
                box = {"fc": "white", "ec": "none", "pad": 1.0}
                axes.text(column, row, in_english(cell), bbox=box, **at)
                continue
            said = f"{cell.value:.3f}" if cell.value < 10 else f"{cell.value:.0f}"
            shade = "white" if norm(cell.value) < 0.5 else drawing.BLACK
            axes.text(column, row, said, color=shade, **at)
            if cell.mark:
                place = (column - 0.46, row - 0.46)
                axes.add_patch(Rectangle(place, 0.92, 0.92, fill=False, ec=drawing.RED, lw=2.2))


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


Image = NDArray[np.uint8]
GROUND = "#EEF1F5"
_SHADOWS = ((0.18, 0.012), (0.20, 0.056))  # darkness, and blur in radii of the robot
_SHADOW_SIZE = 512  # pixels
_OVERSAMPLING = 2  # pixels rendered per pixel shown, in each direction
_HIDDEN = 5  # a group of geoms that MuJoCo does not draw
_OFF = ("disable", "disabled", "off", "false", "0")


def _model(tile: Tile) -> mujoco.MjModel:
    """Compiles a robot's MJCF, its ground hidden, and with the lights of the picture."""
    robot = tile.robot
    spec = robot.description.mjcf.copy()
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.group = _HIDDEN
    free = [joint for joint in spec.joints if joint.type == JointKind.FREE]
    for element in (*spec.lights, *(() if robot.floating else (*free, *spec.keys))):
        spec.delete(element)
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    sun, fill = (spec.worldbody.add_light(type=directional) for _ in range(2))
    extent = max(tile.width, tile.height) / tile.scale / 2
    sun.pos, sun.dir, sun.castshadow = (
        tile.lines.points().mean(axis=0) - 2 * extent * SUN,
        SUN,
        True,
    )
    sun.diffuse, sun.specular = (0.45,) * 3, (0.25,) * 3
    fill.dir, fill.castshadow = (-0.6, -0.7, -0.5), False
    fill.diffuse, fill.specular = (0.18,) * 3, (0.0,) * 3
    visual = spec.visual
    visual.headlight.ambient, visual.headlight.diffuse = (0.42,) * 3, (0.25,) * 3
    visual.headlight.specular = (0.05,) * 3
    visual.global_.offwidth = _OVERSAMPLING * tile.width
    visual.global_.offheight = _OVERSAMPLING * tile.height
    visual.global_.orthographic = True
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 0
    visual.map.shadowclip = 1.0
    spec.stat.extent = extent
    return compile_spec(spec, robot.description.mjcf_source)


def render_tiles(tiles: Sequence[Tile]) -> tuple[list[Image], str, str | None]:
    """Returns an image per tile, from which backend, and no note; or none, ``lines`` and why."""
    reasons = []
    for backend in _backends():
        try:
            with _quiet_attempt():
                return _render_with(backend, tiles), backend, None
        except PupperAnalysisError:
            raise
        except Exception as error:  # every driver fails in its own way
            reasons.append(f"{backend}: {textwrap.shorten(str(error), 100, placeholder='...')}")
    why = "; ".join(reasons) or "MUJOCO_GL switches it off"
    return [], "lines", f"no OpenGL ({why}): a line drawing instead of a rendered picture"


def _backends() -> tuple[str, ...]:
    """Returns the modules of ``mujoco`` to get OpenGL from: the user's, or those that may do.

    MuJoCo reads MUJOCO_GL when it is imported, which is too early: so its choice is made here.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in _OFF:
        return ()
    if wanted in ("egl", "osmesa", "glfw", "cgl"):
        return (wanted,)
    if platform.system() == "Linux":
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        return ("egl", "osmesa", "glfw") if display else ("egl", "osmesa")
    return ("cgl", "glfw") if platform.system() == "Darwin" else ("glfw",)


@contextmanager
def _quiet_attempt() -> Iterator[None]:
    """Keeps drivers quiet, and lets another backend follow if this one fails.

    PyOpenGL is bound to one backend on import, by an environment variable that mujoco sets.
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


def _render_with(backend: str, tiles: Sequence[Tile]) -> list[Image]:
    size = tiles[0].width, max(tile.height for tile in tiles)
    window: Any = import_module(f"mujoco.{backend}").GLContext(*size)
    try:
        window.make_current()
        if backend == "glfw" and not import_module("glfw").get_current_context():
            # MuJoCo ends the process when it is asked a second time without a context.
            raise RuntimeError("it cannot open a window")
        return [_render_tile(tile) for tile in tiles]
    finally:
        window.free()


def _render_tile(tile: Tile) -> Image:
    model = _model(tile)
    data = mujoco.MjData(model)
    tile.robot.mj_convention.set_state(data, tile.qpos)
    mujoco.mj_forward(model, data)
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    try:
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        shadow = _shadow(tile, model, data, context)
        camera = _Camera(
            AZIMUTH, -ELEVATION, tile.centre @ np.array([RIGHT, UP]), tile.height / tile.scale
        )
        shape = (_OVERSAMPLING * tile.height, _OVERSAMPLING * tile.width)
        image, robot = _shoot(camera, shape, model, data, context)
    finally:
        context.free()
    # Pixels on an outline are shared by robot and ground.
    image[~robot] = 0
    steps = [(i, j) for i in range(_OVERSAMPLING) for j in range(_OVERSAMPLING)]
    colour, share = np.zeros((*shadow.shape, 3), np.uint16), np.zeros(shadow.shape, np.uint16)
    for i, j in steps:
        colour += image[i::_OVERSAMPLING, j::_OVERSAMPLING]
        share += robot[i::_OVERSAMPLING, j::_OVERSAMPLING]
    ground = np.array(to_rgb(GROUND), np.float32) * (255 * shadow)[:, :, None]
    mixed = (colour + (len(steps) - share)[:, :, None] * ground) / np.float32(len(steps))
    return np.asarray(mixed + np.float32(0.5), dtype=np.uint8)


def _shadow(
    tile: Tile, model: mujoco.MjModel, data: mujoco.MjData, context: mujoco.MjrContext
) -> Array:
    """Returns by what the ground's light is to be multiplied, per pixel of the tile.

    The shadow is the robot's outline as the sun sees it, blurred, and mapped to the ground.
    """
    azimuth = math.atan2(SUN[1], SUN[0])
    elevation = math.atan2(SUN[2], math.hypot(SUN[0], SUN[1]))
    points = tile.lines.points()
    middle = points.mean(axis=0)
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    sun = _Camera(azimuth, elevation, middle, 2.8 * reach)
    side = min(_SHADOW_SIZE, _OVERSAMPLING * min(tile.width, tile.height))
    outline = _shoot(sun, (side, side), model, data, context)[1].astype(float)
    scale = side / sun.height
    # Both a sharp shadow, which ties the feet to the ground, and a soft one.
    dark = sum(
        weight * ndimage.gaussian_filter(outline, scale * reach * blur) for weight, blur in _SHADOWS
    )
    # From a pixel (row, column) of the tile to the ground, and on to a pixel of the outline.
    ground = np.column_stack([-AHEAD / math.sin(ELEVATION), RIGHT]) / tile.scale
    to_pixels = scale * np.array([-sun.axes()[1], sun.axes()[0]])
    matrix = to_pixels @ ground
    x, y = tile.centre
    centre = x * RIGHT + y / math.sin(ELEVATION) * AHEAD
    shape = (tile.height, tile.width)
    offset = to_pixels @ (centre - middle) + (side - 1) / 2 - matrix @ (np.array(shape) - 1) / 2
    mapped = ndimage.affine_transform(dark, matrix, offset, shape, order=1)
    light: Array = 1 - mapped
    return light.astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Camera:
    """A camera with parallel projection.

    Attributes:
        azimuth: Of its line of sight (rad).
        elevation: Likewise; negative looks down.
        centre: (3,) what is in the picture's middle (m).
        height: Of what it shows (m).
    """

    azimuth: float
    elevation: float
    centre: Array
    height: float

    def axes(self) -> Array:
        """Returns the directions (2, 3) of the picture's right and up in the world."""
        sine, cosine = math.sin(self.azimuth), math.cos(self.azimuth)
        tilt, level = math.sin(self.elevation), math.cos(self.elevation)
        return np.array([[sine, -cosine, 0.0], [-tilt * cosine, -tilt * sine, level]])


def _shoot(
    camera: _Camera,
    shape: tuple[int, int],
    model: mujoco.MjModel,
    data: mujoco.MjData,
    context: mujoco.MjrContext,
) -> tuple[Image, NDArray[np.bool_]]:
    """Returns a picture (height, width, 3), and where in it there is a robot (height, width)."""
    model.vis.global_.fovy = camera.height
    view = mujoco.MjvCamera()
    view.lookat[:] = camera.centre
    view.distance = 2 * camera.height
    view.azimuth, view.elevation = math.degrees(camera.azimuth), math.degrees(camera.elevation)
    view.orthographic = 1
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, everything, scene)
    scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX.value] = 0
    height, width = shape
    image = np.empty((height, width, 3), dtype=np.uint8)
    depth = np.empty((height, width), dtype=np.float32)
    frame = mujoco.MjrRect(0, 0, width, height)
    mujoco.mjr_render(frame, scene, context)
    mujoco.mjr_readPixels(image, depth, frame, context)
    return image[::-1], depth[::-1] < 1.0


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
