"""Differences between two multibody trees: detection, ranking, effects and messages.

``changes_between`` yields the differences of two trees. Each difference can be applied to the first
tree. ``RelativeError`` evaluates its effect on the dynamics. Messages include probable causes, such
as degrees instead of radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    describe_bound,
    describe_effort,
    diagnose,
    fill_template,
    phrase,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EARTH_GRAVITY, select_joint_units
from pupper_analysis.models.attributes import TREE_ATTRIBUTES
from pupper_analysis.models.efforts import MIN_EFFORT
from pupper_analysis.models.multibody import (
    MultibodyTree,
    TreeBody,
    TreeJoint,
    copy_value,
)
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.conventions import Conventions, describe_pose, with_zero
from pupper_analysis.robot.matching.tolerances import Tolerances

INERTIAL_KINDS = ("mass", "com", "inertia")
"""Kinds of differences in the inertial parameters of a body."""

GEOMETRY_KINDS = (*INERTIAL_KINDS, "position", "rotation", "axis", "frame")
"""Kinds of differences in bodies, joint placements and frames."""

LIMIT_KINDS = ("lower limit", "upper limit", "effort")
"""Kinds of differences in position limits of joints and effort limits of motors."""

SERVO_GAIN_KINDS = ("servo stiffness", "servo damping")
"""Kinds of differences in servo gains: kp, kd."""

PropertyKey = tuple[str, str]
"""(kind, element) of a property of a robot, as in `Stated`. The element is for example the name of
a joint, or of the base. ("mass", joint) is the total mass of the body that the joint moves, with
all bodies fixed to this body."""

KIND_ORDER = (
    "compiler",
    "joint",
    "name",
    "type",
    "parent",
    "base frame",
    "zero",
    "gravity",
    *GEOMETRY_KINDS,
    "damping",
    "armature",
    *LIMIT_KINDS,
    "velocity",
    *SERVO_GAIN_KINDS,
    "friction",
    "mimic",
    "spring",
    "damping polynomial",
    "gravity compensation",
    "dry friction",
    "tendon",
    "actuator",
    "motor",
    "fluid",
    "equality",
    "flag",
    "collision",
    "geom",
    "pair",
    "exclude",
    "option",
    "key",
)
"""Kinds of differences between two models. The order is a sorting key for differences of equal
urgency and effect (`Difference.rank`)."""

UNWRITTEN_KINDS = (
    *("type", "parent", "name", "base frame", "rotation", "axis", "frame", "zero"),
    *("gravity", "velocity", "armature", "mimic", "collision"),
)
"""Kinds of differences that `sync` does not write: one format cannot state the value, or the change
needs a decision."""

CONVENTION_KINDS = ("base frame", "zero")
"""Kinds of differences that change only the coordinates (qpos), not the robot."""

_STRUCTURE_KINDS = ("compiler", "joint", "name", "type", "parent", *CONVENTION_KINDS, "gravity")
"""Kinds of differences that are always listed first (`Difference.tier` 0)."""

_MIN_RELATIVE_EFFECT = 1e-3
"""Relative effect of a difference on a dynamic quantity [1], from which the difference is listed
before the differences of limits and efforts. Chosen, not tuned."""

_MIN_RELATIVE_MASS = 0.01
"""Relative difference of a body's mass [1], from which the difference is listed before the
differences of limits and efforts. Chosen, not tuned."""

_MAIN_QUANTITIES = ("mass matrix", "gravity", "foot positions", "joint positions")
"""Dynamic quantities whose largest relative effect is the first number in
`Difference.relative_effects`."""

_RANKED_QUANTITIES = (*_MAIN_QUANTITIES, "bias forces", "forward dynamics")
"""Quantities that order differences with the same `Difference.tier`: the largest relative effect on
one of these quantities comes first."""


@dataclass(frozen=True)
class Effect(Result):
    """Effect of a difference between two files on a dynamic quantity, such as the mass matrix.

    Attributes:
        deviation: Largest absolute deviation of the quantity, if only this difference is present.
        relative: ``deviation``, divided by the scale of the quantity.
        share: ``deviation``, divided by the deviation of all differences together. The share may
            exceed 1, because differences may cancel. The share is infinite, for example, if the
            deviation of all differences is a rounding error.
    """

    deviation: float = field(metadata={"unit": "varies"})
    relative: float = field(metadata={"unit": "1"})
    share: float = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class Stated:
    """Values of a property in two files.

    Attributes:
        kind: Kind of the property, an entry of ``KIND_ORDER``, for example ``mass``, ``lower
            limit`` or ``effort``. ``base frame`` and ``zero`` are differences of conventions.
            ``collision`` concerns the shapes of a foot. ``joint`` is a joint that one of two
            versions lacks.
        element: Name of the joint or frame. A body has the name of the joint that moves the body,
            or of the base. An element that only the MJCF can contain has its name in the MJCF, or
            its number such as ``#3``.
        urdf: Value in the URDF, in the frames of the URDF; None if the URDF has none.
        mjcf: Value in the MJCF, in the frames of the URDF; None if the MJCF has none.
        unit: Unit of both values.
        diagnostic: Message that describes the difference.
    """

    kind: str
    element: str
    urdf: object
    mjcf: object
    unit: str
    diagnostic: Diagnostic

    @property
    def message(self) -> str:
        """Message that describes this difference, in English."""
        return str(self.diagnostic)

    def to_difference(self, effects: dict[str, Effect]) -> Difference:
        """Convert this pair of values to a `Difference` with its effects on the dynamics.

        Args:
            effects: {quantity: effect of the difference}.
        """
        return Difference(
            self.kind, self.element, self.urdf, self.mjcf, self.unit, self.diagnostic, effects
        )


@dataclass(frozen=True, eq=False)
class Difference(Stated, Result):
    """Property that differs between two files; for the inherited attributes see `Stated`.

    Attributes:
        effects: {quantity: effect of the difference}; empty without an effect.
        urdf_place: File and line in the URDF; None if unknown.
        mjcf_place: File and line in the MJCF; None if unknown.
        made_of: Diagnostics of the links or bodies that form the compared body, if there are
            several.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("kind", "element")

    effects: dict[str, Effect]
    urdf_place: str | None = None
    mjcf_place: str | None = None
    made_of: tuple[Diagnostic, ...] = ()

    @property
    def rank(self) -> tuple[float, ...]:
        """Key by which differences are sorted, the most urgent repair first.

        The key consists of ``tier``, relative effects, kind, and the relative difference of a
        limit.
        """
        kind = KIND_ORDER.index("lower limit" if self.kind == "upper limit" else self.kind)
        return (
            self.tier,
            -self._max_ranked_effect,
            -self.relative_effects[1],
            kind,
            -self._relative_limit_difference,
            KIND_ORDER.index(self.kind),
        )

    @property
    def relative_effects(self) -> tuple[float, float]:
        """Largest effects of the difference on dynamic quantities, relative to their scales [1].

        The first number is the largest effect on mass matrix, gravity, and positions of joints and
        feet. The second number is the largest effect on any compared quantity.
        """
        main = [self.effects[name].relative for name in _MAIN_QUANTITIES if name in self.effects]
        all_effects = [effect.relative for effect in self.effects.values()]
        return max(main, default=0.0), max(all_effects, default=0.0)

    @property
    def _max_ranked_effect(self) -> float:
        """Largest relative effect of this difference on one of `_RANKED_QUANTITIES` [1]."""
        effects = (
            self.effects[name].relative for name in _RANKED_QUANTITIES if name in self.effects
        )
        return max(effects, default=0.0)

    @property
    def _relative_mass_difference(self) -> float:
        """Difference between the masses in URDF and MJCF, relative to the larger mass."""
        first, second = (float(value) for value in (self.urdf, self.mjcf))  # type: ignore[arg-type]
        return abs(second - first) / max(abs(first), abs(second), 1e-300)

    @property
    def _relative_limit_difference(self) -> float:
        """Relative difference of a joint's limits in URDF and MJCF, from 0 to 1; a sorting key.

        Positions are relative to a full turn or 1 m, efforts to the larger value.
        """
        if self.kind not in LIMIT_KINDS:
            return 0.0
        first, second = (
            math.inf if value is None else float(value)  # type: ignore[arg-type]
            for value in (self.urdf, self.mjcf)
        )
        if not (math.isfinite(first) and math.isfinite(second)):
            return 1.0
        scale = math.tau if self.unit == "rad" else 1.0
        if self.kind == "effort":
            scale = max(abs(first), abs(second), 1e-300)
        return min(abs(second - first) / scale, 1.0)

    @property
    def tier(self) -> int:
        """Urgency of the repair of this difference, from 0 (most urgent) to 3.

        - 0: structure, convention or gravity (``_STRUCTURE_KINDS``).
        - 1: relative effect of at least 1e-3 (``_MIN_RELATIVE_EFFECT``), or relative mass
          difference of at least 0.01 (``_MIN_RELATIVE_MASS``).
        - 2: other differences of limits and efforts.
        - 3: all others.
        """
        if self.kind in _STRUCTURE_KINDS:
            return 0
        is_mass = self.kind == "mass" and self._relative_mass_difference >= _MIN_RELATIVE_MASS
        if max(self.relative_effects) >= _MIN_RELATIVE_EFFECT or is_mass:
            return 1
        return 2 if self.kind in LIMIT_KINDS else 3


