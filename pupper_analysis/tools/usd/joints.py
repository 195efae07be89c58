"""Joints of a USD: what they join, where, and their numbers, in m, rad, N m and seconds.

UsdPhysics states angles in degrees, and with them all that is per angle: gains, damping, speeds.
What it cannot express (damping, dry friction, armature) stands in the schemas of engines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from pupper_analysis.models.shapes import Pose
from pupper_analysis.models.stated.model import (
    BALL,
    FIXED,
    FREE,
    HINGE,
    SLIDE,
)
from pupper_analysis.tools.usd.shapes import (
    AXES,
    StageUnits,
    axis_of,
    number_of,
    value_of,
)

DEGREE: Final = math.pi / 180

_KINDS: Final = {
    "PhysicsRevoluteJoint": HINGE,
    "PhysicsPrismaticJoint": SLIDE,
    "PhysicsSphericalJoint": BALL,
    "PhysicsFixedJoint": FIXED,
}

_FREEDOMS: Final = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class Statement:
    """An attribute that states a number of a joint, in the schema of an engine.

    Attributes:
        name: Its name; ``{axis}`` is ``angular`` or ``linear``, or ``rotX`` and the like.
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
class UsdDrive:
    """A motor of a joint.

    Attributes:
        stiffness: N m/rad or N/m.
        damping: N m s/rad or N s/m.
        target: The position that it holds (rad, m); None if not stated.
        accelerates: Whether gains are per inertia: it gives an acceleration, not a force.
        written: The stiffness as it is written, per degree.
    """

    stiffness: float
    damping: float
    target: float | None
    accelerates: bool
    written: float


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
        drive: Its motor, as UsdPhysics states it; None if it has none.
        gains: Stiffness and damping of the servo that holds it (N m/rad, N m s/rad; N/m, N s/m), by
            UsdPhysics or MuJoCo's schema; None where nothing holds it, or holds it by inertia.
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
    drive: UsdDrive | None = None
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
    motors: Sequence[Any] = (),
) -> Edge:
    """Reads a joint, between bodies that have been found.

    Args:
        name: Its name.
        prim: Its prim.
        bodies: Names of both; "" for the world.
        frames: Its frame in each.
        units: Of the stage.
        paths: {path of a joint's prim: its name}.
        motors: The prims of MuJoCo's schema that drive it.
    """
    kind, axis, lower, upper = _freedom(prim)
    turns, moves = kind == HINGE, kind in (HINGE, SLIDE)
    unit = DEGREE if turns else units.length
    word = _word(prim, kind, axis)
    ends = {"lower limit": lower * unit, "upper limit": upper * unit}
    stated = {
        what: found
        for what, statements in STATEMENTS.items()
        if moves and (found := _stated(prim, what, statements, word, turns, units))
    }
    drive = _drive(prim, word, turns, units) if moves else None
    efforts = [_effort(motor, units.inertia if turns else units.force) for motor in motors]
    if efforts and None not in efforts:
        stated["effort"] = {
            **stated.get("effort", {}),
            "mjc:forceRange": sum(filter(None, efforts)),
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
        drive=drive,
        gains=_gains(drive, motors, units.inertia if turns else units.mass) if moves else None,
        outside=bool(value_of(prim, "physics:excludeFromArticulation", "number")),
        mimic=_mimic(prim, turns, units, paths),
    )


