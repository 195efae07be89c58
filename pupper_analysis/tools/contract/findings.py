"""What differs between sources: reads facts alone, and says nothing of how they were read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, Term, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import mirror_pairs
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.contract.facts import QUANTITIES, Kind, Role, Statement, kind_of
from pupper_analysis.tools.contract.orders import (
    Placed,
    like_mirror,
    mirrored_sign,
    observed,
)

_SAME = 2e-6
"""Relative: what single precision and seven printed digits leave of a number."""

_TOLERANCES = {kind: getattr(Tolerances(), kind)
               for kind in ("effort", "velocity", "damping", "friction")}  # fmt: skip

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
    values: tuple[float | None, ...]
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
        moved: The greatest angle by which a joint is moved so that all feet are on the ground
            (rad); None where it does not stand.
        sag: By how much the base sinks with the source's gains (m); None if not known.
        utilisation: The greatest share of a motor's limit; None likewise.
        stays: Whether it stays up in simulation with these gains and no feed-forward; None if
            that was not simulated.
        problem: Why something is not known; None if nothing.
    """

    source: str
    height: float
    moved: float | None
    sag: float | None
    utilisation: float | None
    stays: bool | None
    problem: Diagnostic | None


def find_all(
    placed: Sequence[Placed], model: RobotModel, joints: tuple[str, ...]
) -> tuple[Disagreement, ...]:
    """Returns what differs, the worst first.

    Args:
        placed: The sources, in the order in which one is held against another.
        model: The robot.
        joints: Its joints.
    """
    found = [*_orders(placed), *_observations(placed)]
    for quantity in dict.fromkeys(
        [*QUANTITIES, *(what for one in placed for what, _ in one.facts)]
    ):
        kind = kind_of(quantity)
        if kind.severity is not None:
            found += _of_quantity(quantity, kind, placed, ("", *joints))
            if kind.mirrored:
                found += _mirrored(quantity, kind, placed, model, joints)
    offsets = {one.joints for one in found if one.kind == "default angle"}
    kept = [one for one in found if one.kind != "action offset" or one.joints not in offsets]
    return tuple(sorted(kept, key=lambda one: one.severity.rank))


def agree(one: Statement, two: Statement) -> bool:
    """Whether two numbers are one: the same, or the one rounded from the other, worked out.

    What models state is held as near as ``crosscheck`` holds them.
    """
    a, b = one.value, two.value
    if a is None or b is None:
        return True  # nobody knows
    if a == b or abs(a - b) <= _TOLERANCES.get(one.quantity, _SAME) * max(abs(a), abs(b)):
        return True
    if one.quantity in _LIMITS and abs(a - b) <= Tolerances().limit:
        return True
    for rounded, fine in ((one, two), (two, one)):
        written = fine.decimals is None or fine.decimals >= _FINE
        if rounded.decimals is None or not written or rounded.value is None or fine.value is None:
            continue
        step = 0.5 * 10.0**-rounded.decimals
        near = abs(rounded.value - fine.value)
        if (near <= step * (1 + 1e-9) and near <= _ROUNDED * abs(fine.value)) or near < 1e-9:
            return True
    return False


def _of_quantity(
    quantity: str, kind: Kind, placed: Sequence[Placed], joints: tuple[str, ...]
) -> Iterator[Disagreement]:
    """Yields in what each source differs from the first that states a joint's number."""
    pairs: dict[tuple[int, int], list[str]] = {}
    for joint in joints:
        stating = [number for number, one in enumerate(placed)
                   if (quantity, joint) in one.facts
                   and one.facts[quantity, joint].value is not None]  # fmt: skip
        for other in stating[1:]:
            one, two = (placed[n].facts[quantity, joint] for n in (stating[0], other))
            if quantity == "effort" and not math.isfinite(max(one.value or 0, two.value or 0)):
                continue
            if not agree(one, two):
                pairs.setdefault((stating[0], other), []).append(joint)
    for (first, other), differing in pairs.items():
        yield from _grouped(quantity, kind, placed[first], placed[other], differing)


