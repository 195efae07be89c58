"""The section of a comparison: what makes two files disagree, both lines of each side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pupper_analysis.checks.compare import Comparison
from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.engines import EDGES
from pupper_analysis.report.comparison import (
    by_cause,
    effects_told,
    first_to_mend,
    matching_notes,
)
from pupper_analysis.report.html import document as doc
from pupper_analysis.report.html.overlay import overlay_of
from pupper_analysis.report.html.sentences import said
from pupper_analysis.report.html.sources import page, quoted
from pupper_analysis.report.html.words import text, word
from pupper_analysis.results import short

_OVERLAY = (
    "Shapes are the MJCF's, at zero angles; bodies with differences are coloured. Lines join the "
    "URDF's joints, from the same root; a joint's frame may sit anywhere on its axis."
)

SHOWN = 40
"""Groups of differences whose lines are shown side by side; the table has them all."""


def comparison_section(comparison: Comparison) -> doc.Section:
    """Returns what makes two files disagree."""
    causes, groups = by_cause(comparison, everything=False)
    blocks: list[doc.Block] = [
        doc.Lines(
            (text("URDF: {file}", file=comparison.urdf), text("MJCF: {file}", file=comparison.mjcf))
        )
    ]
    scene = overlay_of(comparison)
    if scene is not None:
        blocks.append(doc.View(text("The two files over each other"), scene, text(_OVERLAY)))
    for part in comparison.parts:
        blocks.append(doc.Lines((said(part),), "bad", text("Only in one file")))
    for cause in causes:
        first = comparison.differences[cause.differences[0]]
        made = text("This alone makes {count} differences.", count=len(cause.differences))
        blocks.append(_sides(comparison, first, said(cause.diagnostic), made))
    for group in groups[:SHOWN]:
        more: list[doc.Words] = []
        if len(group) > 1:
            names = ", ".join(difference.element for difference in group[1:])
            more.append(
                text(
                    "Likewise on {count} more: {names}", count=len(group) - 1, names=doc.Name(names)
                )
            )
        blocks.append(_sides(comparison, group[0], said(group[0].diagnostic), *more))
    if len(groups) > SHOWN:
        blocks.append(
            doc.Lines((text("{count} more are in the table alone.", count=len(groups) - SHOWN),))
        )
    if comparison.differences:
        blocks.append(_differences(comparison))
    blocks += _explained(comparison)
    blocks.append(_quantities(comparison))
    notes = [*matching_notes(comparison), *comparison.check.notes, *comparison.engines]
    if notes:
        blocks.append(doc.Lines(tuple(map(said, notes)), title=text("Notes")))
    agree = comparison.agree
    return doc.Section(
        doc.Name(f"{Path(comparison.urdf).name} ↔ {Path(comparison.mjcf).name}"),
        tuple(blocks),
        agree,
        text("AGREE") if agree else text("DISAGREE"),
        (
            text("{count} differences", count=len(comparison.differences)),
            said(first_to_mend(comparison, causes, groups)),
        ),
    )


def _sides(
    comparison: Comparison, difference: Difference, title: doc.Words, *notes: doc.Words
) -> doc.Sides:
    paths = (comparison.urdf, comparison.mjcf)
    columns = []
    for place, value in (
        (difference.urdf_place, difference.urdf),
        (difference.mjcf_place, difference.mjcf),
    ):
        line = quoted(place, *paths)
        shown: doc.Words = doc.Name(line) if line else doc.Name(f"{short(value)} {difference.unit}")
        columns.append((doc.Name(_short(place)) if place else text("not in the file"), shown))
    return doc.Sides(
        title,
        tuple(columns),
        (*notes, *map(said, difference.made_of), said(effects_told(difference))),
    )


def _differences(comparison: Comparison) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for order, difference in enumerate(comparison.differences, start=1):
        effect = difference.weight[1]
        rows.append(
            (
                doc.number(order, "g"),
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
        text("All differences, what is to be mended first, first"),
        (
            doc.Column(text("no."), "1"),
            doc.Column(text("kind"), left=True),
            doc.Column(text("of"), left=True),
            doc.Column(text("in the URDF")),
            doc.Column(text("in the MJCF")),
            doc.Column(text("unit"), left=True),
            doc.Column(text("greatest relative effect"), "1"),
            doc.Column(text("line of the URDF"), left=True),
            doc.Column(text("line of the MJCF"), left=True),
        ),
        tuple(rows),
        (),
        (page("disagreement.md", "How to read it"),),
    )


def _short(place: str | None) -> str:
    """Returns a place with its file's name alone: the folders are told once."""
    return "" if place is None else Path(place).name


def _value(value: object) -> doc.Cell:
    if isinstance(value, float | int):
        return doc.number(float(value), ".6g")
    return doc.Name("-" if value is None else short(value))


def _explained(comparison: Comparison) -> Iterable[doc.Block]:
    if comparison.differences:
        yield doc.Lines(
            (
                text(
                    "Explained: {share} % of the deviation; with the MJCF's values in the URDF's "
                    "model {left} is left.",
                    share=f"{100 * comparison.explained:.6g}",
                    left=f"{max(comparison.left.values()):.1e}",
                ),
            )
        )
    if comparison.objections:
        yield doc.Lines(tuple(map(said, comparison.objections)), "bad", text("Objections"))


def _quantities(comparison: Comparison) -> doc.Table:
    check = comparison.check
    every = dict.fromkeys(EDGES.values())
    sides = [side for side in every if any(side in q.edges for q in check.quantities)]
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(quantity.name),
            *(doc.number(quantity.edges.get(side), ".1e") for side in sides),
            doc.Name("" if quantity.passed else quantity.where),
        )
        for quantity in check.quantities
    ]
    return doc.Table(
        text(
            "Deviation relative to each quantity's scale, at {count} random configurations",
            count=check.configurations,
        ),
        (
            doc.Column(text("quantity"), left=True),
            *(doc.Column(word(side), "1") for side in sides),
            doc.Column(text("worst at"), left=True),
        ),
        tuple(rows),
        (),
        (page("disagreement.md", "Why the list is complete"),),
    )
