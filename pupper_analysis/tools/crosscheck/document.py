"""The comparison of two files: what makes them disagree, both lines of each side by side.

As a document, and as remarks for machines, in the same order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.results import shorten
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import cite_page, quote_line
from pupper_analysis.present.formats import Annotation
from pupper_analysis.robot.compare.differences import MIN_FACTOR, Difference, about_kind
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.crosscheck.crosscheck import (
    EDGE_NAMES,
    EXTRAS_EDGE,
    MJCF_MUJOCO,
    MJCF_PINOCCHIO,
    URDF_MUJOCO,
    URDF_PINOCCHIO,
    URDF_YOURDFPY,
    Comparison,
)


def list_matching_notes(comparison: Comparison) -> Iterable[Diagnostic]:
    """Says how joints were matched, and what was left out."""
    yield from comparison.notes
    if comparison.mount is not None:
        yield diagnose("tilt-is-no-difference", tilt=comparison.mount)
    if comparison.guessed:
        yield _guessed(comparison)
    for joints, file in (
        (comparison.only_urdf, comparison.urdf),
        (comparison.only_mjcf, comparison.mjcf),
    ):
        if joints:
            taken_off = bool(comparison.parts)
            yield diagnose("joints-in-one-file", file=file, joints=joints, taken_off=taken_off)


_WHOLE = 1.005
"""A share that is printed as 100 %."""


def describe_effects(difference: Difference) -> Diagnostic:
    """Returns what a difference does."""
    if not difference.effects:
        return diagnose("no-effect")
    effects = [
        diagnose(
            "effect",
            subject=("quantity", name),
            what=Term(name),
            # Of what others undo it is more than the whole, which says nothing.
            share=Quantity(effect.share, "1") if effect.share <= _WHOLE else None,
            relative=Quantity(effect.relative, "1") if effect.relative < MIN_FACTOR else None,
            times=effect.relative if effect.relative >= MIN_FACTOR else None,
        )
        for name, effect in sorted(difference.effects.items(), key=lambda item: -item[1].share)
    ]
    return diagnose("effects", effects=effects)


def make_comparison_annotations(comparison: Comparison) -> list[Annotation]:
    """Returns a remark per difference, at its place in the URDF, and one per joint left over."""
    urdf, mjcf = comparison.urdf, comparison.mjcf
    found = [_remark("part", "part", part, urdf) for part in comparison.parts]
    for cause in comparison.causes:
        first = comparison.differences[cause.differences[0]]
        found.append(
            _remark("cause", "cause", cause.diagnostic, first.urdf_place, first.mjcf_place)
        )
    for difference in comparison.differences:
        title = f"{difference.kind} of {difference.element}"
        found.append(
            _remark(
                difference.kind,
                title,
                difference.diagnostic,
                difference.urdf_place,
                difference.mjcf_place,
            )
        )
    found += [
        _remark("joint", f"joint {name}", one, file) for name, one, file in _left_over(comparison)
    ]
    found += [
        _remark("agreement", "agreement", objection, mjcf) for objection in comparison.objections
    ]
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
    kind: str, title: str, finding: Diagnostic, place: str | None, other: str | None = None
) -> Annotation:
    message = str(finding) if other is None else f"{finding} [{other}]"
    rule = f"crosscheck/{kind}"
    about = about_kind(kind)
    return Annotation("error", title, message, place, rule=rule, about=about, diagnostic=finding)


MAX_SHORT_GROUPS, MAX_SHOWN_GROUPS = 20, 40
"""Groups of differences whose lines are shown side by side, in a short view and in any; the table
has them all."""

_ONE_FILE = {
    EDGE_NAMES[URDF_PINOCCHIO, URDF_MUJOCO],
    EDGE_NAMES[MJCF_PINOCCHIO, MJCF_MUJOCO],
    EDGE_NAMES[URDF_PINOCCHIO, URDF_YOURDFPY],
}
"""Deviations of two engines or readers on one file: they are about none of the two files."""

MAX_NAMED_ELEMENTS = 4
"""Elements of a group that are named; the table has them all."""


@build_document.register(Comparison)
def comparison_document(comparison: Comparison, _: Robot | None = None) -> doc.Document:
    """Returns what makes two files disagree; see ``build``."""
    agree, same = comparison.agree, comparison.same_robot
    said = (*list_matching_notes(comparison), *comparison.check.notes)
    notes: list[doc.Words] = list(map(doc.diagnostic_text, said))
    notes += [
        text("the-engines-differ-on-one", engine=doc.diagnostic_text(engine))
        for engine in comparison.engines
    ]
    differ = text("same-robot-different-conventions") if same else text("disagree")
    return doc.Document(
        text("cross-check"),
        text("urdf-and-mjcf", urdf=_file(comparison.urdf), mjcf=_file(comparison.mjcf)),
        tuple(_blocks(comparison)),
        passed=agree,
        verdict=text("agree") if agree else differ,
        warned=same and not agree,
        findings=(
            doc.diagnostic_text(comparison.first_to_mend),
            text("1-difference")
            if len(comparison.differences) == 1
            else text("count-differences", count=len(comparison.differences)),
            *_explained(comparison),
        ),
        notes=tuple(notes),
    )


def _file(path: str) -> doc.Name:
    return doc.Name(Path(path).name)


def _blocks(comparison: Comparison) -> Iterable[doc.Block]:
    """Yields what differs, what is to be mended first, first; then how much that explains."""
    causes, groups = comparison.causes, comparison.unexplained
    files = {"urdf-file": comparison.urdf, "mjcf-file": comparison.mjcf}
    named = tuple(text(said, file=doc.Name(file)) for said, file in files.items())
    yield doc.Lines(named, detail=True)
    for part in comparison.parts:
        off = text("part-it-was-taken-off", part=doc.diagnostic_text(part))
        yield doc.Lines((off,), "bad", text("only-in-one-file"))
    # One order for the headline and for all below it: that of the differences.
    listed: list[tuple[int, doc.Block]] = []
    for cause in causes:
        first = comparison.differences[cause.differences[0]]
        made = text("this-alone-makes-count-differences", count=len(cause.differences))
        such = text("the-kind-of-element", kind=word(first.kind), element=first.element)
        sides = _sides(comparison, first, doc.diagnostic_text(cause.diagnostic), made, such)
        listed.append((-1 if cause.leads else cause.differences[0], sides))
    numbers = {id(one): number for number, one in enumerate(comparison.differences)}
    for place, group in enumerate(groups[:MAX_SHOWN_GROUPS]):
        sides = _sides(
            comparison, group[0], doc.diagnostic_text(group[0].diagnostic), *_likewise(group)
        )
        listed.append((numbers[id(group[0])], replace(sides, detail=place >= MAX_SHORT_GROUPS)))
    yield from (block for _, block in sorted(listed, key=itemgetter(0)))
    if comparison.differences:
        yield _differences(comparison)
    if comparison.objections:
        yield doc.Lines(
            tuple(map(doc.diagnostic_text, comparison.objections)), "bad", text("objections")
        )
    yield _quantities(comparison)


def _likewise(group: list[Difference]) -> Iterable[doc.Words]:
    """Says of which else it is true."""
    if len(group) > 1:
        names = [doc.Name(difference.element) for difference in group[1 : MAX_NAMED_ELEMENTS + 1]]
        listed = join_words(names)
        if len(group) > MAX_NAMED_ELEMENTS + 1:
            listed = text("names", names=listed)
        yield text("likewise-on-count-more-names", count=len(group) - 1, names=listed)


def _sides(
    comparison: Comparison, difference: Difference, title: doc.Words, *notes: doc.Words
) -> doc.FileFinding:
    paths = (comparison.urdf, comparison.mjcf)
    columns = []
    for place, value in (
        (difference.urdf_place, difference.urdf),
        (difference.mjcf_place, difference.mjcf),
    ):
        line = quote_line(place, *paths)
        shown = doc.Name(line) if line else doc.Name(f"{shorten(value)} {difference.unit}")
        named = doc.Name(_short(place)) if place else text("not-in-the-file")
        columns.append(doc.FilePlace(named, shown, place or ""))
    made_of = map(doc.diagnostic_text, difference.made_of)
    return doc.FileFinding(title, tuple(columns), (*notes, *made_of, _effects(difference)))


def _effects(difference: Difference) -> doc.Text:
    return doc.diagnostic_text(describe_effects(difference), "" if difference.effects else "quiet")


def _differences(comparison: Comparison) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for order, difference in enumerate(comparison.differences, start=1):
        effect = difference.weight[1]
        rows.append(
            (
                doc.number_cell(order, "g"),
                word(difference.kind),
                doc.Name(difference.element),
                _value(difference.urdf),
                _value(difference.mjcf),
                doc.Name(difference.unit),
                doc.number_cell(effect, ".2g", scale=100),
                doc.Name(_short(difference.urdf_place)),
                doc.Name(_short(difference.mjcf_place)),
            )
        )
    return doc.Table(
        text("all-differences"),
        (
            doc.Column(text("ordinal"), "1"),
            doc.Column(text("kind"), left=True),
            doc.Column(text("of"), left=True),
            doc.Column(text("in-the-urdf")),
            doc.Column(text("in-the-mjcf")),
            doc.Column(text("unit"), left=True),
            doc.Column(text("greatest-relative-effect"), "%"),
            doc.Column(text("line-of-the-urdf"), left=True),
            doc.Column(text("line-of-the-mjcf"), left=True),
        ),
        tuple(rows),
        (),
        (cite_page("explanation/models.md", "Effects, causes, order"),),
        detail=True,
    )


def _short(place: str | None) -> str:
    """Returns a place with its file's name alone: the folders are shown once."""
    return "" if place is None else Path(place).name


