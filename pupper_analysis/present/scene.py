"""What is seen of a robot that stands: shapes, joints, contact forces, com, polygon, ground.

Made once, and drawn by each in its own way: the page's viewer (``html/write``), the live page
(``live/scene``) and the figures of poses (``figures/pose``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import shapely
from numpy.typing import NDArray

from pupper_analysis.models.shapes import NUM_SIZES, Mesh, Shape, read_mesh, read_shape
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground, Step
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.statics.support_polygon import support_polygon

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

NUM_VISIBLE_GROUPS = 3
"""MuJoCo's viewer shows the geoms of groups 0 to 2, and keeps the others for collisions."""

_COARSEST = 512  # cells along a mesh's longest side at first, when it is made coarser
_FEWEST = 100  # triangles of a mesh, however many the robot has


@dataclass(frozen=True, eq=False)
class VisibleShape:
    """A geom that is shown.

    Attributes:
        body: The number of its body in MuJoCo's model.
        form: The shape, in the body's frame.
        colour: (4,) red, green, blue and opacity, 0 to 1.
        mesh: The number of its mesh in MuJoCo's model; None if it is none.
    """

    body: int
    form: Shape
    colour: Array
    mesh: int | None


@dataclass(frozen=True, eq=False)
class JointAxis:
    """A joint, and what its motor holds.

    Attributes:
        name: Its name.
        body: The number of the body that it moves.
        anchor: (3,) on its axis, in the body's frame (m).
        axis: (3,) in the body's frame.
        world_anchor: (3,) on its axis, in the world (m).
        world_axis: (3,) its axis in the world.
        position: Where it is (rad, m).
        torque: What its motor holds (N m, N); None where that is not shown.
        limit: Of that; None where there is none.
        utilisation: The torque in parts of the limit; None as both of them.
    """

    name: str
    body: int
    anchor: Array
    axis: Array
    world_anchor: Array
    world_axis: Array
    position: float
    torque: float | None
    limit: float | None
    utilisation: float | None


@dataclass(frozen=True, eq=False)
class Contact:
    """A foot's contact force.

    Attributes:
        foot: Its name.
        point: (3,) the centre of pressure (m).
        force: (3,) on the foot, in the world (N).
    """

    foot: str
    point: Array
    force: Array


@dataclass(frozen=True, eq=False)
class StandingScene:
    """What acts on a robot that stands, and what it stands on. In the world.

    Attributes:
        ground: The plane, through the origin.
        contact_positions: (n, 3) where the feet touch it or their steps, which are no softer than
            rock (m).
        polygon: (m, 3) the support polygon's corners, each as high as the point that it is, or
            where a com is in balance on several planes (m).
        steps: {foot: what is under it, if that is not the ground}.
        com: (3,) the centre of mass (m).
        com_projection: (3,) where its plumb line meets the plane through the points (m).
        com_inside: Whether that is inside of the polygon.
        joints: In actuator order.
        contacts: The forces; empty where they are not shown.
    """

    ground: Ground
    contact_positions: Array
    polygon: Array
    steps: Mapping[str, Step]
    com: Array
    com_projection: Array
    com_inside: bool
    joints: tuple[JointAxis, ...]
    contacts: tuple[Contact, ...]

    @property
    def ground_centre(self) -> Array:
        """Where the ground's plane is in the middle of the feet (3,) (m)."""
        x, y = self.contact_positions[:, :2].mean(axis=0)
        return np.array([x, y, self.ground.height((x, y))])

    @property
    def ground_normal(self) -> Array:
        """The direction (3,) out of the ground's plane."""
        return self.ground.normal()


def describe_scene(
    robot: Robot, stand: Stand, statics: GravityCompensation | None
) -> StandingScene:
    """Returns what is seen of a robot that stands, but for its shapes.

    Args:
        robot: The robot.
        stand: How it stands.
        statics: What holds it; without it, neither forces nor torques are shown.
    """
    robot = stand.check(robot)
    config = Configuration(robot, stand.qpos)
    com = config.center_of_mass() if statics is None else statics.center_of_mass
    ground = stand.task.ground
    points = np.array([*stand.contact_points.values()] or [stand.qpos[:3] * (1.0, 1.0, 0.0)])
    over = points[:1] if robot.welded else points  # welds hold a com over any place
    return StandingScene(
        ground=ground,
        contact_positions=points,
        polygon=_balanced(robot, stand, points)
        if ground.planes and not robot.welded
        else compute_polygon_corners(over),
        steps=ground.steps(stand.rigid_targets),
        com=com,
        com_projection=np.array([com[0], com[1], evaluate_plane_height(points, com)]),
        com_inside=stand.com_margin >= 0,
        joints=tuple(describe_joint_axes(config, stand.joint_positions(robot), statics)),
        contacts=_contacts(robot, stand, statics) if statics else (),
    )


def _contacts(robot: Robot, stand: Stand, statics: GravityCompensation) -> tuple[Contact, ...]:
    """Returns the forces on feet, and on what grips."""
    loads = statics.foot_loads.items()
    feet = [Contact(foot, load.centre_of_pressure, load.force) for foot, load in loads]
    pulls = {name: statics.weld_wrenches[name][:3] for name in robot.grips}
    return (*feet, *(Contact(name, stand.foot_targets[name], pulls[name]) for name in pulls))