@dataclass(frozen=True, eq=False)
class PatternCause(Result):
    """Mistake in a file that explains two or more differences, or one different inertia tensor.

    Attributes:
        kind: Kind of the mistake: ``units``, ``gears``, ``angles``, ``exchanged``, ``products``,
            ``geoms``, ``equalities``, ``mimics``, ``inertia origin``, ``inertia turn``,
            ``inertia axes``, ``links``, ``scaled links``, ``inertial`` or ``line``.
        diagnostic: Message that describes the mistake, with the numbers.
        differences: Indices of the explained differences, from 0.
        effects: {quantity: effect of all explained differences together}. Empty if one of the
            differences has no place in the joint tree, for example an equality constraint.
    """

    kind: str
    diagnostic: Diagnostic
    differences: tuple[int, ...]
    effects: dict[str, Effect] = field(default_factory=dict)

    @property
    def message(self) -> str:
        """Message that describes this mistake, in English."""
        return str(self.diagnostic)

    @property
    def is_reported_first(self) -> bool:
        """True if this cause is reported before all other causes.

        True for missing mimic constraints (``mimics``), and for effort limits of the motor instead
        of the joint (``gears``), which make motor utilisations wrong by the gear ratio.
        """
        return self.kind in ("gears", "mimics")


@dataclass(frozen=True, eq=False)
class Explanation(Result):
    """Differences that explain the deviation between two models, and the unexplained residual.

    Attributes:
        differences: Differences, the most urgent first: by tier, then by effect.
        deviations: {quantity: relative deviation between the two models}.
        residual: {quantity: relative deviation that the differences do not explain}. Compared are
            the URDF with all values of the MJCF, and the MJCF without the elements that a URDF
            cannot specify.
        complete: Whether each residual is at most 1e-9.
        notes: Diagnostics of values that were copied from the MJCF to the URDF: armature, and
            damping and dry friction if the URDF does not specify them.
    """

    differences: tuple[Difference, ...]
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    complete: bool
    notes: tuple[Diagnostic, ...]


