"""Rendered pictures of standing robots: MuJoCo off screen or, without OpenGL, line drawings."""

from __future__ import annotations

import math
import os
import platform
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from pupper_analysis import figures
from pupper_analysis.analysis import leg_lengths
from pupper_analysis.description.mjcf import compile_spec
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.robot import Robot
from pupper_analysis.stand import Stand

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_GROUND = (0.95, 0.96, 0.975)
_DPI = 100
_SAMPLES = 8  # per pixel
_ELEVATION = math.radians(18)
_AZIMUTH = math.radians(140)  # where the camera looks: from the front and the robot's right
_LABEL = 0.075  # m, room for a label below a robot
_OFF = ("disable", "disabled", "off", "false", "0")


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
        ConfigurationError: If ``width`` is out of range, or the file cannot be written.
    """
    return _picture([(robot, np.array(qpos, dtype=float))], Path(path), width, columns=1)


def render_variants(
    robots_and_stands: Sequence[tuple[Robot, Stand]],
    path: str | Path,
    *,
    width: int = 1800,
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
        ConfigurationError: If there is no robot, ``width`` or ``columns`` is out of range, or the
            file cannot be written.
    """
    poses = [(robot, stand.qpos) for robot, stand in robots_and_stands]
    return _picture(poses, Path(path), width, columns)


def _picture(poses: Sequence[tuple[Robot, Array]], path: Path, width: int, columns: int) -> Picture:
    if not poses:
        raise ConfigurationError("robots", "there is none to draw")
    if not 200 <= width <= 8000:
        raise ConfigurationError("width", f"{width} is not between 200 and 8000 pixels")
    if columns < 1:
        raise ConfigurationError("columns", f"{columns} is not at least 1")
    lines = [figures.skeleton(robot, qpos) for robot, qpos in poses]
    layout = _layout(lines, min(columns, len(poses)))
    height = round(width * layout.size[1] / layout.size[0])
    model, data = _scene(poses, layout, width, height)
    image, method, note = _render(model, data, layout, width, height)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=_GROUND)
    if image is None:
        _draw_lines(figure, lines, layout, width)
    else:
        figure.figimage(image, origin="upper")
    _write_labels(figure, [robot for robot, _ in poses], layout, width)
    figures.save(figure, path)
    return Picture(path, method, note)


