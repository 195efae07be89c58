"""The section of an audit: what is wrong in one file, with the line where it stands."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.checks.audit import RULES, Audit, Finding, Severity
from pupper_analysis.report.html import document as doc
from pupper_analysis.report.html.sentences import said
from pupper_analysis.report.html.sources import page, quoted
from pupper_analysis.report.html.words import text, word

_MARKS = {Severity.ERROR: "bad", Severity.WARNING: "warn", Severity.INFO: ""}


def audit_section(audit: Audit) -> doc.Section:
    """Returns what is wrong in one file."""
    blocks: list[doc.Block] = []
    if audit.findings:
        blocks += [_findings(audit), _advice(audit.findings)]
    if audit.notes:
        blocks.append(doc.Lines(tuple(map(said, audit.notes)), "warn", text("Left out")))
    told = [
        text("{count} of severity {severity}", count=count, severity=word(severity))
        for severity, count in audit.counts.items()
    ]
    told.append(text("by {count} rules", count=len(audit.rules_run)))
    worst = [
        text("{element}: {message}", element=said(one.element), message=said(one.message))
        for one in audit.findings[:3]
    ]
    return doc.Section(
        doc.Name(Path(audit.file).name),
        tuple(blocks),
        audit.passed,
        _verdict(audit),
        (*told, *worst),
        audit.passed and bool(audit.counts.get(Severity.WARNING)),
    )


def _verdict(audit: Audit) -> doc.Text:
    if not audit.passed:
        return text("UNSOUND")
    return text("SUSPECT") if audit.counts.get(Severity.WARNING) else text("SOUND")


def _findings(audit: Audit) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = []
    for order, one in enumerate(audit.findings, start=1):
        line = "" if one.line is None else f":{one.line}"
        rows.append(
            (
                doc.Number(str(order), order, _MARKS[one.severity]),
                word(str(one.severity)),
                doc.Name(one.rule),
                word(RULES[one.rule].title) if one.rule in RULES else doc.Name(""),
                said(one.element),
                said(one.message),
                doc.Name(f"{Path(one.file).name}{line}"),
                doc.Name(quoted(f"{one.file}{line}", audit.file)),
            )
        )
    return doc.Table(
        text("Findings, the worst first"),
        (
            doc.Column(text("no."), "1"),
            doc.Column(text("severity"), left=True),
            doc.Column(text("rule"), left=True),
            doc.Column(text("what the rule looks for"), left=True),
            doc.Column(text("of"), left=True),
            doc.Column(text("finding"), left=True),
            doc.Column(text("line"), left=True),
            doc.Column(text("what stands there"), left=True),
        ),
        tuple(rows),
        (),
        (page("audit.md", "What is compared with what"),),
    )


def _advice(findings: tuple[Finding, ...]) -> doc.Lines:
    """Returns why each rule matters, and what to do, once per rule."""
    ruled = {one.rule: one for one in reversed(findings)}
    lines = tuple(
        text("{rule}: {why} {todo}", rule=doc.Name(rule), why=said(one.why), todo=said(one.todo))
        for rule, one in reversed(ruled.items())
    )
    return doc.Lines(lines, title=text("Why, and what to do"))
