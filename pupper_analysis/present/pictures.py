"""Pictures and animations of robots by MuJoCo's renderer: ``show`` and ``animate`` of results.

A separate process draws the frames (`offscreen`), so that a missing OpenGL ends no notebook. The
view of a type of results is registered with ``@make_view.register``.
"""

from __future__ import annotations

import base64
import io
import math
import os
import reprlib
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from pupper_analysis import __version__
from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.array_types import Array, Pixels
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import ANIMATION_KIND, GENERATOR_NAME
from pupper_analysis.present.display import DisplayError, check_display, in_notebook, show_window
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.whole_body import SolvedPosture

DEFAULT_SIZE = (640, 480)
"""Width and height of a picture [pixel]. Chosen, not tuned."""

ANIMATION_SIZE = (480, 360)
"""Width and height of an animation [pixel]. Chosen, not tuned."""

AZIMUTH, ELEVATION = 135.0, -20.0
"""Direction of the camera in MuJoCo's convention [deg]: from the front right, from above."""

_VIEW_MARGIN = 1.15
"""Distance of the camera, as a multiple of the least distance at which the sphere around the robot
fits into the vertical field of view. Chosen, not tuned.
"""

_MIN_RADIUS = 0.01
"""Smallest radius of the sphere around a robot [m], for robots without geoms. Chosen, not tuned."""

_TURN_SECONDS, _FRAMES_PER_SECOND = 4.0, 10
"""Duration [s] of a turn of the camera around a posture, and frames per second of the turn. Chosen,
not tuned.
"""

_MAX_FRAMES = 600
"""Largest number of frames of an animation of a motion: 300 MB in memory for `ANIMATION_SIZE`.
Chosen, not tuned."""

_MAX_SIDE = 8192
"""Largest width and height of a picture [pixel]. Chosen: half of 16384, the size of a frame buffer
that OpenGL 4.1 requires of each implementation; with larger sizes, MuJoCo's renderer may fail."""

_MAX_PIXELS = 300_000_000
"""Largest number of pixels of all frames together: 0.9 GB in memory. Chosen, not tuned."""

_DRAWING_TIMEOUT = 300.0
"""Time [s] after which a drawing process is ended. Chosen, not tuned."""

_OFFSCREEN_DRIVERS = ("egl", "osmesa", "")
"""Values of MUJOCO_GL that are tried on Linux without a display; "" is MuJoCo's default."""


@dataclass(frozen=True, eq=False)
class MotionView:
    """Robot and configurations that a picture or an animation shows.

    Attributes:
        robot: Robot on its ground.
        time: Times, shape (n,) [s].
        qpos: Configurations, shape (n, nq).
    """

    robot: Robot
    time: Array
    qpos: Array


