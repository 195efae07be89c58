"""Prints the comparison of two model files, for people and for machines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console

from pupper_analysis.checks.compare import Comparison
from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.engines import EDGES, EXTRAS
from pupper_analysis.checks.patterns import Cause
from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.report.console import SafeTable, escape, print_notes
from pupper_analysis.report.formats import Annotation, Case

SHOWN = 20
"""Groups of differences that are printed unless all are asked for."""

_GROUPED = 4  # elements of a group that are named


def print_models(out: Console, comparison: Comparison, *, everything: bool = False) -> None:
    """Prints a comparison: the verdict and its first cause, all differences, what is left.

    Args:
        out: Where to.
        comparison: The comparison.
        everything: Print all differences, however many.
    """
    causes, groups = by_cause(comparison, everything)
    verdict = "[bold green]AGREE[/]" if comparison.agree else "[bold red]DISAGREE[/]"
    if comparison.same_robot and not comparison.agree:
        verdict = "[bold yellow]ONE ROBOT, OTHER COORDINATES[/]"
    first = first_to_mend(comparison, causes, groups)
    out.print(f"{verdict}: {escape(first)}", soft_wrap=True)
    _print_causes(out, comparison, causes, everything)
    shown = groups if everything else groups[:SHOWN]
    for number, group in enumerate(shown, start=1):
        _print_group(out, number, group, everything)
    if len(shown) < len(groups):
        out.print(f"… and {len(groups) - len(shown)} more with less effect; --all prints them")
    if comparison.differences:
        left = max(comparison.left.values())
        complete = "" if comparison.complete else ", [red]so something is missing in this list[/]"
        out.print(
            f"\nexplained: {100 * comparison.explained:.6g} % of the deviation; with the MJCF's "
            f"values in the URDF's model {left:.1e} is left{complete}",
            soft_wrap=True,
        )
    for objection in comparison.objections:
        out.print(f"[red]{escape(str(objection))}[/]", soft_wrap=True)
    _print_quantities(out, comparison)
    print_notes(out, matching_notes(comparison))


def _print_causes(
    out: Console, comparison: Comparison, causes: Iterable[Cause], everything: bool
) -> None:
    """Prints what one file lacks as a whole, and slips that explain several differences."""
    for part in comparison.parts:
        said = f"{part}; it was taken off to compare the rest"
        out.print(f"\n[bold]-[/] {escape(said)}", soft_wrap=True)
    for cause in causes:
        more = "" if everything else "; --all prints each"
        said = f"{cause.message} (this alone makes {len(cause.differences)} differences{more})"
        out.print(f"\n[bold]-[/] {escape(said)}", soft_wrap=True)
        first = comparison.differences[cause.differences[0]]
        where = f"   {first.urdf_place}   {first.mjcf_place}"
        out.print(escape(where), style="dim", soft_wrap=True)
        does = f"   the {first.kind} of {first.element}: {effects_told(first)}"
        out.print(escape(does), soft_wrap=True)


def by_cause(
    comparison: Comparison, everything: bool
) -> tuple[tuple[Cause, ...], list[list[Difference]]]:
    """Returns the causes, and the differences that none explains, or all, in groups."""
    explained = {number for cause in comparison.causes for number in cause.differences}
    rest = [
        difference
        for number, difference in enumerate(comparison.differences)
        if everything or number not in explained
    ]
    return comparison.causes, _groups(rest)


def first_to_mend(
    comparison: Comparison, causes: Sequence[Cause], groups: Sequence[Sequence[Difference]]
) -> Diagnostic | str:
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


def matching_notes(comparison: Comparison) -> Iterable[Diagnostic | str]:
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


def _print_group(out: Console, number: int, group: list[Difference], everything: bool) -> None:
    first = group[0]
    more = ""
    if len(group) > 1:
        names = [difference.element for difference in group[1:]]
        listed = ", ".join(names[:_GROUPED]) + (" …" if len(names) > _GROUPED else "")
        more = f"; likewise on {len(names)} more: {', '.join(names) if everything else listed}"
    out.print(f"\n[bold]{number}.[/] {escape(first.message + more)}", soft_wrap=True)
    out.print(escape(f"   {first.urdf_place}   {first.mjcf_place}"), style="dim", soft_wrap=True)
    for said in first.made_of if first.kind == "mass" else ():
        out.print(escape(f"   {said}"), style="dim", soft_wrap=True)
    out.print(f"   {effects_told(first)}", soft_wrap=True, style="" if first.effects else "dim")


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


def _print_quantities(out: Console, comparison: Comparison) -> None:
    check = comparison.check
    out.print(
        f"\nDeviation relative to each quantity's scale, at {check.configurations} random "
        "configurations",
        style="bold",
    )
    every = dict.fromkeys(EDGES.values())
    sides = [side for side in every if any(side in q.edges for q in check.quantities)]
    extras = any(quantity.edges.get(EXTRAS) for quantity in check.quantities)
    if not extras:
        sides.remove(EXTRAS)  # a column of zeros: the MJCF has none
    # With that column, 80 characters are enough only if the columns share their padding.
    table = SafeTable(
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        header_style="dim",
        collapse_padding=extras,
    )
    table.add_column("quantity", no_wrap=True)
    for side in sides:
        table.add_column(side.replace(" (", "\n("), justify="right", no_wrap=True)
    table.add_column("worst at", overflow="fold")
    for quantity in check.quantities:
        cells = [f"{quantity.edges[side]:.1e}" if side in quantity.edges else "" for side in sides]
        table.add_row(quantity.name, *cells, "" if quantity.passed else escape(quantity.where))
    out.print(table)
    print_notes(out, check.notes)
    for engine in comparison.engines:
        out.print(f"note: the engines differ on one model: {escape(str(engine))}", style="yellow")


def remarks(comparison: Comparison) -> list[Annotation]:
    """Returns a remark per difference, at its place in the URDF, and one per joint left over."""
    urdf = comparison.urdf
    found = [_remark("part", "part", part, urdf) for part in comparison.parts]
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
