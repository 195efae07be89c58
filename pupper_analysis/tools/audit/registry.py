"""The register of rules: each has its reasons in the catalogue, and a small function."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.tools import formats
from pupper_analysis.models.loading import Check
from pupper_analysis.models.places import Place

FORMATS = ("urdf", "mjcf", *formats())


@dataclass(frozen=True)
class Rule:
    """One thing that can be wrong in a file.

    Attributes:
        id: Its name in kebab case.
        severity: How bad it is, at its worst.
        title: What is wrong, in a few words.
        why: Why it matters.
        todo: What to do.
        chinese: {``"title"``, ``"why"`` or ``"todo"``: the same in Simplified Chinese}.
        formats: Which of ``FORMATS`` it is for.
    """

    id: str
    severity: Severity
    title: str
    why: str
    todo: str
    chinese: Mapping[str, str]
    formats: tuple[str, ...] = FORMATS


def _catalogue() -> dict[str, Rule]:
    """Reads what the rules are called, how bad they are, and their reasons and remedies.

    Those for a format of its own stand in ``rules.toml`` of its folder.
    """
    own = Path(__file__).parent / "rules/catalogue.toml"
    entries = tomllib.loads(own.read_text(encoding="utf-8"))
    for format in formats().values():
        if (file := format.folder / "rules.toml").is_file():
            theirs = tomllib.loads(file.read_text(encoding="utf-8"))
            entries |= {name: {"formats": [format.name], **entry} for name, entry in theirs.items()}
    rules = {}
    for name, entry in entries.items():
        words = _words(entry, entries[entry.get("like", name)], " ")
        chinese = _words(entry.get("zh", {}), entries[entry.get("like", name)]["zh"], "")
        stated = tuple(entry.get("formats", FORMATS))
        severity = Severity(entry["severity"])
        rules[name] = Rule(name, severity, **words, chinese=chinese, formats=stated)
    return rules


def _words(own: Mapping[str, str], model: Mapping[str, str], space: str) -> dict[str, str]:
    """Returns title, reason and remedy in one language; what is not its own is the model's."""
    why = space.join([model["why"], *([own["more"]] if "more" in own else [])])
    return {"title": own["title"], "why": why, "todo": model["todo"]}


_CHECKS: dict[str, Check] = {}

RULES: Mapping[str, Rule] = MappingProxyType(_catalogue())
"""All rules, by id."""

CHECKS: Mapping[str, Check] = MappingProxyType(_CHECKS)
"""The function of each rule that is not of a format of its own."""


def rule(check: Check) -> Check:
    """Registers a check as that of the rule of its name: ``axis_zero`` of ``axis-zero``."""
    name = check.__name__.replace("_", "-")
    assert name in RULES, f"catalogue.toml has no rule {name}"
    _CHECKS[name] = check
    return check


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

    _reported = ("message",)

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
        format: One of ``FORMATS``.
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