@dataclass(frozen=True, eq=False, repr=False)
class Animation:
    """Frames of an animation. Notebooks display the animation below the cell.

    Attributes:
        frames: Pixels, shape (n, height, width, 3), red, green and blue from 0 to 255.
        fps: Frames per second.
    """

    frames: Pixels
    fps: float

    def __repr__(self) -> str:
        count, height, width, _ = self.frames.shape
        return f"<Animation: {count} frames, {width} x {height} pixels, {self.fps:g} per second>"

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the animation as ``.gif``, or as ``.mp4`` with the package ``imageio[ffmpeg]``.

        Args:
            path: File. The suffix selects the format.
            force: Whether to replace a file of another kind. If False, only an empty file or an
                animation of this package is replaced.

        Raises:
            ConfigurationError: If the suffix is neither ``.gif`` nor ``.mp4``.
            MissingPackageError: If an MP4 is requested, and ``imageio[ffmpeg]`` is not installed.
            OutputError: If the file cannot be written, or must not be replaced.
        """
        target = Path(path)
        writers = {".gif": self._to_gif, ".mp4": self._to_mp4}
        if target.suffix.lower() not in writers:
            problem = diagnose("not-one-of", given=target.suffix, known=list(writers))
            raise ConfigurationError("path", problem)
        content = writers[target.suffix.lower()]()
        with write_atomically(target, ANIMATION_KIND, force=force) as file:
            file.write(content)
        return target

    def _to_gif(self) -> bytes:
        """Return the animation as the content of a GIF file."""
        images = [Image.fromarray(frame).quantize(128) for frame in self.frames]
        buffer = io.BytesIO()
        images[0].save(
            buffer,
            "GIF",
            save_all=True,
            append_images=images[1:],
            duration=round(1000 / self.fps),
            loop=0,
            comment=f"{GENERATOR_NAME} {__version__}",
        )
        return buffer.getvalue()

    def _to_mp4(self) -> bytes:
        """Return the animation as the content of an MP4 file; requires ``imageio[ffmpeg]``."""
        try:
            imageio = import_module("imageio.v2")
            import_module("imageio_ffmpeg")
        except ImportError as error:
            raise MissingPackageError("imageio[ffmpeg]", "video") from error
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "animation.mp4"
            comment = ["-metadata", f"comment={GENERATOR_NAME} {__version__}"]
            imageio.mimwrite(
                file, list(self.frames), fps=self.fps, macro_block_size=2, output_params=comment
            )
            return file.read_bytes()

    def _repr_html_(self) -> str:
        """Return the animation as an HTML image, for notebooks."""
        text = base64.b64encode(self._to_gif()).decode()
        return f'<img alt="animation" src="data:image/gif;base64,{text}">'


@check_arguments
def show_result(
    result: object,
    robot: Robot | None = None,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
) -> Image.Image | None:
    """Show the last configuration of a result in MuJoCo's viewer, or return a picture.

    The viewer is used if a window can be opened and the code does not run in a notebook. The viewer
    simulates the robot until the window is closed. The result is then None.

    Args:
        result: Result.
        robot: Robot of the result, if the result does not contain the robot.
        size: Width and height of the picture [pixel].
        azimuth: Azimuth of the picture's camera [deg], in MuJoCo's convention.
        elevation: Elevation of the picture's camera [deg], in MuJoCo's convention.

    Raises:
        ConfigurationError: If the result has no picture, the robot is missing, a stand belongs to
            another robot, or an argument is out of range.
        DisplayError: If the picture cannot be drawn, for example without OpenGL.
    """
    check_finite("azimuth", azimuth)
    check_finite("elevation", elevation)
    _check_size(size, 1)
    view = make_view(result, robot)
    if not in_notebook() and _can_open_window():
        data = mujoco.MjData(view.robot.mj_model)
        view.robot.mj_convention.set_state(data, view.qpos[-1])
        mujoco.mj_forward(view.robot.mj_model, data)
        show_window(view.robot.mj_model, data)
        return None
    last = view.qpos[-1:]
    camera = _make_cameras(view.robot, last, np.array([azimuth]), elevation)
    return Image.fromarray(draw_views(view.robot, last, camera, size, shadows=True)[0])


@check_arguments
def animate_result(
    result: object,
    robot: Robot | None = None,
    *,
    size: tuple[int, int] = ANIMATION_SIZE,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
) -> Animation:
    """Draw an animation of a result's motion.

    For a result with a single configuration, the camera turns around the robot once. Of a long
    motion, only every second, third etc. configuration is drawn.

    Args:
        result: Result.
        robot: Robot of the result, if the result does not contain the robot.
        size: Width and height [pixel].
        azimuth: Azimuth of the camera [deg], in MuJoCo's convention; the initial azimuth if the
            camera turns.
        elevation: Elevation of the camera [deg], in MuJoCo's convention.

    Raises:
        ConfigurationError: If the result has no picture, the robot is missing, a stand belongs to
            another robot, or an argument is out of range.
        DisplayError: If the pictures cannot be drawn, for example without OpenGL.
    """
    check_finite("azimuth", azimuth)
    check_finite("elevation", elevation)
    _check_size(size, 1)
    view = make_view(result, robot)
    if len(view.qpos) == 1:
        count = round(_TURN_SECONDS * _FRAMES_PER_SECOND)
        qpos = np.repeat(view.qpos, count, axis=0)
        azimuths = azimuth + np.arange(count) * 360.0 / count
        fps = float(_FRAMES_PER_SECOND)
    else:
        stride = math.ceil(len(view.qpos) / _MAX_FRAMES)
        qpos, time = view.qpos[::stride], view.time[::stride]
        azimuths = np.full(len(qpos), azimuth)
        fps = float((len(time) - 1) / (time[-1] - time[0]))
    cameras = _make_cameras(view.robot, qpos, azimuths, elevation)
    frames = draw_views(view.robot, qpos, cameras, size, shadows=False)
    return Animation(frames, fps)


@singledispatch
def make_view(result: Any, robot: Robot | None = None) -> MotionView:
    """Return the view of a result: the robot and the configurations that a picture shows.

    The view of a simulated stand contains the recorded motion. The views of the other types of this
    module contain a single configuration at time 0.

    Args:
        result: `Configuration`, `SolvedPosture`, `Stand`, `StandVerification`, or a result of a
            type that a tool has registered.
        robot: Robot of the result. Default: the robot that the result contains.

    Returns:
        Robot on its ground, times (n,) [s], and configurations (n, nq) with the joints in
        actuator order.

    Raises:
        ConfigurationError: If the type has no pictures, neither ``robot`` nor the result specifies
            the robot, or a stand belongs to another robot.
    """
    del robot
    kind = type(result).__name__
    raise ConfigurationError("result", diagnose("result-without-picture", kind=kind))


@make_view.register(Configuration)
def _make_configuration_view(config: Configuration, robot: Robot | None = None) -> MotionView:
    """Return the view of a configuration, with the robot of the configuration by default."""
    return _make_still_view(robot or config.robot, config.qpos)


@make_view.register(SolvedPosture)
def _make_posture_view(posture: SolvedPosture, robot: Robot | None = None) -> MotionView:
    """Return the view of a solved posture, with the robot of the posture by default."""
    return _make_still_view(_require_robot(posture, robot or posture.robot), posture.qpos)


@make_view.register(Stand)
def _make_stand_view(stand: Stand, robot: Robot | None = None) -> MotionView:
    """Return the view of a stand on its ground, with the robot of the stand by default."""
    owner = _require_robot(stand, robot or stand.own_robot)
    return _make_still_view(_place_on_ground(owner, stand), stand.qpos)


@make_view.register(StandVerification)
def _make_verification_view(run: StandVerification, robot: Robot | None = None) -> MotionView:
    """Return the view of the motion in a simulated stand; default robot: that of the stand."""
    stand = run.stand
    owner = _require_robot(run, robot or (stand.own_robot if stand is not None else None))
    on_ground = owner if stand is None else _place_on_ground(owner, stand)
    return MotionView(on_ground, run.motion_time, run.motion)


def _make_still_view(robot: Robot, qpos: Array) -> MotionView:
    """Create the view of a robot in a single configuration ``qpos``, shape (nq,), at time 0."""
    return MotionView(robot, np.zeros(1), np.asarray(qpos, dtype=float)[None])


def _require_robot(result: object, robot: Robot | None) -> Robot:
    """Return ``robot``, the robot of a result; raise a ConfigurationError if it is None."""
    if robot is None:
        kind = type(result).__name__
        raise ConfigurationError("robot", diagnose("picture-needs-robot", kind=kind))
    return robot


def _place_on_ground(robot: Robot, stand: Stand) -> Robot:
    """Return the robot on the ground of a stand: with its slopes, steps and tables."""
    return build_on_ground(stand.check(robot), stand.task.ground, stand.rigid_targets)


def check_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Check the names of the options of a picture, such as ``size``; return the options.

    Raises:
        ConfigurationError: If a name is not the name of an option.
    """
    known = ("size", "azimuth", "elevation")
    for name in options:
        if name not in known:
            raise ConfigurationError(name, diagnose("picture-option-unknown", known=known))
    return {**options}


