"""What a body of a USD weighs: as UsdPhysics says it follows from bodies, shapes and densities.

A mass states less than it seems to: where the com or the inertia is not stated, too, they are those
of the shapes that touch; and a body of which nothing is stated is filled with water. The rules are
those of ``UsdPhysicsRigidBodyAPI::ComputeMassProperties``, here in double precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np

from pupper_analysis.models.stated.geometry import Solid
from pupper_analysis.models.stated.model import Array, Inertial
from pupper_analysis.models.stated.usd_shapes import (
    Placed,
    StageUnits,
    UsdShape,
    number_of,
    rotation_of,
    shortest_decimals,
    value_of,
)

WATER: Final = 1000.0
"""kg/m^3: what a shape has of which no density is stated."""

BALL: Final = 0.1
"""m: the radius of the ball that a mass without shape and inertia is taken for."""

_SINGLE: Final = 2.0**-24
"""Half a unit of the last digit of a number of 1 in single precision."""


class Origin(StrEnum):
    """Where a body's mass comes from."""

    STATED = "stated"
    """The body says it."""
    SHAPES = "shapes"
    """Its shapes say their masses or densities, or it says a density."""
    WATER = "water"
    """Of a shape at least nothing is said: it has the density of water."""
    UNKNOWN = "unknown"
    """Neither it nor a shape that touches says anything; or a shape's volume is not known."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """What a body weighs.

    Attributes:
        inertial: None if that is not known.
        origin: Of its mass.
        inertia_made: Whether the inertia is not stated, but follows from the mass.
        axes_made: Whether moments are stated, but not their axes: they are taken to be the body's,
            where USD's own reckoning takes those of the shapes that touch.
        com_made: Whether the com is not stated, but that of the shapes that touch: not stated is
            not at the origin.
        newton: (3, 3) What `newton:inertia` states, in the body's axes (kg m^2); None if nothing.
        water: kg of the mass that are of no stated density.
    """

    inertial: Inertial | None
    origin: Origin
    inertia_made: bool
    newton: Array | None
    water: float = 0.0
    axes_made: bool = False
    com_made: bool = False


def weigh_body(body: Any, place: Placed, shapes: Sequence[UsdShape], units: StageUnits) -> Weighed:
    """Returns what a body weighs.

    Args:
        body: Its prim.
        place: Where it is.
        shapes: Its shapes.
        units: Of the stage.
    """
    below = min(number_of(body, "physics:mass", 0.0), 0.0)
    mass = (_positive(body, "physics:mass") or below) * units.mass
    com = _vector(body, "physics:centerOfMass")
    com = None if com is None else com * place.scale
    moments = _vector(body, "physics:diagonalInertia")
    newton = _newton(body, units)
    tensor = newton
    rounding, axes_made = 0.0, False
    if moments is not None and moments.any():
        turn = _axes(body)
        axes_made = turn is None
        turn = np.eye(3) if turn is None else turn
        tensor = turn @ np.diag(moments * units.inertia) @ turn.T
        rounding = float(np.abs(moments).max() * units.inertia * _SINGLE)
    made = tensor is None
    if mass < 0 or (mass > 0 and com is not None and tensor is not None):
        com, tensor = (
            one if one is not None else none
            for one, none in ((com, np.zeros(3)), (tensor, np.zeros((3, 3))))
        )
        return Weighed(
            Inertial(mass, com, tensor, True, rounding),
            Origin.STATED,
            made,
            newton,
            axes_made=axes_made,
        )
    summed = _summed(body, [shape for shape in shapes if shape.collides], units)
    if summed is None:
        if mass <= 0:
            return Weighed(None, Origin.UNKNOWN, made, newton)
        ball = 0.4 * mass * BALL**2 * np.eye(3)
        com = np.zeros(3) if com is None else com
        told = Inertial(mass, com, ball if tensor is None else tensor, True, rounding)
        return Weighed(told, Origin.STATED, made, newton, axes_made=axes_made)
    whole, middle, about, water = summed
    origin = Origin.STATED if mass > 0 else Origin.WATER if water > 0 else Origin.SHAPES
    factor = mass / whole if mass > 0 else 1.0
    mass, about = whole * factor, about * factor
    com_made = com is None
    com = middle if com is None else com
    if tensor is None:
        tensor = about + mass * _square(com - middle)
    told = Inertial(mass, com, tensor, origin is Origin.STATED and not made, rounding)
    water = 0.0 if origin is Origin.STATED else water
    return Weighed(told, origin, made, newton, water, axes_made, com_made)


def _summed(
    body: Any, shapes: Sequence[UsdShape], units: StageUnits
) -> tuple[float, Array, Array, float] | None:
    """Returns mass, com and inertia of a body's shapes, and how much of it is of no stated density.

    None where there is no shape, or a volume is not known.
    """
    parts: list[tuple[float, Array, Array]] = []
    water = 0.0
    usual = _positive(body, "physics:density") * units.density
    for shape in shapes:
        solid = shape.solid
        mass = _positive(shape.prim, "physics:mass") * units.mass
        if solid is None or not solid.volume > 0:
            return None
        density = _positive(shape.prim, "physics:density") * units.density
        density = density or _of_material(shape.prim) * units.density or usual
        if mass == 0:
            mass = (density or WATER) * solid.volume
            water += 0.0 if density else mass
        parts.append((mass, *_of_shape(shape, solid, mass, units)))
    if not parts:
        return None
    whole = sum(mass for mass, _, _ in parts)
    middle = sum((mass * com for mass, com, _ in parts), np.zeros(3)) / whole
    about = sum((one + mass * _square(com - middle) for mass, com, one in parts), np.zeros((3, 3)))
    return whole, middle, about, water


def _of_shape(shape: UsdShape, solid: Solid, mass: float, units: StageUnits) -> tuple[Array, Array]:
    """Returns the com of a shape and its inertia about it, in the body's axes."""
    inertia = solid.inertia * (mass / solid.volume)
    com = shape.pose.point(solid.com)
    turn = shape.pose.rotation
    tensor: Array = turn @ inertia @ turn.T
    own = _vector(shape.prim, "physics:diagonalInertia")
    if own is not None and own.any():
        axes = _axes(shape.prim)
        turn = turn if axes is None else turn @ axes
        tensor = turn @ np.diag(own * units.inertia) @ turn.T
    own_com = _vector(shape.prim, "physics:centerOfMass")
    if own_com is not None:
        moved = shape.pose.point(own_com * shape.scale)
        if own is None or not own.any():
            tensor = tensor + mass * _square(moved - com)
        com = moved
    return com, tensor


