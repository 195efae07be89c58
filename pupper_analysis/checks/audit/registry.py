"""The register of rules: each is a small function with the reasons for its existence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from pupper_analysis.checks.audit.result import Severity
from pupper_analysis.models.places import Place

Check = Callable[[Any], Iterator["Found"]]
"""Takes a ``View`` (or a ``UrdfView`` or ``MjcfView``, if the rule is for that format alone)."""

BOTH = ("urdf", "mjcf")


@dataclass(frozen=True)
class Rule:
    """One thing that can be wrong in a file.

    Attributes:
        id: Its name in kebab case.
        severity: How bad it is, at its worst.
        title: What is wrong, in a few words.
        why: Why it matters.
        todo: What to do.
        formats: Which of ``"urdf"`` and ``"mjcf"`` it is for.
    """

    id: str
    severity: Severity
    title: str
    why: str
    todo: str
    formats: tuple[str, ...] = BOTH


@dataclass(frozen=True)
class Found:
    """What a check yields.

    Attributes:
        kind: The tag of the element at fault.
        name: Its name; "" where the file as a whole is at fault.
        message: One sentence with the numbers.
        child: A path below the element, for the line.
        place: Where it is, if the element cannot be found by its name.
        severity: If less bad than the rule says.
    """

    kind: str
    name: str
    message: str
    child: str | None = None
    place: Place | None = None
    severity: Severity | None = None


_RULES: dict[str, Rule] = {}
_CHECKS: dict[str, Check] = {}

RULES: Mapping[str, Rule] = MappingProxyType(_RULES)
"""All rules, by id."""

CHECKS: Mapping[str, Check] = MappingProxyType(_CHECKS)
"""The function of each rule."""


def rules_table() -> str:
    """Returns all rules as a table in Markdown."""
    lines = ["| rule | severity | for | what is wrong | why it matters | what to do |"]
    lines.append("|" + "---|" * 6)
    for one in _RULES.values():
        where = ", ".join(name.upper() for name in one.formats)
        cells = (f"`{one.id}`", str(one.severity), where, one.title, one.why, one.todo)
        row = " | ".join(cell.replace("|", "\\|").replace("<", "&lt;") for cell in cells)
        lines.append(f"| {row} |")
    return "\n".join(lines) + "\n"


def rule(
    id: str,
    severity: Severity,
    title: str,
    *,
    why: str,
    todo: str,
    formats: tuple[str, ...] = BOTH,
) -> Callable[[Check], Check]:
    """Registers a check as a rule; the arguments are those of ``Rule``."""

    def register(check: Check) -> Check:
        assert id not in _RULES, id
        _RULES[id] = Rule(id, severity, title, why, todo, formats)
        _CHECKS[id] = check
        return check

    return register