def _grouped(
    quantity: str, kind: Kind, first: Placed, other: Placed, joints: list[str]
) -> Iterator[Disagreement]:
    """Yields findings of two sources: one of an order, or one for each pair of values."""
    one = {joint: first.facts[quantity, joint] for joint in joints}
    two = {joint: other.facts[quantity, joint] for joint in joints}
    names: dict[str, Any] = {"first": first.source.name, "second": other.source.name}

    def sides(joint: str) -> tuple[Side, Side]:
        return (first, one[joint]), (other, two[joint])

    swapped = _exchange(one, two)
    if swapped:
        pairs = tuple(f"{joint} ↔ {whose}" for joint, whose in swapped.items() if joint < whose)
        message = diagnose("contract-exchanged", what=Term(quantity), joints=tuple(joints),
                        pairs=pairs or tuple(f"{a} → {b}" for a, b in swapped.items()),
                        file=names["second"], other=names["first"])  # fmt: skip
        yield _finding(quantity, message, sides(joints[0]), kind.severity, joints=joints,
                       slip="order", unit=kind.unit)  # fmt: skip
        return
    groups: dict[tuple[float, float], list[str]] = {}
    for joint in joints:
        a, b = one[joint].value or 0.0, two[joint].value or 0.0
        signs = (1 if a >= 0 else -1) if quantity in _ANGLES else 1
        groups.setdefault((round(signs * a, 9), round(signs * b, 9)), []).append(joint)
    # What asks for less than the model allows may be meant.
    asks = (first.source.role, other.source.role).count(Role.MODEL) == 1 and quantity in _LIMITS
    lower = -1 if quantity == "lower limit" else 1
    for (a, b), members in groups.items():
        slip, unit = _slip(quantity, a, b)
        meant = asks and lower * a <= lower * b + 1e-6
        near = quantity in ("effort", "velocity") and abs(b - a) <= _NEAR * max(abs(a), abs(b))
        head = members[0]
        message = diagnose("contract-differs", subject=("joint", head) if head else None,
                        what=_term(quantity), others=tuple(members[1:]),
                        one=Quantity(one[head].value or 0.0, kind.unit),
                        two=Quantity(two[head].value or 0.0, kind.unit), **names,
                        sign=slip == "sign" or None, unit=unit or None)  # fmt: skip
        yield _finding(quantity, message, sides(head), None if meant or near else kind.severity,
                       joints=[one for one in members if one], slip=slip, unit=kind.unit,
                       effects=_effects(quantity, a, b))  # fmt: skip


def _term(quantity: str) -> Term | str:
    return Term(quantity) if quantity in QUANTITIES else quantity


_NEAR = 0.02
"""Relative difference of limits of motors that is no more than how a data sheet is rounded."""

_ANGLES = ("default angle", "action offset")


def _exchange(one: dict[str, Statement], two: dict[str, Statement]) -> dict[str, str]:
    """Returns {joint: whose number it has}, if all that differs is whose each number is."""
    if len(one) < 2:
        return {}
    a = Counter(round(said.value or 0.0, 6) for said in one.values())
    b = Counter(round(said.value or 0.0, 6) for said in two.values())
    if a != b or any(count > len(one) / 2 for count in a.values()) or _all_opposite(one, two):
        return {}
    left, found = list(one), {}
    for joint, said in two.items():
        fits = [each for each in left if each != joint and agree(one[each], said)]
        # Those that changed places with each other before all others.
        best = next(
            (each for each in fits if agree(two[each], one[joint])), fits[0] if fits else ""
        )
        if not best:
            return {}
        left.remove(best)
        found[joint] = best
    return found


def _all_opposite(one: dict[str, Statement], two: dict[str, Statement]) -> bool:
    """Whether each number is the other's, with the other sign: an exchange of signs, not sides."""
    return all(abs((one[j].value or 0.0) + (two[j].value or 0.0)) < 1e-9 for j in one)


def _slip(quantity: str, a: float, b: float) -> tuple[str, str]:
    """Returns which slip would make the one number of the other, and the unit, if it is that."""
    if a and abs(a + b) <= _SAME * abs(a):
        return "sign", ""
    if a and b:
        for unit, size in _UNITS.items():
            if unit != "mm" or quantity == "action scale":
                for ratio in (b / a, a / b):
                    if abs(ratio / size - 1) < _UNIT_TOLERANCE:
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


Side = tuple[Placed, Statement]
"""A source, and what it states."""


