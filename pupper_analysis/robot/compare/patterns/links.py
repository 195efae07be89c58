"""Links that one file lacks, or that weigh a multiple: what the folded bodies that differ hide.

Masses and moments add up, so the difference of two folded bodies is that of their links. A slip is
undone, link by link; it is a cause only if nothing of the body's differences is left then.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.multibody import TreeBody
from pupper_analysis.robot.compare.changes import body_changes
from pupper_analysis.robot.compare.differences import OF_INERTIALS
from pupper_analysis.robot.compare.links import ComparedLink, body_moments, from_moments
from pupper_analysis.robot.compare.patterns.case import Found, PatternCase, PatternFinding

Array = NDArray[np.float64]

_MOST_SUBSET_LINKS = 12
"""Links of one body of which every subset is tried: 4096 of them, in a millisecond."""

_MOST_RESIDUAL = 0.02
"""Share of a body's difference that may be left where a slip is undone.

Files of 5 to 6 digits leave some thousandths of a link that is a hundredth of its body. A wrong set
of links leaves about as much as it takes away.
"""


@dataclass(frozen=True, eq=False)
class _Slip:
    """What is wrong with some links of one body, and what is gone if it is undone.

    Attributes:
        mover: The joint that moves the body, or the base.
        links: The links.
        lacks: The file that lacks them, ``URDF`` or ``MJCF``; empty if they weigh a multiple.
        factor: What they weigh in the MJCF, relative to the URDF.
        inertia: Whether their inertias are that multiple, too.
    """

    mover: str
    links: tuple[ComparedLink, ...]
    lacks: str
    factor: float = 0.0
    inertia: bool = False


def other_links(case: PatternCase) -> Found:
    """Finds links that one file lacks, or that weigh another multiple, as many as alike at once."""
    differ = dict.fromkeys(name for kind, name in case.open if kind in OF_INERTIALS)
    if not differ:
        return
    slips = [slip for name in differ if (slip := _slip(case, name)) is not None]
    groups: dict[tuple[str, float, bool], list[_Slip]] = defaultdict(list)
    for slip in slips:
        groups[slip.lacks, float(f"{slip.factor:.3g}"), slip.inertia].append(slip)
    for (lacks, *_), group in groups.items():
        movers = {slip.mover for slip in group}
        explained = {key for key in case.open if key[0] in OF_INERTIALS and key[1] in movers}
        if lacks:
            file = case.urdf if lacks == "MJCF" else case.mjcf
            known = [link.name for links in file.values() for link in links]
            yield PatternFinding("links", _lacking(group, known), explained)
        else:
            yield PatternFinding("scaled links", _scaled(group), explained)


def _slip(case: PatternCase, name: str) -> _Slip | None:
    """Returns the one slip that explains how a body differs, if any does."""
    one, two = case.first.bodies[name], case.second.bodies[name]
    apart = body_moments(one) - body_moments(two)
    if not one.mass or not two.mass or not apart[0]:
        return None
    lacks, links = ("MJCF", case.urdf) if apart[0] > 0 else ("URDF", case.mjcf)
    own = [link for link in links.get(name, ()) if link.body.mass <= 1.01 * abs(apart[0])]
    if len(own) < len(links.get(name, ())):  # a body of which all links are gone is another thing
        for chosen in _subsets(own, abs(apart[0])):
            extra = sum((body_moments(link.body) for link in chosen), start=np.zeros(10))
            less = from_moments(body_moments(one if lacks == "MJCF" else two) - extra)
            if _is_it(case, name, less, two if lacks == "MJCF" else one, extra, apart):
                return _Slip(name, chosen, lacks)
    kinds = {kind for kind, element in case.open if element == name}
    alone = len(case.urdf.get(name, ())) == len(case.mjcf.get(name, ())) == 1
    if alone and not kinds & {"com", "inertia"} and not _power(two.mass / one.mass):
        return None  # one number of one link: the difference says it all
    # What another cause explains of the inertia says nothing of the link's.
    both = (False,) if ("inertia", name) in case.taken else (True, False)
    for link, inertia in product(case.urdf.get(name, ()), both):
        factor = 1.0 - float(apart[0]) / link.body.mass
        if factor <= 0:
            continue
        changed = TreeBody(
            factor * link.body.mass,
            link.body.com,
            (factor if inertia else 1.0) * link.body.inertia,
        )
        extra = body_moments(link.body) - body_moments(changed)
        if _is_it(case, name, from_moments(body_moments(one) - extra), two, extra, apart):
            return _Slip(name, (link,), "", factor, inertia)
    return None


def _subsets(links: Sequence[ComparedLink], mass: float) -> Iterator[tuple[ComparedLink, ...]]:
    """Yields sets of links of a mass, the smallest first; of many links those alike in name."""
    if len(links) > _MOST_SUBSET_LINKS:
        named = {link.name: link for link in links}
        alike = [[named[name] for name in names] for names in by_pattern(list(named)).values()]
        tries = [*alike, *([link] for link in links), list(links)]
    else:
        masses = np.array([link.body.mass for link in links])
        choices = np.array(list(product((False, True), repeat=len(links))))
        near = np.abs(choices @ masses - mass) <= 1.5 * _MOST_RESIDUAL * mass if len(links) else []
        tries = [
            [link for link, taken in zip(links, choice, strict=True) if taken]
            for choice in choices[near]
        ]
    for chosen in sorted(tries, key=len):
        if chosen:
            yield tuple(chosen)


def _is_it(
    case: PatternCase, name: str, one: TreeBody, two: TreeBody, extra: Array, apart: Array
) -> bool:
    """Tells whether two bodies are the same, and what was undone is what they differed by.

    But for an inertia that another cause explains already: what is left of it says nothing.
    """
    taken = {kind for kind, element in case.taken if element == name}
    changes = {change.kind for change in body_changes(name, one, two, case.tolerances)}
    if not one.mass > 0 or changes - taken:
        return False
    scale = _scale(case.first.bodies[name], case.second.bodies[name])
    if "inertia" in taken:
        scale[4:] = math.inf
    extra = extra if float(extra[0] * apart[0]) >= 0 else -extra
    left, whole = (float(np.linalg.norm(each / scale)) for each in (apart - extra, apart))
    return left <= _MOST_RESIDUAL * whole


def _scale(one: TreeBody, two: TreeBody) -> Array:
    """Returns what moments are weighed by (10,): lengths by a body's radius of gyration."""
    mass = max(one.mass, two.mass)
    turning = max(float(np.trace(body.inertia)) for body in (one, two))
    far = max(float(np.linalg.norm(body.com)) for body in (one, two))
    length = max(math.sqrt(max(turning, 0.0) / mass), far, 1e-6)
    return np.array([1.0, *(length,) * 3, *(length**2,) * 6])


