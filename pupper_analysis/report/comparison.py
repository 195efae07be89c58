"""What the comparison of two model files finds, in order, and for machines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from pupper_analysis.checks.compare import Comparison
from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.patterns import Cause
from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.report.formats import Annotation, Case


def by_cause(comparison: Comparison) -> tuple[tuple[Cause, ...], list[list[Difference]]]:
    """Returns the causes, and in groups the differences that none explains."""
    explained = {number for cause in comparison.causes for number in cause.differences}
    rest = [
        difference
        for number, difference in enumerate(comparison.differences)
        if number not in explained
    ]
    return comparison.causes, _groups(rest)


def first_to_mend(
    comparison: Comparison, causes: Sequence[Cause], groups: Sequence[Sequence[Difference]]
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
        pairs = [f"{one}={two}" for one, two in comparison.guessed.items()]
        yield diagnose("joints-matched-otherwise", pairs=pairs)
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


def remarks(comparison: Comparison) -> list[Annotation]:
    """Returns a remark per difference, at its place in the URDF, and one per joint left over."""
    urdf = comparison.urdf
    found = [_remark("part", "part", str(part), urdf) for part in comparison.parts]
    for cause in comparison.causes:
        place = comparison.differences[cause.differences[0]]
        text = f"{cause.message} [{place.mjcf_place}]"
        found.append(_remark("cause", "cause", text, place.urdf_place))
    found += [
        _remark(
            difference.kind,
            f"{difference.kind} of {difference.element}",
            f"{difference.message} [{difference.mjcf_place}]",
            difference.urdf_place,
        )
        for difference in comparison.differences
    ]
    for joints, file, other in (
        (comparison.only_urdf, urdf, comparison.mjcf),
        (comparison.only_mjcf, comparison.mjcf, urdf),
    ):
        found += [
            _remark("joint", f"joint {name}", f"joint {name} is not in {other}", file)
            for name in joints
        ]
    found += [
        _remark("agreement", "agreement", str(objection), comparison.mjcf)
        for objection in comparison.objections
    ]
    if comparison.guessed:
        pairs = ", ".join(f"{one}={two}" for one, two in comparison.guessed.items())
        message = f"matched otherwise than by the whole name: {pairs}"
        found.append(_remark("guess", "guessed joints", message, urdf, level="warning"))
    return found


_ABOUT = {
    "part": "one file has a part that the other lacks",
    "cause": "one slip makes several differences",
    "joint": "one file has a joint that the other lacks",
    "agreement": "the files do not agree, apart from single differences",
    "guess": "joints were matched otherwise than by their whole names",
}


def _remark(
    kind: str, title: str, message: str, place: str | None, *, level: str = "error"
) -> Annotation:
    about = _ABOUT.get(kind, f"{kind}: the URDF and the MJCF differ")
    return Annotation(level, title, message, place, rule=f"crosscheck/{kind}", about=about)


def cases(comparison: Comparison) -> list[Case]:
    """Returns one case per kind of number of each joint and body, and one per quantity."""
    failures: dict[str, list[str]] = {}
    for difference in comparison.differences:
        place = f" [{difference.urdf_place}, {difference.mjcf_place}]"
        failures.setdefault(difference.element, []).append(difference.message + place)
    unmatched = [*comparison.only_urdf, *comparison.only_mjcf]
    missing = f"in one file only: {', '.join(unmatched)}" if unmatched else None
    result = [Case("the same joints", missing)]
    for element in dict.fromkeys([comparison.base, *comparison.joints, *failures]):
        found = failures.get(element)
        result.append(Case(f"parameters of {element}", "\n".join(found) if found else None))
    for quantity in comparison.check.quantities:
        failure = None
        if not (quantity.passed or comparison.agree):
            failure = f"{quantity.relative:.1e} ({quantity.whose}; {quantity.where})"
        result.append(Case(f"{quantity.name} agree", failure))
    incomplete = "\n".join(map(str, comparison.objections)) or None
    result.append(Case("the differences explain the deviations", incomplete))
    return result
