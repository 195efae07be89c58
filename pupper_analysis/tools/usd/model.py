"""Reads the model of a USD file: bodies and joints of UsdPhysics, made a tree.

Where bodies are follows from the frames of the joints, as engines with reduced coordinates have it;
the transforms of the prims are a pose of the robot, at whatever angles.

A mass states less than it seems to: where the com or the inertia is not stated, too, engines take
those of the shapes that touch; and they fill a body of which nothing is stated with water. What
such a body weighs is not known here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.models.attributes import JointAttribute
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.shapes import Array, Pose
from pupper_analysis.models.stated.model import (
    BALL,
    FIXED,
    FREE,
    HINGE,
    SLIDE,
    Inertial,
    Joint,
    Link,
    RobotModel,
)
from pupper_analysis.tools.usd.file import UsdFile

DEGREE: Final = math.pi / 180

_KINDS: Final = {
    "PhysicsRevoluteJoint": HINGE,
    "PhysicsPrismaticJoint": SLIDE,
    "PhysicsSphericalJoint": BALL,
    "PhysicsFixedJoint": FIXED,
}


@dataclass(frozen=True)
class Statement:
    """An attribute that states a number of a joint, in the schema of an engine.

    Attributes:
        name: Its name; ``{axis}`` is ``angular`` or ``linear``.
        per_angle: Whether it is per degree, of a hinge.
        angle: Whether it is in degrees (per second), of a hinge.
    """

    name: str
    per_angle: bool = False
    angle: bool = False


STATEMENTS: Final[Mapping[str, tuple[Statement, ...]]] = {
    "damping": (
        Statement("newton:damping", per_angle=True),
        Statement("mjc:damping"),
        Statement("physxJointAxis:{axis}:viscousFrictionCoefficient", per_angle=True),
    ),
    "friction": (
        Statement("newton:friction"),
        Statement("mjc:frictionloss"),
        Statement("physxJointAxis:{axis}:staticFrictionEffort"),
    ),
    "armature": (
        Statement("newton:armature"),
        Statement("mjc:armature"),
        Statement("physxJointAxis:{axis}:armature"),
        Statement("physxJoint:armature"),
    ),
    "effort": (
        Statement("newton:effortLimit"),
        Statement("drive:{axis}:physics:maxForce"),
        Statement("mjc:actuatorfrcrange:max"),
    ),
    "velocity": (
        Statement("newton:velocityLimit", angle=True),
        Statement("physxJointAxis:{axis}:maxJointVelocity", angle=True),
        Statement("physxJoint:maxJointVelocity", angle=True),
    ),
    "spring": (Statement("mjc:stiffness"),),
}
"""{kind, as in `models.attributes`: what states it}; the first that does is taken, and of efforts
the least, as each of them limits."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A joint between two bodies of a USD.

    Attributes:
        name: Its name.
        prim: Its `pxr.Usd.Prim`.
        kind: As of `model.Joint`.
        bodies: Names of both; "" for the world.
        frames: Its frame in each of them, in m.
        axis: 0 to 2, in its frame.
        lower: rad or m; -inf if unlimited.
        upper: rad or m.
        numbers: {kind: what is stated}; what is not there is not known.
        stated: {kind: {attribute: what it states}}, in the same units, of all that do.
        gains: Stiffness and damping of the drive that holds it (N m/rad, N m s/rad; N/m, N s/m);
            None where nothing holds it, or holds it by inertia.
        outside: Whether it is to be left out of the tree.
        mimic: The joint that it follows as q = multiplier q' + offset; None if it follows none.
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


