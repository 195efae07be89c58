"""The register of rules: each has its reasons in the catalogue, and a small function."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from pupper_analysis.diagnostics import Diagnostic, Severity
from pupper_analysis.models.places import Place

Check = Callable[[Any], Iterator["Found"]]
"""Takes a ``RobotModel`` (a ``UrdfModel`` and the like, if it is for that format alone)."""

FORMATS = ("urdf", "mjcf", "usd")


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
        formats: Which of ``"urdf"``, ``"mjcf"`` and ``"usd"`` it is for.
    """

    id: str
    severity: Severity
    title: str
    why: str
    todo: str
    chinese: Mapping[str, str]
    formats: tuple[str, ...] = FORMATS


@dataclass(frozen=True)
class Found:
    """What a check yields.

    Attributes:
        kind: The tag of the element at fault.
        name: Its name; "" where the file as a whole is at fault.
        told: What is wrong with it.
        child: A path below the element, for the line.
        place: Where it is, if the element cannot be found by its name.
        severity: If less bad than the rule says.
    """

    kind: str
    name: str
    told: Diagnostic
    child: str | None = None
    place: Place | None = None
    severity: Severity | None = None


def _catalogue() -> dict[str, Rule]:
    """Reads what the rules are called, how bad they are, and their reasons and remedies."""
    file = files("pupper_analysis.checks.audit.rules").joinpath("catalogue.toml")
    entries = tomllib.loads(file.read_text(encoding="utf-8"))
    rules = {}
    for name, entry in entries.items():
        words = _words(entry, entries[entry.get("like", name)], " ")
        chinese = _words(entry["zh"], entries[entry.get("like", name)]["zh"], "")
        formats = tuple(entry.get("formats", FORMATS))
        severity = Severity(entry["severity"])
        rules[name] = Rule(name, severity, **words, chinese=chinese, formats=formats)
    return rules


def _words(own: Mapping[str, str], model: Mapping[str, str], space: str) -> dict[str, str]:
    """Returns title, reason and remedy in one language; what is not its own is the model's."""
    why = space.join([model["why"], *([own["more"]] if "more" in own else [])])
    return {"title": own["title"], "why": why, "todo": model["todo"]}


_CHECKS: dict[str, Check] = {}

RULES: Mapping[str, Rule] = MappingProxyType(_catalogue())
"""All rules, by id."""

CHECKS: Mapping[str, Check] = MappingProxyType(_CHECKS)
"""The function of each rule."""


def rule(check: Check) -> Check:
    """Registers a check as that of the rule of its name: ``axis_zero`` of ``axis-zero``."""
    name = check.__name__.replace("_", "-")
    assert name in RULES, f"catalogue.toml has no rule {name}"
    _CHECKS[name] = check
    return check
