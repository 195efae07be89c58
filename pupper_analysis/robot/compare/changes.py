"""Which numbers of two trees of parameters differ, and how to take each over."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin

from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    diagnose,
)
from pupper_analysis.models.attributes import IN_A_TREE
from pupper_analysis.models.multibody import (
    MultibodyTree,
    TreeBody,
    TreeJoint,
    with_value_of,
)
from pupper_analysis.models.urdf_file import ENDLESS_SLIDE
from pupper_analysis.robot.compare.differences import (
    FORMATS,
    Difference,
    Effect,
    ModelNames,
    Stated,
    describe_ratio,
    in_degrees,
    name_mirrored,
    number_pair,
    quaternion_order,
    vector_pair,
)
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.conventions import Conventions, describe_pose, with_zero
from pupper_analysis.robot.matching.tolerances import Tolerances


@dataclass(frozen=True, eq=False)
class Change(Stated):
    """A difference between two sets of parameters, and how to take it over."""

    felt: bool = True  # by the dynamics

    def apply(self, one: MultibodyTree, two: MultibodyTree) -> MultibodyTree:
        """Returns the first robot with the second's value."""
        return with_value_of(one, two, self.kind, self.element)

    def difference(self, effects: dict[str, Effect]) -> Difference:
        """Returns it as a result, with what it does."""
        return Difference(
            self.kind, self.element, self.urdf, self.mjcf, self.unit, self.diagnostic, effects
        )


NOTHING = Tolerances(**{kind.name: 1e-300 for kind in fields(Tolerances)})


def changes_between(
    one: MultibodyTree, two: MultibodyTree, tolerances: Tolerances, sides: ModelNames = FORMATS
) -> Iterable[Change]:
    """Yields the differences of two sets of parameters.

    Args:
        one: The first; of a URDF and an MJCF, the URDF's.
        two: The second, with bodies, joints and frames of the same names.
        tolerances: What counts as a difference.
        sides: What the two are called.
    """
    for name, body in one.bodies.items():
        yield from body_changes(name, body, two.bodies[name], tolerances, sides)
    for name, joint in one.joints.items():
        yield from _joint_changes(name, joint, two.joints[name], tolerances, sides)
    if float(np.linalg.norm(two.gravity - one.gravity)) > tolerances.gravity:
        both = {**vector_pair(one.gravity, two.gravity, "m/s^2"), **sides.named}
        message = diagnose("gravity-differs" if sides.alike else "gravity-stated", **both)
        yield Change("gravity", "option", one.gravity, two.gravity, "m/s^2", message)
    greater = max(one.base_damping, two.base_damping)
    free = ("body", one.base)
    if abs(two.base_damping - one.base_damping) > tolerances.damping * greater:
        both = {**number_pair(one.base_damping, two.base_damping, "N s/m"), **sides.named}
        message = diagnose("free-joint-damping-differs", subject=free, **both)
        values = one.base_damping, two.base_damping
        yield Change("damping", one.base, *values, "N s/m", message)
    # A URDF is given the MJCF's: see `armature.armature_differences`.
    if sides.alike and two.base_armature != one.base_armature:
        unit = "kg and kg m^2"
        both = {**number_pair(one.base_armature, two.base_armature, unit), **sides.named}
        message = diagnose("free-joint-armature-differs", subject=free, **both)
        values = one.base_armature, two.base_armature
        yield Change("armature", one.base, *values, unit, message)
    for name, (owner, position) in one.frames.items():
        other_owner, other = two.frames[name]
        apart = float(np.linalg.norm(other - position))
        if owner != other_owner:
            links = {"one": one.bodies[owner].link, "two": two.bodies[other_owner].link}
            both = {**links, **sides.named}
            message = diagnose("frame-on-other-body", subject=("frame", name), **both)
        elif apart > tolerances.position:
            both = {**vector_pair(position, other, "m"), **sides.named}
            distance = Quantity(apart, "m")
            message = diagnose("frame-apart", subject=("frame", name), distance=distance, **both)
        else:
            continue
        yield Change("frame", name, position, other, "m", message)


