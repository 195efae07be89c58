"""What a page shows in three dimensions: the robot, what acts on it, a ghost, a simulated twin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.models.shapes import Mesh, Shape
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.scene import (
    Contact,
    JointAxis,
    StandingScene,
    collect_visible_shapes,
    describe_scene,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import find_place
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.live.model import Answer

Array = NDArray[np.float64]

# What colour says how hard a motor works: blue, yellow, red, which all eyes tell apart.

UTILISATION_COLOURS: tuple[tuple[float, Colour], ...] = (
    (0.0, (52, 108, 176)),
    (0.25, (120, 170, 214)),
    (0.5, (250, 214, 90)),
    (0.75, (240, 138, 52)),
    (1.0, (208, 28, 40)),
)
"""Parts of a motor's limit, and their colours."""

OVERLOAD_COLOUR: Colour = (138, 0, 110)
"""Above the limit."""

NO_LIMIT_COLOUR: Colour = (150, 150, 150)
"""Of a motor without a limit."""


def choose_utilisation_colour(utilisation: float | None) -> Colour:
    """Returns the colour of a motor's utilisation, in parts of its limit; None without a limit."""
    if utilisation is None or not math.isfinite(utilisation):
        return NO_LIMIT_COLOUR
    for (low, one), (high, other) in pairwise(UTILISATION_COLOURS):
        if utilisation <= high:
            share = (utilisation - low) / (high - low)
            red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
            return red, green, blue
    return OVERLOAD_COLOUR


def to_css(colour: Colour) -> str:
    """Returns a colour as pages write it."""
    return f"rgb({colour[0]},{colour[1]},{colour[2]})"


# A robot's shapes as triangles, each on its body.

Colour = tuple[int, int, int]

MAX_FACES = 40_000
"""Of all meshes of a robot together: half a megabyte, which is sent when a page opens."""


BodyMeshes = dict[tuple[int, Colour], Mesh]
"""{number of a body in MuJoCo's model, colour: its shapes of that colour, in its frame}."""


def make_body_meshes(model: mujoco.MjModel) -> BodyMeshes:
    """Returns a robot's shapes, those of one body and colour together."""
    shapes, meshes = collect_visible_shapes(model, MAX_FACES)
    found: dict[tuple[int, Colour], list[Mesh]] = {}
    for shape in shapes:
        mesh = triangulate_shape(shape.form) if shape.mesh is None else meshes[shape.mesh]
        red, green, blue = (round(255 * float(value)) for value in shape.colour[:3])
        placed = Mesh(shape.form.pose.point(mesh.vertices), mesh.faces)
        found.setdefault((shape.body, (red, green, blue)), []).append(placed)
    return {key: _joined(meshes) for key, meshes in found.items()}


