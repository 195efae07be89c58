"""Visible content of a robot in a stand: shapes, joints, contact forces, centre of mass, ground.

``collect_visible_shapes`` evaluates the shapes, ``describe_scene`` everything else. The page's
viewer (``html/write``), the live page (``live/scene``) and the figures of poses (``figures/pose``)
draw the results.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import shapely

from pupper_analysis.base.array_types import Array
from pupper_analysis.models.shapes import NUM_SIZES, Mesh, Shape, get_mesh, read_shape
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.ground import Ground, Step
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.statics.support_polygon import support_polygon

NUM_VISIBLE_GROUPS = 3
"""Number of geom groups that MuJoCo's viewer shows by default: groups 0 to 2."""

_MAX_GRID_CELLS = 512
"""Number of grid cells along the longest side of a mesh, in the first and finest grid with which
`_simplify_mesh` reduces the mesh. Chosen, not tuned.
"""
_MIN_MESH_FACES = 100
"""Lower bound of the number of triangles that `_simplify_mesh` accepts as the aim of a reduction. A
mesh with at most this number is not reduced. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class VisibleShape:
    """Geom that is drawn.

    Attributes:
        body: Index of the geom's body in MuJoCo's model.
        form: Shape and pose, in the body frame.
        colour: Red, green, blue and opacity, shape (4,), 0 to 1.
        mesh: Index of the mesh in MuJoCo's model; None for other shapes.
    """

    body: int
    form: Shape
    colour: Array
    mesh: int | None


@dataclass(frozen=True, eq=False)
class JointAxis:
    """Axis of a joint and load of the motor.

    Attributes:
        name: Name of the joint.
        body: Index of the body that the joint moves, in MuJoCo's model.
        anchor: Point on the axis, shape (3,) [m], in the body frame.
        axis: Direction, shape (3,), in the body frame.
        world_anchor: Point on the axis, shape (3,) [m], in the world frame.
        world_axis: Direction, shape (3,), in the world frame.
        position: Joint position [rad or m].
        torque: Motor torque [N m or N]; None if loads are not shown.
        limit: Effort limit [N m or N]; None if unknown.
        utilisation: |torque| / limit; None if loads are not shown, or the limit is unknown or zero.
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
class DrawnForce:
    """Contact force on a foot.

    Attributes:
        foot: Name of the foot, or of a contact with a grip.
        point: Centre of pressure, or centre of the contact sphere of a grip, shape (3,) [m], in the
            world frame.
        force: Force on the foot, shape (3,) [N], in world axes.
    """

    foot: str
    point: Array
    force: Array


@dataclass(frozen=True, eq=False)
class StandingScene:
    """State of a robot in a stand, with ground and loads.

    All vectors are in the world frame, except ``anchor`` and ``axis`` of a joint.

    Attributes:
        ground: Ground.
        contact_positions: Contact points of the stand, shape (n, 3) [m]. If the stand has no
            contacts: the vertical projection of the base on height 0.
        polygon: Corners of the support polygon, shape (m, 3) [m]. Each corner has the height of the
            contact point that is nearest in x and y. If the contacts are on several planes: corners
            of the support region, in the plane fitted to the contact points. If a part is welded to
            the world: only the first contact point.
        steps: {foot: step under this foot}.
        com: Centre of mass, shape (3,) [m].
        com_projection: Vertical projection of the centre of mass on the plane fitted to the contact
            points, shape (3,) [m].
        com_inside: True if the CoM margin of the stand is not negative.
        joints: Joint axes and motor loads, in actuator order.
        contacts: Contact forces; empty if loads are not shown.
    """

    ground: Ground
    contact_positions: Array
    polygon: Array
    steps: Mapping[str, Step]
    com: Array
    com_projection: Array
    com_inside: bool
    joints: tuple[JointAxis, ...]
    contacts: tuple[DrawnForce, ...]

    @property
    def ground_centre(self) -> Array:
        """Ground point at the mean x and y of the contact points, shape (3,) [m], world frame."""
        x, y = self.contact_positions[:, :2].mean(axis=0)
        return np.array([x, y, self.ground.height((x, y))])

    @property
    def ground_normal(self) -> Array:
        """Upward unit normal of the slope, shape (3,), in the world frame."""
        return self.ground.normal()


def describe_scene(
    robot: Robot, stand: Stand, statics: GravityCompensation | None
) -> StandingScene:
    """Collect what a view of a stand shows besides shapes: ground, CoM, axes, forces, polygon.

    Without ``statics``, forces and torques are omitted.

    Raises:
        ConfigurationError: If the stand belongs to another robot.
    """
    robot = stand.check(robot)
    config = Configuration(robot, stand.qpos)
    com = config.center_of_mass() if statics is None else statics.center_of_mass
    ground = stand.task.ground
    points = np.array([*stand.contact_points.values()] or [stand.qpos[:3] * (1.0, 1.0, 0.0)])
    over = points[:1] if robot.is_welded else points  # welds hold a com over any place
    return StandingScene(
        ground=ground,
        contact_positions=points,
        polygon=_find_balance_corners(robot, stand, points)
        if ground.planes and not robot.is_welded
        else compute_polygon_corners(over),
        steps=ground.steps(stand.rigid_targets),
        com=com,
        com_projection=np.array([com[0], com[1], evaluate_plane_height(points, com)]),
        com_inside=stand.com_margin >= 0,
        joints=tuple(describe_joint_axes(config, stand.joint_positions(robot), statics)),
        contacts=_collect_contacts(robot, stand, statics) if statics else (),
    )