def _value(value: object) -> doc.Cell:
    if isinstance(value, float | int):
        return doc.number_cell(float(value), ".6g")
    return doc.Name("-" if value is None else shorten(value))


def _explained(comparison: Comparison) -> Iterable[doc.Words]:
    """Says how much of the deviation the differences explain."""
    if not comparison.differences:
        return
    explained = text(
        "explained-share-of-the-deviation",
        share=f"{100 * comparison.explained:.6g}",
        left=f"{max(comparison.residual.values()):.1e}",
    )
    if not comparison.complete:
        missing = "explained-so-something-is-missing"
        explained = text(missing, explained=explained).with_mark("bad")
    yield explained


def _deviation(relative: float | None, tolerance: float) -> doc.Number:
    """Returns a deviation as a cell, marked where it is more than is tolerated."""
    beyond = relative is not None and relative > tolerance
    return doc.number_cell(relative, ".1e", "bad" if beyond else "")


def _quantities(comparison: Comparison) -> doc.Table:
    check = comparison.check
    every = dict.fromkeys(EDGE_NAMES.values())
    sides = [side for side in every if any(side in q.edges for q in check.quantities)]
    if not any(quantity.edges.get(EXTRAS_EDGE) for quantity in check.quantities):
        sides.remove(EXTRAS_EDGE)  # a column of zeros: the MJCF has nothing that a URDF has not
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(quantity.name),
            *(_deviation(quantity.edges.get(side), check.tolerance) for side in sides),
            doc.Name("" if quantity.passed else quantity.where),
        )
        for quantity in check.quantities
    ]
    return doc.Table(
        text("deviation-title", count=check.configurations),
        (
            doc.Column(text("quantity"), left=True),
            *(doc.Column(word(side), "1", detail=side in _ONE_FILE) for side in sides),
            doc.Column(text("worst-at"), left=True),
        ),
        tuple(rows),
        (),
        (cite_page("explanation/models.md", "Why the list is complete"),),
    )