def evaluate_plane_height(points: Array, place: Array) -> float:
    """Returns z of the plane through points (n, 3) at a place (2,) (m); of few, the least one."""
    known = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = np.linalg.lstsq(known, points[:, 2], rcond=None)[0]
    return float(plane @ (place[0], place[1], 1.0))


def _balanced(robot: Robot, stand: Stand, points: Array) -> Array:
    """Returns the corners (m, 3) of where a com is in balance, in the plane through the points."""
    corners = compute_polygon_corners(np.array([(x, y, 0) for x, y in stand.corners(robot)]))
    return np.array(
        [(x, y, evaluate_plane_height(points, np.array((x, y)))) for x, y, _ in corners]
    )


def compute_polygon_corners(points: Array) -> Array:
    """Returns the support polygon's corners (m, 3), each as high as the point that it is (m)."""
    hull = shapely.MultiPoint(points[:, :2]).convex_hull
    wide = hull.geom_type == "Polygon"  # and no line, nor a point
    corners = support_polygon(points) if wide else np.array(hull.coords)
    away = np.linalg.norm(points[:, None, :2] - corners, axis=-1)
    return np.column_stack([corners, points[np.argmin(away, axis=0), 2]])


def describe_joint_axes(
    config: Configuration, positions: Array, statics: GravityCompensation | None
) -> list[JointAxis]:
    """Returns where a robot's joints are, and what their motors hold.

    Args:
        config: The robot in its configuration.
        positions: (nu,) of the joints (rad, m).
        statics: What the motors hold; None if that is not shown.
    """
    robot = config.robot
    model = robot.mj_model
    found = []
    for index, name in enumerate(robot.joint_names):
        joint = model.joint(name).id
        limit = float(robot.effort_limits[index])
        limited = bool(np.isfinite(limit)) and limit > 0
        found.append(
            JointAxis(
                name=name,
                body=int(model.jnt_bodyid[joint]),
                anchor=model.jnt_pos[joint],
                axis=model.jnt_axis[joint],
                world_anchor=config.joint_position(name),
                world_axis=config.joint_axis(name),
                position=float(positions[index]),
                torque=None if statics is None else float(statics.joint_torques[index]),
                limit=limit if np.isfinite(limit) else None,
                utilisation=float(statics.motor_utilisation[index])
                if statics and limited
                else None,
            )
        )
    return found


def collect_visible_shapes(
    model: mujoco.MjModel, max_faces: int
) -> tuple[list[VisibleShape], dict[int, Mesh]]:
    """Returns the robot's shapes, and the meshes that they have.

    Args:
        model: MuJoCo's model of the robot.
        max_faces: Triangles of all meshes together: finer ones are made coarser.
    """
    seen = select_visible_geoms(model)
    shapes = []
    for geom in seen:
        form, material = read_shape(model, geom), int(model.geom_matid[geom])
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        mesh = int(model.geom_dataid[geom]) if form.kind == "mesh" else None
        shapes.append(VisibleShape(int(model.geom_bodyid[geom]), form, colour, mesh))
    numbers = sorted({shape.mesh for shape in shapes if shape.mesh is not None})
    total = sum(int(model.mesh_facenum[mesh]) for mesh in numbers)
    share = min(1.0, max_faces / max(total, 1))
    return shapes, {mesh: _mesh(model, mesh, share) for mesh in numbers}


def select_visible_geoms(model: mujoco.MjModel) -> list[int]:
    """Returns the robot's shapes that are shown: those that MuJoCo's viewer shows, or else all."""
    own = [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] and read_shape(model, geom).kind in NUM_SIZES
    ]
    return [geom for geom in own if model.geom_group[geom] < NUM_VISIBLE_GROUPS] or own


def _mesh(model: mujoco.MjModel, mesh: int, share: float) -> Mesh:
    """Returns a mesh with about ``share`` of its faces."""
    found = read_mesh(model, mesh)
    wanted, cells = max(int(share * len(found.faces)), _FEWEST), _COARSEST
    while len(found.faces) > wanted and cells > 4:
        found = coarsen_mesh(found, cells)
        cells = int(0.75 * cells)
    return found


def coarsen_mesh(mesh: Mesh, cells: int) -> Mesh:
    """Returns a mesh whose vertices within a cell of a grid are one.

    Args:
        mesh: The mesh.
        cells: How many of them the longest side of the mesh's box has.

    Returns:
        Vertices, each the mean of those in a cell, and the triangles that have not collapsed.

    Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes",
    1993: vertex clustering.
    """
    vertices, low = mesh.vertices, mesh.vertices.min(axis=0)
    size = float(np.ptp(vertices, axis=0).max()) / cells
    keys = np.floor((vertices - low) / size).astype(np.int64)
    _, cell = np.unique(keys, axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    merged = np.column_stack([np.bincount(cell, vertices[:, axis]) / count for axis in range(3)])
    moved = cell[mesh.faces]
    return Mesh(merged, moved[(moved != np.roll(moved, 1, axis=1)).all(axis=1)])