def _check_size(size: Any, frames: int) -> None:
    """Raise a ConfigurationError if width and height of pictures [pixel] are not valid."""
    given = [*size] if isinstance(size, Sequence) or np.ndim(size) == 1 else []
    whole = all(isinstance(side, int | np.integer) and type(side) is not bool for side in given)
    if len(given) != 2 or not whole or not all(1 <= side <= _MAX_SIDE for side in given):
        text = " ".join(reprlib.repr(size).split())
        raise ConfigurationError(
            "size", diagnose("picture-without-pixels", given=text, most=_MAX_SIDE)
        )
    width, height = map(int, given)
    most = _MAX_PIXELS // frames
    if width * height > most:
        problem = diagnose(
            "picture-too-large", frames=frames, width=width, height=height, most=most
        )
        raise ConfigurationError("size", problem)


def _can_open_window() -> bool:
    """Return True if MuJoCo's viewer can open a window."""
    try:
        check_display()
    except DisplayError:
        return False
    return True


def _make_cameras(robot: Robot, qpos: Array, azimuths: Array, elevation: float) -> Array:
    """Create a camera per configuration; all have the same distance and looked-at point.

    The sphere around the robot in the first and last configuration fits into the height of the
    picture.

    Args:
        robot: Robot.
        qpos: Configurations, shape (n, nq).
        azimuths: Azimuth of each camera, shape (n,) [deg].
        elevation: Elevation of all cameras [deg].

    Returns:
        Shape (n, 6): looked-at point [m], distance [m], azimuth and elevation [deg].
    """
    model = robot.mj_model
    base = model.body(robot.mj_base).id
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body_rootid[base])
    geoms = geoms[model.geom_bodyid[geoms] != 0]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    points = []
    for state in (qpos[0], qpos[-1]):
        data = robot.compute_kinematics(state)
        points.append(data.xpos[base])
        for geom in geoms:
            box = model.geom_aabb[geom]
            corners = (box[:3] + signs * box[3:]) @ data.geom_xmat[geom].reshape(3, 3).T
            points += [*(data.geom_xpos[geom] + corners)]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    radius = max(float(np.linalg.norm(high - low)) / 2, _MIN_RADIUS)
    distance = _VIEW_MARGIN * radius / math.sin(math.radians(model.vis.global_.fovy) / 2)
    cameras = np.empty((len(qpos), 6))
    cameras[:, :3], cameras[:, 3] = (low + high) / 2, distance
    cameras[:, 4], cameras[:, 5] = azimuths, elevation
    return cameras