def _freedom(prim: Any) -> tuple[str, int, float, float]:
    """Returns a joint's kind, its axis, and its limits as they are written."""
    kind = _KINDS.get(str(prim.GetTypeName()))
    if kind is not None:
        axis = AXES[axis_of(prim, "physics:axis", "X")]
        lower = number_of(prim, "physics:lowerLimit", -math.inf)
        upper = number_of(prim, "physics:upperLimit", math.inf)
        return (kind, axis, *((lower, upper) if kind in (HINGE, SLIDE) else (-math.inf, math.inf)))
    # A general joint is free about and along all axes but those whose limits are exchanged.
    free: dict[str, tuple[float, float]] = {}
    for word in _FREEDOMS:
        low = number_of(prim, f"limit:{word}:physics:low", -math.inf)
        high = number_of(prim, f"limit:{word}:physics:high", math.inf)
        if not low > high:
            free[word] = low, high
    if not free:
        return FIXED, 0, -math.inf, math.inf
    if len(free) == 1:
        (word, (low, high)), *_ = free.items()
        return HINGE if word.startswith("rot") else SLIDE, AXES[word[-1]], low, high
    ball = set(free) == set(_FREEDOMS[3:])
    return BALL if ball else FREE, 0, -math.inf, math.inf


def _word(prim: Any, kind: str, axis: int) -> str:
    """Returns what a joint's axis is called in the names of its drive's attributes."""
    if str(prim.GetTypeName()) in _KINDS:
        return "angular" if kind == HINGE else "linear"
    return ("rot" if kind == HINGE else "trans") + "XYZ"[axis]


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


def _effort(motor: Any, unit: float) -> float | None:
    """Returns what a motor of MuJoCo's schema gives at most at its joint; None if without limit.

    That is its forceRange; or, of a motor without bias, its ctrlRange times its gain.
    """

    def greatest(name: str) -> float | None:
        ends = [abs(number_of(motor, f"mjc:{name}Range:{end}")) for end in ("min", "max")]
        off = str(value_of(motor, f"mjc:{name}Limited", "text")) == "false"
        return None if off or math.isnan(sum(ends)) else max(ends) or None

    limit = greatest("force")
    if limit is None and str(value_of(motor, "mjc:biasType", "text") or "none") == "none":
        control = greatest("ctrl")
        limit = None if control is None else control * abs(_entry(motor, "mjc:gainPrm", 0, 1.0))
    return None if limit is None else limit * abs(_entry(motor, "mjc:gear", 0, 1.0)) * unit


def _entry(motor: Any, name: str, place: int, usual: float) -> float:
    """Returns one number of a list of a motor's; the usual one where that is shorter."""
    values = value_of(motor, name, "list")
    return float(values[place]) if values is not None and len(values) > place else usual


def _gains(
    drive: UsdDrive | None, motors: Sequence[Any], unit: float
) -> tuple[float, float] | None:
    """Returns stiffness and damping of what holds a joint; see `Edge.gains`.

    MuJoCo's motors that are servos have an affine bias, per rad; several add up.
    """
    if drive is not None and drive.stiffness > 0:
        return None if drive.accelerates else (drive.stiffness, drive.damping)
    held = np.zeros(2)
    for motor in motors:
        if str(value_of(motor, "mjc:biasType", "text")) == "affine":
            lever = _entry(motor, "mjc:gear", 0, 1.0) ** 2 * unit
            held -= [_entry(motor, "mjc:biasPrm", place, 0.0) * lever for place in (1, 2)]
    return (float(held[0]), float(held[1])) if held[0] > 0 else None


def _drive(prim: Any, word: str, turns: bool, units: StageUnits) -> UsdDrive | None:
    """Returns a joint's drive of UsdPhysics; None if it has none."""
    if f"PhysicsDriveAPI:{word}" not in prim.GetAppliedSchemas():
        return None

    start = f"drive:{word}:physics"
    accelerates = value_of(prim, f"{start}:type", "text") == "acceleration"
    force = 1.0 if accelerates else units.inertia if turns else units.mass
    unit = force / DEGREE if turns else force
    authored = prim.GetAttribute(f"{start}:targetPosition").IsAuthored()
    target = number_of(prim, f"{start}:targetPosition") * (DEGREE if turns else units.length)
    stiffness = number_of(prim, f"{start}:stiffness", 0.0)
    return UsdDrive(
        stiffness=stiffness * unit,
        damping=number_of(prim, f"{start}:damping", 0.0) * unit,
        target=target if authored and not math.isnan(target) else None,
        accelerates=accelerates,
        written=stiffness,
    )


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
