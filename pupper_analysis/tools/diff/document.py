"""Document of a diff: changes between two versions of a model.

Input is a ``ModelDiff``. The document contains each change with the quoted lines of both versions
and the effect, the change of mass, and the gravity torques that have changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from pupper_analysis.base.arguments import is_finite_number
from pupper_analysis.base.diagnostics import format_number, format_pair
from pupper_analysis.base.results import shorten
from pupper_analysis.base.units import (
    find_common_units,
)
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.robot.compare.attribution import MAX_RESIDUAL
from pupper_analysis.robot.compare.differences import INERTIAL_KINDS, MIN_FACTOR
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.diff.compare import ModelChange, ModelDiff

_MIN_RELATIVE_CHANGE = 1e-3
"""Change of a gravity torque, relative to the larger of the old and new torque, up to which the
table of torques omits the joint. Chosen, not tuned.
"""


@build_document.register(ModelDiff)
def diff_document(diff: ModelDiff, _: Robot | None = None) -> doc.Document:
    """Create the report of the changes between two versions of a model.

    `build_document` calls this function for a `ModelDiff`.
    """
    changes = _describe_count(diff)
    return doc.Document(
        text("changes"),
        _format_title(diff),
        tuple(_list_blocks(diff)),
        passed=diff.same,
        verdict=text("same") if diff.same else text("different"),
        findings=(text("no-change") if diff.same else changes, *_describe_mass(diff)),
        notes=tuple(map(doc.diagnostic_text, diff.notes)),
        next_step=None
        if ":" in diff.new
        else doc.NextStep(_select_next_command(diff), (diff.new,), robot_typed=False),
    )


def _describe_count(diff: ModelDiff) -> doc.Text:
    """Return the number of changes and the first; or the mass from which all changes follow.

    The first change is not named if the masses of both versions agree: line 2 then contains it.
    """
    count = len(diff.changes)
    bodies = {change.element for change in diff.changes if change.kind in INERTIAL_KINDS}
    is_inertial = all(change.kind in INERTIAL_KINDS for change in diff.changes)
    if count > 1 and is_inertial and len(bodies) == 1 and len(diff.edited_masses) == 1:
        ((link, (old, new)),) = diff.edited_masses.items()
        old_text, new_text = format_pair(old, new, ".6g")
        mass = text(
            "mass-of-link-edited", link=doc.Name(link), old=old_text, new=new_text, count=count
        )
        change = _format_percent(old, new)
        return text("mass-change", mass=mass, change=change) if change else mass
    changes = text("1-change") if count == 1 else text("count-changes", count=count)
    if not diff.changes or not _format_percent(*diff.mass):
        return changes
    first = diff.changes[0]  # line 2 contains the masses, not a change
    name = _name_element(first)
    named = text("changes-first", changes=changes, one=count == 1, kind=word(first.kind), name=name)
    old, new = first.old, first.new
    if first.kind == "mass" and len(diff.edited_masses) == 1:  # the link may be fixed to another
        ((link, (old, new)),) = diff.edited_masses.items()
        name = doc.Name(link)
    if not (is_finite_number(old) and is_finite_number(new)):
        return named
    # A single further change is named.
    second = diff.changes[1] if count == 2 else None
    is_other = second is not None and _name_element(second) != _name_element(first)
    old_text, new_text = format_pair(old, new, ".4g")
    edited = text(
        "change-of-value",
        name=name,
        kind=word(first.kind),
        old=old_text,
        new=f"{new_text} {first.unit}".rstrip(),
        change=_format_percent(old, new),
        second=None if second is None or is_other else word(second.kind),
        other=word(second.kind) if second is not None and is_other else None,
        element=None if second is None else _name_element(second),
        more=count - 1 if count > 2 else None,
    )
    return named.with_short_form(edited)


def _name_element(change: ModelChange) -> doc.Name:
    """Return the name of the changed element, as its message names the element."""
    subject = change.diagnostic.subject
    return doc.Name(change.element if subject is None else subject.name)


def _select_next_command(diff: ModelDiff) -> str:
    """Return the command that computes the changed load of the motors, or else `audit`.

    A robot whose mesh files are missing may lack its feet: `audit` states the files.
    """
    if any(note.code in _MISSING_MESH_CODES for note in diff.notes):
        return "audit"
    if diff.floating and _format_percent(*diff.mass):
        return "stand"
    return "hold" if _list_changed_torques(diff) and not diff.floating else "audit"


_MISSING_MESH_CODES = ("meshes-missing", "files-missing")
"""Codes of the notes on missing mesh files of a URDF, and of an MJCF."""


def _format_title(diff: ModelDiff) -> doc.Text:
    """Return the names of both versions; the short form omits folders, unless both names agree."""
    title = text("old-and-new", old=doc.Name(diff.old), new=doc.Name(diff.new))
    old, new = (Path(version).name for version in (diff.old, diff.new))
    if old == new:
        return title
    return title.with_short_form(text("old-and-new", old=doc.Name(old), new=doc.Name(new)))


def _describe_mass(diff: ModelDiff) -> Iterable[doc.Words]:
    """Yield the headline of a diff: the masses of both versions [kg], or the first change."""
    old, new = diff.mass
    if diff.same:
        yield text("mass-of-both", mass=f"{new:.6g}")
    elif not _format_percent(old, new) and diff.changes:
        yield doc.diagnostic_text(diff.changes[0].diagnostic)
    else:
        old_text, new_text = format_pair(old, new, ".6g")
        mass = text("mass-old-kg-now-new", old=old_text, new=new_text)
        if change := _format_percent(old, new):
            mass = text("mass-change", mass=mass, change=change)
        yield mass


def _list_blocks(diff: ModelDiff) -> Iterable[doc.Block]:
    """Yield the blocks of a diff: changes with lines, combined effects, torques, and residual."""
    for change in diff.changes:
        yield doc.FileFinding(
            doc.diagnostic_text(change.diagnostic),
            (
                _make_file_place(diff.old, change.old_place, (change.old, change.new), change.unit),
                _make_file_place(diff.new, change.new_place, (change.new, change.old), change.unit),
            ),
            (
                *_describe_stated_masses(diff, change),
                *(
                    tuple(map(doc.diagnostic_text, change.consequences))
                    or (_describe_dynamics_change(change),)
                ),
            ),
        )
    if diff.combined:
        title = text("all-changes-together") if diff.changes else text("no-change-explains")
        yield doc.Lines(
            tuple(map(doc.diagnostic_text, diff.combined)),
            "" if diff.changes else "bad",
            title,
        )
    if not diff.same:
        yield from _tabulate_torques(diff)
    if not diff.complete:
        name = max(diff.residual, key=lambda quantity: diff.residual[quantity])
        left = text(
            "left-of-quantity-is-left",
            left=f"{diff.residual[name]:.1e}",
            quantity=word(name),
        )
        yield doc.Lines((left,), "bad")


def _describe_stated_masses(diff: ModelDiff, change: ModelChange) -> Iterable[doc.Text]:
    """Yield the stated mass that a changed mass contains, if no link states the changed mass."""
    if change.kind != "mass" or len(diff.edited_masses) != 1:
        return
    ((link, (old, new)),) = diff.edited_masses.items()
    if not math.isclose(old, float(change.old), rel_tol=_ROUNDING_RTOL):
        old_text, new_text = format_pair(old, new, ".6g")
        yield text("stated-mass-with-links", link=doc.Name(link), old=old_text, new=new_text)


def _make_file_place(
    file: str, place: str, values: tuple[object, object], unit: str
) -> doc.FilePlace:
    """Create the place of a value in a file, with the quoted line or else the value.

    ``place`` is path and line, may be empty; ``values`` are those of this version and of the other
    one.
    """
    value, other = values
    line = quote_line(place, file) or f"{shorten(value, other)} {unit}".rstrip()
    named = doc.Name(Path(place).name) if place else text("not-in-the-file")
    return doc.FilePlace(named, doc.Name("-" if value is None else line), place)


def _describe_dynamics_change(change: ModelChange) -> doc.Text:
    """Return a sentence on how much a change alone changes each quantity of the dynamics."""
    if not change.effects:
        unknown = change.kind in _NOT_EVALUATED_KINDS
        key = "effect-not-evaluated" if unknown else "no-effect-on-the-dynamics"
        return text(key).with_mark("quiet")
    effects = sorted(change.effects.items(), key=lambda item: -item[1].relative)
    listed = join_words(
        text("quantity-by-times", quantity=word(name), times=format_number(effect.relative, ".2g"))
        if effect.relative >= MIN_FACTOR
        else text(
            "quantity-by-effect", quantity=word(name), effect=format_number(effect.relative, ".2g%")
        )
        for name, effect in effects
    )
    return text("alone-it-changes-effects", effects=listed)


_NOT_EVALUATED_KINDS = ("joint", "type")
"""Kinds of changes that the report calls not evaluated if they have no effects: for example joints
in a single version, and another type of the base.
"""


_ROUNDING_RTOL = 1e-12
"""Relative difference [1] up to which two values count as equal: sums of masses in another order
differ by rounding. Chosen, not tuned.
"""


def _format_percent(old: float, new: float) -> str:
    """Format the change of a value in percent, or as a factor if large; "" if equal or from 0."""
    if not old or math.isclose(old, new, rel_tol=_ROUNDING_RTOL):
        return ""
    ratio = new / old
    if ratio <= MIN_FACTOR:
        return f"{100 * (ratio - 1):+.3g} %"
    return f"x {format_number(ratio, '.3g')}"


def _list_changed_torques(
    diff: ModelDiff, tolerance: float = _MIN_RELATIVE_CHANGE
) -> dict[str, tuple[float, float]]:
    """Return the gravity torques [N m, N] that change by more than a relative tolerance."""
    return {
        name: pair
        for name, pair in diff.torques.items()
        if abs(pair[1] - pair[0]) > tolerance * max(pair)
    }


def _describe_torques(diff: ModelDiff) -> doc.Text:
    """Return a sentence on the largest change of a gravity torque, with the base held."""
    changed = _list_changed_torques(diff)
    if not changed:
        moved = _list_changed_torques(diff, MAX_RESIDUAL)
        most = f"{100 * _MIN_RELATIVE_CHANGE:g}" if moved else ""
        return text("torques-change-by-less", free=diff.floating, most=most)
    joint = max(
        changed,
        key=lambda name: (
            abs(changed[name][1] / changed[name][0] - 1) if changed[name][0] else math.inf
        ),
    )
    old, new = changed[joint]
    old_text, new_text = format_pair(old, new, ".4g")
    return text(
        "torques-change-by-up-to",
        free=diff.floating,
        joint=joint,
        old=old_text,
        new=new_text,
        unit=diff.torque_units[joint],
        change=_format_percent(old, new),
    )


def _tabulate_torques(diff: ModelDiff) -> Iterable[doc.Block]:
    """Yield a line with the largest change of a gravity torque, and a table if torques change.

    Another line states that the standing robot is not compared, if its mass has changed.
    """
    if diff.torques:
        weight = _format_percent(*diff.mass) if diff.floating else ""
        standing = (text("standing-not-compared", change=weight),) if weight else ()
        yield doc.Lines((_describe_torques(diff), *standing))
    changed = _list_changed_torques(diff)
    if not changed:
        return
    unit = find_common_units(diff.torque_units[name] for name in changed).effort
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(name),
            *doc.pair_cells(old, new, ".4g"),
            doc.Number(_format_percent(old, new), 100 * (new / old - 1) if old else float("nan")),
        )
        for name, (old, new) in changed.items()
    ]
    yield doc.Table(
        text("greatest-torque-that-holds"),
        (
            doc.Column(text("joint"), left=True),
            doc.Column(text("old"), unit),
            doc.Column(text("new"), unit),
            doc.Column(text("change"), "%"),
        ),
        tuple(rows),
        detail=True,
    )
