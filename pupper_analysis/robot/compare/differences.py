"""Which numbers of two models differ, what a comparison finds of them, and their words.

Words: what the two models are called, and guesses at the mistake behind a difference.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    Vector,
    describe_bound,
    diagnose,
    fill_template,
    phrase,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EARTH
from pupper_analysis.models.attributes import TREE_ATTRIBUTES
from pupper_analysis.models.multibody import (
    MultibodyTree,
    TreeBody,
    TreeJoint,
    with_value_of,
)
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.conventions import Conventions, describe_pose, with_zero
from pupper_analysis.robot.matching.tolerances import Tolerances

Array = NDArray[np.float64]

OF_INERTIALS = ("mass", "com", "inertia")
OF_BODIES_AND_PLACES = (*OF_INERTIALS, "position", "rotation", "axis", "frame")
LIMITS = ("lower limit", "upper limit", "effort")
SERVO_GAINS = ("servo stiffness", "servo damping")

ORDER = (
    "compiler",
    "joint",
    "name",
    "type",
    "parent",
    "base frame",
    "zero",
    "gravity",
    *OF_BODIES_AND_PLACES,
    "damping",
    "armature",
    *LIMITS,
    "velocity",
    *SERVO_GAINS,
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
"""All kinds: those of equal effect are listed in this order."""

CONVENTIONS = ("base frame", "zero")
"""Kinds of difference after which the two are still one robot, in other coordinates."""

_STRUCTURE = ("compiler", "joint", "name", "type", "parent", *CONVENTIONS, "gravity")
_LEAST_EFFECT = 1e-3  # least relative effect that goes before limits and efforts
_SCREW = 0.01  # likewise of a body's mass
_MAIN = ("mass matrix", "gravity", "foot positions", "joint positions")
_FELT = (*_MAIN, "bias forces", "forward dynamics")


@dataclass(frozen=True)
class Effect(Result):
    """What one difference does to one quantity.

    Attributes:
        deviation: The worst absolute deviation that it causes alone.
        relative: Relative to the quantity's scale.
        share: Relative to the deviation that all differences cause together; may exceed 1 where
            differences cancel.
    """

    deviation: float = field(metadata={"unit": "varies"})
    relative: float = field(metadata={"unit": "1"})
    share: float = field(metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class Stated:
    """What two sides state of one thing.

    Attributes:
        kind: ``mass``, ``com``, ``inertia``, ``position``, ``rotation``, ``axis``, ``lower limit``,
            ``upper limit``, ``effort``, ``velocity``, ``damping``, ``friction``, ``frame``,
            ``parent``, ``type``, ``gravity``, ``base frame`` or ``zero`` (conventions, see
            `conventions`), or ``armature`` (which a URDF cannot state: of a free joint, or unlike
            that of the mirror image); ``mimic``, that the URDF alone has; ``servo stiffness`` or
            ``servo damping``, of another format; ``name``, where names count; or what the MJCF
            alone has, the kinds of `mjcf_only.MjcfOnlyEffect`. Of two versions of a file also
            ``joint``, that one of them lacks, and ``motor``.
        element: The joint, the body (named by the joint that moves it, or the base) or the frame;
            of what the MJCF alone has, its name there, or ``#3``.
        urdf: The URDF's value, in the URDF's frames; None where it has none.
        mjcf: The MJCF's, in the URDF's frames.
        unit: Of both.
        diagnostic: The difference, with both values, as a message.
    """

    kind: str
    element: str
    urdf: object
    mjcf: object
    unit: str
    diagnostic: Diagnostic

    @property
    def message(self) -> str:
        """The difference in a sentence."""
        return str(self.diagnostic)

    def difference(self, effects: dict[str, Effect]) -> Difference:
        """Returns it as a result, with what it does."""
        return Difference(
            self.kind, self.element, self.urdf, self.mjcf, self.unit, self.diagnostic, effects
        )


@dataclass(frozen=True, eq=False)
class Difference(Stated, Result):
    """One number, or vector, in which the two files differ; its first attributes are `Stated`'s.

    Attributes:
        effects: {quantity: what it does}.
        urdf_place: File and line, where known.
        mjcf_place: File and line, where known.
        made_of: Of which links or bodies the value is made, where there are several.
    """

    effects: dict[str, Effect]
    urdf_place: str | None = None
    mjcf_place: str | None = None
    made_of: tuple[Diagnostic, ...] = ()

    @property
    def rank(self) -> tuple[float, ...]:
        """What a user must mend first, first: by tier, then by effect, then by kind."""
        kind = ORDER.index("lower limit" if self.kind == "upper limit" else self.kind)
        return self.tier, -self._felt, -self.weight[1], kind, ORDER.index(self.kind)

    @property
    def weight(self) -> tuple[float, float]:
        """How much the dynamics feel it.

        The greatest relative effect on mass matrix, gravity and positions; then on any quantity.
        Both are 0 for what the dynamics do not feel.
        """
        main = [self.effects[name].relative for name in _MAIN if name in self.effects]
        every = [effect.relative for effect in self.effects.values()]
        return max(main, default=0.0), max(every, default=0.0)

    @property
    def _felt(self) -> float:
        """The greatest relative effect on forces, accelerations and places: one scale for all."""
        felt = (self.effects[name].relative for name in _FELT if name in self.effects)
        return max(felt, default=0.0)

    @property
    def _share_of_mass(self) -> float:
        one, two = (float(value) for value in (self.urdf, self.mjcf))  # type: ignore[arg-type]
        return abs(two - one) / max(abs(one), abs(two), 1e-300)

    @property
    def tier(self) -> int:
        """What differences are sorted by first: what a user must mend.

        0 is a structure or a convention that is another; then what forces, accelerations or places
        feel by a thousandth or more, and a body's mass by a hundredth; limits and efforts; the
        rest.
        """
        if self.kind in _STRUCTURE:
            return 0
        screw = self.kind == "mass" and self._share_of_mass >= _SCREW
        if max(self.weight) >= _LEAST_EFFECT or screw:
            return 1
        return 2 if self.kind in LIMITS else 3


@dataclass(frozen=True, eq=False)
class PatternCause(Result):
    """One slip that explains several differences.

    Attributes:
        kind: ``units``, ``gears``, ``angles``, ``exchanged``, ``products``, ``coms``, ``geoms``,
            ``equalities``, ``links``, ``scaled links``, ``moved link``, ``inertial`` or ``line``.
        diagnostic: What it is, with its numbers.
        differences: Which of the differences it explains, by number, from 0.
    """

    kind: str
    diagnostic: Diagnostic
    differences: tuple[int, ...]

    @property
    def message(self) -> str:
        """What it is, in a sentence."""
        return str(self.diagnostic)

    @property
    def leads(self) -> bool:
        """Whether it is reported before all else.

        So are efforts of another place on the drive: the dynamics do not feel them, but whatever is
        said of what the motors hold is false by the gear.
        """
        return self.kind == "gears"


@dataclass(frozen=True, eq=False)
class Explanation(Result):
    """Why two models disagree.

    Attributes:
        differences: What a user must mend first, first: by tier, then by effect.
        deviations: {quantity: relative deviation between the two models}.
        residual: {quantity: relative deviation that is left when the URDF's model is given the
            MJCF's value for every difference, and what the MJCF alone has is taken out of it}.
        complete: Whether nothing is left.
        notes: What the URDF was given of the MJCF's, and what it does: armature, and what it does
            not state of damping and dry friction.
    """

    differences: tuple[Difference, ...]
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    complete: bool
    notes: tuple[Diagnostic, ...]


@dataclass(frozen=True, eq=False)
class RelativeError:
    """Weighs deviations against the quantities of the first model, and against the whole.

    Attributes:
        one: The first model's; of a URDF and an MJCF, the URDF's.
        two: The second's.
    """

    one: Mapping[str, Array]
    two: Mapping[str, Array]

    def scale(self, name: str) -> float:
        """Returns the greatest absolute value of a quantity.

        Gravity may be nearly zero (of joints that are all upright): then it is what a thousandth of
        the robot would weigh.
        """
        least = 1e-300
        if name in ("gravity", "bias forces"):
            least = 1e-3 * EARTH * self.scale("mass matrix")
        # With a negative mass MuJoCo has no numbers of the first.
        told = self.one[name] if np.isfinite(self.one[name]).all() else self.two[name]
        return max(float(np.abs(told).max()), least)

    def relative(self, name: str, one: Array, two: Array) -> float:
        """Returns the worst deviation, relative to the scale; infinite if it is no number."""
        with np.errstate(all="ignore"):
            deviation = float(np.abs(one - two).max())
        # What is no number differs from everything.
        return deviation / self.scale(name) if math.isfinite(deviation) else math.inf

    def effects(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> dict[str, Effect]:
        """Returns what has changed between two evaluations, but for rounding."""
        found = {}
        for name, values in after.items():
            relative = self.relative(name, values, before[name])
            if relative > 1e-12:  # rounding
                total = self.relative(name, self.one[name], self.two[name])
                # Of what is rounding, nothing is a share.
                share = relative / total if 1e-9 < total < math.inf else math.inf
                found[name] = Effect(relative * self.scale(name), relative, share)
        return found


def about_kind(kind: str) -> str:
    """Returns what remarks of a kind are about, in a few words; by default that files differ."""
    key = _ABOUT.get(kind, "about-difference")
    return fill_template(phrase(key, "en"), {"kind": kind}, "en")


_ABOUT = {
    "part": "about-part",
    "cause": "about-cause",
    "joint": "about-joint",
    "agreement": "about-agreement",
    "guess": "about-guess",
    "refused": "about-refused",
    "stale": "about-stale",
}


@dataclass(frozen=True)
class ModelNames:
    """What two models are called that are compared.

    Attributes:
        first: The first.
        second: The second.
        alike: Whether both are of one format, so that what one states the other could state, too.
    """

    first: Term
    second: Term
    alike: bool

    @property
    def named(self) -> dict[str, Any]:
        """Both names, as values of a diagnostic."""
        return {"first": self.first, "second": self.second}


FORMATS = ModelNames(Term("the URDF"), Term("the MJCF"), alike=False)
"""A URDF and an MJCF."""

VERSIONS = ModelNames(Term("the old file"), Term("the new file"), alike=True)
"""Two files of one format."""


def with_names_of_models(message: Diagnostic, names: Mapping[str, Term]) -> Diagnostic:
    """Returns a difference with other names of the models, {name: other name}."""

    def renamed(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(renamed(one) for one in value)
        if isinstance(value, Diagnostic):
            return with_names_of_models(value, names)
        return names.get(str(value), value) if isinstance(value, Term) else value

    values = {key: renamed(value) for key, value in message.values.items()}
    return replace(message, values=FrozenDict(values)) if names else message


def number_pair(one: float, two: float, unit: str) -> dict[str, Any]:
    """Returns the first's number and the second's, as values of a diagnostic."""
    return {"one": describe_bound(one, unit), "two": describe_bound(two, unit)}


MANIFOLD = 10.0
"""From so many times on a change is said as a factor: no one reads thousands of percent."""


def describe_ratio(urdf: float, mjcf: float) -> Diagnostic | None:
    """Returns the difference, or the mistake where the ratio is telling."""
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
    if ratio > MANIFOLD:
        return diagnose("relative-factor", times=ratio)
    return diagnose("relative-change", change=Quantity(ratio - 1, "1"))


def in_degrees(urdf: float, mjcf: float) -> Diagnostic | None:
    """Guesses degrees for radians, where the ratio is theirs."""
    if urdf == 0 or not math.isfinite(urdf) or not math.isfinite(mjcf):
        return None
    ratio = mjcf / urdf
    if any(math.isclose(ratio, math.degrees(1.0) ** sign, rel_tol=1e-2) for sign in (1, -1)):
        return diagnose("guess-degrees-for-radians")
    return None


def quaternion_order(urdf: Array, mjcf: Array) -> Diagnostic | None:
    """Tells whether reading the MJCF's quaternion as (x, y, z, w) would end the difference."""
    x, y, z, w = pin.Quaternion(mjcf).coeffs()
    # The file's four numbers were taken for (w, x, y, z); in another order they are (x, y, z, w).
    quaternion = pin.Quaternion(np.array([w, x, y, z]))
    if np.allclose(quaternion.toRotationMatrix(), urdf, atol=1e-4):
        return diagnose("guess-quaternion-order")
    return None


# Which numbers of two trees of parameters differ, and how to take each over.


@dataclass(frozen=True, eq=False)
class Change(Stated):
    """A difference between two sets of parameters, and how to take it over."""

    felt: bool = True  # by the dynamics

    def apply(self, one: MultibodyTree, two: MultibodyTree) -> MultibodyTree:
        """Returns the first robot with the second's value."""
        return with_value_of(one, two, self.kind, self.element)


NOTHING = Tolerances(**{kind.name: 1e-300 for kind in fields(Tolerances)})


def change_of(
    code: str,
    kind: str,
    subject: tuple[str, str] | None,
    values: tuple[Any, Any],
    unit: str,
    sides: ModelNames,
    said: Mapping[str, Any] = FrozenDict(),
    *,
    element: str = "",
    shown: tuple[Any, Any] | None = None,
    felt: bool = True,
) -> Change:
    """Returns a difference; its message has both values, or what is shown of them, and more."""
    one, two = (_as_said(value, unit) for value in shown or values)
    message = diagnose(code, subject=subject, one=one, two=two, **said, **sides.named)
    named = element if subject is None else element or subject[1]
    return Change(kind, named, *values, unit, message, felt=felt)


def _as_said(value: Any, unit: str) -> Any:
    """Returns a value as a message has it: numbers with their unit, and words as they are."""
    if isinstance(value, str):
        return value
    if isinstance(value, np.ndarray):
        return Vector.rounded(value, unit)
    return describe_bound(value, unit)


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
        code = "gravity-differs" if sides.alike else "gravity-stated"
        pulls = one.gravity, two.gravity
        yield change_of(code, "gravity", None, pulls, "m/s^2", sides, element="option")
    free, damping = ("body", one.base), (one.base_damping, two.base_damping)
    if abs(damping[1] - damping[0]) > tolerances.damping * max(damping):
        yield change_of("free-joint-damping-differs", "damping", free, damping, "N s/m", sides)
    # A URDF is given the MJCF's: see `attribution.armature_differences`.
    if sides.alike and two.base_armature != one.base_armature:
        armature, unit = (one.base_armature, two.base_armature), "kg and kg m^2"
        yield change_of("free-joint-armature-differs", "armature", free, armature, unit, sides)
    for name, (owner, position) in one.frames.items():
        other_owner, other = two.frames[name]
        apart, subject = float(np.linalg.norm(other - position)), ("frame", name)
        if owner != other_owner:
            code, places = "frame-on-other-body", (position, other)
            links = one.bodies[owner].link, two.bodies[other_owner].link
            yield change_of(code, "frame", subject, places, "m", sides, shown=links)
        elif apart > tolerances.position:
            far = {"distance": Quantity(apart, "m")}
            yield change_of("frame-apart", "frame", subject, (position, other), "m", sides, far)


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
    mass = one.mass, two.mass
    if abs(two.mass - one.mass) > tolerances.mass * max(map(abs, mass)):
        guess = {"guess": describe_ratio(*mass)}
        yield change_of("mass-differs", "mass", body, mass, "kg", sides, guess, element=name)
    apart = float(np.linalg.norm(two.com - one.com))
    if apart > tolerances.com:
        coms, way = (one.com, two.com), {"distance": Quantity(apart, "m")}
        yield change_of("com-differs", "com", body, coms, "m", sides, way, element=name)
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
        message = diagnose("inertia-differs", subject=body, entries=entries)
        yield Change("inertia", name, one.inertia, two.inertia, "kg m^2", message)


def _joint_changes(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yields another parent, type, place or axis of a joint, and other numbers."""
    subject = "joint", name
    if one.parent != two.parent:
        yield change_of("parent-differs", "parent", subject, (one.parent, two.parent), "", sides)
    if one.slides != two.slides:
        kinds = ("prismatic", "revolute") if one.slides else ("revolute", "prismatic")
        shown = Term(kinds[0]), Term(kinds[1])
        yield change_of("joint-type-differs", "type", subject, kinds, "", sides, shown=shown)
    places = one.position, two.position
    apart = float(np.linalg.norm(two.position - one.position))
    if apart > tolerances.position:
        way = {"distance": Quantity(apart, "m")}
        yield change_of("joint-position-differs", "position", subject, places, "m", sides, way)
    turn = pin.log3(one.rotation.T @ two.rotation)
    angle = float(np.linalg.norm(turn))
    if angle > tolerances.rotation:
        message = diagnose(
            "joint-frame-turned",
            subject=subject,
            angle=Quantity(angle, "rad"),
            axis=Vector.rounded(turn / angle),
            about_its_axis=abs(float(turn @ one.axis)) > (1 - 1e-6) * angle,
            guess=quaternion_order(one.rotation, two.rotation),
        )
        yield Change("rotation", name, one.rotation, two.rotation, "1", message)
    between = math.acos(min(1.0, max(-1.0, float(one.axis @ two.axis))))
    if float(np.linalg.norm(np.cross(one.axis, two.axis))) > tolerances.axis or between > 1.0:
        code = "axis-reversed" if between > math.pi - tolerances.axis else "axis-turned"
        axes, how = (one.axis, two.axis), {"angle": Quantity(between, "rad")}
        yield change_of(code, "axis", subject, axes, "1", sides, how)
    yield from _joint_numbers(name, one, two, tolerances, sides)


def _joint_numbers(
    name: str, one: TreeJoint, two: TreeJoint, tolerances: Tolerances, sides: ModelNames
) -> Iterable[Change]:
    """Yields other limits, damping and friction; and armature, where both can state it."""
    for attribute in TREE_ATTRIBUTES:
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
        endless = (
            kind in ("lower limit", "upper limit") and one.slides and abs(a) >= MAX_SLIDE_POSITION
        )
        if endless and math.isinf(b) and not sides.alike:
            continue  # a URDF cannot state a slide without
        guess = in_degrees(a, b)
        if kind == "effort" and a == 0 and not sides.alike:
            guess = diagnose("guess-zero-for-unknown")
        code, said = "joint-number-differs", {"what": Term(kind), "guess": guess}
        subject, felt = ("joint", name), attribute.felt
        yield change_of(code, kind, subject, (a, b), unit, sides, said, felt=felt)


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