def edge_of(
    name: str,
    prim: Any,
    bodies: tuple[str, str],
    frames: tuple[Pose, Pose],
    units: StageUnits,
    paths: Mapping[str, str],
) -> Edge:
    """Reads a joint, between bodies that have been found.

    Args:
        name: Its name.
        prim: Its prim.
        bodies: Names of both; "" for the world.
        frames: Its frame in each.
        units: Of the stage.
        paths: {path of a joint's prim: its name}.
    """
    kind, axis, lower, upper = _freedom(prim)
    turns, moves = kind == HINGE, kind in (HINGE, SLIDE)
    unit = DEGREE if turns else units.length
    word = "angular" if turns else "linear"
    ends = {"lower limit": lower * unit, "upper limit": upper * unit}
    stated = {
        what: found
        for what, statements in STATEMENTS.items()
        if moves and (found := _stated(prim, what, statements, word, turns, units))
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
        numbers={what: value for what, value in ends.items() if math.isfinite(value)}
        | {what: next(iter(found.values())) for what, found in stated.items()}
        | {what: min(found.values()) for what, found in stated.items() if what == "effort"},
        stated=stated,
        gains=_gains(prim, word, turns, units) if moves else None,
        outside=bool(value_of(prim, "physics:excludeFromArticulation", "number")),
        mimic=_mimic(prim, turns, units, paths),
    )


def _freedom(prim: Any) -> tuple[str, int, float, float]:
    """Returns a joint's kind, its axis, and its limits as they are written.

    A general joint counts as free: such are refused where joints are compared.
    """
    kind = _KINDS.get(str(prim.GetTypeName()), FREE)
    if kind not in (HINGE, SLIDE):
        return kind, 0, -math.inf, math.inf
    axis = AXES[axis_of(prim, "physics:axis", "X")]
    lower = number_of(prim, "physics:lowerLimit", -math.inf)
    return kind, axis, lower, number_of(prim, "physics:upperLimit", math.inf)


def _stated(
    prim: Any,
    what: str,
    statements: tuple[Statement, ...],
    word: str,
    turns: bool,
    units: StageUnits,
) -> dict[str, float]:
    """Returns all that states a number, in SI units."""
    found = {}
    for statement in statements:
        name = statement.name.format(axis=word)
        value = number_of(prim, name)
        if not math.isfinite(value) or not prim.GetAttribute(name).IsAuthored():
            continue
        if what == "velocity":
            unit = units.length
        elif what in ("effort", "friction"):
            unit = units.inertia if turns else units.force
        else:
            unit = units.inertia if turns else units.mass
        if turns:
            if statement.per_angle:
                unit /= DEGREE
            elif statement.angle:
                unit = DEGREE
        found[name] = value * unit
    return found


def _gains(prim: Any, word: str, turns: bool, units: StageUnits) -> tuple[float, float] | None:
    """Returns stiffness and damping of a joint's drive; see `Edge.gains`."""
    start = f"drive:{word}:physics"
    stiffness = number_of(prim, f"{start}:stiffness", 0.0)
    if (
        f"PhysicsDriveAPI:{word}" not in prim.GetAppliedSchemas()
        or value_of(prim, f"{start}:type", "text") == "acceleration"
        or stiffness <= 0
    ):
        return None
    unit = units.inertia / DEGREE if turns else units.mass
    return stiffness * unit, number_of(prim, f"{start}:damping", 0.0) * unit


def _mimic(
    prim: Any, turns: bool, units: StageUnits, paths: Mapping[str, str]
) -> tuple[str, float, float] | None:
    """Returns the joint that one follows, as Newton's or PhysX's schema states it."""
    unit = DEGREE if turns else units.length
    for name in prim.GetAuthoredPropertyNames():
        if not name.endswith(("newton:mimicJoint", ":referenceJoint")):
            continue
        targets = prim.GetRelationship(name).GetTargets()
        leader = paths.get(str(targets[0])) if targets else None
        if leader is None:
            continue
        if name.startswith("newton:"):
            offset = number_of(prim, "newton:mimicCoef0", 0.0) * unit
            return leader, number_of(prim, "newton:mimicCoef1", 1.0), offset
        start = name.removesuffix(":referenceJoint")
        offset = -number_of(prim, f"{start}:offset", 0.0) * unit
        return leader, -number_of(prim, f"{start}:gearing", 0.0), offset
    return None


_SINGLE: Final = 2.0**-24
"""Half a unit of the last digit of a number of 1 in single precision."""


