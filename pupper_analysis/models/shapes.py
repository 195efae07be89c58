"""A shape: its kind, its size and where it is, the same for what draws it, touches or weighs it.

It is the sum of a point, bars, an ellipse, a ball and a hull: all that is asked of its surface
follows from these terms, whichever its kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import Final, NamedTuple

import coal  # comes with pin
import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Direction = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose: x = position + rotation x'.

    Attributes:
        position: (3,) (m).
        rotation: (3, 3).
    """

    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __mul__(self, other: Pose) -> Pose:
        return Pose(self.point(other.position), self.rotation @ other.rotation)

    def point(self, local: Array) -> Array:
        """Returns a point (3,), or points (n, 3), given in this pose's frame, in the outer one."""
        moved: Array = local @ self.rotation.T + self.position
        return moved

    @property
    def placed(self) -> pin.SE3:
        """The same, as Pinocchio has it."""
        return pin.SE3(self.rotation, self.position)

    def inverse(self) -> Pose:
        """Returns the pose of the outer frame in this one."""
        return Pose(-self.rotation.T @ self.position, self.rotation.T)

    @staticmethod
    def of(placement: pin.SE3) -> Pose:
        """Returns a placement of Pinocchio's."""
        return Pose(np.array(placement.translation), np.array(placement.rotation))

    @staticmethod
    def of_body(data: mujoco.MjData, body: int) -> Pose:
        """Returns where a body is in MuJoCo's world."""
        return Pose(data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy())


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        vertices: (n, 3) (m).
        faces: (m, 3) numbers of vertices.
    """

    vertices: Array
    faces: Integers

    def part(self, numbers: Array | Integers, faces: Array | Integers) -> Mesh:
        """Returns those of the vertices, and triangles of them: all by their numbers so far."""
        order = np.full(len(self.vertices), -1, dtype=np.int64)
        order[numbers] = np.arange(len(numbers))
        return Mesh(self.vertices[numbers], order[faces])

    def hull(self) -> Mesh:
        """Returns the convex hull; all, if the vertices lie in a plane."""
        from scipy.spatial import ConvexHull, QhullError  # slow to import

        try:
            found = ConvexHull(self.vertices)
        except (QhullError, ValueError):
            return self
        return self.part(found.vertices, found.simplices)


class Terms(NamedTuple):
    """The convex sets whose sum a shape is, in its body's frame (m).

    Attributes:
        centre: A point.
        bars: Half of each: a box is the sum of three, a capsule that of one and a ball.
        radii: Those of an ellipse, two at right angles, or of an ellipsoid, three; () without one.
        ball: The ball's radius.
        hull: (n, 3) corners of a convex hull, from the centre; None without one.
    """

    centre: Direction
    bars: tuple[Direction, ...]
    radii: tuple[Direction, ...]
    ball: float
    hull: Array | None


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape that is drawn or touches things.

    Attributes:
        name: Its name, "" if it has none.
        kind: ``sphere``, ``box``, ``cylinder``, ``capsule``, ``ellipsoid``, ``mesh`` or another.
        pose: In its body's frame.
        size: Radius; radius and half length; or three half sizes (m).
        collides: Whether it can touch things.
        read: Returns a mesh in the shape's frame, or the hull of it that touches; None if unknown.
    """

    name: str
    kind: str
    pose: Pose
    size: tuple[float, ...]
    collides: bool
    read: Callable[[], Mesh | None] = lambda: None

    @cached_property
    def mesh(self) -> Mesh | None:
        """What was read: only its convex hull counts here, as in the engines' collisions."""
        return self.read()

    def placed_in(self, pose: Pose) -> Shape:
        """Returns the same shape in the frame in which its body has a pose."""
        return replace(self, pose=pose * self.pose)

    @property
    def diagnostic(self) -> Diagnostic:
        """The shape as a fact: its kind, sizes and place."""
        x, y, z = (Quantity(float(value), "m") for value in self.pose.position)
        sizes = tuple(Quantity(size, "m") for size in self.size)
        return diagnose("shape", kind=Term(self.kind), sizes=sizes, x=x, y=y, z=z)

    @cached_property
    def terms(self) -> Terms | None:
        """What it is the sum of; None if its extent is not known (a missing mesh, a plane)."""
        turn, size, hull = self.pose.rotation, self.size, None
        bars, radii, ball = list[tuple[int, float]](), list[tuple[int, float]](), 0.0
        match self.kind:
            case "sphere":
                ball = size[0]
            case "box":
                bars = list(enumerate(size))
            case "ellipsoid" if len({*size}) == 1:
                ball = size[0]
            case "ellipsoid":
                radii = list(enumerate(size))
            case "cylinder":
                bars, radii = [(2, size[1])], [(0, size[0]), (1, size[0])]
            case "capsule":
                bars, ball = [(2, size[1])], size[0]
            case "mesh" if self.mesh is not None:
                hull = np.ascontiguousarray(self.mesh.vertices @ turn.T)
            case _:
                return None

        def along(axis: int, length: float) -> Direction:
            x, y, z = (length * turn[:, axis]).tolist()
            return x, y, z

        x, y, z = self.pose.position.tolist()
        return Terms(
            (x, y, z),
            tuple(along(*bar) for bar in bars),
            tuple(along(*radius) for radius in radii),
            ball,
            hull,
        )

    def support(self, directions: Array) -> Array | None:
        """Returns the support function of its convex hull, in its body's frame.

        h(d) = max over points x of the hull of d'x, which of a sum of convex sets is the sum of
        theirs. Two shapes have one hull if their functions are the same, wherever their axes point:
        MuJoCo and most engines touch with the hull.

        Args:
            directions: (n, 3) unit vectors in the body's frame.

        Returns:
            (n,) (m); None if the extent is not known.
        """
        if self.terms is None:
            return None
        centre, bars, radii, ball, hull = self.terms
        reach = directions @ np.array(centre) + ball
        if bars:
            reach += np.abs(directions @ np.array(bars).T).sum(axis=1)
        if radii:
            reach += np.linalg.norm(directions @ np.array(radii).T, axis=1)
        if hull is not None:
            reach += (directions @ hull.T).max(axis=1)
        return np.asarray(reach)

    def height(self, link: tuple[Array, Array], normal: Direction) -> float:
        """Returns how high its lowest point is above a plane through the origin (m).

        It reaches below its centre by its support function.

        Args:
            link: Rotation (3, 3) and place (3,) of its body.
            normal: Of the plane, a unit vector.
        """
        turn, place = link
        a, b, c = normal
        # The normal in the link's axes, and the height of the link's origin.
        if a == 0.0 and b == 0.0:
            (u, v, w), height = turn[2].tolist(), place.item(2)
        else:
            (xx, xy, xz), (yx, yy, yz), (u, v, w) = turn.tolist()
            at_x, at_y, height = place.tolist()
            u, v, w = a * xx + b * yx + c * u, a * xy + b * yy + c * v, a * xz + b * yz + c * w
            height = a * at_x + b * at_y + c * height
        (x, y, z), bars, radii, ball, hull = self.terms  # type: ignore[misc]
        height += u * x + v * y + w * z - ball
        for x, y, z in bars:
            height -= abs(u * x + v * y + w * z)
        if radii:
            height -= math.hypot(*[u * x + v * y + w * z for x, y, z in radii])
        if hull is not None:
            height += hull.dot((u, v, w)).min()
        return float(height)

    def lowest(self, link: tuple[Array, Array], normal: Array) -> Array:
        """Returns the point (3,) in the world that is lowest above a plane; see ``height`` (m)."""
        turn, place = link
        own = turn.T @ normal
        centre, bars, radii, ball, hull = self.terms  # type: ignore[misc]
        point = np.array(centre) - ball * own
        for bar in bars:
            point -= math.copysign(1.0, own @ bar) * np.array(bar)
        if radii:
            reach = np.array(radii) @ own
            point -= np.array(radii).T @ reach / max(float(np.linalg.norm(reach)), 1e-300)
        if hull is not None:
            point += hull[(hull @ own).argmin()]
        lowest: Array = turn @ point + place
        return lowest

    def outline(self, circle: Array, globe: Array) -> Array | None:
        """Returns the centres (n, 3) of balls, each of the terms' radius, whose hull is the shape.

        Args:
            circle: (n, 2) unit vectors, the points of ellipses that count.
            globe: (n, 3) unit vectors, those of ellipsoids.

        Returns:
            In the body's frame (m); None if the extent is not known.
        """
        if self.terms is None:
            return None
        centre, bars, radii, _, hull = self.terms
        points: Array = np.array([centre]) if hull is None else centre + hull
        sums = [np.array([[-1.0], [1.0]]) * bar for bar in bars]
        if radii:
            sums.append((circle if len(radii) == 2 else globe) @ np.array(radii))
        for one in sums:
            points = (points[:, None] + one).reshape(-1, 3)
        return points

    @property
    def points(self) -> Array | None:
        """Points (n, 3) in the body's frame whose convex hull is the shape's, nearly (m).

        None if the extent is not known.
        """
        centres = self.outline(_CIRCLE, _GLOBE)
        if centres is None or self.terms is None or not self.terms.ball:
            return centres
        return (centres[:, None] + self.terms.ball * _GLOBE).reshape(-1, 3)

    @cached_property
    def collision(self) -> coal.CollisionGeometry:
        """The shape in coal; it is one of ``CONVEX``, its mesh known."""
        match self.kind, self.size:
            case "sphere", (r,):
                return coal.Sphere(r)
            case "capsule", (r, half):
                return coal.Capsule(r, 2 * half)
            case "cylinder", (r, half):
                return coal.Cylinder(r, 2 * half)
            case "ellipsoid", (x, y, z):
                return coal.Ellipsoid(x, y, z)
            case "box", (x, y, z):
                return coal.Box(2 * x, 2 * y, 2 * z)
        assert self.mesh is not None
        corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(self.mesh.vertices))
        triangles.extend([coal.Triangle(*face) for face in self.mesh.faces.tolist()])
        return coal.Convex(corners, triangles)


