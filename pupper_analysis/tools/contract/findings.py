"""What differs between sources: reads facts alone, and says nothing of how they were read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, Term, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.contract.facts import (
    QUANTITIES,
    Fact,
    QuantityKind,
    Role,
    Statement,
    find_quantity_kind,
)
from pupper_analysis.tools.contract.orders import (
    PlacedSource,
    RobotJoints,
    is_mirror_image,
    list_observations,
)

_SAME = 2e-6
"""Relative: what single precision and seven printed digits leave of a number."""

_TOLERANCES = {
    kind: getattr(Tolerances(), kind) for kind in ("effort", "velocity", "damping", "friction")
}

_LIMITS = ("lower limit", "upper limit")

_FINE = 5
"""Digits after the point from which on a number was worked out: others may be rounded from it."""

_ROUNDED = 0.1
"""Greatest share of a number that rounding it takes away or adds: 0.07 for 0.0745."""

_UNITS = {"deg": 180 / math.pi, "rpm": 30 / math.pi, "mm": 1000.0}
"""{unit: how many of it are one of ours}."""

_UNIT_TOLERANCE = 5e-3
"""Relative: degrees are written to three digits."""


@dataclass(frozen=True, eq=False)
class Disagreement(Result):
    """One thing in which sources differ, or in which one contradicts itself.

    Attributes:
        kind: The quantity; order, or observations.
        slip: Which slip it looks like: ``sign``, ``unit``, ``order``, ``mirror``, or "".
        joints: The joints that it is of.
        sources: The sources' names, the one that is held to be meant first.
        values: Of the first joint, in both; None where it is no number.
        unit: Their unit.
        severity: How bad it is.
        diagnostic: What it is.
        places: Where each value stands, ``file:line``.
        effects: What it does.
    """

    kind: str
    slip: str
    joints: tuple[str, ...]
    sources: tuple[str, ...]
    values: tuple[float | None, ...] = field(metadata={"unit": "varies"})
    unit: str
    severity: Severity
    diagnostic: Diagnostic
    places: tuple[str, ...]
    effects: tuple[Diagnostic, ...] = ()

    _reported = ("message",)

    @property
    def message(self) -> str:
        """It in one sentence, with what it does."""
        return "; ".join(map(str, (self.diagnostic, *self.effects)))


@dataclass(frozen=True, eq=False)
class Pose(Result):
    """How a robot stands in the default pose of a source.

    Attributes:
        source: The source's name.
        height: Of the base over the feet in that pose (m).
        sag: By how much the base sinks with the source's gains (m); None if not known.
        utilisation: The greatest share of a motor's limit; None likewise.
        stays: Whether it stays up in simulation with these gains and no feed-forward; None if
            that was not simulated.
        problem: Why something is not known; None if nothing.
    """

    source: str
    height: float = field(metadata={"unit": "m"})
    sag: float | None = field(metadata={"unit": "m"})
    utilisation: float | None = field(metadata={"unit": "1"})
    stays: bool | None
    problem: Diagnostic | None


def find_disagreements(
    placed: Sequence[PlacedSource], model: RobotJoints
) -> tuple[Disagreement, ...]:
    """Returns what differs, the worst first.

    Args:
        placed: The sources, in the order in which one is held against another.
        model: The robot's joints.
    """
    found = [*_orders(placed), *_observations(placed)]
    every = [*QUANTITIES, *(what for one in placed for what, _ in one.facts)]
    for quantity in dict.fromkeys(every):
        kind = find_quantity_kind(quantity)
        if kind.severity is not None:
            found += _of_quantity(quantity, kind, placed, ("", *model.order))
            if kind.mirrored:
                found += _mirrored(quantity, kind, placed, model)
    offsets = {one.joints for one in found if one.kind == "default angle"}
    kept = [one for one in found if one.kind != "action offset" or one.joints not in offsets]
    return tuple(sorted(kept, key=lambda one: one.severity.rank))


def facts_agree(one: Fact, two: Fact) -> bool:
    """Whether two numbers are one: the same, or the one rounded from the other, worked out.

    What models state is held as near as ``crosscheck`` holds them.
    """
    a, b = one.number, two.number
    apart = abs(a - b)
    if a == b or apart <= _TOLERANCES.get(one.quantity, _SAME) * max(abs(a), abs(b)):
        return True
    if one.quantity in _LIMITS and apart <= Tolerances().limit:
        return True
    for rounded, fine in ((one, two), (two, one)):
        written = fine.decimals is None or fine.decimals >= _FINE
        if rounded.decimals is not None and written:
            step = 0.5 * 10.0**-rounded.decimals * (1 + 1e-9)
            if apart <= min(step, _ROUNDED * abs(fine.number)) or apart < 1e-9:
                return True
    return False


FactPair = tuple[Fact, Fact]
"""What two sources state; the first is held to be meant."""


def _of_quantity(
    quantity: str, kind: QuantityKind, placed: Sequence[PlacedSource], joints: tuple[str, ...]
) -> Iterator[Disagreement]:
    """Yields in what each source differs from the first that states a joint's number."""
    pairs: dict[tuple[Role, Role, str, str], dict[str, FactPair]] = {}
    for joint in joints:
        stated = ((one.source.role, one.facts.get((quantity, joint))) for one in placed)
        stating = [(role, said) for role, said in stated if said and said.value is not None]
        for role, two in stating[1:]:
            first, one = stating[0]
            bounded = quantity != "effort" or math.isfinite(max(one.number, two.number))
            if bounded and not facts_agree(one, two):
                key = (first, role, one.source, two.source)
                pairs.setdefault(key, {})[joint] = (one, two)
    for (first, other, *_), differing in pairs.items():
        # What asks for less than the model allows may be meant.
        asks = (first, other).count(Role.MODEL) == 1 and quantity in _LIMITS
        yield from _grouped(quantity, kind, differing, asks)