class Origin(StrEnum):
    """Where a body's mass comes from."""

    STATED = "stated"
    """The body says it, and where it is."""
    SHAPES = "shapes"
    """Some of mass, com and inertia is not stated: engines take that from its shapes."""
    WATER = "water"
    """Of a shape at least nothing is said: it has the density of water."""
    UNKNOWN = "unknown"
    """Neither it nor a shape that touches says anything."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """What a body weighs.

    Attributes:
        inertial: None if that is not known.
        origin: Of its mass.
        lacks: What of ``"mass"``, ``"com"`` and ``"inertia"`` it does not state.
    """

    inertial: Inertial | None
    origin: Origin
    lacks: tuple[str, ...] = ()


def weigh_body(body: Any, place: Placed, shapes: Sequence[Any], units: StageUnits) -> Weighed:
    """Returns what a body weighs.

    Args:
        body: Its prim.
        place: Where it is.
        shapes: The prims of its shapes that touch.
        units: Of the stage.
    """
    below = min(number_of(body, "physics:mass", 0.0), 0.0)
    mass = (_positive(body, "physics:mass") or below) * units.mass
    com = _vector(body, "physics:centerOfMass")
    moments = _vector(body, "physics:diagonalInertia")
    tensor = None
    rounding = 0.0
    if moments is not None and moments.any():
        turn = _axes(body)
        tensor = turn @ np.diag(moments * units.inertia) @ turn.T
        rounding = float(np.abs(moments).max() * units.inertia * _SINGLE)
    stated = {"mass": mass != 0, "com": com is not None, "inertia": tensor is not None}
    lacks = tuple(what for what, is_there in stated.items() if not is_there)
    if mass < 0 or not lacks:
        com = np.zeros(3) if com is None else com * place.scale
        tensor = np.zeros((3, 3)) if tensor is None else tensor
        return Weighed(Inertial(mass, com, tensor, True, rounding), Origin.STATED)
    if not mass and not shapes:
        return Weighed(None, Origin.UNKNOWN, lacks)
    water = not mass and not all(_is_weighed(body, shape) for shape in shapes)
    return Weighed(None, Origin.WATER if water else Origin.SHAPES, lacks)


def _is_weighed(body: Any, shape: Any) -> bool:
    """Says whether something states a shape's mass or density."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
    prims = (body, shape, *([material.GetPrim()] if material else ()))
    return _positive(shape, "physics:mass") > 0 or any(
        _positive(prim, "physics:density") > 0 for prim in prims
    )


def _positive(prim: Any, name: str) -> float:
    """Returns a number that states something if it is above 0; else 0."""
    value = number_of(prim, name, 0.0)
    return max(value, 0.0) if np.isfinite(value) else 0.0


def _vector(prim: Any, name: str) -> Array | None:
    """Returns three numbers; None where they are not stated (-inf is the schema's default)."""
    value = value_of(prim, name, "vector")
    values = None if value is None else shortest_decimals(value)
    return None if values is None or not np.isfinite(values).all() else values


def _axes(prim: Any) -> Array:
    """Returns the rotation (3, 3) of the principal axes: the body's, where they are not stated."""
    value = value_of(prim, "physics:principalAxes", "quaternion")
    return np.eye(3) if value is None else rotation_of((value.GetReal(), *value.GetImaginary()))


@dataclass(frozen=True, eq=False)
class UsdModel(RobotModel):
    """A model in a USD.

    Attributes:
        file: The file.
        edges: {joint: what the file states of it}, all that are switched on.
        weights: {body: what it weighs, and where that comes from}.
        loops: The joints that close loops, or are to be left out of the tree.
        floating: Whether the base can move.
        mount: Where the base is, in the world, z up (m).
        gravity: (3,) m/s^2, z up; None where the file leaves it to the engine.
    """

    file: UsdFile
    edges: Mapping[str, Edge]
    weights: Mapping[str, Weighed]
    loops: tuple[Edge, ...]
    floating: bool
    mount: Pose
    gravity: Array | None

    def words(self, attribute: JointAttribute) -> tuple[str, str | None]:
        """Returns what a joint's number is: several schemas have several names for it."""
        return attribute.kind, None

    @property
    def in_degrees(self) -> bool:
        """Whether the file states angles in degrees: UsdPhysics does."""
        return True

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """{joint: stiffness and damping of its servo}, see `Edge.gains`."""
        stated = {name: edge.gains for name, edge in self.edges.items()}
        return {name: gains for name, gains in stated.items() if gains is not None}


