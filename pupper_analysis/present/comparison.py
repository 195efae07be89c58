"""What the comparison of two model files finds, in order, and for machines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.present.formats import Annotation, CheckedItem
from pupper_analysis.robot.compare.compare import Comparison
from pupper_analysis.robot.compare.differences import Difference, about_kind
from pupper_analysis.robot.compare.patterns import PatternCause


def by_cause(comparison: Comparison) -> tuple[tuple[PatternCause, ...], list[list[Difference]]]:
    """Returns the causes, and in groups the differences that none explains."""
    explained = {number for cause in comparison.causes for number in cause.differences}
    rest = [
        difference
        for number, difference in enumerate(comparison.differences)
        if number not in explained
    ]
    return comparison.causes, _groups(rest)


def first_to_mend(
    comparison: Comparison, causes: Sequence[PatternCause], groups: Sequence[Sequence[Difference]]
) -> Diagnostic:
    """Returns what is to be mended first."""
    if causes and causes[0].leads:
        return causes[0].diagnostic
    if comparison.parts:
        return comparison.parts[0]
    if causes and (causes[0].differences[0] == 0 or not groups):
        return causes[0].diagnostic
    if groups:
        return groups[0][0].diagnostic
    if comparison.objections:
        return comparison.objections[0]
    if comparison.agree and comparison.mount is not None:
        return diagnose("agree-but-tilted", tilt=comparison.mount.diagnostic)
    if comparison.agree:
        return diagnose("agree")
    return diagnose("joints-not-the-same")


def matching_notes(comparison: Comparison) -> Iterable[Diagnostic]:
    """Says how joints were matched, and what was left out."""
    yield from comparison.notes
    if comparison.mount is not None:
        yield diagnose("tilt-is-no-difference", tilt=comparison.mount.diagnostic)
    if comparison.guessed:
        yield _guessed(comparison)
    for joints, file in (
        (comparison.only_urdf, comparison.urdf),
        (comparison.only_mjcf, comparison.mjcf),
    ):
        if joints:
            taken_off = bool(comparison.parts)
            yield diagnose("joints-in-one-file", file=file, joints=joints, taken_off=taken_off)


def _groups(differences: Iterable[Difference]) -> list[list[Difference]]:
    """Puts together differences of one kind with the same two values."""
    groups: dict[tuple[str, str, str], list[Difference]] = {}
    for difference in differences:
        key = (difference.kind, str(difference.urdf), str(difference.mjcf))
        groups.setdefault(key, []).append(difference)
    return list(groups.values())


def effects_told(difference: Difference) -> Diagnostic:
    """Returns what a difference does."""
    if not difference.effects:
        return diagnose("no-effect")
    effects = [
        diagnose(
            "effect",
            subject=("quantity", name),
            what=Term(name),
            share=Quantity(effect.share, "1") if math.isfinite(effect.share) else None,
            relative=effect.relative,
        )
        for name, effect in sorted(difference.effects.items(), key=lambda item: -item[1].share)
    ]
    return diagnose("effects", effects=effects)


def comparison_remarks(comparison: Comparison) -> list[Annotation]:
    """Returns a remark per difference, at its place in the URDF, and one per joint left over."""
    urdf, mjcf = comparison.urdf, comparison.mjcf
    found = [_remark("part", "part", part, urdf) for part in comparison.parts]
    for cause in comparison.causes:
        first = comparison.differences[cause.differences[0]]
        found.append(
            _remark("cause", "cause", cause.diagnostic, first.urdf_place, first.mjcf_place)
        )
    for one in comparison.differences:
        title = f"{one.kind} of {one.element}"
        found.append(_remark(one.kind, title, one.diagnostic, one.urdf_place, one.mjcf_place))
    found += [
        _remark("joint", f"joint {name}", told, file) for name, told, file in _left_over(comparison)
    ]
    found += [_remark("agreement", "agreement", one, mjcf) for one in comparison.objections]
    if comparison.guessed:
        guess = _remark("guess", "guessed joints", _guessed(comparison), urdf)
        found.append(replace(guess, level="warning"))
    return found


def _left_over(comparison: Comparison) -> Iterable[tuple[str, Diagnostic, str]]:
    """Yields joints that one of the files has: name, what is to be said, and that file."""
    urdf, mjcf = comparison.urdf, comparison.mjcf
    for joints, file, other in (
        (comparison.only_urdf, urdf, mjcf),
        (comparison.only_mjcf, mjcf, urdf),
    ):
        for name in joints:
            subject = ("joint", name)
            yield name, diagnose("joint-not-in-file", subject=subject, lacks=other), file


def _guessed(comparison: Comparison) -> Diagnostic:
    pairs = [f"{one}={two}" for one, two in comparison.guessed.items()]
    return diagnose("joints-matched-otherwise", pairs=pairs)


def _remark(
    kind: str, title: str, told: Diagnostic, place: str | None, other: str | None = None
) -> Annotation:
    message = str(told) if other is None else f"{told} [{other}]"
    rule = f"crosscheck/{kind}"
    about = about_kind(kind)
    return Annotation("error", title, message, place, rule=rule, about=about, diagnostic=told)


def comparison_cases(comparison: Comparison) -> list[CheckedItem]:
    """Returns one case per kind of number of each joint and body, and one per quantity."""
    missing = [told for _, told, _ in _left_over(comparison)]
    result = [_case("the same joints", missing)]
    by_element: dict[str, list[Difference]] = {}
    for difference in comparison.differences:
        by_element.setdefault(difference.element, []).append(difference)
    for element in dict.fromkeys([comparison.base, *comparison.joints, *by_element]):
        own = by_element.get(element, [])
        places = [f" [{one.urdf_place}, {one.mjcf_place}]" for one in own]
        told = [one.diagnostic for one in own]
        result.append(_case(f"parameters of {element}", told, places))
    for quantity in comparison.check.quantities:
        deviation = diagnose(
            "quantity-deviates",
            relative=quantity.relative,
            whose=Term(quantity.whose),
            where=quantity.where,
        )
        fails = not (quantity.passed or comparison.agree)
        result.append(_case(f"{quantity.name} agree", [deviation] * fails))
    result.append(_case("the differences explain the deviations", comparison.objections))
    return result


def _case(name: str, told: Sequence[Diagnostic], places: Sequence[str] = ()) -> CheckedItem:
    """Returns a case with a line per diagnostic, each with its places."""
    lines = map("".join, zip(map(str, told), places or [""] * len(told), strict=True))
    return CheckedItem(name, "\n".join(lines) or None, tuple(told))