def _square(d: Array) -> Array:
    """Returns d^2 1 - d d^T: what moving 1 kg by d adds to an inertia."""
    moved: Array = float(d @ d) * np.eye(3) - np.outer(d, d)
    return moved


def _positive(prim: Any, name: str) -> float:
    """Returns a number that states something if it is above 0; else 0."""
    value = number_of(prim, name, 0.0)
    return max(value, 0.0) if np.isfinite(value) else 0.0


def _vector(prim: Any, name: str) -> Array | None:
    """Returns three numbers; None where they are not stated (-inf is the schema's default)."""
    value = value_of(prim, name, "vector")
    values = None if value is None else shortest_decimals(value)
    return None if values is None or not np.isfinite(values).all() else values


def _axes(prim: Any) -> Array | None:
    """Returns the rotation (3, 3) of the principal axes; None where they are not stated."""
    value = value_of(prim, "physics:principalAxes", "quaternion")
    values = () if value is None else (value.GetReal(), *value.GetImaginary())
    return rotation_of(values) if any(values) else None


def _of_material(prim: Any) -> float:
    """Returns the density of the physical material that is bound to a shape; 0 if none is."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    return _positive(material.GetPrim(), "physics:density") if material else 0.0


def _newton(body: Any, units: StageUnits) -> Array | None:
    """Returns what `newton:inertia` states: xx, yy, zz, xy, xz, yz in the body's axes."""
    value = value_of(body, "newton:inertia", "list")
    if value is None or len(value) != 6:
        return None
    xx, yy, zz, xy, xz, yz = np.array(value, dtype=float) * units.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