_GLOBE = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_GLOBE /= np.linalg.norm(_GLOBE, axis=1, keepdims=True)
_CIRCLE = np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 17)[:-1]])

_SAMPLES = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(60, 3))])
DIRECTIONS = _SAMPLES / np.linalg.norm(_SAMPLES, axis=1, keepdims=True)
"""(66, 3) in which the extents of two shapes are compared: axes, and enough others that no turn of
a box or a cylinder hides between them."""

CONVEX: Final = {"sphere": 1, "box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}
"""{kind: how many sizes it has} of MuJoCo's shapes that have an extent."""


def read_shape(model: mujoco.MjModel, geom: int, data: mujoco.MjData | None = None) -> Shape:
    """Returns the shape of a geom, in its body's frame; in the world where ``data`` has it."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    if data is None:
        pose = Pose(np.array(model.geom_pos[geom]), rotation_from_quaternion(model.geom_quat[geom]))
    else:
        pose = Pose(data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy())
    size = tuple(model.geom_size[geom][: CONVEX.get(kind, 0)].tolist())
    collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    name = model.geom(geom).name
    if kind != "mesh":
        return Shape(name, kind, pose, size, collides)
    read = partial(_read_hull, model, int(model.geom_dataid[geom]))
    return Shape(name, kind, pose, size, collides, read)


def read_mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Returns a mesh of MuJoCo's."""
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    begin, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return Mesh(
        np.array(model.mesh_vert[start : start + count], dtype=float),
        np.array(model.mesh_face[begin : begin + number], dtype=np.int64),
    )


def _read_hull(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Returns the convex hull of a mesh: MuJoCo's own, if any collision asks for it.

    See the compiler's ``mesh_graph``: numbers of corners and faces, where each corner's edges
    begin, the corners' numbers in the mesh, the edges, and the faces by numbers in the mesh.
    """
    graph, whole = int(model.mesh_graphadr[mesh]), read_mesh(model, mesh)
    if graph < 0:
        return whole.hull()
    corners, faces = model.mesh_graph[graph : graph + 2].tolist()
    numbers = model.mesh_graph[graph + 2 + corners : graph + 2 + 2 * corners]
    at = graph + 2 + 3 * corners + 3 * faces
    return whole.part(numbers, model.mesh_graph[at : at + 3 * faces].reshape(-1, 3))