def read_usd_model(file: UsdFile) -> UsdModel:
    """Returns the model of a USD.

    Raises:
        ModelError: If the frame of a body or a joint is sheared or mirrored.
    """
    from pxr import UsdGeom

    units, cache = units_of(file.stage), UsdGeom.XformCache()
    prims = {name: file.stage.GetPrimAtPath(path) for name, path in file.bodies.items()}
    places = {
        name: split_transform(file, prim, world_matrix(file, prim, cache), units)
        for name, prim in prims.items()
    }
    for name, place in places.items():
        if np.ptp(place.scale) > 1e-4 * place.scale.max():
            message = diagnose("usd-body-scaled-unevenly", scale=Vector(tuple(place.scale), "1"))
            raise make_file_error(file.place("body", name), message)
    edges = {edge.name: edge for edge in _edges(file, places, units, cache)}
    trees = _Forest(list(prims), edges, _article_roots(file))
    base = trees.base
    poses, parents, loops = trees.poses(places)
    to_base = poses[base].inverse()
    weights = {
        name: weigh_body(prim, places[name], list(_touching(file, prim)), units)
        for name, prim in prims.items()
    }
    links = {}
    for name in trees.order:
        above = parents.get(name)
        parent = above[0] if above is not None else None
        hold = trees.hold(name)
        joints: tuple[Joint, ...] = ()
        if above is not None:
            joints = (_joint(above[1], above[0], name, to_base * poses[above[0]]),)
        elif hold is None:
            joints = (_free(name, to_base * poses[name]),)
        elif hold.kind != FIXED:
            joints = (_joint(hold, "", name, to_base),)
        links[name] = Link(
            name,
            parent,
            to_base * poses[name],
            joints,
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
        trees.hold(base) is None,
        Pose(units.up @ poses[base].position, units.up @ poses[base].rotation),
        _gravity(file, units),
    )


def _edges(
    file: UsdFile, places: Mapping[str, Placed], units: StageUnits, cache: Any
) -> Iterator[Edge]:
    """Yields the joints that are switched on, with what they join."""
    names = {path: name for name, path in file.bodies.items()}
    paths = {path: name for name, path in file.joints.items()}
    for name, path in file.joints.items():
        prim = file.stage.GetPrimAtPath(path)
        if value_of(prim, "physics:jointEnabled", "number") is False:
            continue
        bodies, frames = [], []
        for end in (0, 1):
            targets = prim.GetRelationship(f"physics:body{end}").GetTargets()
            target = file.stage.GetPrimAtPath(targets[0]) if targets else None
            if targets and not target:
                message = diagnose("usd-joint-of-no-prim", end=f"body{end}", prim=str(targets[0]))
                raise make_file_error(Place(file.path, None, path), message)
            body, place = _carrier(target, names), Placed(Pose(), np.full(3, units.length))
            if target:
                matrix = world_matrix(file, target, cache)
                place = split_transform(file, target, matrix, units)
            position = value_of(prim, f"physics:localPos{end}", "point")
            rotation = value_of(prim, f"physics:localRot{end}", "quaternion")
            frame = place.frame(position, rotation)
            if not body:
                frame = place.pose * frame
            elif str(targets[0]) != file.bodies[body]:  # else as it is written, with all its digits
                frame = places[body].pose.inverse() * place.pose * frame
            bodies.append(body)
            frames.append(frame)
        if bodies[0] != bodies[1]:
            ends = (bodies[0], bodies[1]), (frames[0], frames[1])
            yield edge_of(name, prim, *ends, units, paths)


