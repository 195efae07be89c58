"""Document and annotations of a comparison: the differences, with the lines of both files.

Input is a ``Comparison`` of a URDF with an MJCF. Causes and differences are shown in the order of
urgency; differences with the same values form a group. The table of quantities has a column per
edge: a pair of evaluations, of two models in the same engine or of the same model in two engines.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.results import shorten
from pupper_analysis.present import document as doc
from pupper_analysis.present.colours import SERIES_COLOURS
from pupper_analysis.present.document import get_english, join_words, text, word
from pupper_analysis.present.documents.registry import build_document, make_document
from pupper_analysis.present.documents.sources import cite_page, quote_line
from pupper_analysis.present.formats import Annotation
from pupper_analysis.present.plots import Canvas, draw_result, make_figure_title, make_panels
from pupper_analysis.robot.compare.differences import (
    MIN_FACTOR,
    UNWRITTEN_KINDS,
    Difference,
    Effect,
    describe_kind,
    has_inverted_urdf_range,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.crosscheck.crosscheck import (
    BODIES,
    COMPARED_QUANTITIES,
    EDGE_NAMES,
    ENGINE_EDGES,
    EXTRAS_EDGE,
    JOINTS,
    MJCF_MUJOCO,
    MJCF_PINOCCHIO,
    URDF_MUJOCO,
    URDF_PINOCCHIO,
    URDF_YOURDFPY,
    Comparison,
    CrossCheck,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def list_matching_notes(comparison: Comparison) -> Iterable[Diagnostic]:
    """Yield notes on assumptions of a comparison: matched joints, and parts without comparison."""
    yield from comparison.notes
    if comparison.mount is not None:
        yield diagnose("tilt-is-no-difference", tilt=comparison.mount)
    if comparison.guessed:
        yield _describe_guesses(comparison)
    for joints, file in (
        (comparison.only_urdf, comparison.urdf),
        (comparison.only_mjcf, comparison.mjcf),
    ):
        if joints:
            taken_off = bool(comparison.parts)
            yield diagnose("joints-in-one-file", file=file, joints=joints, taken_off=taken_off)


_MAX_PRINTED_SHARE = 1.005
"""Largest printed ratio of the effect of a single difference to the effect of all differences
together. If differences cancel, the ratio is larger, and a remark replaces it. Chosen, not tuned.
"""


def describe_effects(
    effects_by_quantity: Mapping[str, Effect], count: int | None = None
) -> Diagnostic:
    """Create the message with the effects of a difference on the dynamics, the largest share first.

    An effect is the deviation of a quantity that this single difference causes, relative to the
    scale of the quantity. The share is its part in the deviation that all differences cause
    together.

    Args:
        effects_by_quantity: {quantity: effect}.
        count: Number of differences that cause the effect together; None for a single difference.
    """
    if not effects_by_quantity:
        return diagnose("no-effect")
    effects = [
        diagnose(
            "effect",
            subject=("quantity", name),
            what=Term(name),
            share=Quantity(effect.share, "1") if effect.share <= _MAX_PRINTED_SHARE else None,
            cancelled=effect.share > _MAX_PRINTED_SHARE,
            relative=Quantity(effect.relative, "1") if effect.relative < MIN_FACTOR else None,
            times=effect.relative if effect.relative >= MIN_FACTOR else None,
        )
        for name, effect in sorted(effects_by_quantity.items(), key=lambda item: -item[1].share)
    ]
    return diagnose("effects", effects=effects, count=count)


def make_comparison_annotations(comparison: Comparison) -> list[Annotation]:
    """Create annotations for CI services from the comparison of a URDF with an MJCF.

    For example, each cause and each difference has an annotation.
    """
    urdf, mjcf = comparison.urdf, comparison.mjcf
    annotations = [_make_annotation("part", "part", part, urdf) for part in comparison.parts]
    for cause in comparison.causes:
        first = comparison.differences[cause.differences[0]]
        annotations.append(
            _make_annotation("cause", "cause", cause.diagnostic, first.urdf_place, first.mjcf_place)
        )
    for difference in comparison.differences:
        title = f"{difference.kind} of {difference.element}"
        annotations.append(
            _make_annotation(
                difference.kind,
                title,
                difference.diagnostic,
                difference.urdf_place,
                difference.mjcf_place,
            )
        )
    annotations += [
        _make_annotation("joint", f"joint {name}", message, file)
        for name, message, file in _list_unmatched_joints(comparison)
    ]
    annotations += [
        _make_annotation("agreement", "agreement", objection, mjcf)
        for objection in comparison.objections
    ]
    if comparison.guessed:
        guess = _make_annotation("guess", "guessed joints", _describe_guesses(comparison), urdf)
        annotations.append(replace(guess, level="warning"))
    return annotations


def _list_unmatched_joints(comparison: Comparison) -> Iterable[tuple[str, Diagnostic, str]]:
    """Yield each joint that only a single file contains: name, message, and the file."""
    urdf, mjcf = comparison.urdf, comparison.mjcf
    for joints, file, lacking_path in (
        (comparison.only_urdf, urdf, mjcf),
        (comparison.only_mjcf, mjcf, urdf),
    ):
        for name in joints:
            subject = ("joint", name)
            yield name, diagnose("joint-not-in-file", subject=subject, lacks=lacking_path), file


def _describe_guesses(comparison: Comparison) -> Diagnostic:
    """Create the message with the joints that were matched by structure or parts of names."""
    pairs = [f"{urdf_joint}={mjcf_joint}" for urdf_joint, mjcf_joint in comparison.guessed.items()]
    return diagnose("joints-matched-otherwise", pairs=pairs)


def _make_annotation(
    kind: str, title: str, finding: Diagnostic, place: str | None, other: str | None = None
) -> Annotation:
    """Create an annotation for a CI service at ``place``, ``file:line``; ``other`` is appended."""
    message = str(finding) if other is None else f"{finding} [{other}]"
    rule = f"crosscheck/{kind}"
    about = describe_kind(kind)
    return Annotation("error", title, message, place, rule=rule, about=about, diagnostic=finding)


MAX_SHORT_GROUPS, MAX_SHOWN_GROUPS = 20, 40
"""Largest numbers of groups of differences with lines side by side: groups that are not marked as
details, and all groups. The table lists all differences. Chosen, not tuned."""

_ONE_FILE_EDGES = {
    EDGE_NAMES[URDF_PINOCCHIO, URDF_MUJOCO],
    EDGE_NAMES[MJCF_PINOCCHIO, MJCF_MUJOCO],
    EDGE_NAMES[URDF_PINOCCHIO, URDF_YOURDFPY],
}
"""Names of the pairs of evaluations (edges) of the same file in two engines or by two readers."""

MAX_NAMED_ELEMENTS = 4
"""Largest number of further elements with the same difference that a note names. The table lists
all. Chosen, not tuned."""


@build_document.register(Comparison)
def comparison_document(comparison: Comparison, _: Robot | None = None) -> doc.Document:
    """Create the report of the comparison of a URDF and an MJCF: differences and causes."""
    agree, same = comparison.agree, comparison.same_robot
    messages = (*list_matching_notes(comparison), *comparison.check.notes)
    notes: list[doc.Words] = list(map(doc.diagnostic_text, messages))
    notes += [
        text("the-engines-differ-on-one", engine=doc.diagnostic_text(engine))
        for engine in comparison.engines
    ]
    differ = text("same-robot-different-conventions") if same else text("disagree")
    explained = tuple(_describe_explained(comparison))
    extent = _describe_extent(comparison)
    refusal = () if comparison.refusal is None else (doc.diagnostic_text(comparison.refusal),)
    extent_is_short = not (agree and refusal)  # line 2 of an agreement is the refusal
    one_sided = comparison.only_urdf or comparison.only_mjcf
    assumed = comparison.mount is not None or comparison.guessed or one_sided
    return doc.Document(
        text("cross-check"),
        text(
            "urdf-and-mjcf",
            urdf=_format_file_name(comparison.urdf),
            mjcf=_format_file_name(comparison.mjcf),
        ),
        tuple(_list_blocks(comparison)),
        passed=agree,
        verdict=text("agree") if agree else differ,
        warned=(same and not agree) or bool(agree and refusal),
        findings=(
            doc.diagnostic_text(comparison.main_problem),
            *((extent,) if extent_is_short else ()),
            *_describe_largest_mass_change(comparison),
            *refusal,
            *(() if comparison.complete else explained),
        ),
        details=(
            *(() if extent_is_short else (extent,)),
            *(explained if comparison.complete else ()),
        ),
        brief=agree and not assumed,
        notes=tuple(notes),
        next_step=_select_next_step(comparison),
    )


def _select_next_step(comparison: Comparison) -> doc.NextStep:
    """Return the command to suggest next: `audit` of an MJCF that MuJoCo refuses, for example.

    `sync` is not suggested if it writes none of the differences.
    """
    if has_inverted_urdf_range(comparison.differences):
        return doc.NextStep("audit", (comparison.urdf, "--fix"), robot_typed=False)
    kinds = {difference.kind for difference in comparison.differences}
    if not comparison.agree and (not kinds or kinds - {*UNWRITTEN_KINDS}):
        return doc.NextStep("sync")
    if comparison.refusal is not None:
        return doc.NextStep("audit", (comparison.mjcf,), robot_typed=False)
    return doc.NextStep("stand" if comparison.floating else "hold")


def _describe_extent(comparison: Comparison) -> doc.Text:
    """Return a text with the number of differences and the largest deviation of a quantity."""
    count = len(comparison.differences)
    if not count and comparison.agree:
        check = comparison.check
        worst = max(check.quantities, key=lambda quantity: quantity.relative)
        return text(
            "largest-deviation-of-quantities",
            count=len(check.quantities),
            relative=f"{worst.relative:.1e}",
            quantity=word(worst.name),
        )
    found = text("1-difference") if count == 1 else text("count-differences", count=count)
    worst_name, deviation = find_largest_effect(comparison.check)
    if deviation > comparison.check.tolerance:
        share = f"{100 * deviation:.2g} %"
        found = text("differences-deviate", count=found, share=share, quantity=word(worst_name))
    elif count:
        found = text("differences-without-effect", count=found)
    first = comparison.main_problem
    other_causes = [cause.diagnostic for cause in comparison.causes if cause.diagnostic != first]
    if len(other_causes) == len(comparison.causes) or not other_causes:
        return found  # line 1 contains no cause, or the only cause
    cause = doc.diagnostic_text(other_causes[0])
    return text("differences-of-another-cause", differences=found, cause=cause)


def _describe_largest_mass_change(comparison: Comparison) -> Iterable[doc.Text]:
    """Yield a text with the link whose mass differs most, relative to the mass in the URDF.

    Yield nothing if the main problem, in the first line of the report, is a mass, or if the
    difference is below `MIN_PRINTED_MASS_CHANGE`.
    """
    changes = {
        difference.element: difference.mjcf / difference.urdf - 1
        for difference in comparison.differences
        if difference.kind == "mass"
        and isinstance(difference.urdf, float | int)
        and isinstance(difference.mjcf, float | int)
        and difference.urdf > 0
    }
    first = comparison.main_problem
    if not changes or first.code in _CODES_WITH_MASS or first.values.get("kind") == "mass":
        return
    link = max(changes, key=lambda name: abs(changes[name]))
    if abs(changes[link]) >= MIN_PRINTED_MASS_CHANGE:
        yield text(
            "largest-mass-change", link=doc.Name(link), change=f"{100 * changes[link]:+.3g} %"
        )


MIN_PRINTED_MASS_CHANGE = 0.01
"""Smallest relative difference of a mass that the short answer states [1]. Chosen, not tuned."""

_CODES_WITH_MASS = ("inertials-of-another-robot", "links-lacking")
"""Codes of causes whose text states a mass."""


def find_largest_effect(check: CrossCheck) -> tuple[str, float]:
    """Return the dynamic or kinematic quantity with the largest deviation between both models.

    Parameters, such as masses and limits, are no effects. Deviations between engines do not count.

    Returns:
        Name of the quantity, and its relative deviation [1].
    """
    deviations = {
        quantity.name: max(
            (value for edge, value in quantity.edge_deviations.items() if edge not in ENGINE_EDGES),
            default=0.0,
        )
        for quantity in check.quantities
        if COMPARED_QUANTITIES[quantity.name][0] not in (BODIES, JOINTS)
    }
    worst = max(deviations, key=deviations.__getitem__, default="")
    return worst, deviations.get(worst, 0.0)


def _format_file_name(path: str) -> doc.Name:
    """Return the file name of a path, without folders."""
    return doc.Name(Path(path).name)


def _list_blocks(comparison: Comparison) -> Iterable[doc.Block]:
    """Yield the blocks of the document, with causes and differences in the order of urgency."""
    causes, groups = comparison.causes, comparison.unexplained_differences
    files = {"urdf-file": comparison.urdf, "mjcf-file": comparison.mjcf}
    named = tuple(text(label, file=doc.Name(file)) for label, file in files.items())
    yield doc.Lines(named, detail=True)
    for part in comparison.parts:
        off = text("part-it-was-taken-off", part=doc.diagnostic_text(part))
        yield doc.Lines((off,), "bad", text("only-in-one-file"))
    # Headline and blocks have the order of the differences.
    listed: list[tuple[int, doc.Block]] = []
    # Causes are sorted by joint effect; they take the places of their differences in this order.
    places = sorted(cause.differences[0] for cause in causes if not cause.is_reported_first)
    free_places = iter(places)
    for cause in causes:
        first = comparison.differences[cause.differences[0]]
        made = text("this-alone-makes-count-differences", count=len(cause.differences))
        such = text("the-kind-of-element", kind=word(first.kind), element=first.element)
        sides = _make_difference_block(
            comparison,
            first,
            doc.diagnostic_text(cause.diagnostic),
            made,
            such,
            effects=_format_effects(
                cause.effects or first.effects, len(cause.differences) if cause.effects else None
            ),
        )
        listed.append((-1 if cause.is_reported_first else next(free_places), sides))
    numbers = {id(difference): number for number, difference in enumerate(comparison.differences)}
    for place, group in enumerate(groups[:MAX_SHOWN_GROUPS]):
        sides = _make_difference_block(
            comparison,
            group[0],
            doc.diagnostic_text(group[0].diagnostic),
            *_list_similar_elements(group),
            effects=_format_effects(group[0].effects),
        )
        listed.append((numbers[id(group[0])], replace(sides, detail=place >= MAX_SHORT_GROUPS)))
    yield from (block for _, block in sorted(listed, key=itemgetter(0)))
    if comparison.differences:
        yield _tabulate_differences(comparison)
    if comparison.objections:
        yield doc.Lines(
            tuple(map(doc.diagnostic_text, comparison.objections)), "bad", text("objections")
        )
    yield _tabulate_quantities(comparison)


def _list_similar_elements(group: list[Difference]) -> Iterable[doc.Words]:
    """Yield a note that names further elements with the same difference."""
    if len(group) > 1:
        names = [doc.Name(difference.element) for difference in group[1 : MAX_NAMED_ELEMENTS + 1]]
        listed = join_words(names)
        if len(group) > MAX_NAMED_ELEMENTS + 1:
            listed = text("names", names=listed)
        yield text("likewise-on-count-more-names", count=len(group) - 1, names=listed)


def _make_difference_block(
    comparison: Comparison,
    difference: Difference,
    title: doc.Words,
    *notes: doc.Words,
    effects: doc.Words,
) -> doc.FileFinding:
    """Create the block of a difference, with the quoted lines of both files and the effects."""
    paths = (comparison.urdf, comparison.mjcf)
    columns = []
    for place, value, other_value in (
        (difference.urdf_place, difference.urdf, difference.mjcf),
        (difference.mjcf_place, difference.mjcf, difference.urdf),
    ):
        line = quote_line(place, *paths)
        shown = (
            doc.Name(line) if line else doc.Name(f"{shorten(value, other_value)} {difference.unit}")
        )
        named = doc.Name(_shorten_place(place)) if place else text("not-in-the-file")
        columns.append(doc.FilePlace(named, shown, place or ""))
    made_of = map(doc.diagnostic_text, difference.made_of)
    return doc.FileFinding(title, tuple(columns), (*notes, *made_of, effects))


def _format_effects(effects: Mapping[str, Effect], count: int | None = None) -> doc.Text:
    """Return the text of the effects of ``count`` differences, unobtrusive if there are none."""
    return doc.diagnostic_text(describe_effects(effects, count), "" if effects else "quiet")


def _tabulate_differences(comparison: Comparison) -> doc.Table:
    """Create the table of all differences, a row each, the most urgent first."""
    rows: list[tuple[doc.Cell, ...]] = []
    for order, difference in enumerate(comparison.differences, start=1):
        effect = difference.relative_effects[1]
        rows.append(
            (
                doc.number_cell(order, "g"),
                word(difference.kind),
                doc.Name(difference.element),
                _make_value_cell(difference.urdf, difference.mjcf),
                _make_value_cell(difference.mjcf, difference.urdf),
                doc.Name(difference.unit),
                doc.number_cell(effect, ".2g", scale=100),
                doc.Name(_shorten_place(difference.urdf_place)),
                doc.Name(_shorten_place(difference.mjcf_place)),
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


def _shorten_place(place: str | None) -> str:
    """Return a place with the file name only, without folders; empty for None."""
    return "" if place is None else Path(place).name


def _make_value_cell(value: object, other: object) -> doc.Cell:
    """Create a cell with a differing value of one file; a dash if the file has no value.

    ``other`` is the value of the other file; the digits show the difference.
    """
    if isinstance(value, float | int):
        compared = float(other) if isinstance(other, float | int) else float(value)
        return doc.pair_cells(float(value), compared, ".6g")[0]
    return doc.Name("-" if value is None else shorten(value, other))


def _describe_explained(comparison: Comparison) -> Iterable[doc.Words]:
    """Yield the percentage of the deviation between both files that the differences explain."""
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


def _make_deviation_cell(relative: float | None, tolerance: float) -> doc.Number:
    """Make a cell with a relative deviation, marked if above the tolerance."""
    beyond = relative is not None and relative > tolerance
    return doc.number_cell(relative, ".1e", "bad" if beyond else "")


_SIDES_HEIGHT = 0.5
"""Vertical distance between the first and the last mark of a quantity, relative to the distance of
the rows [1]. In one line, the marks of equal deviations would cover each other. Chosen, not tuned.
"""


@draw_result.register(Comparison)
def plot_comparison(comparison: Comparison, _: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Plot the largest relative deviation of each quantity between models and between engines."""
    check = comparison.check
    every = dict.fromkeys(EDGE_NAMES.values())
    sides = [
        side
        for side in every
        if any(quantity.edge_deviations.get(side) for quantity in check.quantities)
    ]
    names = [get_english(word(quantity.name)) for quantity in check.quantities]
    title = get_english(make_figure_title(make_document(comparison)))
    (axes,) = make_panels(title, 0.16 * len(names) + 1.6, canvas)
    styles = zip(itertools.cycle("osv^Dx"), itertools.cycle(SERIES_COLOURS))
    rows = np.arange(len(names), dtype=float)
    shifts = _SIDES_HEIGHT * np.linspace(-0.5, 0.5, max(len(sides), 2))
    for side, shift, (marker, colour) in zip(sides, shifts, styles, strict=False):
        deviations = [
            quantity.edge_deviations.get(side) or math.nan for quantity in check.quantities
        ]
        label = get_english(word(side))
        axes.plot(deviations, rows + shift, marker, color=colour, label=label, ms=4)
    tolerance = f"tolerance {check.tolerance:g}"
    axes.axvline(check.tolerance, color="black", ls="--", lw=1, label=tolerance)
    axes.set(xscale="log", xlabel="largest relative deviation (1); zeros are left out")
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    canvas.add_legend(axes, columns=2)
    return (axes,)


def _tabulate_quantities(comparison: Comparison) -> doc.Table:
    """Create the table of relative deviations: a row per quantity, a column per compared pair."""
    check = comparison.check
    every = dict.fromkeys(EDGE_NAMES.values())
    sides = [side for side in every if any(side in q.edge_deviations for q in check.quantities)]
    if not any(quantity.edge_deviations.get(EXTRAS_EDGE) for quantity in check.quantities):
        sides.remove(EXTRAS_EDGE)  # all zeros: the MJCF has no such terms
    rows: list[tuple[doc.Cell, ...]] = [
        (
            word(quantity.name),
            *(
                _make_deviation_cell(quantity.edge_deviations.get(side), check.tolerance)
                for side in sides
            ),
            doc.Name("" if quantity.passed else quantity.location),
        )
        for quantity in check.quantities
    ]
    return doc.Table(
        text("deviation-title", count=check.configurations),
        (
            doc.Column(text("quantity"), left=True),
            *(doc.Column(word(side), "1", detail=side in _ONE_FILE_EDGES) for side in sides),
            doc.Column(text("worst-at"), left=True),
        ),
        tuple(rows),
        (),
        (cite_page("explanation/models.md", "Why the list is complete"),),
        detail=True,
    )