def apply_changes(
    first: MultibodyTree, second: MultibodyTree, sides: ModelNames = FORMATS
) -> MultibodyTree:
    """Returns the first parameters with the second's value for every difference.

    What is within the tolerance is taken over as well, so that only what was overlooked is left.
    """
    patched = first
    for change in changes_between(first, second, NOTHING, sides):
        patched = change.apply(patched, second)
    return patched


def body_changes(
    name: str, one: TreeBody, two: TreeBody, tolerances: Tolerances, sides: ModelNames = FORMATS
) -> Iterable[Change]:
    """Yields the differences of two bodies."""
    body = ("link", one.link or two.link or name)
    greater = max(abs(one.mass), abs(two.mass))
    if abs(two.mass - one.mass) > tolerances.mass * greater:
        both = {**number_pair(one.mass, two.mass, "kg"), **sides.named}
        message = diagnose(
            "mass-differs", subject=body, guess=describe_ratio(one.mass, two.mass), **both
        )
        yield Change("mass", name, one.mass, two.mass, "kg", message)
    apart = float(np.linalg.norm(two.com - one.com))
    if apart > tolerances.com:
        message = diagnose(
            "com-differs",
            subject=body,
            distance=Quantity(apart, "m"),
            guess=name_mirrored(one.com, two.com, tolerances.com),
            **vector_pair(one.com, two.com, "m"),
            **sides.named,
        )
        yield Change("com", name, one.com, two.com, "m", message)
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()))
    differs = np.abs(two.inertia - one.inertia) > tolerances.inertia * size
    if differs.any():
        entries = []
        for label, place in INERTIA_ENTRIES.items():
            a, b = float(one.inertia[place]), float(two.inertia[place])
            if differs[place]:
                both = {**number_pair(a, b, "kg m^2"), **sides.named}
                entries.append(
                    diagnose(
                        "inertia-entry-differs", entry=label, guess=describe_ratio(a, b), **both
                    )
                )
        message = diagnose(
            "inertia-differs", subject=body, entries=entries, guess=_turned(one, two)
        )
        yield Change("inertia", name, one.inertia, two.inertia, "kg m^2", message)


def _turned(one: TreeBody, two: TreeBody) -> Diagnostic | None:
    """Says so if two tensors have the same principal moments."""
    moments = np.linalg.eigvalsh(one.inertia), np.linalg.eigvalsh(two.inertia)
    off = np.abs(one.inertia - np.diag(np.diag(one.inertia))).max()
    if np.allclose(np.diag(one.inertia), np.diag(two.inertia), rtol=1e-3) and off > 0:
        return diagnose("guess-products-of-inertia")
    if np.allclose(*moments, rtol=1e-3, atol=1e-3 * abs(moments[0]).max()):
        return diagnose("guess-tensor-in-turned-axes")
    return None