def _carrier(target: Any, names: Mapping[str, str]) -> str:
    """Returns the body that a prim is of: itself, or the nearest above it; "" of the world."""
    while target:
        name = names.get(str(target.GetPath()))
        if name is not None:
            return name
        target = target.GetParent()
    return ""


def _article_roots(file: UsdFile) -> set[str]:
    """Returns the bodies that are said to be roots of articulations."""
    from pxr import UsdPhysics

    return {
        name
        for name, path in file.bodies.items()
        if file.stage.GetPrimAtPath(path).HasAPI(UsdPhysics.ArticulationRootAPI)
    }


class _Forest:
    """Bodies and joints as trees, each from its root: what a tree leaves over closes a loop."""

    def __init__(self, bodies: list[str], edges: Mapping[str, Edge], roots: set[str]) -> None:
        self._edges, self._roots = edges, roots
        self._at: dict[str, list[Edge]] = {name: [] for name in bodies}
        self._held: dict[str, Edge] = {}
        self._below: dict[str, int] = dict.fromkeys(bodies, 0)
        for edge in edges.values():
            for end in edge.bodies:
                if end and not edge.outside:
                    self._at[end].append(edge)
            if not all(edge.bodies) and not edge.outside:
                body = edge.bodies[0] or edge.bodies[1]
                if body not in self._held or edge.kind == FIXED:
                    self._held[body] = edge
            if all(edge.bodies):
                self._below[edge.bodies[1]] += 1
        self.order: list[str] = []
        self._parents: dict[str, tuple[str, Edge]] = {}
        self._sizes: dict[str, int] = {}
        self._used: set[str] = {edge.name for edge in self._held.values()}
        for root in sorted(bodies, key=self._rank):
            if root not in self.order:
                self._grow(root)
        self.base = max(self._sizes, key=lambda root: (self._sizes[root], root in roots))

    def _rank(self, body: str) -> tuple[bool, bool, bool, int]:
        """Orders roots: what is called one, is held, has none above it, carries most."""
        edges = self._at[body]
        carried = sum(edge.bodies[0] == body for edge in edges)
        return body not in self._roots, body not in self._held, self._below[body] > 0, -carried

    def _grow(self, root: str) -> None:
        tree = [root]
        for body in tree:
            for edge in self._at[body]:
                other = edge.bodies[1] if edge.bodies[0] == body else edge.bodies[0]
                if other and other not in tree and other not in self.order:
                    self._parents[other] = body, edge
                    self._used.add(edge.name)
                    tree.append(other)
        self._sizes[root] = len(tree)
        self.order += tree

    def hold(self, body: str) -> Edge | None:
        """Returns the joint between a root and the world; None if it is free."""
        return self._held.get(body)

    def poses(
        self, places: Mapping[str, Placed]
    ) -> tuple[dict[str, Pose], dict[str, tuple[str, Edge]], list[Edge]]:
        """Returns bodies' poses in the stage at zero angles, {body: parent, joint}, and loops."""
        poses: dict[str, Pose] = {}
        for body in self.order:
            above = self._parents.get(body)
            if above is not None:
                parent, edge = above
                one, two = edge.frames if edge.bodies[0] == parent else edge.frames[::-1]
                poses[body] = poses[parent] * one * two.inverse()
            elif body in self._held:
                edge = self._held[body]
                one, two = edge.frames if edge.bodies[1] == body else edge.frames[::-1]
                poses[body] = one * two.inverse()
            else:
                poses[body] = places[body].pose
        loops = [edge for edge in self._edges.values() if edge.name not in self._used]
        return poses, self._parents, loops


