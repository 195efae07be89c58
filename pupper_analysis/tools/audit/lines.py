"""The audit of a model file, for machines."""

from __future__ import annotations

from pupper_analysis.present.formats import Annotation, CheckedItem
from pupper_analysis.tools.audit.audit import (
    RULES,
    Audit,
    Finding,
    Severity,
)

LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "notice"}
"""Of annotations."""


def audit_remarks(audit: Audit) -> list[Annotation]:
    """Returns the findings as annotations."""
    return [
        Annotation(
            LEVELS[finding.severity],
            f"{finding.rule}: {finding.element}",
            f"{finding.element}: {finding.message} {finding.todo}",
            finding.place.path,
            rule=f"audit/{finding.rule}",
            about=RULES[finding.rule].title,
            diagnostic=finding.diagnostic,
        )
        for finding in audit.findings
    ]


def audit_cases(audit: Audit) -> list[CheckedItem]:
    """Returns one case per rule; errors and warnings are its failures."""
    failures: dict[str, list[Finding]] = {}
    for finding in audit.findings:
        if finding.severity is not Severity.NOTE:
            failures.setdefault(finding.rule, []).append(finding)
    return [_case(rule, failures.get(rule, [])) for rule in audit.rules_run]


def _case(rule: str, found: list[Finding]) -> CheckedItem:
    lines = [f"{one.place.path}: {one.element}: {one.message}" for one in found]
    return CheckedItem(rule, "\n".join(lines) or None, tuple(one.diagnostic for one in found))


def rank_severity(severity: str) -> int:
    """Returns the rank of a severity by name; 0 is the worst."""
    return Severity(severity).rank


def worst_rank(audit: Audit) -> int:
    """Returns the rank of the worst finding; one more than the mildest's if there is none."""
    return min((finding.severity.rank for finding in audit.findings), default=len(Severity))
