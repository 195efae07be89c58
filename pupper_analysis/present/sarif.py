"""SARIF, the format that code scanning reads: findings with their rules, places and fingerprints.

Source: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0"; what GitHub asks
for beyond it: GitHub documentation, "SARIF support for code scanning".
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import to_json

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"

_LEVELS = {"error": "error", "warning": "warning", "notice": "note"}
"""SARIF's names of the levels of annotations."""


@dataclass(frozen=True)
class SarifRule:
    """What kind of thing a result is about.

    Attributes:
        id: The same for all such results, in every run.
        about: In a few words; the id, if empty.
    """

    id: str
    about: str = ""


@dataclass(frozen=True)
class SarifResult:
    """One finding.

    Attributes:
        rule: Its rule.
        level: ``error``, ``warning`` or ``notice``.
        message: One sentence.
        subject: What it is about, by name: with rule and file it tells one result from another,
            also after the line, or the number in the message, has changed.
        file: The file; "" if there is none.
        line: From 1; None where the file as a whole is meant.
        known: Whether a baseline has it; None where there is no baseline.
        diagnostic: It as a code and values, if it is one.
    """

    rule: SarifRule
    level: str
    message: str
    subject: str
    file: str
    line: int | None
    known: bool | None = None
    diagnostic: Diagnostic | None = None


def from_root(file: str | Path) -> str:
    """Returns a file's path as CI services know it, with ``/``.

    It is relative to the checkout (or the current folder, where there is none), and absolute if it
    is outside.
    """
    root = Path(os.environ.get("GITHUB_WORKSPACE") or Path.cwd())
    path = Path(os.path.abspath(file))  # noqa: PTH100  (a link is the file that is in the checkout)
    for one, folder in ((path, root), (path.resolve(), root.resolve())):
        if one.is_relative_to(folder):
            return one.relative_to(folder).as_posix()
    return path.as_posix()


def write_sarif(results: Iterable[SarifResult]) -> str:
    """Returns a log of one run, as indented JSON."""
    listed = list(results)
    rules = {result.rule.id: result.rule for result in listed}
    numbers = {name: number for number, name in enumerate(rules)}
    driver = {
        "name": "pupper-analysis",
        "version": version("pupper-analysis"),
        "rules": [
            {"id": rule.id, "shortDescription": {"text": rule.about or rule.id}}
            for rule in rules.values()
        ],
    }
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": list(_results(listed, numbers)),
    }
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2)


def _results(results: Iterable[SarifResult], numbers: dict[str, int]) -> Iterator[dict[str, Any]]:
    before: Counter[tuple[str, str, str]] = Counter()
    for result in results:
        entry: dict[str, Any] = {
            "ruleId": result.rule.id,
            "ruleIndex": numbers[result.rule.id],
            "level": _LEVELS[result.level],
            "message": {"text": _plain(result.message)},
        }
        file = from_root(result.file) if result.file else ""
        if file:
            entry["locations"] = [{"physicalLocation": _location(file, result.line)}]
        same = (result.rule.id, file, result.subject)
        fingerprint = hashlib.sha256("\0".join((*same, str(before[same]))).encode(errors="replace"))
        before[same] += 1
        entry["partialFingerprints"] = {"subject/v1": fingerprint.hexdigest()[:32]}
        if result.known is not None:
            entry["baselineState"] = "unchanged" if result.known else "new"
        if result.diagnostic is not None:
            entry["properties"] = code_and_values(result.diagnostic)
        yield entry


def code_and_values(diagnostic: Diagnostic) -> dict[str, Any]:
    """Returns what a program wants to know of a diagnostic, as JSON has it."""
    told = json.loads(to_json(diagnostic))
    return {name: told[name] for name in ("code", "values")}


def _plain(text: str) -> str:
    """Returns a text that viewers take for no link: names in model files are anybody's.

    Source: SARIF 2.1.0, 3.11.6: "[" and "]" of a message that are no embedded link are escaped.
    """
    return re.sub(r"[\\\[\]]", r"\\\g<0>", text)


def _location(file: str, line: int | None) -> dict[str, Any]:
    # A relative reference may not begin with "C:", which would be a scheme; so ":" is quoted, too.
    uri = Path(file).as_uri() if Path(file).is_absolute() else quote(os.fsencode(file))
    # GitHub shows no result without a line.
    return {"artifactLocation": {"uri": uri}, "region": {"startLine": line or 1}}
