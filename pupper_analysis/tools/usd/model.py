"""Robot model of a USD file: bodies and joints of UsdPhysics as a tree.

The poses of the bodies at zero joint positions are computed from the joint frames, as in engines
with reduced coordinates. The transforms of the prims are not used, since the prims describe a pose
of the robot at unknown joint positions.

Engines compute missing mass properties from the collision shapes, with the density of water if no
density is stated. Without collision shapes, engines use defaults. This module does neither: the
inertial of such a body is None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.attributes import JointAttribute
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.shapes import Pose
from pupper_analysis.models.stated.model import (
    BALL_JOINT,
    FIXED_JOINT,
    FREE_JOINT,
    HINGE_JOINT,
    SLIDE_JOINT,
    Inertial,
    Joint,
    Link,
    RobotModel,
)
from pupper_analysis.tools.usd.file import UsdFile

RADIANS_PER_DEGREE: Final = math.pi / 180
"""Radians per degree."""

_JOINT_KINDS: Final = {
    "PhysicsRevoluteJoint": HINGE_JOINT,
    "PhysicsPrismaticJoint": SLIDE_JOINT,
    "PhysicsSphericalJoint": BALL_JOINT,
    "PhysicsFixedJoint": FIXED_JOINT,
}
"""{USD type name: joint kind}; joints of other types count as free joints."""


@dataclass(frozen=True)
class NumberAttribute:
    """Attribute that states a number of a joint, in the schema of an engine.

    Attributes:
        name: Attribute name; ``{axis}`` is replaced by ``angular`` or ``linear``.
        per_angle: Whether the number of a hinge is per degree.
        angle: Whether the number of a hinge is in degrees (per second).
    """

    name: str
    per_angle: bool = False
    angle: bool = False


NUMBER_ATTRIBUTES: Final[Mapping[str, tuple[NumberAttribute, ...]]] = {
    "damping": (
        NumberAttribute("newton:damping", per_angle=True),
        NumberAttribute("mjc:damping"),
        NumberAttribute("physxJointAxis:{axis}:viscousFrictionCoefficient", per_angle=True),
    ),
    "friction": (
        NumberAttribute("newton:friction"),
        NumberAttribute("mjc:frictionloss"),
        NumberAttribute("physxJointAxis:{axis}:staticFrictionEffort"),
    ),
    "armature": (
        NumberAttribute("newton:armature"),
        NumberAttribute("mjc:armature"),
        NumberAttribute("physxJointAxis:{axis}:armature"),
        NumberAttribute("physxJoint:armature"),
    ),
    "effort": (
        NumberAttribute("newton:effortLimit"),
        NumberAttribute("drive:{axis}:physics:maxForce"),
        NumberAttribute("mjc:actuatorfrcrange:max"),
    ),
    "velocity": (
        NumberAttribute("newton:velocityLimit", angle=True),
        NumberAttribute("physxJointAxis:{axis}:maxJointVelocity", angle=True),
        NumberAttribute("physxJoint:maxJointVelocity", angle=True),
    ),
    "spring": (NumberAttribute("mjc:stiffness"),),
}
"""{kind of a joint number, as in `models.attributes`: attributes that may state the number}. The
first stated attribute is used; for the effort the smallest value, since each value is a limit.
"""


@dataclass(frozen=True, eq=False)
class Edge:
    """Joint between two bodies of a USD, or between a body and the world.

    Attributes:
        name: Joint name.
        prim: `pxr.Usd.Prim`.
        kind: Kind, as in `model.Joint`.
        bodies: Names of both bodies; "" for the world.
        frames: Joint frame in the frame of each body [m].
        axis: Axis of the joint frame, 0 to 2.
        lower: Lower limit [rad or m]; -inf if unlimited.
        upper: Upper limit [rad or m]; inf if unlimited.
        numbers: {kind: number}; missing kinds are unknown.
        stated: {kind: {attribute: number}} of all stated attributes, in the units of ``numbers``.
        gains: Stiffness and damping of the position drive [N m/rad, N m s/rad; N/m, N s/m]; None
            without a force drive of positive stiffness.
        outside: Whether the joint is excluded from the articulation.
        mimic: Leader, multiplier and offset of q = multiplier q' + offset; None if the joint is
            independent.
    """

    name: str
    prim: Any
    kind: str
    bodies: tuple[str, str]
    frames: tuple[Pose, Pose]
    axis: int
    lower: float
    upper: float
    numbers: Mapping[str, float] = field(default_factory=dict)
    stated: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gains: tuple[float, float] | None = None
    outside: bool = False
    mimic: tuple[str, float, float] | None = None


def read_edge(
    name: str,
    prim: Any,
    bodies: tuple[str, str],
    frames: tuple[Pose, Pose],
    units: StageUnits,
    paths: Mapping[str, str],
) -> Edge:
    """Read a joint of a USD file between two known bodies, or a body and the world.

    Args:
        name: Joint name.
        prim: Joint prim.
        bodies: Names of both bodies; "" for the world.
        frames: Joint frame in the frame of each body [m].
        units: Units of the stage.
        paths: {path of a joint's prim: joint name}.

    Raises:
        ModelError: If an attribute has a wrong type or value.
    """
    kind, axis, lower, upper = _read_freedom(prim)
    is_hinge, has_axis = kind == HINGE_JOINT, kind in (HINGE_JOINT, SLIDE_JOINT)
    unit = RADIANS_PER_DEGREE if is_hinge else units.length
    axis_word = "angular" if is_hinge else "linear"
    limits = {"lower limit": lower * unit, "upper limit": upper * unit}
    stated = {
        number_kind: numbers
        for number_kind, statements in NUMBER_ATTRIBUTES.items()
        if has_axis
        and (numbers := _read_numbers(prim, number_kind, statements, axis_word, is_hinge, units))
    }
    return Edge(
        name=name,
        prim=prim,
        kind=kind,
        bodies=bodies,
        frames=frames,
        axis=axis,
        lower=lower * unit,
        upper=upper * unit,
        numbers={
            number_kind: value for number_kind, value in limits.items() if math.isfinite(value)
        }
        | {number_kind: next(iter(numbers.values())) for number_kind, numbers in stated.items()}
        | {
            number_kind: min(numbers.values())
            for number_kind, numbers in stated.items()
            if number_kind == "effort"
        },
        stated=stated,
        gains=_read_drive_gains(prim, axis_word, is_hinge, units) if has_axis else None,
        outside=bool(read_value(prim, "physics:excludeFromArticulation", "number")),
        mimic=_read_mimic(prim, is_hinge, units, paths),
    )


def _read_freedom(prim: Any) -> tuple[str, int, float, float]:
    """Return kind, axis index (0 to 2), and lower and upper limit of a joint in units of the file.

    Missing limits are infinite.
    """
    kind = _JOINT_KINDS.get(str(prim.GetTypeName()), FREE_JOINT)
    if kind not in (HINGE_JOINT, SLIDE_JOINT):
        return kind, 0, -math.inf, math.inf
    axis = AXIS_INDICES[read_axis(prim, "physics:axis", "X")]
    lower = read_number(prim, "physics:lowerLimit", -math.inf)
    return kind, axis, lower, read_number(prim, "physics:upperLimit", math.inf)


def _read_numbers(
    prim: Any,
    number_kind: str,
    statements: tuple[NumberAttribute, ...],
    axis_word: str,
    is_hinge: bool,
    units: StageUnits,
) -> dict[str, float]:
    """Return {attribute: finite number in SI units} of the stated attributes of a joint.

    ``axis_word`` is the word for the axis in the names of the attributes.
    """
    numbers = {}
    for statement in statements:
        name = statement.name.format(axis=axis_word)
        value = read_number(prim, name)
        if not math.isfinite(value) or not prim.GetAttribute(name).IsAuthored():
            continue
        if number_kind == "velocity":
            unit = units.length
        elif number_kind in ("effort", "friction"):
            unit = units.inertia if is_hinge else units.force
        else:
            unit = units.inertia if is_hinge else units.mass
        if is_hinge:
            if statement.per_angle:
                unit /= RADIANS_PER_DEGREE
            elif statement.angle:
                unit = RADIANS_PER_DEGREE
        numbers[name] = value * unit
    return numbers


def _read_drive_gains(
    prim: Any, axis_word: str, is_hinge: bool, units: StageUnits
) -> tuple[float, float] | None:
    """Return stiffness and damping of a joint's position drive [N m/rad, N m s/rad; N/m, N s/m].

    None without a force drive of positive stiffness.

    Raises:
        ModelError: If a gain is infinite or NaN.
    """
    prefix = f"drive:{axis_word}:physics"
    stiffness = read_number(prim, f"{prefix}:stiffness", 0.0)
    if (
        f"PhysicsDriveAPI:{axis_word}" not in prim.GetAppliedSchemas()
        or read_value(prim, f"{prefix}:type", "text") == "acceleration"
        or stiffness <= 0
    ):
        return None
    damping = read_number(prim, f"{prefix}:damping", 0.0)
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        if math.isinf(value):
            raise _make_number_error(prim, f"{prefix}:{name}", value)
    unit = units.inertia / RADIANS_PER_DEGREE if is_hinge else units.mass
    return stiffness * unit, damping * unit


def _read_mimic(
    prim: Any, is_hinge: bool, units: StageUnits, paths: Mapping[str, str]
) -> tuple[str, float, float] | None:
    """Return leader, multiplier and offset [rad, m] of a coupled joint; None if not coupled.

    ``paths`` is {path of a joint's prim: name of the joint}.
    """
    unit = RADIANS_PER_DEGREE if is_hinge else units.length
    for name in prim.GetAuthoredPropertyNames():
        if not name.endswith(("newton:mimicJoint", ":referenceJoint")):
            continue
        targets = prim.GetRelationship(name).GetTargets()
        leader = paths.get(str(targets[0])) if targets else None
        if leader is None:
            continue
        if name.startswith("newton:"):
            offset = read_number(prim, "newton:mimicCoef0", 0.0) * unit
            return leader, read_number(prim, "newton:mimicCoef1", 1.0), offset
        prefix = name.removesuffix(":referenceJoint")
        offset = -read_number(prim, f"{prefix}:offset", 0.0) * unit
        return leader, -read_number(prim, f"{prefix}:gearing", 0.0), offset
    return None


_SINGLE_PRECISION_RTOL: Final = 2.0**-24
"""Largest relative rounding error of a number in single precision. Bounds the rounding error of the
moments of inertia, which USD stores in single precision."""


class MassOrigin(StrEnum):
    """Origin of a body's mass properties in a USD file: stated, derived from shapes, or default."""

    STATED = "stated"
    """Mass, CoM and inertia are stated, or the mass is negative."""
    SHAPES = "shapes"
    """Mass, CoM or inertia is missing, and engines derive the missing properties from the collision
    shapes. A missing mass is derived from stated masses or densities of the shapes.
    """
    DEFAULT = "default"
    """The mass is stated, CoM or inertia is missing, and the body has no collision shapes. Engines
    use defaults: UsdPhysics the CoM (0, 0, 0), and the inertia of a ball of radius 10 cm.
    """
    WATER = "water"
    """The body has no stated mass, and the file states neither mass nor density for a shape.
    Engines use the density of water for such a shape.
    """
    UNKNOWN = "unknown"
    """The body has neither a mass nor collision shapes."""


@dataclass(frozen=True, eq=False)
class BodyMass:
    """Mass properties of a body in a USD file, and the origin of the mass.

    Attributes:
        inertial: Inertial; None if unknown.
        origin: Origin of the mass.
        lacks: Missing properties among ``"mass"``, ``"com"`` and ``"inertia"``; empty if ``origin``
            is ``STATED``.
    """

    inertial: Inertial | None
    origin: MassOrigin
    lacks: tuple[str, ...] = ()


def read_body_mass(
    body: Any, placement: PrimPlacement, shapes: Sequence[Any], units: StageUnits
) -> BodyMass:
    """Read mass, CoM and inertia of a body of a USD file.

    Args:
        body: Body prim.
        placement: Pose and scale of the prim.
        shapes: Prims of the collision shapes.
        units: Units of the stage.

    Returns:
        Mass properties, in SI units and the body frame. The inertial is None unless mass, CoM and
        inertia are all stated, or the mass is negative, which `audit` reports.

    Raises:
        ModelError: If an attribute has the wrong type, for example.
    """
    negative_mass = min(read_number(body, "physics:mass", 0.0), 0.0)
    mass = (_read_positive(body, "physics:mass") or negative_mass) * units.mass
    com = _read_vector(body, "physics:centerOfMass")
    moments = _read_vector(body, "physics:diagonalInertia")
    tensor = None
    rounding = 0.0
    if moments is not None and moments.any():
        axes = _read_principal_axes(body)
        tensor = axes @ np.diag(moments * units.inertia) @ axes.T
        rounding = float(np.abs(moments).max() * units.inertia * _SINGLE_PRECISION_RTOL)
    stated = {"mass": mass != 0, "com": com is not None, "inertia": tensor is not None}
    lacks = tuple(property_name for property_name, is_stated in stated.items() if not is_stated)
    if mass < 0 or not lacks:
        com = np.zeros(3) if com is None else com * placement.scale
        tensor = np.zeros((3, 3)) if tensor is None else tensor
        return BodyMass(Inertial(mass, com, tensor, True, rounding), MassOrigin.STATED)
    if not shapes:
        return BodyMass(None, MassOrigin.DEFAULT if mass else MassOrigin.UNKNOWN, lacks)
    has_water = not mass and not all(_has_shape_mass(body, shape) for shape in shapes)
    return BodyMass(None, MassOrigin.WATER if has_water else MassOrigin.SHAPES, lacks)


def _has_shape_mass(body: Any, shape: Any) -> bool:
    """Return True if the file determines the mass of a shape, by a mass or a density.

    The density may be that of the shape, of the shape's material, or of the body.
    """
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
    prims = (body, shape, *([material.GetPrim()] if material else ()))
    return _read_positive(shape, "physics:mass") > 0 or any(
        _read_positive(prim, "physics:density") > 0 for prim in prims
    )


def _read_positive(prim: Any, name: str) -> float:
    """Read a number attribute of a prim, in the unit of the file; 0 unless positive and finite."""
    value = read_number(prim, name, 0.0)
    return max(value, 0.0) if np.isfinite(value) else 0.0


def _read_vector(prim: Any, name: str) -> Array | None:
    """Return a vector attribute in the unit of the file, shape (3,); None if missing or not finite.

    The schema's default of a CoM is -inf.
    """
    value = read_value(prim, name, "vector")
    values = None if value is None else recover_decimals(value)
    return None if values is None or not np.isfinite(values).all() else values


def _read_principal_axes(prim: Any) -> Array:
    """Return the rotation from the principal axes of inertia to the body frame, shape (3, 3)."""
    value = read_value(prim, "physics:principalAxes", "quaternion")
    return np.eye(3) if value is None else make_rotation((value.GetReal(), *value.GetImaginary()))


@dataclass(frozen=True, eq=False)
class UsdModel(RobotModel):
    """Robot model of a USD file.

    Attributes:
        file: File.
        edges: {joint: joint data} of all enabled joints between different bodies, or a body and the
            world.
        body_masses: {body: mass properties and origin of the mass}.
        loops: Joints that close loops, or are excluded from the articulation.
        floating: True if no enabled joint of the articulation connects the base to the world.
        mount: Pose of the base in the world, z up [m].
        gravity: Gravity, shape (3,) [m/s^2], z up; None if not stated in the file.
    """

    file: UsdFile
    edges: Mapping[str, Edge]
    body_masses: Mapping[str, BodyMass]
    loops: tuple[Edge, ...]
    floating: bool
    mount: Pose
    gravity: Array | None

    @cached_property
    def has_free_base(self) -> bool:
        """Whether no enabled joint of the articulation connects the base to the world."""
        return self.floating

    def locate_parameter(self, attribute: JointAttribute) -> tuple[str, str | None]:
        """Return the name of a joint parameter for messages, and None as the child element.

        The name is the kind of the parameter, such as ``damping``, because attribute names differ
        between USD schemas.
        """
        return attribute.kind, None

    @property
    def in_degrees(self) -> bool:
        """Whether the file states angles in degrees. True, as in UsdPhysics."""
        return True

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """``{joint: (stiffness, damping)}`` of the servos [N m/rad, N m s/rad; slides N/m, N s/m].

        Joints without a force drive of positive stiffness are left out.
        """
        stated = {name: edge.gains for name, edge in self.edges.items()}
        return {name: gains for name, gains in stated.items() if gains is not None}


def read_usd_model(file: UsdFile) -> UsdModel:
    """Read the robot model of a USD file: tree of links and joints, masses, and gravity.

    Raises:
        ModelError: If the file is inconsistent: a sheared frame, or a joint that refers to a
            missing prim, for example.
    """
    from pxr import UsdGeom

    units, cache = read_units(file.stage), UsdGeom.XformCache()
    prims = {name: file.stage.GetPrimAtPath(path) for name, path in file.bodies.items()}
    placements = _read_placements(file, prims, units, cache)
    edges = {edge.name: edge for edge in _read_edges(file, placements, units, cache)}
    forest = _JointForest(list(prims), edges, _find_articulation_roots(file))
    base = forest.base
    poses, parents, loops = forest.compute_poses(placements)
    to_base = poses[base].inverse()
    weights = {
        name: read_body_mass(
            prim, placements[name], list(_list_collision_shapes(file, prim)), units
        )
        for name, prim in prims.items()
    }
    links = {}
    for name in forest.order:
        parent_edge = parents.get(name)
        links[name] = Link(
            name,
            None if parent_edge is None else parent_edge[0],
            to_base * poses[name],
            _make_link_joints(name, parent_edge, forest.find_world_edge(name), poses, to_base),
            weights[name].inertial,
            (),
        )
    return UsdModel(
        "usd",
        "body",
        base,
        links,
        file.notes,
        file,
        edges,
        weights,
        tuple(loops),
        forest.find_world_edge(base) is None,
        Pose(units.up @ poses[base].position, units.up @ poses[base].rotation),
        _read_gravity(file, units),
    )


def _read_placements(
    file: UsdFile, prims: Mapping[str, Any], units: StageUnits, cache: Any
) -> dict[str, PrimPlacement]:
    """Return {body: pose [m] and scale of the body in the axes of the stage} for prims of a stage.

    ``cache`` is USD's cache of transforms.

    Raises:
        ModelError: If a body is scaled unevenly, or its transform is not valid.
    """
    placements = {
        name: split_transform(file, prim, compute_world_matrix(file, prim, cache), units)
        for name, prim in prims.items()
    }
    for name, placement in placements.items():
        if np.ptp(placement.scale) > 1e-4 * placement.scale.max():
            message = diagnose(
                "usd-body-scaled-unevenly", scale=Vector(tuple(placement.scale), "1")
            )
            raise make_file_error(file.place("body", name), message)
    return placements


def _make_link_joints(
    name: str,
    parent_edge: tuple[str, Edge] | None,
    world_edge: Edge | None,
    poses: Mapping[str, Pose],
    to_base: Pose,
) -> tuple[Joint, ...]:
    """Create the joint of a link to its parent or to the world; none if fixed to the world.

    ``poses`` is {link: pose in the axes of the stage [m], at zero joint positions}; ``to_base``
    transforms from the axes of the stage to the base.
    """
    if parent_edge is not None:
        parent, edge = parent_edge
        return (_make_joint(edge, parent, name, to_base * poses[parent]),)
    if world_edge is None:
        return (_make_free_joint(name, to_base * poses[name]),)
    if world_edge.kind != FIXED_JOINT:
        return (_make_joint(world_edge, "", name, to_base),)
    return ()


def _read_edges(
    file: UsdFile, placements: Mapping[str, PrimPlacement], units: StageUnits, cache: Any
) -> Iterator[Edge]:
    """Yield the enabled joints between different bodies, with the joint frames in both bodies [m].

    The world counts as a body. ``cache`` is USD's cache of transforms.

    Raises:
        ModelError: If a joint refers to a prim that does not exist, for example.
    """
    body_names = {path: name for name, path in file.bodies.items()}
    paths = {path: name for name, path in file.joints.items()}
    for name, path in file.joints.items():
        prim = file.stage.GetPrimAtPath(path)
        if read_value(prim, "physics:jointEnabled", "number") is False:
            continue
        bodies, frames = [], []
        for side in (0, 1):
            targets = prim.GetRelationship(f"physics:body{side}").GetTargets()
            target = file.stage.GetPrimAtPath(targets[0]) if targets else None
            if targets and not target:
                message = diagnose("usd-joint-of-no-prim", end=f"body{side}", prim=str(targets[0]))
                raise make_file_error(Place(file.path, None, path), message)
            body, placement = (
                _find_body(target, body_names),
                PrimPlacement(Pose(), np.full(3, units.length)),
            )
            if target:
                matrix = compute_world_matrix(file, target, cache)
                placement = split_transform(file, target, matrix, units)
            position = read_value(prim, f"physics:localPos{side}", "point")
            rotation = read_value(prim, f"physics:localRot{side}", "quaternion")
            frame = placement.make_frame(position, rotation)
            if not body:
                frame = placement.pose * frame
            elif str(targets[0]) != file.bodies[body]:  # otherwise keep the written digits
                frame = placements[body].pose.inverse() * placement.pose * frame
            bodies.append(body)
            frames.append(frame)
        if bodies[0] != bodies[1]:
            bodies_and_frames = (bodies[0], bodies[1]), (frames[0], frames[1])
            yield read_edge(name, prim, *bodies_and_frames, units, paths)


def _find_body(prim: Any, body_names: Mapping[str, str]) -> str:
    """Return the body of a prim: itself or the nearest ancestor; "" for the world."""
    while prim:
        name = body_names.get(str(prim.GetPath()))
        if name is not None:
            return name
        prim = prim.GetParent()
    return ""


def _find_articulation_roots(file: UsdFile) -> set[str]:
    """Return the bodies that are marked as roots of articulations."""
    from pxr import UsdPhysics

    return {
        name
        for name, path in file.bodies.items()
        if file.stage.GetPrimAtPath(path).HasAPI(UsdPhysics.ArticulationRootAPI)
    }


class _JointForest:
    """Trees of the bodies and joints of a USD file.

    Attributes:
        order: Bodies, parents before children.
        base: Root of the largest tree; of equally large trees, a body that is marked as root.
    """

    def __init__(self, bodies: list[str], edges: Mapping[str, Edge], roots: set[str]) -> None:
        self._all_edges, self._roots = edges, roots
        self._adjacent_edges: dict[str, list[Edge]] = {name: [] for name in bodies}
        self._world_edges: dict[str, Edge] = {}
        self._num_parents: dict[str, int] = dict.fromkeys(bodies, 0)
        for edge in edges.values():
            for body_name in edge.bodies:
                if body_name and not edge.outside:
                    self._adjacent_edges[body_name].append(edge)
            if not all(edge.bodies) and not edge.outside:
                body = edge.bodies[0] or edge.bodies[1]
                if body not in self._world_edges or edge.kind == FIXED_JOINT:
                    self._world_edges[body] = edge
            if all(edge.bodies):
                self._num_parents[edge.bodies[1]] += 1
        self.order: list[str] = []
        self._parents: dict[str, tuple[str, Edge]] = {}
        self._sizes: dict[str, int] = {}
        self._used: set[str] = set()
        for root in sorted(bodies, key=self._rank_root):
            if root not in self.order:
                self._grow_tree(root)
        self.base = max(self._sizes, key=lambda root: (self._sizes[root], root in roots))

    def _rank_root(self, body: str) -> tuple[bool, bool, bool, int]:
        """Return the sort key of a body as root of the tree; the smallest key is preferred."""
        edges = self._adjacent_edges[body]
        num_children = sum(edge.bodies[0] == body for edge in edges)
        return (
            body not in self._roots,
            body not in self._world_edges,
            self._num_parents[body] > 0,
            -num_children,
        )

    def _grow_tree(self, root: str) -> None:
        """Add the tree of the bodies that are reachable from a root, breadth first."""
        tree = [root]
        if root in self._world_edges:
            self._used.add(self._world_edges[root].name)
        for body in tree:
            for edge in self._adjacent_edges[body]:
                neighbour = edge.bodies[1] if edge.bodies[0] == body else edge.bodies[0]
                if neighbour and neighbour not in tree and neighbour not in self.order:
                    self._parents[neighbour] = body, edge
                    self._used.add(edge.name)
                    tree.append(neighbour)
        self._sizes[root] = len(tree)
        self.order += tree

    def find_world_edge(self, body: str) -> Edge | None:
        """Return the articulation's joint between a body and the world; None if there is none."""
        return self._world_edges.get(body)

    def compute_poses(
        self, placements: Mapping[str, PrimPlacement]
    ) -> tuple[dict[str, Pose], dict[str, tuple[str, Edge]], list[Edge]]:
        """Compute the body poses at zero joint positions, and list the joints of the tree.

        Returns:
            {body: pose in the axes of the stage [m]}; {body with a parent: (parent, joint)}; joints
            that close loops or are excluded from the articulation.
        """
        poses: dict[str, Pose] = {}
        for body in self.order:
            parent_edge = self._parents.get(body)
            if parent_edge is not None:
                parent, edge = parent_edge
                parent_frame, body_frame = (
                    edge.frames if edge.bodies[0] == parent else edge.frames[::-1]
                )
                poses[body] = poses[parent] * parent_frame * body_frame.inverse()
            elif body in self._world_edges:
                edge = self._world_edges[body]
                parent_frame, body_frame = (
                    edge.frames if edge.bodies[1] == body else edge.frames[::-1]
                )
                poses[body] = parent_frame * body_frame.inverse()
            else:
                poses[body] = placements[body].pose
        loops = [edge for edge in self._all_edges.values() if edge.name not in self._used]
        return poses, self._parents, loops


def _make_joint(edge: Edge, parent: str, child: str, pose: Pose) -> Joint:
    """Create a joint in the base frame, from the pose of the parent in the base frame.

    A joint that is defined from child to parent rotates in the opposite direction.
    """
    is_forward = edge.bodies[0] == parent
    frame = pose * (edge.frames[0] if is_forward else edge.frames[1])
    unit_axis = np.eye(3)[edge.axis]
    has_axis = edge.kind in (HINGE_JOINT, SLIDE_JOINT)
    axis = frame.rotation @ unit_axis * (1.0 if is_forward else -1.0) if has_axis else np.zeros(3)
    return Joint(
        name=edge.name,
        kind=edge.kind,
        parent=parent or "world",
        child=child,
        position=frame.position,
        axis=axis,
        raw_axis=unit_axis,
        stated=edge.numbers,
        lower=edge.lower,
        upper=edge.upper,
        effort=edge.numbers.get("effort", math.inf),
    )


def _make_free_joint(body: str, pose: Pose) -> Joint:
    """Create the free joint between the world and a body; ``pose`` [m] is the pose of the body."""
    zeros, infinite = np.zeros(3), (-math.inf, math.inf, math.inf)
    return Joint(f"({body})", FREE_JOINT, "world", body, pose.position, zeros, zeros, {}, *infinite)


def _read_gravity(file: UsdFile, units: StageUnits) -> Array | None:
    """Return the gravity in a frame with z up, shape (3,) [m/s^2]; None if not stated."""
    from pxr import Usd, UsdPhysics

    for prim in Usd.PrimRange(file.stage.GetPseudoRoot()):
        if not prim.IsA(UsdPhysics.Scene):
            continue
        magnitude = read_number(prim, "physics:gravityMagnitude")
        direction = np.array(read_value(prim, "physics:gravityDirection", "point"), dtype=float)
        if not np.isfinite(magnitude) or magnitude < 0:
            continue
        if not direction.any():
            direction = units.up.T @ np.array([0.0, 0.0, -1.0])
        gravity: Array = units.up @ direction / np.linalg.norm(direction) * magnitude * units.length
        return gravity
    return None


SCALE_ATOL: Final = 1e-6
"""Deviation of a scale from 1 below which the scale is set to 1: orientations are in single
precision. Chosen, not tuned.
"""


@dataclass(frozen=True)
class StageUnits:
    """Factors from the units of a USD stage to SI units, and rotation to an upward z axis.

    Attributes:
        length: Length unit [m].
        mass: Mass unit [kg].
        up: Rotation matrix, shape (3, 3), that maps the stage's vertical axis to z.
    """

    length: float
    mass: float
    up: Array

    @property
    def force(self) -> float:
        """Unit of force of the USD stage [N]: mass unit times length unit per second^2."""
        return self.mass * self.length

    @property
    def inertia(self) -> float:
        """Unit of rotational inertia of the stage in kg m^2, and also of torque in N m."""
        return self.mass * self.length**2


def read_units(stage: Any) -> StageUnits:
    """Return the units and the up axis of a USD stage.

    Units that the stage does not state have USD's defaults, centimetre and kilogram.
    """
    from pxr import UsdGeom, UsdPhysics

    y_up_rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return StageUnits(
        float(UsdGeom.GetStageMetersPerUnit(stage)),
        float(UsdPhysics.GetStageKilogramsPerUnit(stage)),
        y_up_rotation if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(3),
    )


@dataclass(frozen=True, eq=False)
class PrimPlacement:
    """Pose and scale of a prim of a USD stage.

    Attributes:
        pose: Pose in the stage's axes [m].
        scale: Factors from the prim's lengths in the file to metres, shape (3,) [m].
    """

    pose: Pose
    scale: Array

    def make_frame(self, position: Any, rotation: Any) -> Pose:
        """Convert the position and rotation of a joint frame to a pose relative to the prim [m].

        Args:
            position: Position in the file; multiplied by ``scale`` to be in metres. None for 0.
            rotation: Quaternion in the file; None for no rotation.
        """
        offset = np.zeros(3) if position is None else recover_decimals(position) * self.scale
        if rotation is None:
            return Pose(offset)
        return Pose(offset, make_rotation((rotation.GetReal(), *rotation.GetImaginary())))


def read_value(prim: Any, name: str, kind: str) -> Any:
    """Return the value of an attribute as the Python object of pxr; None if there is no value.

    Args:
        prim: Prim.
        name: Attribute name.
        kind: Required kind: ``"number"`` (bool, int or float), ``"vector"`` (Gf.Vec3, components
            may be infinite), ``"point"`` (Gf.Vec3 with finite components), ``"quaternion"``
            (Gf.Quat with finite components), ``"text"`` (str), or ``"list"`` (Vt array or list).

    Raises:
        ModelError: If the value is not of this kind; a file may declare any type.
    """
    value = prim.GetAttribute(name).Get()
    has_kind = (
        value is None
        or {
            "number": isinstance(value, bool | int | float),
            "vector": hasattr(value, "GetNormalized") and np.size(value) == 3,
            "point": hasattr(value, "GetNormalized")
            and np.size(value) == 3
            and _all_finite(*value),
            "quaternion": hasattr(value, "GetImaginary")
            and _all_finite(value.GetReal(), *value.GetImaginary()),
            "text": isinstance(value, str),
            "list": type(value).__name__.endswith(("Array", "list")),
        }[kind]
    )
    if not has_kind:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=type(value).__name__)
        raise make_file_error(Place(file, None, str(prim.GetPath())), message)
    return value


def read_number(prim: Any, name: str, default: float = math.nan) -> float:
    """Read the number of an attribute, in the unit of the file; ``default`` without a value.

    Raises:
        ModelError: If the value is no number, or is NaN.
    """
    value = read_value(prim, name, "number")
    if value is None:
        return default
    if math.isnan(value):
        raise _make_number_error(prim, name, value)
    return float(recover_decimals(value))


def _make_number_error(prim: Any, name: str, value: float) -> ModelError:
    """Return the error that an attribute of a prim is not finite, or NaN."""
    file = Path(prim.GetStage().GetRootLayer().realPath)
    message = diagnose("usd-number-not-valid", attribute=name, value=f"{value:g}")
    return make_file_error(Place(file, None, str(prim.GetPath())), message)


def _all_finite(*values: float) -> bool:
    """Return True if all values are finite."""
    return bool(np.isfinite(values).all())


AXIS_INDICES: Final = {"X": 0, "Y": 1, "Z": 2}
"""{name of an axis: index}."""


def read_axis(prim: Any, name: str, default: str) -> str:
    """Read the axis that an attribute of a prim names: X, Y or Z.

    Raises:
        ModelError: If the value is not allowed.
    """
    axis = str(read_value(prim, name, "text") or default)
    if axis not in AXIS_INDICES:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=axis)
        raise make_file_error(Place(file, None, str(prim.GetPath())), message)
    return axis


