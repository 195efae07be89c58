"""The document of a sync: what is written to make two files agree, and what is left."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.sync.models import Sync, format_difference_label
from pupper_analysis.tools.sync.plan import UnwrittenCause


@build_document.register(Sync)
def sync_document(
    sync: Sync,
    _: Robot | None = None,
    *,
    chosen: bool = True,
    dry_run: bool = False,
) -> doc.Document:
    """Returns what was written, and what is left; see ``build``.

    Args:
        sync: What was done.
        chosen: Whether it was said whose values are taken; if not, the choices are shown.
        dry_run: It was not done: show how the files would change.
    """
    blocks = _done(sync, dry_run) if chosen or not sync.differences else _choices(sync)
    count = len(sync.edits)
    would = dry_run or sync.withheld or bool(sync.differences and not chosen)
    written = text(
        "attributes-that-would-be-written" if would else "attributes-written-count",
        count=count,
    )
    messages = [written]
    if sync.not_mended:
        messages.append(text("differences-left-count", count=len(sync.not_mended)))
    return doc.Document(
        text("sync"),
        text("both-files"),
        tuple(blocks),
        passed=sync.agree,
        verdict=text("agree") if sync.agree else text("disagree"),
        failures=tuple(_withheld(sync)),
        findings=tuple(messages),
        notes=tuple(
            text("difference-note", difference=doc.Name(named), note=doc.diagnostic_text(note))
            for named, note in sync.notes.items()
        ),
    )


def _withheld(sync: Sync) -> Iterable[doc.Words]:
    if sync.withheld:
        failed = sum(left.cause == UnwrittenCause.NOT_MENDED for left in sync.not_mended)
        yield text(
            "nothing-is-written-count",
            count=failed,
        )


def _choices(sync: Sync) -> Iterable[doc.Block]:
    """Yields the differences with their numbers, and what to type."""
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


def _done(sync: Sync, dry_run: bool) -> Iterable[doc.Block]:
    """Yields what was written, or would be, and what is left."""
    if dry_run:
        if sync.diff:
            yield doc.Listing(text("what-would-change"), sync.diff, "diff")
    elif sync.edits and not sync.withheld:
        edits = []
        for edit in sync.edits:
            old = "(not stated)" if edit.old is None else edit.old
            said = f"{edit.file}:{edit.line}: {edit.element}: {edit.attribute}: {old} -> {edit.new}"
            edits.append(doc.Name(said))
        yield doc.Lines(tuple(edits), title=text("what-was-written"))
    if sync.backups:
        kept = (text("the-old-file-is-kept", file=doc.Name(one)) for one in sync.backups)
        yield doc.Lines(tuple(kept))
    if sync.not_mended:
        yield doc.Lines(
            tuple(
                text("difference-note", difference=doc.Name(left.difference),
                     note=doc.diagnostic_text(left.reason))
                for left in sync.not_mended
            ),
            "bad",
            text("not-written"),
        )  # fmt: skip
