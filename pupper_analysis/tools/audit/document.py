"""Document of an audit: the findings in a file, with the lines concerned.

Input is an ``Audit``. Findings of a rule with equal severity and message form a group, with the
quoted line and the repairs of the first finding. The findings are also converted to annotations for
CI systems, with the repairs as byte ranges.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rich.cells import cell_len

from pupper_analysis.base.diagnostics import LANGUAGES, Diagnostic, term
from pupper_analysis.models.published import is_published_name
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import SEVERITY_MARKS, join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.present.formats import ANNOTATION_LEVELS, Annotation, Fix
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.audit.audit import (
    RULES,
    Audit,
    Finding,
    Rule,
    Severity,
)
from pupper_analysis.tools.audit.fix import (
    list_computed_repairs,
    list_unique_repairs,
    locate_repair,
)
from pupper_analysis.tools.audit.registry import MODEL_FORMATS, ValueRepair

MAX_SHOWN_GROUPS = 40
"""Largest number of groups of findings that are not marked as details. Chosen, not tuned."""


@build_document.register(Audit)
def audit_document(audit: Audit, _: Robot | None = None) -> doc.Document:
    """Create the report of an audit: grouped findings, the most severe first, and a count.

    `build_document` calls this function for an `Audit`.
    """
    rules = text("by-count-rules", count=len(audit.rules_run))
    suspect = bool(audit.counts.get(Severity.WARNING))
    passed = text("audit-warnings") if suspect else text("audit-ok")  # no error, but likely a slip
    return doc.Document(
        text("audit"),
        doc.Name(Path(audit.file).name),
        tuple(_group_findings(audit)),
        passed=audit.passed,
        verdict=passed if audit.passed else text("audit-errors"),
        warned=audit.passed and suspect,
        findings=(
            join_words([describe_counts(audit.counts), rules]),
            *describe_first_finding(audit.findings),
            *_describe_fix(audit),
        ),
        next_step=_select_next_step(audit),
        notes=tuple(map(doc.diagnostic_text, audit.notes)),
    )


def describe_patch(document: doc.Document, audit: Audit, count: int) -> doc.Document:
    """Replace the answer of an audit's report by that of `audit --fix`.

    The answer states the number of repairs in the patch, the findings that the patch repairs, and
    the most severe of the other findings. `audit` prints the findings, so they become details.

    Args:
        document: Report of the audit.
        audit: Audit of the unchanged file.
        count: Number of repairs in the patch.
    """
    computed = list_computed_repairs([audit])
    written = [repair for repair in list_unique_repairs([audit]) if repair not in computed]
    other_findings = [
        finding
        for finding in audit.findings
        if len(finding.repairs) != 1 or finding.repairs[0] not in written
    ]
    repaired = len(audit.findings) - len(other_findings)
    answer = text("audit-patch", count=count, repaired=repaired, findings=len(audit.findings))
    blocks = (
        replace(block, detail=True) if isinstance(block, doc.FileFinding) else block
        for block in document.blocks
    )
    remaining = describe_first_finding(
        other_findings, "audit-remaining" if count else "audit-first"
    )
    return replace(document, findings=(answer, *remaining), blocks=tuple(blocks))


def describe_counts(counts: Mapping[str, int]) -> doc.Words:
    """Return a text with the number of findings by severity: ``1 error, 2 warnings, 0 notes``."""
    return join_words(
        text("count-severity", count=count, severity=word(_pluralise_severity(severity, count)))
        for severity, count in counts.items()
    )


def describe_first_finding(
    findings: Sequence[Finding], key: str = "audit-first"
) -> Iterable[doc.Words]:
    """Yield the text ``key`` of the first, most severe finding, if there is a finding."""
    if findings:
        first, *following = findings
        alike = [
            finding_alike
            for finding_alike in following
            if (finding_alike.rule, finding_alike.message) == (first.rule, first.message)
        ]
        finding = summarise_finding(first.rule, first.diagnostic, len(alike))
        yield text(key, finding=finding)


def _describe_fix(audit: Audit) -> Iterable[doc.Words]:
    """Yield the text that `audit --fix` proposes a patch, if this is the next command."""
    step = _select_next_step(audit)
    if step is not None and "--fix" in step.words:
        yield text("fix-proposes", count=len(list_unique_repairs([audit])))


MAX_SUMMARY_WIDTH = 92
"""Largest width [columns] of a finding in a short answer, after "first: ". A Chinese character has
two columns. A longer message is replaced by its first clause, if this has a number and fits, and
the title of the rule."""


def summarise_finding(rule: str, diagnostic: Diagnostic, num_alike: int = 0) -> doc.Text:
    """Return element and message of a finding, with a short form of one clause.

    Args:
        rule: Id of the rule.
        diagnostic: Message of the finding.
        num_alike: Number of further elements with the same message.
    """
    message = doc.diagnostic_text(diagnostic)
    if "start" in diagnostic.values:  # the message names the configuration
        return message
    subject = diagnostic.subject
    is_part = subject is not None and subject.kind in ("link", "joint", "body")
    element = text(
        "audit-elements",
        element=format_element(diagnostic),
        name=doc.Name(subject.name) if subject is not None and subject.name and is_part else None,
        more=num_alike or None,
    )
    finding = text("element-message", element=element, message=message)
    title = get_rule_text(rule, "title")
    short, short_zh = (
        _shorten_finding(finding, element, message, title, language) for language in LANGUAGES
    )
    return replace(finding, short=short, short_zh=short_zh)


def _shorten_finding(
    finding: doc.Text, element: doc.Text, message: doc.Text, title: doc.Text, language: str
) -> str:
    """Return a finding in a language in at most `MAX_SUMMARY_WIDTH` columns, if possible.

    The result is the short form of ``finding``. If this form is too wide, the result contains the
    short form of ``element``, the first clause of ``message`` if it has a number and fits, and
    ``title``.
    """
    whole = doc.translate(finding, language, short=True)
    if cell_len(whole) <= MAX_SUMMARY_WIDTH:
        return whole
    title_words = doc.translate(title, language)
    is_name = any(map(str.isupper, title_words.partition(" ")[0][1:]))  # such as MuJoCo
    if not is_name:
        title_words = f"{title_words[:1].lower()}{title_words[1:]}"
    clause = _CLAUSE_END_PATTERN.split(doc.translate(message, language, short=True), maxsplit=1)[0]
    colon = doc.translate(text("colon"), language)
    name = doc.translate(element, language, short=True)
    with_number = colon.join((name, clause, title_words))
    if re.search(r"\d", clause) and cell_len(with_number) <= MAX_SUMMARY_WIDTH:
        return with_number
    return colon.join((name, title_words))


_CLAUSE_END_PATTERN = re.compile(r"[,;:] | \(|[，；：。（]")  # noqa: RUF001
"""End of the first clause of a message."""


def _select_next_step(audit: Audit) -> doc.NextStep | None:
    """Return the command that the report proposes to run next, or None."""
    simulated = Path(audit.file).suffix.lower() in (".urdf", ".xml", ".mjcf")
    flawed = any(finding.severity is not Severity.NOTE for finding in audit.findings)
    if flawed and simulated and list_unique_repairs([audit]):
        return doc.NextStep("audit", ("--fix",))
    if not audit.passed:  # to be repaired by hand: -v prints the lines and what to do
        return doc.NextStep("audit", ("-v",))
    if not simulated and not is_published_name(audit.file):
        return None
    missing = [finding for finding in audit.findings if finding.rule == "mesh-missing"]
    for values in (finding.diagnostic.values for finding in missing):
        package, folder = values.get("package"), values.get("folder")
        if package and folder:
            found = os.path.relpath(Path(audit.file).parent / str(folder))
            return doc.NextStep("audit", ("--package", f"{package}={found}"))
        if package:
            return doc.NextStep("audit", ("-v",))  # prints each missing file
    # Without meshes, a robot may lack its feet; `hold` needs no meshes.
    return doc.NextStep("stand" if audit.floating and not missing else "hold")


def _pluralise_severity(severity: str, count: int) -> str:
    """Return the catalogue key of a severity, in the plural unless ``count`` is 1."""
    return severity if count == 1 else f"{severity}s"


def _group_findings(audit: Audit) -> Iterable[doc.FileFinding]:
    """Yield findings with equal messages as groups, the most severe first."""
    rules: dict[tuple[str, Severity], dict[str, list[Finding]]] = {}
    for finding in audit.findings:
        key = finding.rule, finding.severity
        rules.setdefault(key, {}).setdefault(finding.message, []).append(finding)
    shown = 0
    for (rule, _), alike in rules.items():
        why, todo = get_rule_text(rule, "why"), get_rule_text(rule, "todo")
        advice: tuple[doc.Words, ...] = (text("why-todo", why=why, todo=todo).with_mark("quiet"),)
        for place, group in enumerate(alike.values(), start=1):
            sides = _describe_finding_group(audit, group, advice if place == len(alike) else ())
            yield replace(sides, detail=shown >= MAX_SHOWN_GROUPS)
            shown += 1


def _describe_finding_group(
    audit: Audit, group: Sequence[Finding], advice: tuple[doc.Words, ...]
) -> doc.FileFinding:
    """Describe findings of a rule with equal messages, with place and repairs of the first finding.

    ``advice`` are texts about the rule and the general repair.
    """
    first, *others = group
    message = doc.diagnostic_text(first.diagnostic)
    said = text("element-message", element=format_element(first.diagnostic), message=message)
    if others:
        names = join_words(format_element(finding.diagnostic) for finding in others)
        said = text("finding-likewise-names", finding=said, names=names)
    advice = (*_describe_repairs(first), *advice)
    path = first.place.path
    quote = doc.Name(quote_line(path, audit.file))
    tag = text(
        "severity-rule",
        severity=word(str(first.severity)),
        rule=first.rule,
    ).with_mark(SEVERITY_MARKS[first.severity])
    return doc.FileFinding(
        said, (doc.FilePlace(doc.Name(str(first.place)), quote, path),), advice, tag
    )


def _describe_repairs(finding: Finding) -> Iterable[doc.Words]:
    """Describe the repair, or the alternative repairs, of a finding; nothing without a repair."""
    candidates = [
        (_format_change(repair), doc.diagnostic_text(repair.reason)) for repair in finding.repairs
    ]
    if len(candidates) == 1:
        (repair,) = finding.repairs
        # Only values of an expanded text, or of a robot in memory, have no line.
        is_stated = finding.line is not None or (
            Path(repair.file).is_file() and bool(locate_repair(repair))
        )
        yield describe_repair(repair, is_stated=is_stated)
    elif candidates:
        changes = join_words(
            text("repair-candidate", change=change, reason=reason) for change, reason in candidates
        )
        yield text("repair-candidates", changes=changes)


def describe_repair(repair: ValueRepair, *, is_stated: bool = True) -> doc.Text:
    """Describe the only repair of a finding, and whether `audit --fix` writes the repair.

    Args:
        repair: The repair.
        is_stated: Whether a file states the old value. False, for example, if a xacro macro
            computes the value.
    """
    if repair.is_estimate:
        key = "repair-estimate"
    else:
        key = "repair-unique" if is_stated else "repair-computed"
    return text(
        key,
        change=_format_change(repair),
        reason=doc.diagnostic_text(repair.reason),
    )


def _format_change(repair: ValueRepair) -> doc.Name:
    """Format old and new values: ``link 'FL_calf': mass value 0.05 -> 0.06``."""
    parts = []
    for change in repair.list_changes():
        values = ", ".join(
            f"{word} {change.old[word]} -> {new}".replace("  ", " ")
            for word, new in change.new.items()
        )
        part = f"{change.child.rpartition('/')[2]} " if change.child else ""
        parts.append(f"{part}{values}")
    return doc.Name(f"{repair.tag} {repair.name!r}: {'; '.join(parts)}")


def get_rule_text(rule: str, what: str) -> doc.Text:
    """Return a text of an audit rule in English and Chinese: title, reason or repair.

    Args:
        rule: Id of the rule.
        what: ``"title"``, ``"why"`` (the reason) or ``"todo"`` (the repair).
    """
    return doc.Text(getattr(RULES[rule], what), RULES[rule].chinese[what])


def format_element(finding: Diagnostic) -> doc.Text:
    """Return kind and name of the element of a finding, such as ``link 'FL_calf'``."""
    subject = finding.subject
    assert subject is not None
    name = f" {subject.name!r}" if subject.name else ""
    return doc.Text(*(f"{term(subject.kind, language)}{name}" for language in LANGUAGES))


def _list_formats(rule: Rule) -> doc.Cell:
    """Create a cell with the file formats to which a rule applies."""
    return (
        text("all-formats") if rule.formats == MODEL_FORMATS else doc.Name(", ".join(rule.formats))
    )


def make_rules_table() -> doc.Table:
    """Create the table of all audit rules: id, severity, file formats and title."""
    return doc.Table(
        text("count-rules-disable-rule-leaves", count=len(RULES)),
        (
            doc.Column(text("rule"), left=True),
            doc.Column(text("severity"), left=True),
            doc.Column(text("formats"), left=True),
            doc.Column(text("what-the-rule-looks"), left=True),
        ),
        tuple(
            (
                doc.Name(rule.id),
                word(str(rule.severity)),
                _list_formats(rule),
                get_rule_text(rule.id, "title"),
            )
            for rule in RULES.values()
        ),
    )


# Annotations for machines.


def make_fix(repair: ValueRepair) -> Fix:
    """Convert a repair to byte ranges of the file on disk, each with the replacing text."""
    splices = locate_repair(repair)
    return Fix(f"{_format_change(repair).text} ({repair.reason})", repair.file, splices)


def make_audit_annotations(audit: Audit) -> list[Annotation]:
    """Create an annotation for CI systems from each finding of an audit."""
    return [
        Annotation(
            ANNOTATION_LEVELS[finding.severity],
            f"{finding.rule}: {finding.element}",
            f"{finding.element}: {finding.message} {finding.todo}",
            finding.place.path,
            rule=f"audit/{finding.rule}",
            about=RULES[finding.rule].title,
            diagnostic=finding.diagnostic,
            fixes=tuple(map(make_fix, finding.repairs)),
        )
        for finding in audit.findings
    ]