def recover_decimals(value: Any) -> Array:
    """Replace single-precision numbers by the decimals that an author probably typed.

    A typed 0.18 is stored in single precision as 0.18000000715. The result is the shortest decimal
    that rounds to the single-precision number. Other numbers are unchanged.
    """
    values = np.array(value, dtype=float)
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    decimals = np.array([float(str(number)) for number in single.ravel()]).reshape(values.shape)
    return np.where(single == values, decimals, values)


def make_rotation(quaternion: Any) -> Array:
    """Convert a quaternion (w, x, y, z) to a rotation, shape (3, 3); the identity for zeros."""
    values = np.array(quaternion, dtype=float)
    length = float(np.linalg.norm(values))
    return np.eye(3) if length == 0 else rotation_from_quaternion(values / length)


def compute_world_matrix(file: UsdFile, prim: Any, cache: Any) -> Any:
    """Compute the transform of a prim to the world of the stage, a USD matrix for row vectors.

    Raises:
        ModelError: If an operation of the transform has no value.
    """
    from pxr import Tf

    try:
        return cache.GetLocalToWorldTransform(prim)
    except Tf.ErrorException as error:
        message = diagnose("usd-transform-without-value")
        raise make_file_error(Place(file.path, None, str(prim.GetPath())), message) from error