def draw_views(
    robot: Robot, qpos: Array, cameras: Array, size: Sequence[int], *, shadows: bool
) -> Pixels:
    """Draw configurations with MuJoCo's renderer, in a separate process.

    Args:
        robot: Robot on its ground.
        qpos: Configurations, shape (n, nq).
        cameras: Cameras, shape (n, 6): looked-at point [m], distance [m], azimuth and elevation
            [deg] in MuJoCo's convention.
        size: Width and height [pixel].
        shadows: Whether to draw shadows and reflections.

    Returns:
        Pixels, shape (n, height, width, 3).

    Raises:
        ConfigurationError: If the size is not valid (`_check_size`).
        DisplayError: If the drawing process fails or takes too long, for example without OpenGL.
    """
    _check_size(size, len(qpos))
    data = mujoco.MjData(robot.mj_model)
    states = np.empty((len(qpos), robot.mj_model.nq))
    for index, state in enumerate(qpos):
        robot.mj_convention.set_state(data, state)
        states[index] = data.qpos
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mujoco.mj_saveModel(robot.mj_model, str(folder / "model.mjb"))
        np.savez(
            folder / "views.npz", qpos=states, cameras=cameras, size=np.array(size), shadows=shadows
        )
        problem = ""
        for driver in _list_drivers():
            problem = _run_drawing(folder, driver) or ""
            if not problem:
                frames: Pixels = np.load(folder / "frames.npy")
                return frames
    raise DisplayError(diagnose("no-opengl", message=problem))


def _list_drivers() -> tuple[str, ...]:
    """Return the values of MUJOCO_GL to try; "" is MuJoCo's default."""
    requested = os.environ.get("MUJOCO_GL", "")
    if requested:
        return (requested,)
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return _OFFSCREEN_DRIVERS if sys.platform.startswith("linux") and not screen else ("",)


def _run_drawing(folder: Path, driver: str) -> str | None:
    """Run `offscreen` in another process, to draw the views stored in a folder.

    ``driver`` is the value of MUJOCO_GL. Returns the reason of a failure; None if the frames were
    written.
    """
    environment = {**os.environ, "MUJOCO_GL": driver}
    program = Path(__file__).with_name("offscreen.py")
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(program), str(folder)],
            env=environment,
            cwd=folder,  # MuJoCo writes its log file there
            capture_output=True,
            text=True,
            check=False,
            timeout=_DRAWING_TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        return f"MuJoCo's renderer took more than {_DRAWING_TIMEOUT:g} s"
    if done.returncode == 0 and (folder / "frames.npy").is_file():
        return None
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"exit status {done.returncode}"
