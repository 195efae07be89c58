"""3-D scene of a page: robot, forces, torques, ghost of the nearest stance, simulated twin.

Inputs are robots and solved stances; outputs are nodes of viser's scene, in the world frame in m.
The meshes of a robot are joined for each body and colour, so that a new configuration moves their
nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.models.shapes import Mesh, Shape
from pupper_analysis.present.colours import (
    COM_COLOUR,
    FORCE_COLOUR,
    SUPPORT_COLOUR,
    split_colour,
)
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.scene import (
    DrawnForce,
    JointAxis,
    StandingScene,
    collect_visible_shapes,
    describe_scene,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.joints import force_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import find_place
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.live.model import Answer

# Colours of motor utilisation: blue, yellow, red, which colour-blind users can distinguish.

UTILISATION_COLOURS: tuple[tuple[float, Colour], ...] = (
    (0.0, (52, 108, 176)),
    (0.25, (120, 170, 214)),
    (0.5, (250, 214, 90)),
    (0.75, (240, 138, 52)),
    (1.0, (208, 28, 40)),
)
"""Colour scale of motor utilisation (torque / limit): (utilisation, colour) in ascending order;
colours between two entries are interpolated linearly."""

OVERLOAD_COLOUR: Colour = (138, 0, 110)
"""Colour of a finite utilisation above 1."""

NO_LIMIT_COLOUR: Colour = (150, 150, 150)
"""Colour of a motor without torque limit, or with a limit of 0."""


def choose_utilisation_colour(utilisation: float | None) -> Colour:
    """Return the colour (RGB, 0 to 255) of a motor utilisation (torque / limit).

    `NO_LIMIT_COLOUR` if the utilisation is None or not finite, `OVERLOAD_COLOUR` above 1.
    """
    if utilisation is None or not math.isfinite(utilisation):
        return NO_LIMIT_COLOUR
    for (low, low_colour), (high, high_colour) in pairwise(UTILISATION_COLOURS):
        if utilisation <= high:
            weight = (utilisation - low) / (high - low)
            red, green, blue = (
                round(a + weight * (b - a)) for a, b in zip(low_colour, high_colour, strict=True)
            )
            return red, green, blue
    return OVERLOAD_COLOUR


def linearise(colour: Colour) -> Colour:
    """Convert an sRGB colour (0 to 255) to linear intensities, 0 to 255 (IEC 61966-2-1)."""
    shares = [value / 255 for value in colour]
    red, green, blue = (
        round(255 * (share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4))
        for share in shares
    )
    return red, green, blue


def to_css(colour: Colour) -> str:
    """Return an RGB colour (0 to 255) as CSS text."""
    return f"rgb({colour[0]},{colour[1]},{colour[2]})"


# Shapes of a robot as triangles in body frames.

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

MAX_FACES = 40_000
"""Approximate upper bound of the number of triangles of all meshes of a robot, which are sent when
a page opens: about 0.5 MB of vertex indices. Larger meshes are simplified; primitive shapes are not
counted. Chosen, not tuned."""


BodyMeshes = dict[tuple[int, Colour], Mesh]
"""Shapes in the frame of the body: {(body id of the MuJoCo model, colour): mesh}."""


def make_body_meshes(model: mujoco.MjModel) -> BodyMeshes:
    """Return the visible shapes of a robot as {(body, colour): mesh in the body frame [m]}."""
    shapes, meshes = collect_visible_shapes(model, MAX_FACES)
    meshes_by_key: dict[tuple[int, Colour], list[Mesh]] = {}
    for shape in shapes:
        mesh = triangulate_shape(shape.form) if shape.mesh is None else meshes[shape.mesh]
        red, green, blue = (round(255 * float(value)) for value in shape.colour[:3])
        placed = Mesh(shape.form.pose.point(mesh.vertices), mesh.faces)
        meshes_by_key.setdefault((shape.body, (red, green, blue)), []).append(placed)
    return {key: _join_meshes(meshes) for key, meshes in meshes_by_key.items()}


def _join_meshes(meshes: list[Mesh]) -> Mesh:
    """Return a mesh with the vertices [m] and triangles of all meshes, in their common frame."""
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + first for mesh, first in zip(meshes, firsts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def triangulate_shape(shape: Shape) -> Mesh:
    """Return the triangles [m] of a primitive shape, centred at the origin, axis along z.

    Other shapes than boxes, cylinders and capsules are drawn as a sphere or ellipsoid.
    """
    from trimesh import creation  # comes with viser

    size, solid = shape.size, None
    match shape.kind:
        case "box":
            solid = creation.box(extents=2 * np.array(size))
        case "cylinder":
            solid = creation.cylinder(radius=size[0], height=2 * size[1], sections=24)
        case "capsule":
            solid = creation.capsule(radius=size[0], height=2 * size[1], count=(16, 16))
        case _:
            solid = creation.icosphere(subdivisions=2)
            solid.apply_scale(np.broadcast_to(size, 3))
    return Mesh(np.asarray(solid.vertices, dtype=float), np.asarray(solid.faces, dtype=np.int64))


GHOST_COLOUR: Colour = (110, 130, 150)
"""Colour of the transparent figure in the nearest reachable stance."""

TWIN_COLOUR: Colour = (226, 120, 30)
"""Colour of the second figure, which shows a simulated motion: with more red than the shell of
Pupper v3, which resembles the orange of Okabe and Ito.
"""

OUTSIDE_COLOUR: Colour = (200, 30, 40)
"""Colour of the CoM if the CoM margin is negative, and of a support polygon in which the stance is
not in balance. Otherwise, CoM, polygon and forces have the colours of all figures
(``present/colours``).
"""

LOAD_COLOUR: Colour = (90, 60, 140)
"""Colour of the payload."""

STEP_COLOUR: Colour = (190, 194, 200)
"""Colour of a step under a foot."""

PIT_COLOUR: Colour = (120, 126, 134)
"""Colour of a pit under a foot."""

_NUM_POLYGON_CORNERS = 24
"""Number of corners of a drawn support polygon, or a multiple of this number for a polygon with
more corners. The size of the array of a scene node is constant, so a polygon with fewer corners
repeats its last corner. Chosen, not tuned."""

_WEIGHT_ARROW_LENGTH = 3.0
"""Length of the arrow of a force equal to the robot's weight, relative to the height of the stand.
Chosen, not tuned."""


_DISC_RADIUS, _DISC_REFERENCE_HEIGHT = 0.025, 0.13
"""Radius [m] of the disc that is drawn at a joint, if the stand of the robot has the reference
height [m]. For other robots, the radius is proportional to height^0.6. Chosen, not tuned."""


class RobotFigure:
    """Robot as drawn in the 3-D scene of a page.

    Args:
        scene: viser's scene of the page.
        name: Name of the root node.
        robot: Robot.
        parts: Shapes of the robot.
        colour: Colour of all shapes; None for the colours of the model.
        opacity: Opacity, below 1 for a transparent figure; None for opaque.
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
        for number, ((body, model_colour), mesh) in enumerate(parts.items()):
            at = f"{name}/{body}"
            if body not in self._bodies:
                self._bodies[body] = scene.add_frame(at, show_axes=False)
            scene.add_mesh_simple(
                f"{at}/{number}",
                mesh.vertices,
                mesh.faces,
                color=colour or model_colour,
                opacity=opacity,
                flat_shading=len(mesh.faces) < 2000,
                cast_shadow=opacity is None,
                receive_shadow=False,
            )

    def set_configuration(self, qpos: Array) -> None:
        """Draw this robot figure in a configuration, shape (nq,) [m, quaternion, rad]."""
        self.robot.mj_convention.set_state(self._data, qpos)
        mujoco.mj_kinematics(self.robot.mj_model, self._data)
        for body, frame in self._bodies.items():
            frame.position = self._data.xpos[body]
            frame.wxyz = self._data.xquat[body]

    def set_position(self, position: Array) -> None:
        """Set the translation of the drawn figure in the world frame, shape (3,) [m]."""
        self._root.position = position

    def show(self, shown: bool) -> None:
        """Show or hide the drawn robot."""
        self._root.visible = shown

    def remove(self) -> None:
        """Remove the drawn robot from the scene."""
        self._root.remove()


