"""Prints the audit of a model file, for people and for machines."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from pupper_analysis.checks.audit import RULES, Audit, Finding, Severity
from pupper_analysis.report.console import escape, print_notes
from pupper_analysis.report.formats import Annotation, Case

STYLES = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "cyan"}
LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "notice"}
"""Of annotations."""


def print_rules(out: Console) -> None:
    """Prints all rules."""
    width = max(len(name) for name in RULES)
    for rule in RULES.values():
        formats = ", ".join(rule.formats)
        line = f"{rule.id:{width}}  {rule.severity:7}  {formats:10}  {rule.title}"
        out.print(escape(line), soft_wrap=True)
    out.print(f"{len(RULES)} rules; --disable RULE leaves one out")


def print_audit(out: Console, audit: Audit) -> None:
    """Prints the findings, the worst first; what to do, once for those of a rule."""
    print_notes(out, audit.notes)
    rules: dict[tuple[str, Severity, str, str], list[Finding]] = {}
    for finding in audit.findings:
        key = finding.rule, finding.severity, finding.why, finding.todo
        rules.setdefault(key, []).append(finding)
    for (_, _, why, todo), findings in rules.items():
        alike: dict[str, list[Finding]] = {}
        for finding in findings:
            alike.setdefault(finding.message, []).append(finding)
        for group in alike.values():
            _print_alike(out, group)
        out.print(f"  {escape(f'{why} {todo}')}", style="dim", soft_wrap=True)
    counts = ", ".join(
        f"{number} {severity}{'' if severity == 'info' or number == 1 else 's'}"
        for severity, number in audit.counts.items()
    )
    verdict = "[bold green]SOUND[/]"
    if not audit.passed:
        verdict = "[bold red]UNSOUND[/]"
    elif audit.counts.get(Severity.WARNING):
        verdict = "[bold yellow]SUSPECT[/]"  # no error, but what is very likely a slip
    out.print(
        f"{verdict} {escape(audit.file)}: {counts}, by {len(audit.rules_run)} rules", soft_wrap=True
    )


def _print_alike(out: Console, findings: Sequence[Finding]) -> None:
    """Prints findings of which only the element is another, with the place of the first."""
    first, *others = findings
    style = STYLES[first.severity]
    out.print(
        f"[{style}]{first.severity}[/] {escape(_place(first))} [dim]{first.rule}[/]",
        soft_wrap=True,
    )
    more = f"; likewise {', '.join(other.element for other in others)}" if others else ""
    out.print(f"  {escape(f'{first.element}: {first.message}{more}')}", soft_wrap=True)


def _place(finding: Finding) -> str:
    return finding.file if finding.line is None else f"{finding.file}:{finding.line}"


def remarks(audit: Audit) -> list[Annotation]:
    """Returns the findings as annotations."""
    return [
        Annotation(
            LEVELS[finding.severity],
            f"{finding.rule}: {finding.element}",
            f"{finding.element}: {finding.message} {finding.todo}",
            _place(finding),
            rule=f"audit/{finding.rule}",
            about=RULES[finding.rule].title,
        )
        for finding in audit.findings
    ]


def cases(audit: Audit) -> list[Case]:
    """Returns one case per rule; errors and warnings are its failures."""
    failures: dict[str, list[str]] = {}
    for finding in audit.findings:
        if finding.severity is not Severity.INFO:
            text = f"{_place(finding)}: {finding.element}: {finding.message}"
            failures.setdefault(finding.rule, []).append(text)
    return [
        Case(rule, "\n".join(failures[rule]) if rule in failures else None)
        for rule in audit.rules_run
    ]


def rank(severity: str) -> int:
    """Returns the rank of a severity by name; 0 is the worst."""
    return Severity(severity).rank


def worst_rank(audit: Audit) -> int:
    """Returns the rank of the worst finding; one more than the mildest's if there is none."""
    return min((finding.severity.rank for finding in audit.findings), default=len(Severity))
