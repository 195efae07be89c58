"""Force polytope: set of external forces on a point of a robot that the motors withstand.

The motors withstand an external force f on the point if ``|l - J^T f| <= limits``. l is the static
load of the motors, J is the Jacobian (3, nu) of the point, and ``limits`` are the effort limits.
Loops and couplings transfer l and J^T f to the motors. The base is held. These forces form a convex
polytope, with at most one pair of parallel faces per motor (Chiacchio, Bouffard-Vercelli and
Pierrot 1997, "Force polytope and force ellipsoid for redundant manipulators").
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_direction
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import FramePoint, Tool, find_place, find_tool

MIN_LEVER_ARM = 1e-9
"""Lever arm of a force about a hinge [m], or component of a unit force along a slide [1], above
which the motor bears the force. Chosen as the size of rounding errors."""

_PARALLEL_TOLERANCE = 1e-9
"""Tolerance [1] of the linear dependence of unit normals of faces, for their triple product or
third singular value. Rounding is 1e-16; chosen, not tuned."""

_VERTEX_RTOL = 1e-9
"""Tolerance with which a vertex may be outside of a face, or two vertices count as equal, relative
to the force, or to 1 N for smaller forces. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class ForcePolytope(Tabular):
    """Set of external forces on a point of a robot that the motors withstand with a held base.

    The motors withstand a force f on the point if ``|l - J^T f| <= limits``, with the static load l
    of the motors. The robot then pushes with -f against its environment.

    Attributes:
        point: Position of the point in the world, shape (3,) (m).
        joints: Joints of the n motors between the base and the point, and of the motors that bear
            the force through loops and couplings.
        rows: Rows of J^T in world axes, shape (n, 3) (m or 1).
        load: Static load of the motors, shape (n,) (N m or N).
        limits: Effort limits of the motors, shape (n,) (N m or N); infinite if the limit is
            unknown.
        vertices: Vertices of the polytope in world axes, shape (k, 3) (N). None if a limit is
            unknown, or if no motor bears a force in some direction (fewer than three motors, or a
            straight limb): the polytope is then unbounded or empty. Otherwise k = 0 if no force
            keeps all motors within their limits. A motor that bears no force, with a static load
            beyond its limit, also gives k = 0.
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"x": "N", "y": "N", "z": "N"}

    point: Array = field(metadata={"unit": "m"})
    joints: tuple[str, ...]
    rows: Array = field(metadata={"unit": "m or 1"})
    load: Array = field(metadata={"unit": "N m or N"})
    limits: Array = field(metadata={"unit": "N m or N"})
    vertices: Array | None = field(metadata={"unit": "N"})

    def largest_force(self, direction: ArrayLike) -> float:
        """Return the largest external force [N] along a direction that the motors withstand.

        NaN if a motor that bears the force has an unknown torque limit. Otherwise 0 if the static
        load alone exceeds the limit of a motor in ``joints``, even if the force would relieve this
        motor. Otherwise infinite if no motor bears the force.

        Args:
            direction: Direction (3,) of the force, in world axes; normalised here.

        Raises:
            ConfigurationError: If the direction is not a vector of finite numbers, or is zero.
        """
        return self._limit_along(direction)[0]

    def largest_push(self, direction: ArrayLike) -> float:
        """Return the largest straight push [N] of the robot that the motors withstand.

        The robot pushes against the environment along ``direction``. The result is
        ``largest_force(-direction)``, since the external force on the robot is opposite to the
        push.

        Args:
            direction: Direction (3,) of the push, in world axes; normalised here.

        Raises:
            ConfigurationError: If the direction is not a vector of finite numbers, or is zero.
        """
        return self.largest_force(-check_direction("direction", direction))

    def limiting_joint(self, direction: ArrayLike) -> str | None:
        """Return the joint whose motor limits the largest external force along a direction.

        None if this force (`largest_force`) is infinite or unknown.

        Args:
            direction: Direction (3,) of the external force, in world axes.

        Raises:
            ConfigurationError: If the direction is not a vector of finite numbers, or is zero.
        """
        index = self._limit_along(direction)[1]
        return self.joints[index] if index >= 0 else None

    def _limit_along(self, direction: ArrayLike) -> tuple[float, int]:
        """Compute the largest external force [N] along a direction, and the limiting motor's index.

        The index refers to ``joints``; it is -1 if the force is infinite or NaN.
        """
        unit = check_direction("direction", direction)
        if not self.joints:
            return float("inf"), -1
        forces, limiting = force_limits_along(*self._make_inequalities(), unit[None])
        return float(forces[0]), int(limiting[0])

    def _make_inequalities(self) -> tuple[Array, Array]:
        """Return rows (2 n, 3) and bounds (2 n,) of ``rows @ f <= bounds``, for a force f [N]."""
        slack = np.concatenate([self.limits + self.load, self.limits - self.load])
        return np.concatenate([self.rows, -self.rows]), slack

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {"x", "y", "z": coordinates [N]}, the columns of a table with a row per vertex."""
        vertices = np.zeros((0, 3)) if self.vertices is None else self.vertices
        return dict(zip(("x", "y", "z"), vertices.T, strict=True))