def _grouped(
    quantity: str, kind: QuantityKind, differing: dict[str, FactPair], asks: bool
) -> Iterator[Disagreement]:
    """Yields findings of two sources: one of an order, or one for each pair of values."""
    joints = list(differing)
    one, two = differing[joints[0]]
    swapped = _exchange(differing)
    if swapped:
        pairs = tuple(f"{joint} ↔ {whose}" for joint, whose in swapped.items() if joint < whose)
        message = diagnose(
            "contract-exchanged",
            what=Term(quantity),
            joints=tuple(joints),
            pairs=pairs or tuple(f"{a} → {b}" for a, b in swapped.items()),
            file=two.source,
            other=one.source,
        )
        yield _finding(quantity, message, (one, two), kind, joints=joints, slip="order")
        return
    groups: dict[tuple[float, float], list[str]] = {}
    for joint, (one, two) in differing.items():
        signs = (1 if one.number >= 0 else -1) if quantity in _ANGLES else 1
        pair = (round(signs * one.number, 9), round(signs * two.number, 9))
        groups.setdefault(pair, []).append(joint)
    lower = -1 if quantity == "lower limit" else 1
    for (a, b), members in groups.items():
        head = members[0]
        one, two = differing[head]
        slip, unit = _slip(quantity, a, b)
        null = a == 0 and quantity in ("effort", "velocity")  # a motor that does nothing
        meant = asks and not null and lower * a <= lower * b + 1e-6
        near = quantity in ("effort", "velocity") and abs(b - a) <= _NEAR * max(abs(a), abs(b))
        what = Term(quantity) if quantity in QUANTITIES else quantity
        message = diagnose(
            "contract-differs",
            subject=("joint", head) if head else None,
            what=what,
            others=tuple(members[1:]),
            one=Quantity(one.number, kind.unit),
            two=Quantity(two.number, kind.unit),
            first=one.source,
            second=two.source,
            sign=slip == "sign" or None,
            unit=unit or None,
        )
        yield _finding(
            quantity,
            message,
            (one, two),
            kind._replace(severity=None) if meant or near else kind,
            joints=members,
            slip=slip,
            effects=_effects(quantity, a, b),
        )


_NEAR = 0.02
"""Relative difference of limits of motors that is no more than how a data sheet is rounded."""

_ANGLES = ("default angle", "action offset")


def _exchange(differing: dict[str, FactPair]) -> dict[str, str]:
    """Returns {joint: whose number it has}, if all that differs is whose each number is."""
    a, b = (Counter(round(both[side].number, 6) for both in differing.values()) for side in (0, 1))
    # If each number is the other's, with the other sign, signs are exchanged, and not sides.
    opposite = all(abs(one.number + two.number) < 1e-9 for one, two in differing.values())
    half = len(differing) / 2
    if half < 1 or a != b or any(count > half for count in a.values()) or opposite:
        return {}
    left, found = list(differing), {}
    for joint, (one, two) in differing.items():
        fits = [each for each in left if each != joint and facts_agree(differing[each][0], two)]
        # Those that changed places with each other before all others.
        both = [each for each in fits if facts_agree(differing[each][1], one)]
        if not fits:
            return {}
        found[joint] = (both or fits)[0]
        left.remove(found[joint])
    return found


def _slip(quantity: str, a: float, b: float) -> tuple[str, str]:
    """Returns which slip would make the one number of the other, and the unit, if it is that."""
    if a and abs(a + b) <= _SAME * abs(a):
        return "sign", ""
    ratios = (b / a, a / b) if a and b else ()
    for unit, size in _UNITS.items():
        near = any(abs(ratio / size - 1) < _UNIT_TOLERANCE for ratio in ratios)
        if near and (unit != "mm" or quantity == "action scale"):
            return "unit", unit
    return "", ""


