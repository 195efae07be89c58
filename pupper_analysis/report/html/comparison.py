"""The section of a comparison: what makes two files disagree, both lines of each side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pupper_analysis.checks.compare import Comparison
from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.engines import EDGES
from pupper_analysis.report.comparison import (
    by_cause,
    effects_in_words,
    first_to_mend,
    matching_notes,
)
from pupper_analysis.report.html.document import (
    Block,
    Cell,
    Column,
    Lines,
    Name,
    Number,
    Section,
    Sides,
    Table,
    Text,
    View,
    Words,
    number,
)
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


def comparison_section(comparison: Comparison) -> Section:
    """Returns what makes two files disagree."""
    causes, groups = by_cause(comparison, everything=False)
    blocks: list[Block] = [
        Lines(
            (text("URDF: {file}", file=comparison.urdf), text("MJCF: {file}", file=comparison.mjcf))
        )
    ]
    scene = overlay_of(comparison)
    if scene is not None:
        blocks.append(View(text("The two files over each other"), scene, text(_OVERLAY)))
    for part in comparison.parts:
        blocks.append(Lines((said(part),), "bad", text("Only in one file")))
    for cause in causes:
        first = comparison.differences[cause.differences[0]]
        made = text("This alone makes {count} differences.", count=len(cause.differences))
        blocks.append(_sides(comparison, first, said(cause.message), made))
    for group in groups[:SHOWN]:
        more: list[Words] = []
        if len(group) > 1:
            names = ", ".join(difference.element for difference in group[1:])
            more.append(
                text("Likewise on {count} more: {names}", count=len(group) - 1, names=Name(names))
            )
        blocks.append(_sides(comparison, group[0], said(group[0].message), *more))
    if len(groups) > SHOWN:
        blocks.append(
            Lines((text("{count} more are in the table alone.", count=len(groups) - SHOWN),))
        )
    if comparison.differences:
        blocks.append(_differences(comparison))
    blocks += _explained(comparison)
    blocks.append(_quantities(comparison))
    notes = [*matching_notes(comparison), *comparison.check.notes, *comparison.engines]
    if notes:
        blocks.append(Lines(tuple(map(said, notes)), title=text("Notes")))
    agree = comparison.agree
    return Section(
        Name(f"{Path(comparison.urdf).name} ↔ {Path(comparison.mjcf).name}"),
        tuple(blocks),
        agree,
        text("AGREE") if agree else text("DISAGREE"),
        (
            text("{count} differences", count=len(comparison.differences)),
            said(first_to_mend(comparison, causes, groups)),
        ),
    )


def _sides(comparison: Comparison, difference: Difference, title: Words, *notes: Words) -> Sides:
    paths = (comparison.urdf, comparison.mjcf)
    columns = []
    for place, value in (
        (difference.urdf_place, difference.urdf),
        (difference.mjcf_place, difference.mjcf),
    ):
        line = quoted(place, *paths)
        shown: Words = Name(line) if line else Name(f"{short(value)} {difference.unit}")
        columns.append((Name(_short(place)) if place else text("not in the file"), shown))
    return Sides(
        title,
        tuple(columns),
        (*notes, *map(said, difference.made_of), _effects(difference)),
    )


def _effects(difference: Difference) -> Words:
    """Returns what a difference does, in both languages."""
    english = effects_in_words(difference)
    if not difference.effects:
        return text("no effect on the dynamics")
    begin = text("alone it makes, of the deviation in: ")
    parts = english.removeprefix(begin.en).split(", ")
    spoken = []
    for part in parts:
        name = next(name for name in difference.effects if part.startswith(f"{name} "))
        quantity = word(name)
        spoken.append((quantity.zh if isinstance(quantity, Text) else name) + part[len(name) :])
    return Text(english, begin.zh + "、".join(spoken))


def _differences(comparison: Comparison) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for order, difference in enumerate(comparison.differences, start=1):
        effect = difference.weight[1]
        rows.append(
            (
                number(order, "g"),
                word(difference.kind),
                Name(difference.element),
                _value(difference.urdf),
                _value(difference.mjcf),
                Name(difference.unit),
                Number(f"{effect:.1e}", effect),
                Name(_short(difference.urdf_place)),
                Name(_short(difference.mjcf_place)),
            )
        )
    return Table(
        text("All differences, what is to be mended first, first"),
        (
            Column(text("no."), "1"),
            Column(text("kind"), left=True),
            Column(text("of"), left=True),
            Column(text("in the URDF")),
            Column(text("in the MJCF")),
            Column(text("unit"), left=True),
            Column(text("greatest relative effect"), "1"),
            Column(text("line of the URDF"), left=True),
            Column(text("line of the MJCF"), left=True),
        ),
        tuple(rows),
        (),
        (page("disagreement.md", "How to read it"),),
    )


def _short(place: str | None) -> str:
    """Returns a place with its file's name alone: the folders are told once."""
    return "" if place is None else Path(place).name


def _value(value: object) -> Cell:
    if isinstance(value, float | int):
        return number(float(value), ".6g")
    return Name("-" if value is None else short(value))


def _explained(comparison: Comparison) -> Iterable[Block]:
    if comparison.differences:
        yield Lines(
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
        yield Lines(tuple(map(said, comparison.objections)), "bad", text("Objections"))


def _quantities(comparison: Comparison) -> Table:
    check = comparison.check
    sides = [
        side
        for side in dict.fromkeys(EDGES.values())
        if any(side in q.edges for q in check.quantities)
    ]
    rows: list[tuple[Cell, ...]] = [
        (
            word(quantity.name),
            *(number(quantity.edges.get(side), ".1e") for side in sides),
            Name("" if quantity.passed else quantity.where),
        )
        for quantity in check.quantities
    ]
    return Table(
        text(
            "Deviation relative to each quantity's scale, at {count} random configurations",
            count=check.configurations,
        ),
        (
            Column(text("quantity"), left=True),
            *(Column(word(side), "1") for side in sides),
            Column(text("worst at"), left=True),
        ),
        tuple(rows),
        (),
        (page("disagreement.md", "Why the list is complete"),),
    )