def _joint_changes(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    yield from _kinds_of_joints(name, one, two, sides)
    yield from _placements(name, one, two, tolerances, sides)
    yield from _axes(name, one, two, tolerances, sides)
    yield from _joint_numbers(name, one, two, tolerances, sides)


def _kinds_of_joints(
    name: str, one: TreeJoint, two: TreeJoint, sides: ModelNames
) -> Iterable[Change]:
    """Yields another parent, and another type."""
    if one.parent != two.parent:
        both = {"one": one.parent, "two": two.parent, **sides.named}
        message = diagnose("parent-differs", subject=("joint", name), **both)
        yield Change("parent", name, one.parent, two.parent, "", message)
    if one.slides != two.slides:
        kinds = ["prismatic" if joint.slides else "revolute" for joint in (one, two)]
        both = {"one": Term(kinds[0]), "two": Term(kinds[1]), **sides.named}
        message = diagnose("joint-type-differs", subject=("joint", name), **both)
        yield Change("type", name, kinds[0], kinds[1], "", message)


def _placements(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yields another position or orientation in the parent's frame."""
    apart = float(np.linalg.norm(two.position - one.position))
    if apart > tolerances.position:
        message = diagnose(
            "joint-position-differs",
            subject=("joint", name),
            distance=Quantity(apart, "m"),
            guess=name_mirrored(one.position, two.position, tolerances.position),
            **vector_pair(one.position, two.position, "m"),
            **sides.named,
        )
        yield Change("position", name, one.position, two.position, "m", message)
    turn = pin.log3(one.rotation.T @ two.rotation)
    angle = float(np.linalg.norm(turn))
    if angle > tolerances.rotation:
        about = abs(float(turn @ one.axis)) > (1 - 1e-6) * angle
        message = diagnose(
            "joint-frame-turned",
            subject=("joint", name),
            angle=Quantity(angle, "rad"),
            axis=Vector.rounded(turn / angle),
            about_its_axis=about,
            guess=quaternion_order(one.rotation, two.rotation),
        )
        yield Change("rotation", name, one.rotation, two.rotation, "1", message)


def _axes(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    between = math.acos(min(1.0, max(-1.0, float(one.axis @ two.axis))))
    if float(np.linalg.norm(np.cross(one.axis, two.axis))) > tolerances.axis or between > 1.0:
        reversed_axis = between > math.pi - tolerances.axis
        message = diagnose(
            "axis-reversed" if reversed_axis else "axis-turned",
            subject=("joint", name),
            angle=Quantity(between, "rad"),
            **vector_pair(one.axis, two.axis),
            **sides.named,
        )
        yield Change("axis", name, one.axis, two.axis, "1", message)


def _joint_numbers(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yields other limits, damping and friction; and armature, where both can state it."""
    for attribute in IN_A_TREE:
        kind, field, unit = attribute.kind, attribute.field, attribute.unit(one.slides)
        a, b = float(getattr(one, field)), float(getattr(two, field))
        if not (sides.alike or attribute.in_both):
            continue  # one of the formats has no words for it, and was given the other's
        tolerance = getattr(tolerances, attribute.tolerance)
        if a == b or (
            math.isfinite(a)
            and math.isfinite(b)
            and abs(b - a) <= tolerance * (max(abs(a), abs(b)) if attribute.relative else 1.0)
        ):
            continue
        if kind == "effort" and a == 0 and math.isinf(b) and not sides.alike:
            continue  # neither states one
        endless = kind in ("lower limit", "upper limit") and one.slides and abs(a) >= ENDLESS_SLIDE
        if endless and math.isinf(b) and not sides.alike:
            continue  # a URDF cannot state a slide without
        guess = in_degrees(a, b)
        if kind == "effort" and a == 0 and not sides.alike:
            guess = diagnose("guess-zero-for-unknown")
        message = diagnose(
            "joint-number-differs",
            subject=("joint", name),
            what=Term(kind),
            guess=guess,
            **number_pair(a, b, unit),
            **sides.named,
        )
        yield Change(kind, name, a, b, unit, message, felt=attribute.felt)


def convention_changes(
    found: Conventions, first: MultibodyTree, sides: ModelNames = FORMATS
) -> Iterator[tuple[Difference, MultibodyTree]]:
    """Yields each convention as a difference, and the first robot without that change.

    Args:
        found: The conventions; of a fixed base that shows it, where its frame is is no difference.
        first: The first robot, in the second's conventions.
        sides: What the two are called.
    """
    if found.base is not None and (first.floating or not found.shown):
        message = diagnose(
            "base-frame-elsewhere",
            subject=("body", first.base),
            pose=describe_pose(found.base),
            floating=first.floating,
            shown=found.shown,
            **sides.named,
        )
        pose = np.array(found.base.homogeneous)
        difference = Difference("base frame", first.base, pose, np.eye(4), "m", message, {})
        yield difference, with_base(first, found.base.inverse())
    for name, offset in found.zeros.items():
        unit = "m" if first.joints[name].slides else "rad"
        message = diagnose(
            "joint-zero-elsewhere",
            subject=("joint", name),
            offset=Quantity(offset, unit),
            more=offset > 0,
            magnitude=Quantity(abs(offset), unit),
            turn=None if unit == "m" else Quantity(offset, unit),
            **sides.named,
        )
        difference = Difference("zero", name, offset, 0.0, unit, message, {})
        yield difference, with_zero(first, name, -offset)
