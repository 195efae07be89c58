"""What a page shows in three dimensions: the robot, what acts on it, a ghost, a simulated twin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arrays import rotation_from_quaternion
from pupper_analysis.live.colour import colour_of
from pupper_analysis.live.model import Answer
from pupper_analysis.live.shapes import Colour, Part, parts_of
from pupper_analysis.report.formats import visible
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]

GHOST: Colour = (110, 130, 150)
TWIN: Colour = (226, 120, 30)
FORCE: Colour = (0, 128, 96)
INSIDE: Colour = (30, 140, 70)
OUTSIDE: Colour = (200, 30, 40)
LOAD: Colour = (90, 60, 140)
STONE: Colour = (190, 194, 200)
PIT: Colour = (120, 126, 134)

_STEP = 0.45
"""Side of a step under a foot, in parts of the stand's height."""

_CORNERS = 24
"""Corners of a support polygon as it is drawn, the last one repeated: so that its size stays."""

_ARROW = 3.0
"""Length of the whole weight as an arrow, in parts of the stand's height."""


_DISC, _DISC_AT = 0.025, 0.13
"""Radius of a joint's disc (m), for a robot of that height: around v3's motors of 23 mm."""


class Figure:
    """A robot as it is drawn.

    Args:
        scene: viser's scene of one page.
        name: Of the node that all parts hang on.
        robot: The robot.
        parts: Its shapes.
        colour: Of all shapes; their own if None.
        opacity: Below 1: one sees through it.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        robot: Robot,
        parts: list[Part],
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        self.robot = robot
        self._data = mujoco.MjData(robot.mj_model)
        self._root = scene.add_frame(name, show_axes=False)
        self._bodies: dict[int, Any] = {}
        for number, part in enumerate(parts):
            at = f"{name}/{part.body}"
            if part.body not in self._bodies:
                self._bodies[part.body] = scene.add_frame(at, show_axes=False)
            scene.add_mesh_simple(
                f"{at}/{number}",
                part.vertices,
                part.faces,
                color=colour or part.colour,
                opacity=opacity,
                flat_shading=len(part.faces) < 2000,
                cast_shadow=opacity is None,
                receive_shadow=False,
            )

    def pose(self, qpos: Array) -> None:
        """Moves it to a configuration (nq,)."""
        self.robot.mj_convention.set_state(self._data, qpos)
        mujoco.mj_kinematics(self.robot.mj_model, self._data)
        for body, frame in self._bodies.items():
            frame.position = self._data.xpos[body]
            frame.wxyz = self._data.xquat[body]

    def shift(self, place: Array) -> None:
        """Moves it aside by (3,) (m)."""
        self._root.position = place

    def show(self, shown: bool) -> None:
        """Shows it, or hides it."""
        self._root.visible = shown

    def remove(self) -> None:
        """Takes it out of the scene, with all that hangs on it."""
        self._root.remove()


class Scene:
    """One page's scene.

    Args:
        scene: viser's scene of one page.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._robot: Robot | None = None
        self._parts: list[Part] = []
        self._figures: dict[str, Figure] = {}
        self._nodes: dict[str, Any] = {}
        self._joints: dict[str, Any] = {}
        self._labels: dict[str, Any] = {}
        self.joint_labels = False
        self._size = 1.0

    def show(self, answer: Answer) -> None:
        """Shows a stance, and what holds it; without one, nothing but the ground."""
        robot, stand = answer.robot, answer.stand
        self.hide("twin")
        if robot is None:
            self._draw_only(())
            self.hide("stand")
            self.hide("ghost")
            return
        self._prepare(robot)
        if answer.task is not None:
            self._ground(answer.task.ground)
        if stand is None:
            self.hide("stand")
            self._draw_only(())
            return
        self.hide("ghost")
        self._figure("stand").pose(stand.qpos)
        self._figure("stand").show(True)
        self._steps(stand)
        self._support(answer, stand)
        self._com(answer, stand)
        self._load(answer, stand)
        self._torques(answer, stand)
        self._forces(answer)

    def ghost(self, robot: Robot, stand: Stand | None) -> None:
        """Shows a stance as a ghost: one that is not what was asked for."""
        if stand is None:
            self.hide("ghost")
            return
        self._prepare(robot)
        self._figure("ghost").pose(stand.qpos)
        self._figure("ghost").show(True)

    def twin(self, robot: Robot, qpos: Array, ground: Ground, *, beside: bool) -> None:
        """Shows a simulated configuration, beside the stand or over it."""
        figure = self._figure("twin")
        along = np.array([-math.sin(ground.uphill), math.cos(ground.uphill), 0.0])
        figure.shift((2.6 * robot.stand_height if beside else 0.0) * along)
        figure.pose(qpos)
        figure.show(True)

    def hide(self, name: str) -> None:
        """Hides a figure, if there is one."""
        if name in self._figures:
            self._figures[name].show(False)

    def _figure(self, name: str) -> Figure:
        """Returns a figure of the robot; it is made when it is first shown."""
        assert self._robot is not None
        if name not in self._figures:
            looks: dict[str, dict[str, Any]] = {
                "stand": {},
                "ghost": {"colour": GHOST, "opacity": 0.35},
                "twin": {"colour": TWIN},
            }
            made = Figure(self._scene, f"/{name}", self._robot, self._parts, **looks[name])
            self._figures[name] = made
        return self._figures[name]

    def _prepare(self, robot: Robot) -> None:
        """Makes the scene that of a robot."""
        if robot is self._robot:
            return
        for figure in self._figures.values():
            figure.remove()
        for node in (*self._joints.values(), *self._labels.values()):
            node.remove()
        self._figures, self._joints, self._labels = {}, {}, {}
        self._robot, self._parts = robot, parts_of(robot.mj_model)
        self._size = size = robot.stand_height
        disc = _DISC * (size / _DISC_AT) ** 0.6  # motors grow more slowly than their robots
        for number, name in enumerate(robot.joint_names):
            self._joints[name] = self._scene.add_cylinder(
                f"/joints/{number}", disc, 1.9 * disc, cast_shadow=False
            )
            self._labels[name] = self._scene.add_label(
                f"/labels/{number}", "", visible=False, anchor="bottom-center"
            )

    def _node(self, name: str, make: str, *arguments: Any, **options: Any) -> Any:
        """Returns a node; it is made when it is first asked for."""
        if name not in self._nodes:
            self._nodes[name] = getattr(self._scene, make)(f"/{name}", *arguments, **options)
        node = self._nodes[name]
        node.visible = True
        return node

    def _draw_only(self, names: tuple[str, ...]) -> None:
        for name, node in self._nodes.items():
            node.visible = name in (*names, "ground")
        for node in (*self._joints.values(), *self._labels.values()):
            node.visible = False

    def _ground(self, ground: Ground) -> None:
        size = 0.5 if self._size < 0.25 else 2.0
        grid = self._node(
            "ground",
            "add_grid",
            8 * size,
            8 * size,
            cell_size=size / 10,
            section_size=size / 2,
            cell_color=(214, 220, 226),
            section_color=(176, 186, 196),
            plane_color=(244, 246, 248),
            plane_opacity=1.0,
            shadow_opacity=0.25,
        )
        turn = ground.rotation()
        grid.wxyz = quaternion(turn)
        grid.position = -1e-3 * turn[:, 2]  # beneath what lies on it

    def _steps(self, stand: Stand) -> None:
        """Draws the steps under the feet that stand on some: as high as each, or as deep."""
        ground = stand.task.ground
        assert self._robot is not None
        turn, side, thin = ground.rotation(), _STEP * self._size, 4e-3 * self._size
        for name in [name for name in self._nodes if name.startswith("steps/")]:
            self._nodes[name].visible = False
        for number, (foot, height) in enumerate(ground.heights.items()):
            points = [stand.contact_points[p] for p in self._robot.points_of(foot)
                      if p in stand.contact_points]  # fmt: skip
            if not height or not points:
                continue
            # A pit is a dark square on the ground, which nobody can look through.
            thick = max(height, thin)
            top = np.mean(points, axis=0) - (min(height, 0.0) - thin) * turn[:, 2] * (height < 0)
            size = side, side, thick
            box = self._node(f"steps/{number}", "add_box", dimensions=size)
            box.dimensions, box.color = size, STONE if height > 0 else PIT
            box.wxyz, box.position = quaternion(turn), top - 0.5 * thick * turn[:, 2]

    def _support(self, answer: Answer, stand: Stand) -> None:
        ground = stand.task.ground
        contacts = np.array(list(stand.contact_points.values()))
        corners = support_polygon(contacts)
        rise = 0.005 * self._size
        points = np.array([[x, y, ground.height((x, y)) + rise] for x, y in corners])
        if any(ground.heights.values()):  # feet on steps: each corner is as high as its foot's
            away = np.linalg.norm(contacts[:, None, :2] - corners, axis=-1)
            points[:, 2] = contacts[np.argmin(away, axis=0), 2] + rise
        padded = np.concatenate([points, np.tile(points[-1], (_CORNERS, 1))])[:_CORNERS]
        held = answer.statics is not None and stand.com_margin >= 0
        fan = [(0, n, n + 1) for n in range(1, _CORNERS - 1)]
        area = self._node(
            "support",
            "add_mesh_simple",
            padded,
            np.array(fan),
            color=INSIDE,
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        area.vertices = padded
        area.color = INSIDE if held else OUTSIDE

    def _com(self, answer: Answer, stand: Stand) -> None:
        if answer.statics is not None:
            com = answer.statics.center_of_mass
        else:
            assert answer.robot is not None
            com = Configuration(answer.robot, stand.qpos).center_of_mass()
        foot = np.array([com[0], com[1], stand.task.ground.height(com)])
        colour = INSIDE if stand.com_margin >= 0 else OUTSIDE
        for name, place, size in (("com", com, 0.075), ("beneath", foot, 0.05)):
            ball = self._node(name, "add_icosphere", size * self._size, colour, cast_shadow=False)
            ball.position = place
            ball.color = colour
        line = self._node(
            "plumb",
            "add_line_segments",
            np.array([[com, foot]]),
            colour,
            thickness=2.0,
            thickness_units="screen",
        )
        line.points = np.array([[com, foot]])
        line.colors = np.array(colour, dtype=np.uint8)

    def _load(self, answer: Answer, stand: Stand) -> None:
        if not answer.state.payload:
            if "load" in self._nodes:
                self._nodes["load"].visible = False
            return
        ball = self._node("load", "add_icosphere", 0.13 * self._size, LOAD)
        turn = rotation_from_quaternion(stand.qpos[3:7])
        ball.position = stand.qpos[:3] + turn @ np.array(answer.state.payload_point())

    def _torques(self, answer: Answer, stand: Stand) -> None:
        """Colours the joints; names the one whose motor works hardest, or all."""
        robot, statics = answer.robot, answer.statics
        assert robot is not None
        if statics is None:
            for node in (*self._joints.values(), *self._labels.values()):
                node.visible = False
            return
        config = Configuration(robot, stand.qpos)
        shares = np.nan_to_num(statics.motor_utilisation, nan=0.0, posinf=0.0)
        hardest = int(np.argmax(shares if shares.any() else np.abs(statics.joint_torques)))
        for number, (name, limit) in enumerate(
            zip(robot.joint_names, robot.effort_limits, strict=True)
        ):
            share = float(statics.motor_utilisation[number])
            place = config.joint_position(name)
            disc, label = self._joints[name], self._labels[name]
            disc.visible = True
            disc.color = colour_of(share, float(limit))
            disc.position, disc.wxyz = place, along(config.joint_axis(name))
            label.visible = self.joint_labels or number == hardest
            if label.visible:
                label.text = joint_text(name, float(statics.joint_torques[number]), share, limit)
                label.position = place + np.array([0.0, 0.0, 0.2 * self._size])

    def _forces(self, answer: Answer) -> None:
        robot, statics = answer.robot, answer.statics
        if statics is None or not statics.foot_loads:
            if "forces" in self._nodes:
                self._nodes["forces"].visible = False
            return
        assert robot is not None
        arrows = force_arrows(robot, {f: (v.centre_of_pressure, v.force)
                                      for f, v in statics.foot_loads.items()})  # fmt: skip
        node = self._node(
            "forces",
            "add_arrows",
            arrows,
            FORCE,
            shaft_radius=0.025 * self._size,
            head_radius=0.06 * self._size,
            head_length=0.11 * self._size,
        )
        node.points = arrows


def force_arrows(robot: Robot, loads: Mapping[str, tuple[Array, Array]]) -> Array:
    """Returns contact forces as arrows (n, 2, 3): from the ground up (m).

    Args:
        robot: The robot.
        loads: {foot: where (3,) (m), and which force (3,) (N)}.
    """
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    scale = _ARROW * robot.stand_height / weight
    return np.array([[place, place + scale * force] for place, force in loads.values()])


def joint_text(name: str, torque: float, share: float, limit: float) -> str:
    """Returns what stands at a joint: its name, torque (N m) and utilisation."""
    used = f", {100 * share:.0f} %" if math.isfinite(limit) and limit > 0 else ""
    return f"{visible(name)}: {torque:+.3f} N m{used}"


def along(axis: Array) -> Array:
    """Returns the quaternion (w, x, y, z) that turns z into an axis (3,)."""
    x, y, z = (float(value) for value in axis)
    if z < -1.0 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    turn = np.array([1.0 + z, -y, x, 0.0])
    unit: Array = turn / np.linalg.norm(turn)
    return unit


def quaternion(turn: Array) -> Array:
    """Returns the quaternion (w, x, y, z) of a rotation (3, 3)."""
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, turn.ravel())
    return found