def _effects(quantity: str, a: float, b: float) -> tuple[Diagnostic, ...]:
    """Returns what a difference does, as far as the numbers alone tell."""
    if quantity in _ANGLES:
        return (diagnose("contract-effect-angle", angle=Quantity(abs(b - a), "rad")),)
    if not (a and b and math.isfinite(a * b)):
        return ()
    share = Quantity(b / a, "1")
    if quantity == "action scale":
        return (diagnose("contract-effect-scale", share=share),)
    if quantity == "kp" and b > 0:
        return (diagnose("contract-effect-kp", share=Quantity(a / b, "1")),)
    if quantity in ("kd", "effort", "velocity"):
        what = Term("damping" if quantity == "kd" else quantity)
        return (diagnose("contract-effect-share", share=share, what=what),)
    return ()


def _finding(
    what: str,
    message: Diagnostic,
    sides: FactPair,
    kind: QuantityKind,
    *,
    joints: Iterable[str] = (),
    slip: str = "",
    effects: tuple[Diagnostic, ...] = (),
) -> Disagreement:
    names, values, places = zip(*((one.source, one.value, one.place) for one in sides), strict=True)
    return Disagreement(
        what,
        slip,
        tuple(filter(None, joints)),
        names,
        values,
        kind.unit,
        kind.severity or Severity.NOTE,
        message,
        places,
        effects,
    )


def _mirrored(
    quantity: str, kind: QuantityKind, placed: Sequence[PlacedSource], model: RobotJoints
) -> Iterator[Disagreement]:
    """Yields where a source has another number left than right: it contradicts itself."""
    for source, pair in product(placed, find_mirror_pairs(model.order)):
        both = [source.facts.get((quantity, each)) for each in pair]
        one, two = (None if said is None or said.value is None else said for said in both)
        if one is None or two is None or (one.implied and two.implied):
            continue
        sign = model.mirrored_sign(*pair) if kind.mirrored < 0 else 1
        if not is_mirror_image(one.value, two.value, sign):
            message = diagnose(
                "contract-mirror",
                subject=("joint", pair[0]),
                what=Term(quantity),
                mirror=pair[1],
                one=Quantity(one.number, kind.unit),
                two=Quantity(two.number, kind.unit),
                file=one.source,
                wanted=Quantity(sign * one.number, kind.unit),
            )
            yield _finding(
                quantity,
                message,
                (one, two),
                kind._replace(severity=Severity.WARNING),
                joints=pair,
                slip="mirror",
            )


def _orders(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yields where what feeds a policy has its joints in another order than another that does."""
    # What was assumed is nobody's; what says which motor each joint is may have any order.
    feeding = [
        one
        for one in placed
        if one.source.role is not Role.MODEL
        and one.order
        and one.how != "assumed"
        and (one.facts or one.source.motors)
    ]
    for first, other in ((feeding[0], one) for one in feeding[1:]):
        moved = {
            one: f"{first.order.index(one)} → {other.order.index(one)} ({one})"
            for one, two in zip(first.order, other.order, strict=False)
            if one != two and one in other.order
        }
        mapped = first.source.motors and other.source.motors
        if moved and not mapped and set(first.order) == set(other.order):
            message = diagnose(
                "contract-order",
                first=first.source.name,
                second=other.source.name,
                count=len(moved),
                moved=tuple(moved.values())[:6],
                more=max(0, len(moved) - 6) or None,
            )
            sides = [
                one.fact(Statement("order", None, one.order_place or Place(one.path)))
                for one in (first.source, other.source)
            ]
            yield _finding(
                "order", message, (sides[0], sides[1]), _ORDER, joints=moved, slip="order"
            )


def _observations(placed: Sequence[PlacedSource]) -> Iterator[Disagreement]:
    """Yields where two sources observe the same things in another order."""
    stating = [one.source for one in placed if one.source.observations]
    for first, other in ((stating[0], one) for one in stating[1:]):
        mine, theirs = list_observations(first), list_observations(other)
        here = tuple(name for name in mine if name in theirs)
        there = tuple(name for name in theirs if name in mine)
        if here != there:
            message = diagnose(
                "contract-observed-order", one=here, two=there, first=first.name, second=other.name
            )
            sides = [
                one.fact(Statement("observations", None, one.observations[0][2]))
                for one in (first, other)
            ]
            yield _finding("observations", message, (sides[0], sides[1]), _ORDER, slip="order")


_ORDER = QuantityKind("", Severity.ERROR, 0, is_setting=True)


def add_height_effects(
    findings: tuple[Disagreement, ...], poses: tuple[Pose, ...]
) -> tuple[Disagreement, ...]:
    """Adds to findings of default angles how far apart the robot stands in both."""
    heights = {pose.source: pose.height for pose in poses}
    done = []
    for one in findings:
        both = {heights[name] for name in one.sources if name in heights}
        if one.kind == "default angle" and len(both) == 2:
            apart = Quantity(max(both) - min(both), "m")
            message = diagnose("contract-effect-height", height=apart)
            one = replace(one, effects=(*one.effects, message))
        done.append(one)
    return tuple(done)