@dataclass(frozen=True, eq=False)
class RelativeError:
    """Relative deviations between two models, for each compared quantity.

    Attributes:
        one: {quantity: values at all states} of the first model (URDF).
        two: {quantity: values at all states} of the second model (MJCF).
    """

    one: Mapping[str, Array]
    two: Mapping[str, Array]

    def scale(self, name: str) -> float:
        """Return the scale of a quantity, in the unit of the quantity: divisor of deviations.

        The scale is the largest absolute value of the first model, or of the second model if a
        value of the first model is not finite. Gravity and bias forces may be nearly zero; their
        scale has a lower bound.

        Args:
            name: Name of the quantity, for example ``mass matrix``.
        """
        if name not in self._scales:
            lower_bound = 1e-300
            if name in ("gravity", "bias forces"):
                lower_bound = 1e-3 * EARTH_GRAVITY * self.scale("mass matrix")
            # With a negative mass, MuJoCo returns NaN for the first model.
            values = self.one[name] if np.isfinite(self.one[name]).all() else self.two[name]
            self._scales[name] = max(float(np.abs(values).max()), lower_bound)
        return self._scales[name]

    @cached_property
    def _scales(self) -> dict[str, float]:
        """Scales computed so far, by `scale`: matrices of large robots have 1e7 entries."""
        return {}

    @cached_property
    def _total_deviations(self) -> dict[str, float]:
        """{quantity: relative deviation between both models, with all differences together}."""
        return {
            name: self.relative_deviation(name, values, self.two[name])
            for name, values in self.one.items()
        }

    def relative_deviation(self, name: str, first: Array, second: Array) -> float:
        """Return the largest deviation between two arrays of a quantity, divided by its ``scale``.

        Args:
            name: Quantity.
            first: Values of the first model.
            second: Values of the other model, same shape.

        Returns:
            Relative deviation; infinite if a difference is NaN or infinite.
        """
        with np.errstate(all="ignore"):
            deviation = float(np.abs(first - second).max())

        return deviation / self.scale(name) if math.isfinite(deviation) else math.inf

    def effects(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> dict[str, Effect]:
        """Compute the effect of a change of the model on each quantity, from two evaluations.

        Args:
            before: {quantity: values before the change}.
            after: {quantity: values after the change}, same shapes.

        Returns:
            {quantity: effect}. Quantities that change by at most 1e-12 of their scale (rounding)
            are omitted.
        """
        effects = {}
        for name, values in after.items():
            relative = self.relative_deviation(name, values, before[name])
            if relative > 1e-12:  # rounding
                total = self._total_deviations[name]
                # The fraction is undefined if the total is a rounding error.
                fraction = relative / total if 1e-9 < total < math.inf else math.inf
                effects[name] = Effect(relative * self.scale(name), relative, fraction)
        return effects


def has_inverted_urdf_range(differences: Iterable[Difference]) -> bool:
    """Return True if the limits of a joint differ, and its lower limit in the URDF is the larger.

    An MJCF cannot state such a range, so that only a change of the URDF removes the differences.
    """
    limits: dict[str, dict[str, float]] = {}
    for difference in differences:
        if difference.kind in ("lower limit", "upper limit") and isinstance(difference.urdf, float):
            limits.setdefault(difference.element, {})[difference.kind] = difference.urdf
    return any(
        limit.get("lower limit", -math.inf) > limit.get("upper limit", math.inf)
        for limit in limits.values()
    )


def describe_kind(kind: str) -> str:
    """Return a short English description of a kind of check result, for example ``joint``."""
    key = _ABOUT_KEYS.get(kind, "about-difference")
    return fill_template(phrase(key, "en"), {"kind": kind}, "en")


_ABOUT_KEYS = {
    "part": "about-part",
    "cause": "about-cause",
    "joint": "about-joint",
    "agreement": "about-agreement",
    "guess": "about-guess",
    "refused": "about-refused",
    "stale": "about-stale",
}
"""{kind of a check result: key of its description in the catalogue}. Other kinds are differences,
with the key ``about-difference``."""


@dataclass(frozen=True)
class ModelNames:
    """Names of two compared models in messages.

    Attributes:
        first: Name of the first model.
        second: Name of the second model.
        alike: Whether both models have the same format, and therefore can specify the same
            properties.
    """

    first: Term
    second: Term
    alike: bool

    @property
    def message_values(self) -> dict[str, Any]:
        """Names of both models as values of a message, under the keys ``first`` and ``second``."""
        return {"first": self.first, "second": self.second}


FORMAT_NAMES = ModelNames(Term("the URDF"), Term("the MJCF"), alike=False)
"""Names of a URDF and an MJCF in messages."""

VERSION_NAMES = ModelNames(Term("the old file"), Term("the new file"), alike=True)
"""Names of two versions of a file in messages."""


def with_names_of_models(message: Diagnostic, names: Mapping[str, Term]) -> Diagnostic:
    """Return a message in which names of the compared models are replaced, also in nested messages.

    Args:
        message: Message.
        names: {name: new name}.
    """

    def replace_names(value: Any) -> Any:
        """Replace the terms in ``names`` in a value of a message, also in nested values."""
        if isinstance(value, tuple):
            return tuple(replace_names(item) for item in value)
        if isinstance(value, Diagnostic):
            return with_names_of_models(value, names)
        return names.get(str(value), value) if isinstance(value, Term) else value

    values = {key: replace_names(value) for key, value in message.values.items()}
    return replace(message, values=FrozenDict(values)) if names else message


def number_pair(first: float, second: float, unit: str) -> dict[str, Any]:
    """Format two compared numbers with unit as values ``one`` and ``two`` of a message.

    The term "unlimited" replaces a number that is not finite.
    """
    return {"one": describe_bound(first, unit), "two": describe_bound(second, unit)}


MIN_FACTOR = 10.0
"""Lower bound of the ratio of two numbers, such as MJCF / URDF, or of the relative effect [1] for
which a message states a factor ("20 times") instead of a percentage. Chosen, not tuned."""


def describe_ratio(urdf: float, mjcf: float) -> Diagnostic | None:
    """Describe the ratio between the numbers of MJCF and URDF, for a message.

    Ratios such as 1000 or -1 are described as probable mistakes, for example grams instead of
    kilograms.

    Args:
        urdf: Number of the URDF.
        mjcf: Number of the MJCF, in the same unit.

    Returns:
        Description; None if a number is zero.
    """
    if urdf == 0 or mjcf == 0:
        return None
    ratio = mjcf / urdf
    if any(math.isclose(ratio, factor, rel_tol=1e-3) for factor in (1e3, 1e-3)):
        return diagnose("guess-grams-for-kilograms")
    if math.isclose(ratio, 10.0, rel_tol=1e-3):
        return diagnose("guess-ten-times")
    if math.isclose(ratio, 0.1, rel_tol=1e-3):
        return diagnose("guess-a-tenth")
    if math.isclose(ratio, -1.0, rel_tol=1e-3):
        return diagnose("guess-other-sign")
    if ratio > MIN_FACTOR:
        return diagnose("relative-factor", times=ratio)
    return diagnose("relative-change", change=Quantity(ratio - 1, "1"))


def guess_degrees(urdf: float, mjcf: float) -> Diagnostic | None:
    """Return a diagnostic if one of two values seems to be in degrees, the other in radians.

    Criterion: the ratio of the values is 57.3 or 1/57.3, within 1 %.

    Args:
        urdf: Number of the URDF.
        mjcf: Number of the MJCF.

    Returns:
        Diagnostic, or None.
    """
    if urdf == 0 or not math.isfinite(urdf) or not math.isfinite(mjcf):
        return None
    ratio = mjcf / urdf
    if any(math.isclose(ratio, math.degrees(1.0) ** sign, rel_tol=1e-2) for sign in (1, -1)):
        return diagnose("guess-degrees-for-radians")
    return None


def guess_quaternion_order(urdf: Array, mjcf: Array) -> Diagnostic | None:
    """Return a diagnostic if the MJCF's quaternion was probably written as (x, y, z, w).

    Criterion: both rotations agree if the quaternion is read as (x, y, z, w).

    Args:
        urdf: Rotation matrix of the URDF, shape (3, 3).
        mjcf: Rotation matrix of the MJCF, shape (3, 3), for its quaternion read as (w, x, y, z).

    Returns:
        Diagnostic, or None.
    """
    x, y, z, w = pin.Quaternion(mjcf).coeffs()
    # The numbers in the file were read as (w, x, y, z); here they are read as (x, y, z, w).
    quaternion = pin.Quaternion(np.array([w, x, y, z]))
    if np.allclose(quaternion.toRotationMatrix(), urdf, atol=1e-4):
        return diagnose("guess-quaternion-order")
    return None


# Differences of two multibody trees.


@dataclass(frozen=True, eq=False)
class Change(Stated):
    """Difference between two multibody trees, which can be applied to the first tree.

    Attributes:
        felt: Whether the difference affects the dynamics.
    """

    felt: bool = True

    def apply(self, first: MultibodyTree, second: MultibodyTree) -> MultibodyTree:
        """Return a copy of the first tree with the differing value of the second tree."""
        return copy_value(first, second, self.kind, self.element)


ZERO_TOLERANCES = Tolerances(**{kind.name: 1e-300 for kind in fields(Tolerances)})
"""Tolerances of 1e-300, with which practically only equal values are accepted. `Tolerances` does
not permit zero."""


def change_of(
    code: str,
    kind: str,
    subject: tuple[str, str] | None,
    values: tuple[Any, Any],
    unit: str,
    sides: ModelNames,
    details: Mapping[str, Any] = FrozenDict(),
    *,
    element: str = "",
    shown: tuple[Any, Any] | None = None,
    felt: bool = True,
) -> Change:
    """Create a difference between two models, with a message that contains both values.

    Args:
        code: Code of the message in the catalogue.
        kind: Kind of the difference, an entry of ``KIND_ORDER`` such as ``mass``.
        subject: Element that the message names: (type, name), for example ("joint", "knee"); or
            None.
        values: Values of the first and of the second model.
        unit: Unit of the values.
        sides: Names of the two models in the message.
        details: Further values of the message.
        element: Name of the element in the result, if this name differs from the name in
            ``subject``.
        shown: Values in the message, if they differ from ``values``.
        felt: Whether the difference affects the dynamics.
    """
    first, second = (_format_value(value, unit) for value in shown or values)
    message = diagnose(
        code, subject=subject, one=first, two=second, **details, **sides.message_values
    )
    element_name = element if subject is None else element or subject[1]
    return Change(kind, element_name, *values, unit, message, felt=felt)


def _format_value(value: Any, unit: str) -> Any:
    """Format a value for a message: numbers and arrays get the unit, texts stay unchanged."""
    if isinstance(value, str | Quantity):
        return value
    if isinstance(value, np.ndarray):
        return Vector.rounded(value, unit)
    return describe_bound(value, unit)


def changes_between(
    first: MultibodyTree,
    second: MultibodyTree,
    tolerances: Tolerances,
    sides: ModelNames = FORMAT_NAMES,
) -> Iterable[Change]:
    """Yield the differences of two multibody trees that exceed the tolerances, value by value.

    Armatures are compared only between two files of the same format.

    Args:
        first: First tree (URDF).
        second: Second tree, with the same names of bodies, joints and frames.
        tolerances: Tolerances of the comparison.
        sides: Names of the two models in messages.
    """
    for name, body in first.bodies.items():
        yield from body_changes(name, body, second.bodies[name], tolerances, sides)
    for name, joint in first.joints.items():
        yield from _compare_joints(name, joint, second.joints[name], tolerances, sides)
    if float(np.linalg.norm(second.gravity - first.gravity)) > tolerances.gravity:
        code = "gravity-differs" if sides.alike else "gravity-stated"
        gravities = first.gravity, second.gravity
        yield change_of(code, "gravity", None, gravities, "m/s^2", sides, element="option")
    free_joint, damping = ("body", first.base), (first.base_damping, second.base_damping)
    if abs(damping[1] - damping[0]) > tolerances.damping * max(damping):
        yield change_of(
            "free-joint-damping-differs", "damping", free_joint, damping, "N s/m", sides
        )
    # Between formats, `attribution.armature_differences` reports armature.
    if sides.alike and second.base_armature != first.base_armature:
        armature, unit = (first.base_armature, second.base_armature), "kg and kg m^2"
        yield change_of(
            "free-joint-armature-differs", "armature", free_joint, armature, unit, sides
        )
    for name, (owner, position) in first.frames.items():
        other_owner, other_position = second.frames[name]
        distance, subject = float(np.linalg.norm(other_position - position)), ("frame", name)
        if owner != other_owner:
            code, places = "frame-on-other-body", (position, other_position)
            links = first.bodies[owner].link, second.bodies[other_owner].link
            yield change_of(code, "frame", subject, places, "m", sides, shown=links)
        elif distance > tolerances.position:
            details = {"distance": Quantity(distance, "m")}
            yield change_of(
                "frame-apart", "frame", subject, (position, other_position), "m", sides, details
            )


def apply_changes(
    first: MultibodyTree, second: MultibodyTree, sides: ModelNames = FORMAT_NAMES
) -> MultibodyTree:
    """Return the first tree with the differing values of the second tree, without tolerances.

    Properties that `changes_between` does not compare are unchanged, for example the armature if
    the trees are from a URDF and an MJCF.

    Args:
        first: First tree; not modified.
        second: Second tree, with the same names of bodies, joints and frames.
        sides: Names of the two trees in messages.
    """
    patched = first
    for change in changes_between(first, second, ZERO_TOLERANCES, sides):
        patched = change.apply(patched, second)
    return patched


def body_changes(
    name: str,
    first: TreeBody,
    second: TreeBody,
    tolerances: Tolerances,
    sides: ModelNames = FORMAT_NAMES,
) -> Iterable[Change]:
    """Yield the differences of mass, CoM and inertia of two bodies that exceed the tolerances.

    The CoM of a body without mass is undefined, and is not compared.

    Args:
        name: Name of the compared body: the joint that moves the body, or the base.
        first: Body of the first model (URDF).
        second: Body of the second model (MJCF), in the same frame.
        tolerances: Tolerances of the comparison.
        sides: Names of the two models in messages.
    """
    body = ("link", first.link or second.link or name)
    mass = first.mass, second.mass
    if abs(second.mass - first.mass) > tolerances.mass * max(map(abs, mass)):
        guess = {"guess": describe_ratio(*mass)}
        yield change_of("mass-differs", "mass", body, mass, "kg", sides, guess, element=name)
    distance = float(np.linalg.norm(second.com - first.com))
    if distance > tolerances.com and any(mass):
        coms, details = (first.com, second.com), {"distance": Quantity(distance, "m")}
        yield change_of("com-differs", "com", body, coms, "m", sides, details, element=name)
    scale = max(float(np.abs(first.inertia).max()), float(np.abs(second.inertia).max()))
    differs = np.abs(second.inertia - first.inertia) > tolerances.inertia * scale
    if differs.any():
        entries = []
        for label, indices in INERTIA_ENTRIES.items():
            first_value, second_value = (
                _clear_rounding(float(tensor[indices]), scale)
                for tensor in (first.inertia, second.inertia)
            )
            if differs[indices]:
                values = {
                    **number_pair(first_value, second_value, "kg m^2"),
                    **sides.message_values,
                }
                entries.append(
                    diagnose(
                        "inertia-entry-differs",
                        entry=label,
                        guess=describe_ratio(first_value, second_value),
                        **values,
                    )
                )
        message = diagnose("inertia-differs", subject=body, entries=entries)
        yield Change("inertia", name, first.inertia, second.inertia, "kg m^2", message)


def _clear_rounding(value: float, scale: float) -> float:
    """Replace a tensor entry by 0 if at most `_ROUNDING_RTOL` times the largest entry ``scale``."""
    return value if abs(value) > _ROUNDING_RTOL * scale else 0.0


_ROUNDING_RTOL = 1e-9
"""Relative rounding error of an inertia tensor [1]. A message states 0 for an entry of at most this
fraction of the largest entry. Chosen, not tuned."""


def _compare_joints(
    name: str, first: TreeJoint, second: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yield the differences of two joints: parent, type, placement, axis and parameters."""
    subject = "joint", name
    if first.parent != second.parent:
        yield change_of(
            "parent-differs", "parent", subject, (first.parent, second.parent), "", sides
        )
    if first.slides != second.slides:
        kinds = ("prismatic", "revolute") if first.slides else ("revolute", "prismatic")
        shown = Term(kinds[0]), Term(kinds[1])
        yield change_of("joint-type-differs", "type", subject, kinds, "", sides, shown=shown)
    places = first.position, second.position
    distance = float(np.linalg.norm(second.position - first.position))
    if distance > tolerances.position:
        details = {"distance": Quantity(distance, "m")}
        yield change_of("joint-position-differs", "position", subject, places, "m", sides, details)
    rotation_vector = pin.log3(first.rotation.T @ second.rotation)
    angle = float(np.linalg.norm(rotation_vector))
    if angle > tolerances.rotation:
        message = diagnose(
            "joint-frame-turned",
            subject=subject,
            angle=Quantity(angle, "rad"),
            axis=Vector.rounded(rotation_vector / angle),
            about_its_axis=abs(float(rotation_vector @ first.axis)) > (1 - 1e-6) * angle,
            guess=guess_quaternion_order(first.rotation, second.rotation),
        )
        yield Change("rotation", name, first.rotation, second.rotation, "1", message)
    between = math.acos(min(1.0, max(-1.0, float(first.axis @ second.axis))))
    if float(np.linalg.norm(np.cross(first.axis, second.axis))) > tolerances.axis or between > 1.0:
        code = "axis-reversed" if between > math.pi - tolerances.axis else "axis-turned"
        axes, details = (first.axis, second.axis), {"angle": Quantity(between, "rad")}
        yield change_of(code, "axis", subject, axes, "1", sides, details)
    yield from _compare_joint_parameters(name, first, second, tolerances, sides)


def _compare_joint_parameters(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yield the differences of the scalar parameters of two joints, such as limits and damping."""
    for attribute in TREE_ATTRIBUTES:
        kind, field, unit = attribute.kind, attribute.field, attribute.unit(one.slides)
        first, second = float(getattr(one, field)), float(getattr(two, field))
        if not (sides.alike or attribute.is_in_both_formats):
            continue  # one format does not support this parameter, and has the value of the other
        if kind == "effort":  # a limit below the smallest is a motor without torque
            first, second = (0.0 if abs(limit) < MIN_EFFORT else limit for limit in (first, second))
        tolerance = getattr(tolerances, attribute.tolerance)
        if first == second or (
            math.isfinite(first)
            and math.isfinite(second)
            and abs(second - first)
            <= tolerance * (max(abs(first), abs(second)) if attribute.relative else 1.0)
        ):
            continue
        is_unlimited_slide = (
            kind in ("lower limit", "upper limit")
            and one.slides
            and abs(first) >= MAX_SLIDE_POSITION
        )
        if is_unlimited_slide and math.isinf(second) and not sides.alike:
            continue  # a URDF must limit a slide: huge limits mean none
        guess = guess_degrees(first, second)
        if kind == "effort" and first == 0 and not sides.alike:
            guess = diagnose("guess-zero-for-unknown")
        code, details = "joint-number-differs", {"what": Term(kind), "guess": guess}
        subject, felt = ("joint", name), attribute.felt
        values = (first, second)
        shown = None
        if kind == "effort":
            shown = (describe_effort(first, unit), describe_effort(second, unit))
        yield change_of(code, kind, subject, values, unit, sides, details, shown=shown, felt=felt)


def convention_changes(
    found: Conventions, first: MultibodyTree, sides: ModelNames = FORMAT_NAMES
) -> Iterator[tuple[Difference, MultibodyTree]]:
    """Yield each difference of base frame or joint zero between two trees, to evaluate its effect.

    Args:
        found: Original base frame and joint zeros of the first tree, relative to the second tree. A
            displaced frame of a fixed base is not yielded if it is confirmed
            (``Conventions.shown``).
        first: First tree, converted to the base frame and joint zeros of the second tree.
        sides: Names of the models.

    Yields:
        Difference; ``first`` with the original base frame or the original zero of the joint.
    """
    if found.base is not None and (first.floating or not found.shown):
        message = diagnose(
            "base-frame-elsewhere",
            subject=("body", first.base),
            pose=describe_pose(found.base),
            floating=first.floating,
            shown=found.shown,
            **sides.message_values,
        )
        pose = np.array(found.base.homogeneous)
        difference = Difference("base frame", first.base, pose, np.eye(4), "m", message, {})
        yield difference, with_base(first, found.base.inverse())
    for name, offset in found.zeros.items():
        unit = select_joint_units(slides=first.joints[name].slides).position
        message = diagnose(
            "joint-zero-elsewhere",
            subject=("joint", name),
            offset=Quantity(offset, unit),
            more=offset > 0,
            magnitude=Quantity(abs(offset), unit),
            turn=None if unit == "m" else Quantity(offset, unit),
            **sides.message_values,
        )
        difference = Difference("zero", name, offset, 0.0, unit, message, {})
        yield difference, with_zero(first, name, -offset)