def _collect_contacts(
    robot: Robot, stand: Stand, statics: GravityCompensation
) -> tuple[DrawnForce, ...]:
    """Return the contact forces on feet and on contacts with a grip, with their positions."""
    loads = statics.foot_loads.items()
    feet = [DrawnForce(foot, load.centre_of_pressure, load.force) for foot, load in loads]
    pulls = {name: statics.weld_wrenches[name][:3] for name in robot.grips}
    return (*feet, *(DrawnForce(name, stand.foot_targets[name], pulls[name]) for name in pulls))


def evaluate_plane_height(points: Array, place: Array) -> float:
    """Return z [m] of the least-squares plane through ``points``, shape (n, 3) [m], at a place.

    ``place`` contains x and y [m]. If the points do not determine a plane, the minimum-norm
    solution is used.
    """
    known = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = np.linalg.lstsq(known, points[:, 2], rcond=None)[0]
    return float(plane @ (place[0], place[1], 1.0))


def _find_balance_corners(robot: Robot, stand: Stand, points: Array) -> Array:
    """Compute the corners of the support region, shape (m, 3) [m], in the world frame.

    x and y are those of `Stand.corners`; z is the height there of the least-squares plane of
    ``points``, shape (n, 3) [m].
    """
    corners = compute_polygon_corners(np.array([(x, y, 0) for x, y in stand.corners(robot)]))
    return np.array(
        [(x, y, evaluate_plane_height(points, np.array((x, y)))) for x, y, _ in corners]
    )


def compute_polygon_corners(points: Array) -> Array:
    """Compute the corners of the support polygon, shape (m, 3) [m], from contact positions.

    ``points``, shape (n, 3) [m], and the corners are expressed in the world frame. Each corner has
    the height of the point nearest in x and y.
    """
    hull = shapely.MultiPoint(points[:, :2]).convex_hull
    wide = hull.geom_type == "Polygon"  # not a line or a point
    corners = support_polygon(points) if wide else np.array(hull.coords)
    away = np.linalg.norm(points[:, None, :2] - corners, axis=-1)
    return np.column_stack([corners, points[np.argmin(away, axis=0), 2]])


def describe_joint_axes(
    config: Configuration, positions: Array, statics: GravityCompensation | None
) -> list[JointAxis]:
    """List each joint's axis and anchor in the body and world frames, position and motor load.

    The joints are in actuator order; ``positions`` has the shape (nu,) [rad or m]. Without
    ``statics``, torques are omitted.
    """
    robot = config.robot
    model = robot.mj_model
    axes = []
    for index, name in enumerate(robot.joint_names):
        joint = model.joint(name).id
        limit = float(robot.effort_limits[index])
        limited = bool(np.isfinite(limit)) and limit > 0
        axes.append(
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
    return axes


def collect_visible_shapes(
    model: mujoco.MjModel, max_faces: int
) -> tuple[list[VisibleShape], dict[int, Mesh]]:
    """Read the visible geoms of a model, and simplify the meshes.

    ``max_faces`` is the approximate upper bound of the triangles of all meshes. If the meshes have
    more triangles, large meshes are reduced by about the same factor.

    Returns:
        Shapes, and {index of a mesh: mesh}.
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
    return shapes, {mesh: _simplify_mesh(model, mesh, share) for mesh in numbers}


def select_visible_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the indices of the bodies' geoms in the groups that MuJoCo's viewer shows by default.

    These groups are 0 to 2. If no geom is in these groups, geoms of other groups are returned.
    Geoms of the world body and of unsupported kinds are excluded.
    """
    own = [
        geom
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] and read_shape(model, geom).kind in NUM_SIZES
    ]
    return [geom for geom in own if model.geom_group[geom] < NUM_VISIBLE_GROUPS] or own


def _simplify_mesh(model: mujoco.MjModel, mesh: int, share: float) -> Mesh:
    """Reduce the triangles of a mesh to the fraction ``share`` or fewer, by vertex clustering.

    Small meshes (`_MIN_MESH_FACES`) are not reduced; the coarsest grid may leave more triangles.
    """
    simplified = get_mesh(model, mesh)
    max_faces, cells = max(int(share * len(simplified.faces)), _MIN_MESH_FACES), _MAX_GRID_CELLS
    while len(simplified.faces) > max_faces and cells > 4:
        simplified = coarsen_mesh(simplified, cells)
        cells = int(0.75 * cells)
    return simplified


def coarsen_mesh(mesh: Mesh, cells: int) -> Mesh:
    """Merge the vertices of a mesh that are in the same cell of a grid.

    ``cells`` is the number of cells along the longest side of the bounding box. The result has the
    mean vertex of each cell, and no collapsed triangles.

    Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes",
    1993 (vertex clustering).
    """
    vertices, low = mesh.vertices, mesh.vertices.min(axis=0)
    size = float(np.ptp(vertices, axis=0).max()) / cells or 1.0  # all vertices may be equal
    x, y, z = np.floor((vertices - low) / size).astype(np.int64).T
    # A number per cell, in lexicographic order: NumPy sorts numbers faster than rows.
    _, cell = np.unique((x * (cells + 1) + y) * (cells + 1) + z, return_inverse=True)
    count = np.bincount(cell)
    merged = np.column_stack([np.bincount(cell, vertices[:, axis]) / count for axis in range(3)])
    moved = cell[mesh.faces]
    return Mesh(merged, moved[(moved != np.roll(moved, 1, axis=1)).all(axis=1)])