@check_arguments
def force_polytope(config: Configuration, point: str | FramePoint) -> ForcePolytope:
    """Compute the external forces on a foot, hand or other point that the motors withstand.

    The base is held, and gravity and springs act. For the largest straight push of a foot:
    ``force_polytope(config, "FR").largest_push([0, 0, -1])``.

    Args:
        config: State of the robot; the velocity is ignored.
        point: Name of a contact point (the lowest point of its sphere), foot (the mean of its
            contact points), link, site, body or geom. Or a position (3,) [m] in the base frame. A
            position in the frame of a link, site, body or geom begins with its name:
            ``("right_hand", 0.0, 0.0, 0.05)``.

    Raises:
        UnknownNameError: If the robot has no such frame.
        ConfigurationError: If the place is not valid, or a closed loop is singular.
    """
    robot = config.robot
    tool = _find_point(config, point)
    first = robot.nv - robot.nu
    load = config.transfer_to_motors(config.static_load())[first:]
    rows = config.transfer_to_motors(tool.jacobian(config).T)[first:]
    bearing = np.linalg.norm(rows, axis=1) > MIN_LEVER_ARM
    moving = np.array([name in tool.chain for name in robot.joint_names])
    if robot.closure is not None:
        moving[robot.closure.dependent_joints] = (
            False  # dependent joints have no motor of their own
        )
    kept = np.flatnonzero(bearing | moving)
    limits = robot.effort_limits[kept]
    vertices = None
    if np.isfinite(limits).all():
        slack = np.concatenate([limits + load[kept], limits - load[kept]])
        vertices = find_vertices(rows[kept], slack)
    return ForcePolytope(
        point=tool.position(config),
        joints=tuple(robot.joint_names[index] for index in kept),
        rows=rows[kept],
        load=load[kept],
        limits=np.array(limits),
        vertices=vertices,
    )


def _find_point(config: Configuration, point: str | FramePoint) -> Tool:
    """Return the `Tool` (a point on a link) that a name or a `FramePoint` specifies."""
    robot = config.robot
    if not isinstance(point, str):
        return find_place(robot, point)
    points = robot.feet.get(point, (point,))
    if not all(name in robot.contact_frames for name in points):
        return find_tool(robot, point)
    tool = find_tool(robot, robot.contact_frames[points[0]])
    places = config.contact_points(points)
    gap = np.mean(list(places.values()), axis=0) - tool.position(config)
    return tool.translated(config.frame_rotation(tool.link).T @ gap)


def force_inequalities(config: Configuration, tool: Tool) -> tuple[Array, Array]:
    """Return the inequalities rows @ f <= slack of the forces f on a tool that motors withstand.

    Args:
        config: State of a robot with a fixed base.
        tool: Point of application of the force.

    Returns:
        Rows, shape (2 nu, 3) [m, or 1 for a slide], and slack, shape (2 nu,) [N m, or N for a
        slide]. The slack contains the distances of the static load from the lower effort limits of
        all motors, then from the upper limits. The force f is expressed in world axes [N].
    """
    limits = config.robot.effort_limits
    load = config.transfer_to_motors(config.static_load())
    rows = config.transfer_to_motors(tool.jacobian(config).T)
    slack = np.concatenate([limits + load, limits - load])
    return np.concatenate([rows, -rows]), slack


