"""The document of a comparison: what makes two files disagree, both lines of each side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pupper_analysis.base.results import shorten
from pupper_analysis.present import document as doc
from pupper_analysis.present.comparison import (
    by_cause,
    effects_told,
    first_to_mend,
    matching_notes,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import page_of, quote_line
from pupper_analysis.present.words import join_words, text, word
from pupper_analysis.robot.compare.compare import Comparison
from pupper_analysis.robot.compare.differences import Difference
from pupper_analysis.robot.compare.engines import (
    EDGES,
    EXTRAS,
    MJCF_MUJOCO,
    MJCF_PINOCCHIO,
    URDF_MUJOCO,
    URDF_PINOCCHIO,
    URDF_READ,
    URDF_YOURDFPY,
)
from pupper_analysis.robot.robot import Robot

_OVERLAY = "overlay-note"

SHORT, SHOWN = 20, 40
"""Groups of differences whose lines are shown side by side, in a short view and in any; the table
has them all."""

_ONE_FILE = {
    EDGES[URDF_PINOCCHIO, URDF_MUJOCO],
    EDGES[MJCF_PINOCCHIO, MJCF_MUJOCO],
    EDGES[URDF_PINOCCHIO, URDF_YOURDFPY],
    EDGES[URDF_READ, URDF_MUJOCO],
}
"""Deviations of two engines or readers on one file: they are about none of the two files."""

GROUPED = 4
"""Elements of a group that are named; the table has them all."""


@build_document.register(Comparison)
def comparison_document(comparison: Comparison, _: Robot | None = None) -> doc.Document:
    """Returns what makes two files disagree; see ``build``."""
    causes, groups = by_cause(comparison)
    agree, same = comparison.agree, comparison.same_robot
    said = (*matching_notes(comparison), *comparison.check.notes)
    notes: list[doc.Words] = list(map(doc.tell, said))
    notes += [
        text("the-engines-differ-on-one", engine=doc.tell(engine)) for engine in comparison.engines
    ]
    differ = text("same-robot-different-conventions") if same else text("disagree")
    return doc.Document(
        text("cross-check"),
        text("urdf-and-mjcf", urdf=_file(comparison.urdf), mjcf=_file(comparison.mjcf)),
        tuple(_blocks(comparison)),
        passed=agree,
        verdict=text("agree") if agree else differ,
        warned=same and not agree,
        told=(
            doc.tell(first_to_mend(comparison, causes, groups)),
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
    causes, groups = by_cause(comparison)
    files = {"urdf-file": comparison.urdf, "mjcf-file": comparison.mjcf}
    named = tuple(text(said, file=doc.Name(file)) for said, file in files.items())
    yield doc.Lines(named, detail=True)
    yield doc.View(text("overlay-title"), doc.OverlayScene(comparison), text(_OVERLAY))
    for part in comparison.parts:
        off = text("part-it-was-taken-off", part=doc.tell(part))
        yield doc.Lines((off,), "bad", text("only-in-one-file"))
    for cause in causes:
        first = comparison.differences[cause.differences[0]]
        made = text("this-alone-makes-count-differences", count=len(cause.differences))
        such = text("the-kind-of-element", kind=word(first.kind), element=first.element)
        yield _sides(comparison, first, doc.tell(cause.diagnostic), made, such)
    for place, group in enumerate(groups[:SHOWN]):
        sides = _sides(comparison, group[0], doc.tell(group[0].diagnostic), *_likewise(group))
        yield replace(sides, detail=place >= SHORT)
    if len(groups) > SHOWN:
        more = text("count-more-are-in-the-table", count=len(groups) - SHOWN)
        yield doc.Lines((more,), detail=True)
    if comparison.differences:
        yield _differences(comparison)
    if comparison.objections:
        yield doc.Lines(tuple(map(doc.tell, comparison.objections)), "bad", text("objections"))
    yield _quantities(comparison)


def _likewise(group: list[Difference]) -> Iterable[doc.Words]:
    """Says of which else it is true."""
    if len(group) > 1:
        names = [doc.Name(difference.element) for difference in group[1 : GROUPED + 1]]
        listed = join_words(names)
        if len(group) > GROUPED + 1:
            listed = text("names", names=listed)
        yield text("likewise-on-count-more-names", count=len(group) - 1, names=listed)


def _sides(
    comparison: Comparison, difference: Difference, title: doc.Words, *notes: doc.Words
) -> doc.Sides:
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
    made_of = map(doc.tell, difference.made_of)
    return doc.Sides(title, tuple(columns), (*notes, *made_of, _effects(difference)))


def _effects(difference: Difference) -> doc.Text:
    """Returns what a difference does."""
    return doc.tell(effects_told(difference), "" if difference.effects else "quiet")


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
                doc.Number(f"{effect:.1e}", effect),
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
            doc.Column(text("greatest-relative-effect"), "1"),
            doc.Column(text("line-of-the-urdf"), left=True),
            doc.Column(text("line-of-the-mjcf"), left=True),
        ),
        tuple(rows),
        (),
        (page_of("explanation/models.md", "Effects, causes, order"),),
        detail=True,
    )


def _short(place: str | None) -> str:
    """Returns a place with its file's name alone: the folders are told once."""
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
        explained = text(missing, explained=explained).marked("bad")
    yield explained


def _deviation(relative: float | None, tolerance: float) -> doc.Number:
    """Returns a deviation as a cell, marked where it is more than is tolerated."""
    beyond = relative is not None and relative > tolerance
    return doc.number_cell(relative, ".1e", "bad" if beyond else "")


def _quantities(comparison: Comparison) -> doc.Table:
    check = comparison.check
    every = dict.fromkeys(EDGES.values())
    sides = [side for side in every if any(side in q.edges for q in check.quantities)]
    if not any(quantity.edges.get(EXTRAS) for quantity in check.quantities):
        sides.remove(EXTRAS)  # a column of zeros: the MJCF has nothing that a URDF has not
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(quantity.name),
            *(_deviation(quantity.edges.get(side), check.tolerance) for side in sides),
            doc.Name("" if quantity.passed else quantity.where),
        )
        for quantity in check.quantities
    ]
    worst = {
        side: max(quantity.edges.get(side, 0.0) for quantity in check.quantities) for side in sides
    }
    # What engines make of one file is left out of a short view where they agree on it.
    hidden = [side for side in sides if side in _ONE_FILE and worst[side] <= check.tolerance]
    agree = f"{max((worst[side] for side in hidden), default=0.0):.1e}"
    return doc.Table(
        text("deviation-title", count=check.configurations),
        (
            doc.Column(text("quantity"), left=True),
            *(doc.Column(word(side), "1", detail=side in hidden) for side in sides),
            doc.Column(text("worst-at"), left=True),
        ),
        tuple(rows),
        (text("engines-agree-on-each-file", worst=agree),) if hidden else (),
        (page_of("explanation/models.md", "Why the list is complete"),),
    )