def _joint(edge: Edge, parent: str, child: str, pose: Pose) -> Joint:
    """Returns a joint in the base's frame, of the pose of the parent there.

    One that is written from the child to the parent turns the other way about its axis.
    """
    forward = edge.bodies[0] == parent
    frame = pose * (edge.frames[0] if forward else edge.frames[1])
    raw = np.eye(3)[edge.axis]
    moves = edge.kind in (HINGE, SLIDE)
    axis = frame.rotation @ raw * (1.0 if forward else -1.0) if moves else np.zeros(3)
    return Joint(
        name=edge.name,
        kind=edge.kind,
        parent=parent or "world",
        child=child,
        position=frame.position,
        axis=axis,
        raw_axis=raw,
        stated=edge.numbers,
        lower=edge.lower,
        upper=edge.upper,
        effort=edge.numbers.get("effort", math.inf),
    )


def _free(body: str, pose: Pose) -> Joint:
    """Returns the joint of a body that nothing holds."""
    none, infinite = np.zeros(3), (-math.inf, math.inf, math.inf)
    return Joint(f"({body})", FREE, "world", body, pose.position, none, none, {}, *infinite)


def _gravity(file: UsdFile, units: StageUnits) -> Array | None:
    """Returns the gravity of the first scene that states one, z up; None where none does."""
    from pxr import Usd, UsdPhysics

    for prim in Usd.PrimRange(file.stage.GetPseudoRoot()):
        if not prim.IsA(UsdPhysics.Scene):
            continue
        size = number_of(prim, "physics:gravityMagnitude")
        way = np.array(value_of(prim, "physics:gravityDirection", "point"), dtype=float)
        if not np.isfinite(size) or size < 0:
            continue
        if not way.any():
            way = units.up.T @ np.array([0.0, 0.0, -1.0])
        found: Array = units.up @ way / np.linalg.norm(way) * size * units.length
        return found
    return None


SCALE_ROUNDING: Final = 1e-6
"""A scale so near to 1 is 1: orientations are written in single precision."""


@dataclass(frozen=True)
class StageUnits:
    """What a stage's numbers are in.

    Attributes:
        length: m.
        mass: kg.
        up: The rotation (3, 3) that turns its vertical axis to z.
    """

    length: float
    mass: float
    up: Array

    @property
    def force(self) -> float:
        """N; seconds are seconds."""
        return self.mass * self.length

    @property
    def inertia(self) -> float:
        """Kg m^2; so are torques in N m."""
        return self.mass * self.length**2


def units_of(stage: Any) -> StageUnits:
    """Returns a stage's units; a robot's stage says that they are metres, or it is in cm."""
    from pxr import UsdGeom, UsdPhysics

    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return StageUnits(
        float(UsdGeom.GetStageMetersPerUnit(stage)),
        float(UsdPhysics.GetStageKilogramsPerUnit(stage)),
        turn if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(3),
    )


@dataclass(frozen=True, eq=False)
class Placed:
    """Where a prim is in the world of its stage.

    Attributes:
        pose: In m, in the stage's axes.
        scale: (3,) What its own lengths are multiplied by, in m.
    """

    pose: Pose
    scale: Array

    def frame(self, position: Any, rotation: Any) -> Pose:
        """Returns a frame in the prim's, of a position in its lengths and a quaternion."""
        place = np.zeros(3) if position is None else shortest_decimals(position) * self.scale
        if rotation is None:
            return Pose(place)
        return Pose(place, rotation_of((rotation.GetReal(), *rotation.GetImaginary())))


def value_of(prim: Any, name: str, kind: str) -> Any:
    """Returns what an attribute states; None where nothing does.

    Args:
        prim: Its prim.
        name: Its name.
        kind: ``"number"``, ``"vector"`` of three, ``"point"``, which is a finite one,
            ``"quaternion"``, likewise, ``"text"`` or ``"list"``.

    Raises:
        ModelError: If it is of another type: a file may declare any.
    """
    value = prim.GetAttribute(name).Get()
    fits = (
        value is None
        or {
            "number": isinstance(value, bool | int | float),
            "vector": hasattr(value, "GetNormalized") and np.size(value) == 3,
            "point": hasattr(value, "GetNormalized") and np.size(value) == 3 and _finite(*value),
            "quaternion": hasattr(value, "GetImaginary")
            and _finite(value.GetReal(), *value.GetImaginary()),
            "text": isinstance(value, str),
            "list": type(value).__name__.endswith(("Array", "list")),
        }[kind]
    )
    if not fits:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=type(value).__name__)
        raise make_file_error(Place(file, None, str(prim.GetPath())), message)
    return value


