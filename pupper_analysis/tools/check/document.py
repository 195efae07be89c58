"""The document of a check: what of a repository's models fails, and how much is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pupper_analysis.present import document as doc
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.present.words import join_words, text, word
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.audit.audit import RULES
from pupper_analysis.tools.audit.document import MARKS, element_text, rule_words
from pupper_analysis.tools.check.check import PairCheck, RepositoryCheck
from pupper_analysis.tools.check.lines import (
    before_in_words,
    from_the_root,
    stale_entries,
    summarise_check,
)
from pupper_analysis.tools.check.remarks import Remark


@build_document.register(RepositoryCheck)
def check_document(check: RepositoryCheck, _: Robot | None = None) -> doc.Document:
    """Returns what fails, with its place, and how much is known; see ``build``."""
    blocks: list[doc.Block] = [_group(group) for group in _groups(check.remarks)]
    if check.stale:
        blocks.append(doc.Lines(tuple(map(doc.tell, stale_entries(check))), "warn", text("stale")))
    blocks.append(_pairs(check.pairs))
    notes = tuple(
        text("name-note", name=doc.Name(pair.name), note=doc.tell(note))
        for pair in check.pairs
        for note in pair.notes
    )
    if notes:
        blocks.append(doc.Lines(notes, title=text("notes-title"), detail=True))
    return doc.Document(
        text("check-of-a-repository"),
        doc.Name(Path(check.config).name),
        tuple(blocks),
        passed=check.passed,
        verdict=text("passed") if check.passed else text("FAILED"),
        told=(summarise_check(check),),
    )


def _groups(remarks: Iterable[Remark]) -> list[list[Remark]]:
    """Puts together remarks of one kind and file with the same values, old and new."""
    groups: dict[tuple[str, ...], list[Remark]] = {}
    for remark in remarks:
        same = (remark.state, str(remark.values), str(remark.before))
        key = (remark.check, remark.pair, remark.kind, remark.file, *same)
        groups.setdefault(key, []).append(remark)
    return list(groups.values())


def _group(group: list[Remark]) -> doc.Sides:
    first, *others = group
    notes: list[doc.Words] = []
    if others:
        names = join_words(doc.Name(remark.element) for remark in others)
        notes.append(text("likewise-on-count-more-names", count=len(others), names=names))
    if first.before is not None:
        notes.append(before_in_words(first))
    tag = text(
        "severity-check-kind-state",
        severity=word(str(first.severity)),
        check=first.check,
        kind=first.kind,
        state=word(str(first.state)),
    ).marked(MARKS[first.severity])
    places = [first.place or first.file, *([first.other_place] if first.other_place else [])]
    columns = tuple(
        doc.FilePlace(
            doc.Name(from_the_root(place) or place),
            doc.Name(quote_line(place, first.file)),
            from_the_root(place) or place,
        )
        for place in places
    )
    told: doc.Words = doc.tell(first.diagnostic)
    if first.check == "audit" and first.kind in RULES:
        told = text("element-message", element=element_text(first.diagnostic), message=told)
        notes.append(rule_words(first.kind, "todo"))
    sides = doc.Sides(told, columns, tuple(notes), tag)
    return replace(sides, detail=not any(remark.fails for remark in group))


def _pairs(pairs: Iterable[PairCheck]) -> doc.Table:
    """Returns what was checked."""
    listed = list(pairs)
    agree: dict[bool | None, doc.Cell] = {
        True: text("they-agree"),
        False: text("they-differ"),
        None: doc.Name(""),
    }
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(pair.name),
            text("FAILED").marked("bad") if pair.failures else text("all-ok").marked("good"),
            doc.number_cell(pair.failures, "g"),
            doc.number_cell(pair.known, "g"),
            agree[pair.agree],
            doc.Name(", ".join(pair.files)),
        )
        for pair in listed
    ]
    off = tuple(
        text("name-rule-is-switched-off", name=doc.Name(pair.name),
             rule=doc.Name(rule), reason=doc.Name(reason))
        for pair in listed
        for rule, reason in pair.disabled.items()
    )  # fmt: skip
    return doc.Table(
        text("what-was-checked"),
        (
            doc.Column(text("pair"), left=True),
            doc.Column(text("verdict"), left=True),
            doc.Column(text("to-mend"), "1"),
            doc.Column(text("known"), "1"),
            doc.Column(text("the-files"), left=True),
            doc.Column(text("files"), left=True),
        ),
        tuple(rows),
        off,
    )