def _joined(meshes: list[Mesh]) -> Mesh:
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + first for mesh, first in zip(meshes, firsts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def triangulate_shape(shape: Shape) -> Mesh:
    """Returns a shape that is no mesh as triangles, along z about its centre."""
    from trimesh import creation  # comes with viser

    size, made = shape.size, None
    match shape.kind:
        case "box":
            made = creation.box(extents=2 * np.array(size))
        case "cylinder":
            made = creation.cylinder(radius=size[0], height=2 * size[1], sections=24)
        case "capsule":
            made = creation.capsule(radius=size[0], height=2 * size[1], count=(16, 16))
        case _:
            made = creation.icosphere(subdivisions=2)
            made.apply_scale(np.broadcast_to(size, 3))
    return Mesh(np.asarray(made.vertices, dtype=float), np.asarray(made.faces, dtype=np.int64))


GHOST_COLOUR: Colour = (110, 130, 150)
TWIN_COLOUR: Colour = (226, 120, 30)
FORCE_COLOUR: Colour = (0, 128, 96)
INSIDE_COLOUR: Colour = (30, 140, 70)
OUTSIDE_COLOUR: Colour = (200, 30, 40)
LOAD_COLOUR: Colour = (90, 60, 140)
STEP_COLOUR: Colour = (190, 194, 200)
PIT_COLOUR: Colour = (120, 126, 134)

_CORNERS = 24
"""Corners of a support polygon as it is drawn, the last one repeated: so that its size stays."""

_ARROW = 3.0
"""Length of the whole weight as an arrow, in parts of the stand's height."""


_DISC, _DISC_AT = 0.025, 0.13
"""Radius of a joint's disc (m), for a robot of that height: around v3's motors of 23 mm."""


class RobotFigure:
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
        parts: BodyMeshes,
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        self.robot = robot
        self._data = mujoco.MjData(robot.mj_model)
        self._root = scene.add_frame(name, show_axes=False)
        self._bodies: dict[int, Any] = {}
        for number, ((body, own), mesh) in enumerate(parts.items()):
            at = f"{name}/{body}"
            if body not in self._bodies:
                self._bodies[body] = scene.add_frame(at, show_axes=False)
            scene.add_mesh_simple(
                f"{at}/{number}",
                mesh.vertices,
                mesh.faces,
                color=colour or own,
                opacity=opacity,
                flat_shading=len(mesh.faces) < 2000,
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
        self._parts: BodyMeshes = {}
        self._figures: dict[str, RobotFigure] = {}
        self._nodes: dict[str, Any] = {}
        self._joints: dict[str, Any] = {}
        self._size = 1.0

    def show(self, answer: Answer) -> None:
        """Shows a stance, and what holds it; without one, nothing but the ground."""
        robot, stand = answer.robot, answer.stand
        self.hide("twin")
        self._draw_only(())
        if robot is None:
            self.hide("stand")
            self.hide("ghost")
            return
        self._prepare(robot)
        if answer.task is not None:
            self._ground(answer.task.ground)
        if stand is None:
            self.hide("stand")
            return
        self.hide("ghost")
        self._figure("stand").pose(stand.qpos)
        self._figure("stand").show(True)
        seen = describe_scene(robot, stand, answer.statics)
        self._steps(seen)
        self._support(seen, held=answer.statics is not None and seen.com_inside)
        self._com(seen)
        self._load(answer, stand)
        self._torques(seen.joints)
        self._forces(seen)

    def ghost(self, robot: Robot, stand: Stand | None) -> None:
        """Shows a stance as a ghost: one that is not what was asked for."""
        if stand is None:
            self.hide("ghost")
            return
        self._prepare(robot)
        self._figure("ghost").pose(stand.qpos)
        self._figure("ghost").show(True)

    def twin(self, robot: Robot, qpos: Array, ground: Ground) -> None:
        """Shows a simulated configuration, beside the stand."""
        figure = self._figure("twin")
        along = np.array([-math.sin(ground.uphill), math.cos(ground.uphill), 0.0])
        figure.shift(2.6 * robot.stand_height * along)
        figure.pose(qpos)
        figure.show(True)

    def hide(self, name: str) -> None:
        """Hides a figure, if there is one."""
        if name in self._figures:
            self._figures[name].show(False)

    def _figure(self, name: str) -> RobotFigure:
        """Returns a figure of the robot; it is made when it is first shown."""
        assert self._robot is not None
        if name not in self._figures:
            evaluations: dict[str, dict[str, Any]] = {
                "stand": {},
                "ghost": {"colour": GHOST_COLOUR, "opacity": 0.35},
                "twin": {"colour": TWIN_COLOUR},
            }
            made = RobotFigure(
                self._scene, f"/{name}", self._robot, self._parts, **evaluations[name]
            )
            self._figures[name] = made
        return self._figures[name]

    def _prepare(self, robot: Robot) -> None:
        if robot is self._robot:
            return
        for figure in self._figures.values():
            figure.remove()
        for node in self._joints.values():
            node.remove()
        self._figures, self._joints = {}, {}
        self._robot, self._parts = robot, make_body_meshes(robot.mj_model)
        self._size = size = robot.stand_height
        disc = _DISC * (size / _DISC_AT) ** 0.6  # motors grow more slowly than their robots
        for number, name in enumerate(robot.joint_names):
            self._joints[name] = self._scene.add_cylinder(
                f"/joints/{number}", disc, 1.9 * disc, cast_shadow=False
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
        for node in self._joints.values():
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
        grid.wxyz = quaternion_from_rotation(turn)
        grid.position = -1e-3 * turn[:, 2]  # beneath what lies on it

    def _steps(self, seen: StandingScene) -> None:
        """Draws the steps under the feet that stand on some: as high as each, or as deep."""
        out, thin = seen.ground_normal, 2e-3 * self._size
        for number, step in enumerate(seen.steps.values()):
            # A pit is a dark square on the ground, which nobody can look through.
            pit = step.height < 0
            half = np.array([*step.half[:2], thin]) if pit else step.half
            rise = float(out @ step.centre) if pit else 0.0
            if step.round:
                box = self._node(f"steps/bar{number}", "add_cylinder")
                box.radius, box.height = half[0], 2 * half[2]
            else:
                box = self._node(f"steps/{number}", "add_box")
                box.dimensions = tuple(2 * half)
            box.color = PIT_COLOUR if pit else STEP_COLOUR
            box.wxyz, box.position = step.turn, step.centre - rise * out

    def _support(self, seen: StandingScene, *, held: bool) -> None:
        points = seen.polygon + np.array([0.0, 0.0, 0.005 * self._size])
        padded = np.concatenate([points, np.tile(points[-1], (_CORNERS, 1))])[:_CORNERS]
        fan = [(0, n, n + 1) for n in range(1, _CORNERS - 1)]
        area = self._node(
            "support",
            "add_mesh_simple",
            padded,
            np.array(fan),
            color=INSIDE_COLOUR,
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        area.vertices = padded
        area.color = INSIDE_COLOUR if held else OUTSIDE_COLOUR

    def _com(self, seen: StandingScene) -> None:
        colour = INSIDE_COLOUR if seen.com_inside else OUTSIDE_COLOUR
        for name, place, size in (("com", seen.com, 0.075), ("beneath", seen.com_projection, 0.05)):
            ball = self._node(name, "add_icosphere", size * self._size, colour, cast_shadow=False)
            ball.position = place
            ball.color = colour
        ends = np.array([[seen.com, seen.com_projection]])
        line = self._node(
            "plumb", "add_line_segments", ends, colour, thickness=2.0, thickness_units="screen"
        )
        line.points = ends
        line.colors = np.array(colour, dtype=np.uint8)

    def _load(self, answer: Answer, stand: Stand) -> None:
        if not answer.state.payload:
            return
        ball = self._node("load", "add_icosphere", 0.13 * self._size, LOAD_COLOUR)
        assert answer.robot is not None
        place = find_place(answer.robot, answer.state.payload_point())
        ball.position = place.position(Configuration(answer.robot, stand.qpos))

    def _torques(self, joints: Sequence[JointAxis]) -> None:
        """Colours the joints; names the one whose motor works hardest."""
        known = [one for one in joints if one.torque is not None]
        for one in known:
            disc = self._joints[one.name]
            disc.visible, disc.color = True, choose_utilisation_colour(one.utilisation)
            disc.position, disc.wxyz = one.world_anchor, quaternion_along(one.world_axis)
        if known:
            hardest = max(known, key=lambda one: (one.utilisation or 0.0, abs(one.torque or 0.0)))
            label = self._node("hardest", "add_label", "", anchor="bottom-center")
            label.text = format_joint_label(
                hardest.name, hardest.torque or 0.0, hardest.utilisation
            )
            label.position = hardest.world_anchor + np.array([0.0, 0.0, 0.2 * self._size])

    def _forces(self, seen: StandingScene) -> None:
        if not seen.contacts:
            return
        assert self._robot is not None
        arrows = make_force_arrows(self._robot, seen.contacts)
        node = self._node(
            "forces",
            "add_arrows",
            arrows,
            FORCE_COLOUR,
            shaft_radius=0.025 * self._size,
            head_radius=0.06 * self._size,
            head_length=0.11 * self._size,
        )
        node.points = arrows


def make_force_arrows(robot: Robot, contacts: Sequence[Contact]) -> Array:
    """Returns contact forces as arrows (n, 2, 3): from the ground up (m)."""
    weight = robot.weight
    scale = _ARROW * robot.stand_height / weight
    return np.array([[one.point, one.point + scale * one.force] for one in contacts])


def format_joint_label(name: str, torque: float, share: float | None) -> str:
    """Returns what stands at a joint: its name, torque (N m) and utilisation."""
    used = "" if share is None else f", {100 * share:.0f} %"
    return f"{escape_control(name)}: {torque:+.3f} N m{used}"


def quaternion_along(axis: Array) -> Array:
    """Returns the quaternion (w, x, y, z) that turns z into an axis (3,)."""
    x, y, z = (float(value) for value in axis)
    if z < -1.0 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    turn = np.array([1.0 + z, -y, x, 0.0])
    unit: Array = turn / np.linalg.norm(turn)
    return unit