def _lacking(slips: Sequence[_Slip], known: Sequence[str]) -> Diagnostic:
    """Says which links a file lacks, those of one name pattern at once.

    Args:
        slips: What is wrong.
        known: All links with mass of the other file.
    """
    links = {link.name: link.body.mass for slip in slips for link in slip.links}
    other = "URDF" if slips[0].lacks == "MJCF" else "MJCF"
    groups = sorted(
        by_pattern(list(links)).items(), key=lambda group: -sum(links[name] for name in group[1])
    )
    told = []
    for pattern, names in groups:
        masses = [links[name] for name in names]
        every = sum(fnmatchcase(name, pattern) for name in known)
        alike = len(names) > 1 and math.isclose(min(masses), max(masses), rel_tol=1e-6)
        told.append(
            diagnose(
                "links-of-a-pattern",
                pattern=pattern,
                count=len(names) if len(names) > 1 else None,
                every=every if every > len(names) > 1 else None,
                mass=Quantity(masses[0] if alike else sum(masses), "kg"),
                each=alike,
            )
        )
    mass = Quantity(sum(links.values()), "kg")
    return diagnose("links-lacking", lacks=slips[0].lacks, has=other, mass=mass, links=told)


def _scaled(slips: Sequence[_Slip]) -> Diagnostic:
    """Says which links weigh a multiple in the MJCF."""
    factor = float(f"{slips[0].factor:.6g}")
    links = [
        diagnose(
            "mass-of-a-link",
            subject=("link", link.name),
            urdf=Quantity(link.body.mass, "kg"),
            mjcf=Quantity(slip.factor * link.body.mass, "kg"),
        )
        for slip in slips
        for link in slip.links
    ]
    power = _power(factor)
    guess = None
    if power:
        grams = abs(power) == _GRAMS
        guess = diagnose("guess-grams-for-kilograms" if grams else "guess-decimal-point")
    inertia = slips[0].inertia
    return diagnose("links-scaled", links=links, factor=factor, inertia=inertia, guess=guess)


_GRAMS = 3  # powers of ten between g and kg


def _power(factor: float) -> int:
    """Returns which power of ten a factor is; 0 if it is none, or 1."""
    power = math.log10(factor)
    return round(power) if math.isclose(power, round(power), abs_tol=1e-3) else 0


def by_pattern(names: Sequence[str]) -> dict[str, list[str]]:
    """Returns {``*_rotor`` or ``sensor_*``, or a name by itself: the names}, the largest first."""
    left, found = list(names), dict[str, list[str]]()
    while left:
        alike: dict[str, list[str]] = defaultdict(list)
        for name in left:
            for place in (match.start() for match in re.finditer(r"[^A-Za-z0-9]", name)):
                alike[f"*{name[place:]}"].append(name)
                alike[f"{name[: place + 1]}*"].append(name)
        pattern, group = max(
            alike.items(), key=lambda each: (len(each[1]), len(each[0])), default=("", [])
        )
        if len(group) < 2:
            return found | {name: [name] for name in left}
        found[pattern] = group
        left = [name for name in left if name not in group]
    return found