def _finding(
    kind: str,
    message: Diagnostic,
    sides: tuple[Side, Side],
    severity: Severity | None = Severity.ERROR,
    *,
    joints: Sequence[str] = (),
    slip: str = "",
    unit: str = "",
    effects: tuple[Diagnostic, ...] = (),
) -> Disagreement:
    """Returns the finding that two sides differ."""
    names, values, places = zip(
        *((one.source.name, said.value, said.place.path) for one, said in sides), strict=True
    )
    return Disagreement(kind, slip, tuple(joints), names, values, unit, severity or Severity.NOTE,
                        message, places, effects)  # fmt: skip


def _mirrored(
    quantity: str, kind: Kind, placed: Sequence[Placed], model: RobotModel, joints: tuple[str, ...]
) -> Iterator[Disagreement]:
    """Yields where a source has another number left than right: it contradicts itself."""
    for source in placed:
        for joint, other in mirror_pairs(joints):
            one, two = (source.facts.get((quantity, each)) for each in (joint, other))
            if one is None or two is None or (one.implied and two.implied):
                continue
            if one.value is None or two.value is None:
                continue
            sign = mirrored_sign(model, joint, other) if kind.mirrored < 0 else 1
            if like_mirror(one.value, two.value, sign):
                continue
            message = diagnose("contract-mirror", subject=("joint", joint), what=Term(quantity),
                            mirror=other, one=Quantity(one.value, kind.unit),
                            two=Quantity(two.value, kind.unit), file=source.source.name,
                            wanted=Quantity(sign * one.value, kind.unit))  # fmt: skip
            yield _finding(quantity, message, ((source, one), (source, two)), Severity.WARNING,
                           joints=(joint, other), slip="mirror", unit=kind.unit)  # fmt: skip


def _orders(placed: Sequence[Placed]) -> Iterator[Disagreement]:
    """Yields where what feeds a policy has its joints in another order than another that does."""
    # What was assumed is nobody's; what says which motor each joint is may have any order.
    feeding = [one for one in placed if one.source.role is not Role.MODEL and one.order
               and one.how != "assumed" and (one.facts or one.source.motors)]  # fmt: skip
    for first, other in ((feeding[0], one) for one in feeding[1:]):
        moved = [
            (one, other.order.index(one))
            for one, two in zip(first.order, other.order, strict=False)
            if one != two and one in other.order
        ]
        mapped = first.source.motors and other.source.motors
        if not moved or mapped or set(first.order) != set(other.order):
            continue
        words = tuple(f"{first.order.index(joint)} → {there} ({joint})" for joint, there in moved)
        message = diagnose("contract-order", first=first.source.name, second=other.source.name,
                        count=len(moved), moved=words[:6],
                        more=max(0, len(words) - 6) or None)  # fmt: skip
        places = (one.source.order_place or Place(one.source.path) for one in (first, other))
        yield _in_order("order", message, (first, other), places, [joint for joint, _ in moved])


def _observations(placed: Sequence[Placed]) -> Iterator[Disagreement]:
    """Yields where two sources observe the same things in another order."""
    stating = [one for one in placed if one.source.observations]
    for first, other in ((stating[0], one) for one in stating[1:]):
        mine, theirs = observed(first.source), observed(other.source)
        here = [name for name in mine if name in theirs]
        there = [name for name in theirs if name in mine]
        if here != there:
            message = diagnose("contract-observed-order", one=tuple(here), two=tuple(there),
                            first=first.source.name, second=other.source.name)  # fmt: skip
            places = (one.source.observations[0][2] for one in (first, other))
            yield _in_order("observations", message, (first, other), places)


def _in_order(
    kind: str,
    message: Diagnostic,
    both: tuple[Placed, Placed],
    places: Iterable[Place],
    joints: Sequence[str] = (),
) -> Disagreement:
    """Returns the finding that two sources differ in an order."""
    here, there = (Statement(kind, None, place) for place in places)
    return _finding(kind, message, ((both[0], here), (both[1], there)), joints=joints, slip="order")


def pose_effects(
    findings: tuple[Disagreement, ...], poses: tuple[Pose, ...]
) -> tuple[Disagreement, ...]:
    """Adds to findings of default angles how far apart the robot stands in both."""
    heights = {pose.source: pose.height for pose in poses}
    done = []
    for one in findings:
        both = [heights.get(name) for name in one.sources]
        if one.kind == "default angle" and None not in both and both[0] != both[1]:
            apart = Quantity(abs((both[0] or 0.0) - (both[1] or 0.0)), "m")
            message = diagnose("contract-effect-height", height=apart)
            one = replace(one, effects=(*one.effects, message))
        done.append(one)
    return tuple(done)
