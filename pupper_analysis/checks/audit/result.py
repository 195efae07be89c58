"""What an audit finds: findings, and the audit as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.diagnostics import Diagnostic, Severity
from pupper_analysis.models.places import Place
from pupper_analysis.results import Result, Tabular


@dataclass(frozen=True, eq=False)
class Finding(Result):
    """One thing that is wrong in a file.

    Attributes:
        rule: The id of the rule that found it.
        severity: The rule's, or a lesser one where the case is less bad.
        file: The file in which it stands (an included one, perhaps).
        line: Its line, from 1; None where it is nowhere in particular.
        prim: The path of its prim, in a USD; None in other files.
        element: ``link 'FL_calf'``.
        why: Why it matters.
        todo: What to do.
        diagnostic: What is wrong, as a code, of which a rule may have several, and numbers with
            units, of that element and place.
    """

    rule: str
    severity: Severity
    file: str
    line: int | None
    element: str
    why: str
    todo: str
    diagnostic: Diagnostic
    prim: str | None = None

    _told = ("message",)

    @property
    def message(self) -> str:
        """One sentence with the numbers."""
        return str(self.diagnostic)

    @property
    def place(self) -> Place:
        """Where it stands: file and line, or file and prim."""
        return Place(Path(self.file), self.line, self.prim)

    def __str__(self) -> str:
        return f"{self.severity} {self.place} {self.element}: {self.message} [{self.rule}]"


@dataclass(frozen=True, eq=False)
class Audit(Tabular):
    """What is wrong in one file.

    Attributes:
        file: The file.
        format: ``"urdf"``, ``"mjcf"`` or ``"usd"``.
        passed: Whether nothing of severity ERROR was found.
        counts: How many findings of each severity.
        findings: The worst first, then by line.
        rules_run: The ids of the rules that were run.
        disabled: The ids of those that were not, on demand.
        notes: What was left out.
    """

    file: str
    format: str
    passed: bool
    counts: Mapping[str, int]
    findings: tuple[Finding, ...]
    rules_run: tuple[str, ...]
    disabled: tuple[str, ...]
    notes: tuple[Diagnostic, ...]

    def _columns(self) -> dict[str, list[object]]:
        names = ("rule", "severity", "file", "line", "element", "message")
        return {name: [getattr(found, name) for found in self.findings] for name in names}