def force_limits_along(
    rows: Array, slack: Array, directions: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Compute the largest external force along each of k directions that the motors withstand.

    The forces f that the motors withstand are a polytope, ``rows @ f <= slack``.

    Args:
        rows: Left-hand sides of the inequalities (`force_inequalities`) of n motors, shape (2 n, 3)
            [m, or 1 for a slide].
        slack: Right-hand sides, shape (2 n,) [N m, or N for a slide].
        directions: Unit vectors in world axes, shape (k, 3).

    Returns:
        Largest forces, shape (k,) [N], as from `ForcePolytope.largest_force`; and indices (k,) of
        the motors that reach the effort limit first, -1 if the force is not finite.
    """
    along = directions @ rows.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(along > MIN_LEVER_ARM, slack / along, np.inf)
    if slack.min() < 0:  # the load alone exceeds a limit: 0 also for a relieving force
        ends[:, slack < 0] = 0.0
    nearest = ends.argmin(axis=1)
    forces = ends[np.arange(len(ends)), nearest]
    forces[(np.abs(along[:, np.isinf(slack)]) > MIN_LEVER_ARM).any(axis=1)] = (
        np.nan
    )  # a limit is unknown
    return forces, np.where(np.isfinite(forces), nearest % (len(rows) // 2), -1)


def find_vertices(rows: Array, slack: Array) -> Array | None:
    """Compute the vertices of the polytope of forces f with -slack[n:] <= rows @ f <= slack[:n].

    All triples of faces are solved, because a polytope without volume (a motor with a limit of
    zero) has no interior point, which Qhull requires.

    Args:
        rows: Shape (n, 3) [m, or 1 for a slide]. Rows with a length up to `MIN_LEVER_ARM` count as
            zero.
        slack: Shape (2 n,) [N m, or N for a slide]; finite upper bounds of ``rows @ f``, then of
            ``-rows @ f``.

    Returns:
        Vertices, shape (k, 3) [N]; k = 0 if the polytope is empty. None if the rows do not span
        three dimensions, and the polytope is not known to be empty.
    """
    lengths = np.linalg.norm(rows, axis=1)
    bearing = lengths > MIN_LEVER_ARM
    count = len(rows)
    if (slack[:count][~bearing] < 0).any() or (slack[count:][~bearing] < 0).any():
        return np.zeros((0, 3))
    normals = rows[bearing] / lengths[bearing, None]
    if len(normals) < 3 or np.linalg.svd(normals, compute_uv=False)[2] < _PARALLEL_TOLERANCE:
        return None
    upper = slack[:count][bearing] / lengths[bearing]
    lower = -slack[count:][bearing] / lengths[bearing]
    triples = np.array(list(itertools.combinations(range(len(normals)), 3)))
    meeting = np.abs(np.linalg.det(normals[triples])) > _PARALLEL_TOLERANCE
    triples = triples[meeting]
    sides = np.array(list(itertools.product((0, 1), repeat=3)))
    ends = np.stack([lower, upper])[sides[:, None], triples]  # (8, triples, 3)
    points = np.linalg.solve(normals[triples], ends[..., None])[..., 0].reshape(-1, 3)
    tolerance = _VERTEX_RTOL * np.maximum(1.0, np.abs(points).max(axis=1, initial=0.0))
    along = points @ normals.T
    inside = along <= upper + tolerance[:, None]
    inside &= along >= lower - tolerance[:, None]
    return _merge_equal_points(points[inside.all(axis=1)])


def _merge_equal_points(points: Array) -> Array:
    """Remove points (n, 3) [N] that equal an earlier point, within `_VERTEX_RTOL`."""
    tolerance = _VERTEX_RTOL * max(1.0, float(np.abs(points).max(initial=0.0)))
    kept: list[Array] = []
    for point in points:
        if not kept or np.abs(np.array(kept) - point).max(axis=1).min() > tolerance:
            kept.append(point)
    return np.array(kept).reshape(-1, 3)