# ------------------------------------------------------------------------------------- layout


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where the robots stand, and the parallel projection that shows them.

    Attributes:
        offsets: (n, 2) added to each robot's place on the ground (m).
        labels: (n, 3) below each robot, on the ground (m).
        centre: (3,) what is in the middle of the picture (m).
        right: (3,) the picture's horizontal axis in the world.
        up: (3,) its vertical axis.
        size: Width and height of what is shown (m).
        columns: Robots in a row.
    """

    offsets: Array
    labels: Array
    centre: Array
    right: Array
    up: Array
    size: tuple[float, float]
    columns: int

    def pixels(self, points: Array, width: int) -> Array:
        """Returns where points (n, 3) are in a picture: (n, 2) from its lower left corner."""
        seen = (points - self.centre) @ np.array([self.right, self.up]).T
        place: Array = (seen + np.array(self.size) / 2) * width / self.size[0]
        return place


def _layout(lines: Sequence[figures.Skeleton], columns: int) -> _Layout:
    sight = np.array([math.cos(_AZIMUTH), math.sin(_AZIMUTH), 0.0])
    right = np.array([sight[1], -sight[0], 0.0])
    up = math.cos(_ELEVATION) * np.array([0, 0, 1.0]) + math.sin(_ELEVATION) * sight
    seen = []
    for line in lines:
        points = np.concatenate([line.boxes.reshape(-1, 3), *line.legs.values()])
        seen.append(points @ np.array([right, up]).T)
    low = np.array([points.min(axis=0) for points in seen]) - 0.02
    high = np.array([points.max(axis=0) for points in seen]) + 0.02
    pitch = (high - low).max(axis=0) + np.array([0.04, _LABEL])
    rows = -(-len(lines) // columns)
    offsets, labels = [], []
    for index in range(len(lines)):
        row, column = divmod(index, columns)
        # Each robot's picture is centred in its column and stands on its row's line.
        x = column * pitch[0] - (low[index, 0] + high[index, 0]) / 2
        y = -row * pitch[1] - low[index, 1]
        ground = x * right + y / math.sin(_ELEVATION) * sight
        offsets.append(ground[:2])
        labels.append(column * pitch[0] * right + -row * pitch[1] / math.sin(_ELEVATION) * sight)
    tops = high[:columns, 1] - low[:columns, 1]
    size = (columns * pitch[0], (rows - 1) * pitch[1] + tops.max() + _LABEL)
    middle = (columns - 1) * pitch[0] / 2 * right
    middle = middle + (size[1] / 2 - (rows - 1) * pitch[1] - _LABEL) / math.sin(_ELEVATION) * sight
    return _Layout(np.array(offsets), np.array(labels), middle, right, up, size, columns)


# ------------------------------------------------------------------------------------- drawing


def _write_labels(figure: Figure, robots: Sequence[Robot], layout: _Layout, width: int) -> None:
    size = 0.0094 * width * 72 / _DPI * (3 / layout.columns) ** 0.5
    for robot, (x, y) in zip(robots, layout.pixels(layout.labels, width), strict=True):
        place = (x / _DPI / figure.get_figwidth(), y / _DPI / figure.get_figheight())
        figure.text(
            *place,
            robot.name,
            size=1.35 * size,
            weight="bold",
            color="#1F2937",
            ha="center",
            va="top",
            parse_math=False,
        )
        figure.text(
            place[0],
            place[1] - 2.1 * size / 72 / figure.get_figheight(),
            f"legs {1e3 * sum(leg_lengths(robot)):.0f} mm, mass {robot.total_mass:.2f} kg",
            size=size,
            color="#4B5563",
            ha="center",
            va="top",
        )


def _draw_lines(
    figure: Figure, lines: Sequence[figures.Skeleton], layout: _Layout, width: int
) -> None:
    """Draws robots as lines, in the same projection as the rendered picture."""
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(0, width), ylim=(0, width * layout.size[1] / layout.size[0]))
    thick = 0.006 * width / layout.size[0] * 72 / _DPI  # 6 mm in points
    for line, (x, y) in zip(lines, layout.offsets, strict=True):
        shift = np.array([x, y, 0.0])
        feet = figures.support_polygon(leg[-1] for leg in line.legs.values())
        ground = np.column_stack([feet, np.zeros(len(feet))])
        axes.fill(*layout.pixels(ground + shift, width).T, color="#DDE2E9", zorder=1)
        hips = np.array([leg[0] for leg in line.legs.values()])
        for leg in line.legs.values():
            # The camera is on the right: the legs of that side hide the base, it hides the others.
            near = leg[0, 1] < hips[:, 1].mean()
            order, colour = (4, "#374151") if near else (2, "#9CA3AF")
            seen = layout.pixels(leg + shift, width).T
            axes.plot(*seen, color=colour, lw=3 * thick, solid_capstyle="round", zorder=order)
            axes.plot(*seen[:, -1:], "o", color="#111827", ms=6 * thick, zorder=order)
        for box in line.boxes:
            for face in figures.BOX_FACES:
                corners = layout.pixels(box[list(face)] + shift, width).T
                axes.fill(*corners, fc="#F3C453", ec="#7A5300", alpha=0.6, lw=0.3 * thick, zorder=3)


# ------------------------------------------------------------------------------------- OpenGL


def _scene(
    poses: Sequence[tuple[Robot, Array]], layout: _Layout, width: int, height: int
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Puts all robots into one MuJoCo model, each in its place and pose, on a plain ground."""
    scene = mujoco.MjSpec()
    scene.compiler.conflict = mujoco.mjtConflict.mjCONFLICT_MERGE
    scene.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 0.05), rgba=(*_GROUND, 1.0)
    )
    for direction, brightness, shadow in (
        ((-0.45, 0.35, -1.0), 0.42, True),
        ((-0.6, -0.7, -0.6), 0.16, False),
    ):
        scene.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=(*layout.centre[:2], 1.0),
            dir=direction,
            diffuse=(brightness,) * 3,
            specular=(0.2 * shadow,) * 3,
            castshadow=shadow,
        )
    qpos = []
    for index, ((robot, pose), offset) in enumerate(zip(poses, layout.offsets, strict=True)):
        spec = robot.description.mjcf.copy()
        planes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
        free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
        unwanted = [*planes, *spec.lights, *spec.keys, *([] if robot.floating else free)]
        for element in unwanted:
            spec.delete(element)
        place = scene.worldbody.add_frame(pos=(*offset, 0.0))
        scene.attach(spec, frame=place, prefix=f"{index}/")
        own = mujoco.MjData(robot.mj_model)
        robot.mj_convention.set_state(own, pose)
        if robot.floating:
            own.qpos[robot.mj_convention.qpos_index[:2]] += offset
        qpos.append(own.qpos)
    visual = scene.visual
    visual.global_.offwidth = width
    visual.global_.offheight = height
    visual.global_.fovy = layout.size[1]
    visual.global_.orthographic = True
    visual.quality.shadowsize = 4096
    visual.quality.offsamples = _SAMPLES
    visual.headlight.ambient = (0.42,) * 3
    visual.headlight.diffuse = (0.28,) * 3
    visual.headlight.specular = (0.05,) * 3
    model = compile_spec(scene, Path("scene"))
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate(qpos)
    mujoco.mj_forward(model, data)
    return model, data


def _render(
    model: mujoco.MjModel, data: mujoco.MjData, layout: _Layout, width: int, height: int
) -> tuple[Image | None, str, str | None]:
    """Returns the picture, by which backend, and no note; or None, ``lines`` and the reason."""
    reasons = []
    for backend in _backends():
        try:
            with _quiet_attempt():
                return _render_with(backend, model, data, layout, width, height), backend, None
        except Exception as error:  # every driver fails in its own way
            reasons.append(f"{backend}: {' '.join(str(error).split())[:120]}")
    why = "; ".join(reasons) or "MUJOCO_GL switches it off"
    return None, "lines", f"no OpenGL ({why}): a line drawing instead of a rendered picture"


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


def _render_with(
    backend: str,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    layout: _Layout,
    width: int,
    height: int,
) -> Image:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = layout.centre
    camera.distance = 3.0
    camera.azimuth = math.degrees(_AZIMUTH)
    camera.elevation = -math.degrees(_ELEVATION)
    camera.orthographic = 1
    scene = mujoco.MjvScene(model, maxgeom=10000)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
    )
    window: Any = import_module(f"mujoco.{backend}").GLContext(width, height)
    try:
        window.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
            frame = mujoco.MjrRect(0, 0, width, height)
            image = np.empty((height, width, 3), dtype=np.uint8)
            mujoco.mjr_render(frame, scene, context)
            mujoco.mjr_readPixels(image, None, frame, context)
        finally:
            context.free()
    finally:
        window.free()
    return image[::-1]