class Scene:
    """3-D scene of a page: robot in the stance, forces, torques, and two further robot figures.

    The ghost is a transparent figure in the nearest reachable stance; the twin shows a simulated
    motion.

    Args:
        scene: viser's scene of the page.
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
        """Draw the ground, and the stance with torques and contact forces if it is solved."""
        robot, stand = answer.robot, answer.stand
        self.hide("twin")
        self._draw_only(())
        if robot is None:
            self.hide("stand")
            self.hide("ghost")
            return
        self._prepare_robot(robot)
        if answer.task is not None:
            self._draw_ground(answer.task.ground)
        if stand is None:
            self.hide("stand")
            return
        self.hide("ghost")
        self._get_figure("stand").set_configuration(stand.qpos)
        self._get_figure("stand").show(True)
        described = describe_scene(robot, stand, answer.statics)
        self._draw_steps(described)
        self._draw_support(described, held=answer.statics is not None and described.com_inside)
        self._draw_com(described)
        self._draw_load(answer, stand)
        self._draw_torques(described.joints)
        self._draw_forces(described)

    def draw_ghost(self, robot: Robot, stand: Stand | None) -> None:
        """Draw a stance as a transparent figure (ghost), or hide it if ``stand`` is None."""
        if stand is None:
            self.hide("ghost")
            return
        self._prepare_robot(robot)
        self._get_figure("ghost").set_configuration(stand.qpos)
        self._get_figure("ghost").show(True)

    def draw_twin(self, robot: Robot, qpos: Array, ground: Ground) -> None:
        """Draw a simulated configuration, shape (nq,), as a second figure beside the stand.

        The slope direction of ``ground`` determines the side.
        """
        figure = self._get_figure("twin")
        along = np.array([-math.sin(ground.uphill), math.cos(ground.uphill), 0.0])
        figure.set_position(2.6 * robot.stand_height * along)
        figure.set_configuration(qpos)
        figure.show(True)

    def hide(self, name: str) -> None:
        """Hide a figure (``stand``, ``ghost`` or ``twin``), if it exists."""
        if name in self._figures:
            self._figures[name].show(False)

    def _get_figure(self, name: str) -> RobotFigure:
        """Return the figure ``stand``, ``ghost`` or ``twin`` of the robot; created on first use."""
        assert self._robot is not None
        if name not in self._figures:
            options: dict[str, dict[str, Any]] = {
                "stand": {},
                "ghost": {"colour": GHOST_COLOUR, "opacity": 0.35},
                "twin": {"colour": TWIN_COLOUR},
            }
            figure = RobotFigure(self._scene, f"/{name}", self._robot, self._parts, **options[name])
            self._figures[name] = figure
        return self._figures[name]

    def _prepare_robot(self, robot: Robot) -> None:
        """Prepare meshes and joint discs for another robot, and remove the figures of the last."""
        if robot is self._robot:
            return
        for figure in self._figures.values():
            figure.remove()
        for node in self._joints.values():
            node.remove()
        self._figures, self._joints = {}, {}
        self._robot, self._parts = robot, make_body_meshes(robot.mj_model)
        self._size = size = robot.stand_height
        disc = (
            _DISC_RADIUS * (size / _DISC_REFERENCE_HEIGHT) ** 0.6
        )  # motors grow more slowly than their robots
        for number, name in enumerate(robot.joint_names):
            self._joints[name] = self._scene.add_cylinder(
                f"/joints/{number}", disc, 1.9 * disc, cast_shadow=False
            )

    def _get_node(self, name: str, make: str, *arguments: Any, **options: Any) -> Any:
        """Return the scene node ``name``, made visible; created on first use.

        ``make`` is the name of the scene's method that creates the node from ``arguments`` and
        ``options``.
        """
        if name not in self._nodes:
            self._nodes[name] = getattr(self._scene, make)(f"/{name}", *arguments, **options)
        node = self._nodes[name]
        node.visible = True
        return node

    def _draw_only(self, names: tuple[str, ...]) -> None:
        """Show the nodes ``names`` and the ground; hide all other nodes and the joint discs."""
        for name, node in self._nodes.items():
            node.visible = name in (*names, "ground")
        for node in self._joints.values():
            node.visible = False

    def _draw_ground(self, ground: Ground) -> None:
        """Draw the ground plane, with its slope, as a grid."""
        size = 0.5 if self._size < 0.25 else 2.0
        grid = self._get_node(
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
        grid.position = -1e-3 * turn[:, 2]  # slightly below drawings on the ground

    def _draw_steps(self, described: StandingScene) -> None:
        """Draw steps as boxes or cylinders, and pits as dark areas of the ground plane."""
        normal, thin = described.ground_normal, 2e-3 * self._size
        for number, step in enumerate(described.steps.values()):
            # A pit is drawn as a dark square on the opaque ground.
            pit = step.height < 0
            half = np.array([*step.half[:2], thin]) if pit else step.half
            rise = float(normal @ step.centre) if pit else 0.0
            if step.round:
                box = self._get_node(f"steps/bar{number}", "add_cylinder")
                box.radius, box.height = half[0], 2 * half[2]
            else:
                box = self._get_node(f"steps/{number}", "add_box")
                box.dimensions = tuple(2 * half)
            box.color = PIT_COLOUR if pit else STEP_COLOUR
            box.wxyz, box.position = step.quaternion, step.centre - rise * normal

    def _draw_support(self, described: StandingScene, *, held: bool) -> None:
        """Draw the support polygon: blue, or red (`OUTSIDE_COLOUR`) unless the stand is held."""
        points = described.polygon + np.array([0.0, 0.0, 0.005 * self._size])
        count = _NUM_POLYGON_CORNERS * math.ceil(len(points) / _NUM_POLYGON_CORNERS)
        padded = np.concatenate([points, np.tile(points[-1], (count - len(points), 1))])
        fan = [(0, n, n + 1) for n in range(1, count - 1)]
        area = self._get_node(
            "support" if count == _NUM_POLYGON_CORNERS else f"support_{count}",
            "add_mesh_simple",
            padded,
            np.array(fan),
            color=split_colour(SUPPORT_COLOUR),
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        area.vertices = padded
        area.color = split_colour(SUPPORT_COLOUR) if held else OUTSIDE_COLOUR

    def _draw_com(self, described: StandingScene) -> None:
        """Draw the CoM, its projection on the support plane and a line between.

        The colour shows the sign of the CoM margin.
        """
        colour = split_colour(COM_COLOUR) if described.com_inside else OUTSIDE_COLOUR
        for name, place, size in (
            ("com", described.com, 0.075),
            ("beneath", described.com_projection, 0.05),
        ):
            ball = self._get_node(
                name, "add_icosphere", size * self._size, colour, cast_shadow=False
            )
            ball.position = place
            ball.color = colour
        ends = np.array([[described.com, described.com_projection]])
        line = self._get_node(
            "plumb", "add_line_segments", ends, colour, thickness=2.0, thickness_units="screen"
        )
        line.points = ends
        line.colors = np.array(colour, dtype=np.uint8)

    def _draw_load(self, answer: Answer, stand: Stand) -> None:
        """Draw a ball at the position of the payload in a stance; nothing without a payload."""
        if not answer.state.payload:
            return
        ball = self._get_node("load", "add_icosphere", 0.13 * self._size, LOAD_COLOUR)
        assert answer.robot is not None
        place = find_place(answer.robot, answer.state.payload_point())
        ball.position = place.position(Configuration(answer.robot, stand.qpos))

    def _draw_torques(self, joints: Sequence[JointAxis]) -> None:
        """Draw a disc at each joint with a known torque, coloured by the motor utilisation.

        A label states the load of the most utilised motor.
        """
        assert self._robot is not None
        held_joints = [joint for joint in joints if joint.torque is not None]
        for joint in held_joints:
            disc = self._joints[joint.name]
            disc.visible, disc.color = True, choose_utilisation_colour(joint.utilisation)
            disc.position, disc.wxyz = joint.world_anchor, quaternion_along(joint.world_axis)
        if held_joints:
            hardest = max(
                held_joints, key=lambda joint: (joint.utilisation or 0.0, abs(joint.torque or 0.0))
            )
            label = self._get_node("hardest", "add_label", "", anchor="bottom-center")
            label.text = format_joint_label(
                hardest.name,
                hardest.torque or 0.0,
                hardest.utilisation,
                force_unit(self._robot, hardest.name),
            )
            label.position = hardest.world_anchor + np.array([0.0, 0.0, 0.2 * self._size])

    def _draw_forces(self, described: StandingScene) -> None:
        """Draw the contact forces (`make_force_arrows`); nothing without contacts."""
        if not described.contacts:
            return
        assert self._robot is not None
        arrows = make_force_arrows(self._robot, described.contacts)
        node = self._get_node(
            "forces",
            "add_arrows",
            arrows,
            linearise(split_colour(FORCE_COLOUR)),  # viser 1.1 does not decode this colour
            shaft_radius=0.025 * self._size,
            head_radius=0.06 * self._size,
            head_length=0.11 * self._size,
        )
        node.points = arrows


def make_force_arrows(robot: Robot, contacts: Sequence[DrawnForce]) -> Array:
    """Return the start and the end of an arrow for each contact force, shape (n, 2, 3) [m].

    An arrow starts at the point of the force (`DrawnForce.point`) and has the direction of the
    force on the foot, both in the world frame. A force equal to the robot's weight has an arrow of
    ``_WEIGHT_ARROW_LENGTH`` times the height of the stand; the length is proportional to the force.
    """
    weight = robot.weight
    scale = _WEIGHT_ARROW_LENGTH * robot.stand_height / weight
    return np.array(
        [[contact.point, contact.point + scale * contact.force] for contact in contacts]
    )


def format_joint_label(name: str, torque: float, share: float | None, unit: str) -> str:
    """Return the label of a joint: name, signed torque with ``unit``, and utilisation.

    The utilisation ``share`` (1 is shown as 100 %) is left out if it is None.
    """
    suffix = "" if share is None else f", {100 * share:.0f} %"
    return f"{escape_control(name)}: {torque:+.3f} {unit}{suffix}"


def quaternion_along(axis: Array) -> Array:
    """Return the quaternion (w, x, y, z) that rotates the z axis to the given unit vector (3,)."""
    x, y, z = (float(value) for value in axis)
    if z < -1.0 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    turn = np.array([1.0 + z, -y, x, 0.0])
    unit: Array = turn / np.linalg.norm(turn)
    return unit