def number_of(prim: Any, name: str, usual: float = math.nan) -> float:
    """Returns a number that an attribute states, as it is written; the usual one where none is."""
    value = value_of(prim, name, "number")
    return usual if value is None else float(shortest_decimals(value))


def _finite(*values: float) -> bool:
    return bool(np.isfinite(values).all())


AXES: Final = {"X": 0, "Y": 1, "Z": 2}


def axis_of(prim: Any, name: str, usual: str) -> str:
    """Returns one of X, Y and Z.

    Raises:
        ModelError: If it is none of them.
    """
    axis = str(value_of(prim, name, "text") or usual)
    if axis not in AXES:
        file = Path(prim.GetStage().GetRootLayer().realPath)
        message = diagnose("usd-value-of-other-type", attribute=name, kind=axis)
        raise make_file_error(Place(file, None, str(prim.GetPath())), message)
    return axis


def shortest_decimals(value: Any) -> Array:
    """Returns numbers as they are written: of one in single precision its shortest decimal.

    A file's 0.18 is read as 0.18000000715. Nothing else has that as its nearest number in single
    precision and as few digits.
    """
    values = np.array(value, dtype=float)
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    exact = np.array([float(str(one)) for one in single.ravel()]).reshape(values.shape)
    return np.where(single == values, exact, values)


def rotation_of(quaternion: Any) -> Array:
    """Returns the rotation (3, 3) of a quaternion (w, x, y, z) in single precision; 0 is none."""
    values = np.array(quaternion, dtype=float)
    length = float(np.linalg.norm(values))
    return np.eye(3) if length == 0 else rotation_from_quaternion(values / length)


def world_matrix(file: UsdFile, prim: Any, cache: Any) -> Any:
    """Returns the transform of a prim to the world of its stage, as USD has it.

    Raises:
        ModelError: If one of its operations has no value.
    """
    from pxr import Tf

    try:
        return cache.GetLocalToWorldTransform(prim)
    except Tf.ErrorException as error:
        message = diagnose("usd-transform-without-value")
        raise make_file_error(Place(file.path, None, str(prim.GetPath())), message) from error


def split_transform(file: UsdFile, prim: Any, matrix: Any, units: StageUnits) -> Placed:
    """Splits the transform of a prim into a pose and a scale.

    Raises:
        ModelError: If it shears or mirrors: no joint's or body's frame can.
    """
    whole = np.array(matrix).T
    scale = np.linalg.norm(whole[:3, :3], axis=0)
    turn = whole[:3, :3] / np.where(scale > 0, scale, 1.0)
    if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
        message = diagnose("usd-frame-sheared", scale=Vector(tuple(scale), "1"))
        raise make_file_error(Place(file.path, None, str(prim.GetPath())), message)
    scale = np.where(np.abs(scale - 1.0) < SCALE_ROUNDING, 1.0, scale)
    left, _, right = np.linalg.svd(turn)
    return Placed(Pose(whole[:3, 3] * units.length, left @ right), scale * units.length)


def _touching(file: UsdFile, body: Any) -> Iterator[Any]:
    """Yields the prims of a body's shapes that touch."""
    from pxr import UsdGeom, UsdPhysics

    for prim in own_prims(file, body):
        stated = prim.IsA(UsdGeom.Gprim) and prim.HasAPI(UsdPhysics.CollisionAPI)
        enabled = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
        if stated and enabled.Get() is not False:
            yield prim


def own_prims(file: UsdFile, body: Any) -> Iterator[Any]:
    """Yields the prims of a body: itself and what is below it, but for other bodies."""
    from pxr import Usd

    others = set(file.bodies.values()) - {str(body.GetPath())}
    prims = iter(Usd.PrimRange(body, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if str(prim.GetPath()) in others:
            prims.PruneChildren()
        else:
            yield prim