def split_transform(file: UsdFile, prim: Any, matrix: Any, units: StageUnits) -> PrimPlacement:
    """Split the transform of a prim into a pose and a scale.

    Raises:
        ModelError: If the transform is sheared, mirrored or singular.
    """
    transform = np.array(matrix).T
    scale = np.linalg.norm(transform[:3, :3], axis=0)
    rotation = transform[:3, :3] / np.where(scale > 0, scale, 1.0)
    if not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
        message = diagnose("usd-frame-sheared", scale=Vector(tuple(scale), "1"))
        raise make_file_error(Place(file.path, None, str(prim.GetPath())), message)
    scale = np.where(np.abs(scale - 1.0) < SCALE_ATOL, 1.0, scale)
    left, _, right = np.linalg.svd(rotation)
    return PrimPlacement(Pose(transform[:3, 3] * units.length, left @ right), scale * units.length)


def _list_collision_shapes(file: UsdFile, body: Any) -> Iterator[Any]:
    """Yield the prims of a body's enabled collision shapes."""
    from pxr import UsdGeom, UsdPhysics

    for prim in list_body_prims(file, body):
        is_shape = prim.IsA(UsdGeom.Gprim) and prim.HasAPI(UsdPhysics.CollisionAPI)
        enabled = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
        if is_shape and enabled.Get() is not False:
            yield prim


def list_body_prims(file: UsdFile, body: Any) -> Iterator[Any]:
    """Yield the prims of a body: the body and all descendants, without other bodies."""
    from pxr import Usd

    other_bodies = set(file.bodies.values()) - {str(body.GetPath())}
    prims = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if str(prim.GetPath()) in other_bodies:
            prims.PruneChildren()
        else:
            yield prim
