"""The document of a contract: what differs, both lines side by side; and all that is stated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from pathlib import Path

from pupper_analysis.base.diagnostics import Severity
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import cite_page, quote_line
from pupper_analysis.present.formats import Annotation
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.contract.contract import Contract
from pupper_analysis.tools.contract.facts import QUANTITIES, Fact, find_quantity_kind
from pupper_analysis.tools.contract.findings import Disagreement

SEVERITY_MARKS = {Severity.ERROR: "bad", Severity.WARNING: "warn", Severity.NOTE: ""}
ANNOTATION_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "notice"}

MAX_SHOWN_FINDINGS = 25
"""Findings whose lines are shown side by side; the table has them all."""


@build_document.register(Contract)
def contract_document(contract: Contract, _: Robot | None = None) -> doc.Document:
    """Returns what differs between sources, and what they state; see ``build_document``."""
    message = text(
        "contract-count",
        findings=len(contract.findings),
        facts=len(contract.facts),
        sources=len(contract.sources),
    )
    found = bool(contract.findings)
    agree = text("contract-agree-but" if found else "contract-agree")
    return doc.Document(
        text("contract"),
        doc.Name(Path(contract.model).name),
        tuple(_blocks(contract)),
        passed=contract.passed,
        verdict=agree if contract.passed else text("contract-differ"),
        warned=contract.passed and found,
        findings=(message,),
        notes=tuple(map(doc.diagnostic_text, contract.notes)),
    )


def _blocks(contract: Contract) -> Iterable[doc.Block]:
    for number, finding in enumerate(contract.findings):
        yield _sides(finding, detail=number >= MAX_SHOWN_FINDINGS)
    if contract.poses:
        yield _poses(contract)
    yield _sources(contract)
    for quantity in QUANTITIES:
        stating = [one for one in contract.facts if one.quantity == quantity and one.joint]
        if stating:
            yield _table(contract, stating, word(quantity), find_quantity_kind(quantity).unit)
    settings = [one for one in contract.facts if not one.joint]
    if settings:
        yield _table(contract, settings, text("contract-settings"))
    if any(one.observations for one in contract.sources):
        yield _observations(contract)


def _sides(finding: Disagreement, *, detail: bool) -> doc.FileFinding:
    numbers = {place: number for number, place in enumerate(finding.places)}
    columns = tuple(
        doc.FilePlace(
            doc.Name(Path(place).name),
            doc.Name(quote_line(place) or _value(finding, number)),
            place,
        )
        for place, number in numbers.items()
    )
    tag: doc.Words = word(str(finding.severity))
    if finding.slip:
        tag = text("severity-rule", severity=tag, rule=word(finding.slip))
    tag = tag.with_mark(SEVERITY_MARKS[finding.severity]) if isinstance(tag, doc.Text) else tag
    return doc.FileFinding(
        doc.diagnostic_text(finding.diagnostic),
        columns,
        tuple(map(doc.diagnostic_text, finding.effects)),
        tag,
        detail,
    )


def _value(finding: Disagreement, number: int) -> str:
    value = finding.values[number]
    return "-" if value is None else f"{value:.6g} {finding.unit}".rstrip()


def _column(key: str, unit: str = "", *, detail: bool = False) -> doc.Column:
    return doc.Column(text(key), unit, left=not unit, detail=detail)


def _poses(contract: Contract) -> doc.Table:
    columns = (
        _column("contract-source"),
        _column("contract-height", "mm"),
        _column("contract-sag", "mm"),
        _column("contract-utilisation", "%"),
        _column("contract-stays"),
    )
    ends: dict[bool | None, doc.Cell] = {
        None: doc.Name("-"),
        True: text("contract-stays-up"),
        False: text("contract-falls").with_mark("bad"),
    }
    rows = tuple(
        (
            doc.Name(pose.source),
            doc.number_cell(pose.height, ".1f", scale=1e3),
            doc.number_cell(pose.sag, ".1f", scale=1e3),
            doc.number_cell(pose.utilisation, ".1f", scale=100.0),
            ends[pose.stays],
        )
        for pose in contract.poses
    )
    notes = tuple(
        text("contract-pose-note", source=pose.source, why=doc.diagnostic_text(pose.problem))
        for pose in contract.poses
        if pose.problem is not None
    )
    source = (cite_page("how-to/contract.md", "The default poses"),)
    return doc.Table(text("contract-poses"), columns, rows, notes, source)


def _sources(contract: Contract) -> doc.Table:
    columns = (
        _column("contract-source"),
        _column("contract-role"),
        _column("contract-numbers", "1"),
        _column("contract-order-how"),
    )
    count = Counter(fact.source for fact in contract.facts)
    rows = tuple(
        (
            doc.Name(one.name),
            word(one.role),
            doc.number_cell(count[one.name], ".0f"),
            text(f"contract-order-{one.how or 'none'}"),
        )
        for one in contract.sources
    )
    return doc.Table(text("contract-sources"), columns, rows, detail=False)


def _table(
    contract: Contract, facts: Sequence[Fact], title: doc.Words, unit: str = ""
) -> doc.Table:
    """Returns a quantity, or all settings: a row per joint, or setting, a column per source."""
    by = {(one.joint or one.quantity, one.source): one for one in facts}
    names = [one.name for one in contract.sources if any(f.source == one.name for f in facts)]
    found = [one for one in contract.findings if one.kind in {fact.quantity for fact in facts}]
    # A mirror image that is wrong where sources differ is so because of one of the two joints.
    found = [one for one in found if one.slip != "mirror"] or found
    differ = {(row, one.sources[1]) for one in found for row in one.joints or [one.kind]}
    rows: list[tuple[doc.Cell, ...]] = []
    for row in dict.fromkeys([*contract.joints, *(row for row, _ in by)]):
        said = [by.get((row, name)) for name in names]
        if any(said):
            marks = ["bad" if (row, name) in differ else "" for name in names]
            head = doc.Name(row) if row in contract.joints else word(row)
            rows.append((head, *map(_cell, said, marks)))
    columns = [_column("joint" if facts[0].joint else "contract-setting")]
    columns += [doc.Column(doc.Name(name), unit) for name in names]
    places = {name: next(one.place for one in facts if one.source == name) for name in names}
    notes = (
        join_words(
            text("contract-first-place", source=name, place=Path(place).name)
            for name, place in places.items()
        ),
    )
    return doc.Table(title, tuple(columns), tuple(rows), notes, detail=True)


def _cell(fact: Fact | None, mark: str) -> doc.Cell:
    if fact is None:
        return doc.Name("")
    if fact.value is None:
        return text("contract-no-constant", expression=fact.expression)
    return doc.Number(f"{fact.value:.5g}", fact.value, mark)


def _observations(contract: Contract) -> doc.Table:
    seen = {one.name: one.observations for one in contract.sources if one.observations}
    named = [doc.Column(doc.Name(name), left=True) for name in seen]
    rows: list[tuple[doc.Cell, ...]] = []
    for number, row in enumerate(zip_longest(*seen.values(), fillvalue=""), start=1):
        rows.append((doc.number_cell(number, ".0f"), *map(doc.Name, row)))
    columns = (_column("ordinal", "1"), *named)
    return doc.Table(text("contract-observations"), columns, tuple(rows), detail=True)


# For machines.


def make_contract_annotations(contract: Contract) -> list[Annotation]:
    """Returns each finding as an annotation at the line of each source."""
    return [
        Annotation(
            ANNOTATION_LEVELS[one.severity],
            f"{one.slip or one.kind}: {', '.join(one.joints[:3]) or one.kind}",
            f"{one.message} [{one.places[1 - number]}]",
            place,
            about=one.kind,
            rule=f"contract/{one.kind.replace(' ', '-')}",
            diagnostic=one.diagnostic,
        )
        for one in contract.findings
        for place, number in {place: n for n, place in enumerate(one.places)}.items()
    ]
