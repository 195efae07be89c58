"""Document of `sync`: written attributes and remaining differences.

Input is the result of a sync; output is a document that is independent of the output format. If no
difference was selected, the differences are listed with examples of the option ``--take``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pupper_analysis.models.efforts import is_placeholder_number
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.robot.compare.differences import (
    UNWRITTEN_KINDS,
    Difference,
    has_inverted_urdf_range,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.sync.models import Sync, format_difference_label, format_owner_name
from pupper_analysis.tools.sync.plan import UnwrittenCause


@build_document.register(Sync)
def sync_document(
    sync: Sync,
    _: Robot | None = None,
    *,
    files: Sequence[str | Path] = (),
    chosen: bool = True,
    dry_run: bool = False,
) -> doc.Document:
    """Create the report of a sync: changed numbers of URDF and MJCF, remaining differences.

    `build_document` calls this function for a `Sync`.

    Args:
        sync: Result.
        files: URDF and MJCF, for the title.
        chosen: True if values were chosen; otherwise the differences are listed as choices.
        dry_run: True to show the changes as a diff that was not written.
    """
    blocks = (
        _make_edit_blocks(sync, dry_run)
        if chosen or not sync.differences
        else _make_choice_blocks(sync)
    )
    names = [doc.Name(Path(file).name) for file in files]
    count = len(sync.edits)
    is_hypothetical = dry_run or sync.withheld or bool(sync.differences and not chosen)
    edit_count = text(
        "attributes-that-would-be-written" if is_hypothetical else "attributes-written-count",
        count=count,
    )
    if chosen:
        messages = [edit_count]
        if sync.not_mended:
            left = list(sync.not_mended)
            kept = text(
                "unwritten-differences",
                name=left[0].difference,
                distance=None,
                count=None,
            )
            messages.append(text("differences-left-count", count=len(left), kept=kept))
        if dry_run:
            messages.append(text("dry-run-writes-nothing"))
    else:
        messages = [*_describe_differences(sync)]
    agree = text("sync-would-agree" if is_hypothetical and sync.edits else "agree")
    return doc.Document(
        text("sync"),
        text("urdf-and-mjcf", **dict(zip(("urdf", "mjcf"), names, strict=True)))
        if names
        else text("both-files"),
        tuple(blocks),
        passed=sync.agree,
        verdict=agree if sync.agree else text("disagree"),
        failures=tuple(_describe_impossible_changes(sync)),
        findings=tuple(messages),
        notes=tuple(
            text("difference-note", difference=doc.Name(name), note=doc.diagnostic_text(note))
            for name, note in sync.notes.items()
        ),
        next_step=_select_next_step(sync, files, chosen=chosen, dry_run=dry_run),
    )


def _describe_differences(sync: Sync) -> Iterable[doc.Text]:
    """Yield the number of differences and the difference to repair first, or that none exists."""
    if not sync.differences:
        yield text("no-difference-to-sync")
        yield text("nothing-to-write")
        return
    yield text("differences-listed-count", count=len(sync.differences))
    if sync.left_by_side:
        side = _find_better_side(sync)
        other = "urdf" if side == "mjcf" else "mjcf"
        yield text(
            "differences-left-by-side",
            side=side,
            other=other,
            count=len(sync.differences),
            removed=len(sync.differences) - sync.left_by_side[side],
            fewer=len(sync.differences) - sync.left_by_side[other],
            equal=sync.left_by_side[side] == sync.left_by_side[other],
            kept=_describe_unwritten(sync.differences),
        )
    first = doc.diagnostic_text(sync.differences[0].diagnostic)
    yield text("difference-first", difference=first)


def _describe_unwritten(differences: Iterable[Difference]) -> doc.Text | None:
    """Return the first difference of a kind that `sync` does not write, and their number.

    None without such a difference.
    """
    unwritten = [difference for difference in differences if difference.kind in UNWRITTEN_KINDS]
    if not unwritten:
        return None
    return text(
        "unwritten-differences",
        name=format_owner_name(unwritten[0]),
        distance=unwritten[0].diagnostic.values.get("distance"),
        count=len(unwritten) if len(unwritten) > 1 else None,
    )


def _select_next_step(
    sync: Sync, files: Sequence[str | Path], *, chosen: bool, dry_run: bool
) -> doc.NextStep:
    """Return the command that the report proposes to run next.

    If values were not chosen, it is `sync` with the values that leave fewer differences, or `audit`
    of the URDF if no difference can be removed.
    """
    if sync.agree and not sync.edits:
        return doc.NextStep("stand" if sync.floating else "hold")
    is_stuck = (
        not sync.edits
        if chosen
        else min(sync.left_by_side.values(), default=0) >= len(sync.differences)
    )
    if files and not sync.agree and is_stuck:
        fix = ("--fix",) if has_inverted_urdf_range(sync.differences) else ()
        return doc.NextStep("audit", (str(files[0]), *fix), robot_typed=False)
    if not chosen and not sync.agree:
        return doc.NextStep("sync", ("--take", _find_better_side(sync), "--dry-run"))
    if dry_run and sync.edits and not sync.withheld:
        return doc.NextStep("sync", omitted=("--dry-run",))
    return doc.NextStep("crosscheck")


def _find_better_side(sync: Sync) -> str:
    """Return the file whose values are proposed, ``"urdf"`` or ``"mjcf"``.

    The file with fewer probable placeholders among the differing values is proposed, then the file
    whose values leave fewer differences. If both numbers are equal, the first difference decides
    (`_select_side`).
    """
    counts = {side: _count_placeholders(sync.differences, side) for side in ("urdf", "mjcf")}
    if len(set(counts.values())) > 1:
        return min(counts, key=counts.__getitem__)
    left = sync.left_by_side
    if len(set(left.values())) > 1:
        return min(left, key=left.__getitem__)
    return _select_side(sync.differences[0])


def _count_placeholders(differences: Sequence[Difference], side: str) -> int:
    """Return the number of differences whose value in a file is probably a placeholder.

    A mass is also a placeholder if this file repeats the mass at three or more differing links,
    and the other file states different masses for these links.
    """
    by_mass: dict[object, list[object]] = {}
    for difference in differences:
        if difference.kind == "mass":
            value, other = _get_values(difference, side)
            by_mass.setdefault(value, []).append(other)
    repeated = {
        mass
        for mass, new_masses in by_mass.items()
        if len(new_masses) >= _MIN_REPEATED_MASSES and len(set(new_masses)) > 1
    }
    return sum(
        _is_placeholder(difference, side)
        or (difference.kind == "mass" and _get_values(difference, side)[0] in repeated)
        for difference in differences
    )


def _get_values(difference: Difference, side: str) -> tuple[Any, Any]:
    """Return the values of a difference in the file ``side`` and in the other file."""
    values = difference.urdf, difference.mjcf
    return values if side == "urdf" else values[::-1]


_MIN_REPEATED_MASSES = 3
"""Lower bound of the number of links with one mass that counts as a placeholder. Chosen, not tuned:
an exporter writes its default at all links."""

_MIN_PLACEHOLDER_RATIO = 2.0
"""Lower bound [1] of the ratio between a probable placeholder and the value in the other file.
Chosen, not tuned: a smaller difference may be a correction of the value."""


def _is_placeholder(difference: Difference, side: str) -> bool:
    """Return True if the mass or effort limit in a file is probably a placeholder.

    The value is 1, 2 or 5 times a power of ten from 100 on, and much larger than a positive value
    in the other file that is no such number.
    """
    value, other = _get_values(difference, side)
    if difference.kind not in ("effort", "mass") or not (
        isinstance(value, float | int) and isinstance(other, float | int)
    ):
        return False
    larger = math.isfinite(value) and value > _MIN_PLACEHOLDER_RATIO * other > 0
    return larger and is_placeholder_number(value) and not is_placeholder_number(other)


def _select_side(difference: Difference) -> str:
    """Return the file whose value the report proposes to take, ``"urdf"`` or ``"mjcf"``.

    The URDF, unless the value in the URDF is missing, or is a limit or mass of zero, which many
    exporters write for an unknown value.
    """
    unstated = (math.inf, -math.inf, *((0.0,) if difference.kind in ("effort", "mass") else ()))
    urdf, mjcf = (
        value is not None and not (isinstance(value, float | int) and value in unstated)
        for value in (difference.urdf, difference.mjcf)
    )
    return "mjcf" if mjcf and not urdf else "urdf"


def _describe_impossible_changes(sync: Sync) -> Iterable[doc.Words]:
    """Yield the text "nothing was written because of ... impossible changes", if there are any."""
    if sync.withheld:
        count = sum(unmended.cause == UnwrittenCause.NOT_MENDED for unmended in sync.not_mended)
        yield text(
            "nothing-is-written-count",
            count=count,
        )


def _make_choice_blocks(sync: Sync) -> Iterable[doc.Block]:
    """Yield the differences with the lines in both files, then examples of ``--take``.

    The sync must have a difference.
    """
    for difference in sync.differences:
        places = (difference.urdf_place, difference.mjcf_place)
        columns = tuple(
            doc.FilePlace(doc.Name(place), doc.Name(quote_line(place)), place)
            for place in places
            if place
        )
        yield doc.FileFinding(doc.diagnostic_text(difference.diagnostic), columns)
    first, kind = format_difference_label(sync.differences[0]), sync.differences[0].kind
    kind = f'"{kind}"' if " " in kind else kind
    yield doc.Lines(
        (
            text("nothing-was-changed-take-urdf"),
            doc.Name(f'--take mjcf:1   --take urdf:"{first}"   --take mjcf:{kind}'),
            text("with-dry-run-it-shows"),
        )
    )


def _make_edit_blocks(sync: Sync, dry_run: bool) -> Iterable[doc.Block]:
    """Yield the written changes (or the diff of a dry run), backups and remaining differences."""
    if dry_run:
        if sync.diff:
            yield doc.Listing(text("what-would-change"), sync.diff, "diff")
    elif sync.edits and not sync.withheld:
        edits = []
        for edit in sync.edits:
            old = "(not stated)" if edit.old is None else edit.old
            line = f"{edit.file}:{edit.line}: {edit.element}: {edit.attribute}: {old} -> {edit.new}"
            edits.append(doc.Name(line))
        yield doc.Lines(tuple(edits), title=text("what-was-written"))
    if sync.backups:
        lines = (text("the-old-file-is-kept", file=doc.Name(file)) for file in sync.backups)
        yield doc.Lines(tuple(lines))
    if sync.not_mended:
        yield doc.Lines(
            tuple(
                text("difference-note", difference=doc.Name(unmended.difference),
                     note=doc.diagnostic_text(unmended.reason))
                for unmended in sync.not_mended
            ),
            "bad",
            text("not-written"),
        )  # fmt: skip
