"""Draws robots through OpenGL, with the light of a picture, and their shadows on the ground."""

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
from typing import Any

import mujoco
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy import ndimage

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.present.tiles import (
    AHEAD,
    AZIMUTH,
    ELEVATION,
    RIGHT,
    SUN,
    UP,
    Tile,
)

Array = NDArray[np.float64]
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
