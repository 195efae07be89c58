"""Findings in machine-readable formats: GitHub annotations, JUnit XML and SARIF.

Inputs are ``Annotation`` objects. Each writer returns a string.

Sources: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0"; GitHub
documentation, "SARIF support for code scanning".
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.diagnostics.diagnostic import Severity
from pupper_analysis.base.results import to_json

SARIF_SCHEMA_URL = "https://json.schemastore.org/sarif-2.1.0.json"
"""URL of the JSON schema that SARIF files refer to."""

_SARIF_LEVELS = {"error": "error", "warning": "warning", "notice": "note"}
"""{level of an annotation: level of the result in a SARIF file}."""


@dataclass(frozen=True)
class Fix:
    """Change of a file that removes a finding.

    Attributes:
        description: New values and the reason.
        file: File to be changed.
        splices: Start byte, number of bytes and new text of each changed part.
    """

    description: str
    file: str
    splices: tuple[tuple[int, int, str], ...]


ANNOTATION_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "notice"}
"""{severity of a finding: level of its annotation}."""


@dataclass(frozen=True)
class Annotation:
    """Remark on a place in a file.

    Attributes:
        level: ``error``, ``warning`` or ``notice``.
        title: Name of the subject. In SARIF, ``kind``, file and title identify the finding in later
            runs.
        message: Text of the finding.
        place: ``file:line``, ``file:<element>``, ``file``, or None.
        rule: Identifier of the kind of finding; the title is used if empty.
        about: Short description of the rule; ``kind`` is used if empty.
        known: True if a baseline contains the annotation; None without a baseline.
        diagnostic: The finding as code and values; None if there is no such form.
        fixes: Changes that remove the finding: one change, or several alternatives.
    """

    level: str
    title: str
    message: str
    place: str | None = None
    rule: str = ""
    about: str = ""
    known: bool | None = None
    diagnostic: Diagnostic | None = None
    fixes: tuple[Fix, ...] = ()

    @property
    def kind(self) -> str:
        """Identifier of the rule: ``rule``, or ``title`` if ``rule`` is empty."""
        return self.rule or self.title

    @property
    def file_and_line(self) -> tuple[str, int | None]:
        """File (empty if unknown) and line number (None if unknown) of this annotation."""
        file, _, line = (self.place or "").rpartition(":")
        if line.startswith("<"):
            return file, None
        return (file, int(line)) if file and line.isdecimal() else (self.place or "", None)


def relative_to_checkout(file: str | Path) -> str:
    """Return the path of a file relative to the checkout, with ``/`` as separator.

    The checkout is $GITHUB_WORKSPACE. If the variable is not set or empty, the checkout is the
    current folder. The path of a file outside the checkout is absolute.
    """
    root = Path(os.environ.get("GITHUB_WORKSPACE") or Path.cwd())
    path = Path(os.path.abspath(file))  # noqa: PTH100  (a link is the file that is in the checkout)
    for candidate, folder in ((path, root), (path.resolve(), root.resolve())):
        if candidate.is_relative_to(folder):
            return candidate.relative_to(folder).as_posix()
    return path.as_posix()


def write_sarif(annotations: Iterable[Annotation]) -> str:
    """Convert annotations to a SARIF 2.1.0 log with one run, and return it as indented JSON."""
    listed = list(annotations)
    rules = {annotation.kind: annotation.about or annotation.kind for annotation in listed}
    numbers = {name: number for number, name in enumerate(rules)}
    driver = {
        "name": "pupper-analysis",
        "version": version("pupper-analysis"),
        "rules": [
            {"id": kind, "shortDescription": {"text": about}} for kind, about in rules.items()
        ],
    }
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": list(_make_results(listed, numbers)),
    }
    return json.dumps({"$schema": SARIF_SCHEMA_URL, "version": "2.1.0", "runs": [run]}, indent=2)


def _make_results(
    annotations: Iterable[Annotation], numbers: dict[str, int]
) -> Iterator[dict[str, Any]]:
    """Yield a SARIF result object per annotation, with rule, place, fingerprint and fixes.

    By the fingerprint, which does not depend on the line, a server recognises a finding in a later
    run. ``numbers`` is {kind: index of the rule}.
    """
    before: Counter[tuple[str, str, str]] = Counter()
    for annotation in annotations:
        entry: dict[str, Any] = {
            "ruleId": annotation.kind,
            "ruleIndex": numbers[annotation.kind],
            "level": _SARIF_LEVELS[annotation.level],
            "message": {"text": _escape_brackets(annotation.message)},
        }
        file, line = annotation.file_and_line
        file = relative_to_checkout(file) if file else ""
        if file:
            entry["locations"] = [{"physicalLocation": _make_location(file, line)}]
        same = (annotation.kind, file, annotation.title)
        fingerprint = hashlib.sha256("\0".join((*same, str(before[same]))).encode(errors="replace"))
        before[same] += 1
        entry["partialFingerprints"] = {"subject/v1": fingerprint.hexdigest()[:32]}
        if annotation.known is not None:
            entry["baselineState"] = "unchanged" if annotation.known else "new"
        if annotation.diagnostic is not None:
            entry["properties"] = get_code_and_values(annotation.diagnostic)
        if annotation.fixes:
            entry["fixes"] = [_make_fix(fix) for fix in annotation.fixes]
        yield entry


def _make_fix(fix: Fix) -> dict[str, Any]:
    """Create a SARIF fix object: {"description": ..., "artifactChanges": [...]}.

    Source: SARIF 2.1.0, 3.55.
    """
    replacements = [
        {
            "deletedRegion": {"byteOffset": start, "byteLength": count},
            "insertedContent": {"text": text},
        }
        for start, count, text in fix.splices
    ]
    location = _make_location(relative_to_checkout(fix.file), None)["artifactLocation"]
    change = {"artifactLocation": location, "replacements": replacements}
    return {"description": {"text": fix.description}, "artifactChanges": [change]}


def get_code_and_values(diagnostic: Diagnostic) -> dict[str, Any]:
    """Return {"code": ..., "values": {name: value}} of a diagnostic, as plain JSON values."""
    content = json.loads(to_json(diagnostic))
    return {name: content[name] for name in ("code", "values")}


def _escape_brackets(text: str) -> str:
    """Escape brackets and backslashes, so that viewers do not read names as links.

    Source: SARIF 2.1.0, 3.11.6.
    """
    return re.sub(r"[\\\[\]]", r"\\\g<0>", text)


def _make_location(file: str, line: int | None) -> dict[str, Any]:
    """Create a SARIF object for a place in a file: {"artifactLocation": ..., "region": ...}.

    Without a line number the place is line 1, because GitHub shows no result without a line.
    """
    uri = Path(file).as_uri() if Path(file).is_absolute() else quote(os.fsencode(file))
    return {"artifactLocation": {"uri": uri}, "region": {"startLine": line or 1}}


_HIDDEN_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of the characters that `escape_control` replaces: control characters, formats
such as text directions, surrogates, line and paragraph separators.
"""


def escape_control(text: str) -> str:
    """Replace control characters in a text by visible escape sequences of Python.

    Names in model files and names of files may contain sequences that control a terminal or begin a
    new line.
    """
    if text.isprintable():
        return text
    return "".join(
        letter.encode("unicode_escape").decode()
        if unicodedata.category(letter) in _HIDDEN_CATEGORIES
        else letter
        for letter in text
    )


def write_github(annotations: Iterable[Annotation]) -> str:
    """Convert annotations to GitHub workflow commands, a command per line.

    GitHub shows the messages beside the lines of the files: ten annotations per level and step.
    The log of the step contains all annotations.

    Source: GitHub documentation, "Workflow commands for GitHub Actions".
    """
    lines = []
    for annotation in annotations:
        file, line = annotation.file_and_line
        parameters = [f"file={_escape_property(relative_to_checkout(file))}"] if file else []
        parameters += [f"line={line}"] if line is not None else []
        parameters.append(f"title={_escape_property(annotation.title)}")
        messages = annotation.message
        if annotation.diagnostic is not None:
            messages += f" [{annotation.diagnostic.code}]"
        lines.append(f"::{annotation.level} {','.join(parameters)}::{_escape_data(messages)}")
    return "\n".join(lines)


def _escape_data(text: str) -> str:
    """Escape the message of a GitHub workflow command.

    GitHub defines escapes for line ends and "%". Other control characters become visible text
    (`escape_control`).
    """
    message = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return escape_control(message)


def _escape_property(text: str) -> str:
    """Escape a property of a GitHub workflow command, such as the file or the title."""
    return _escape_data(text).replace(":", "%3A").replace(",", "%2C")


def write_junit(annotations: Iterable[Annotation], suite_name: str = "pupper-analysis") -> str:
    """Convert annotations to JUnit XML, with a test case per annotation.

    A test case passes if the level of the annotation is notice, or if a baseline contains the
    annotation. Without annotations, there is a single test case, which passes. ``suite_name`` is
    the name of the test suite.
    """
    listed = list(annotations) or [Annotation("notice", "nothing found", "")]
    failing = [annotation.level != "notice" and not annotation.known for annotation in listed]
    counts = {"tests": str(len(listed)), "failures": str(sum(failing)), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": escape_control(suite_name)} | counts)
    for annotation, fails in zip(listed, failing, strict=True):
        file, line = annotation.file_and_line
        names = {
            "name": escape_control(annotation.title),
            "classname": escape_control(annotation.kind),
        }
        names |= {"file": escape_control(relative_to_checkout(file))} if file else {}
        names |= {"line": str(line)} if line is not None else {}
        case = ElementTree.SubElement(suite, "testcase", names)
        if fails:
            code = annotation.kind if annotation.diagnostic is None else annotation.diagnostic.code
            message = escape_control(annotation.message)
            failure = ElementTree.SubElement(case, "failure", message=message, type=code)
            failure.text = f"{escape_control(str(annotation.place or ''))}: {message}"
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


ANNOTATION_WRITERS = {"github": write_github, "sarif": write_sarif, "junit": write_junit}
"""{output format: function that converts annotations to a text in this format}."""


def write_annotations(
    style: str, annotations: Iterable[Annotation], suite_name: str = "pupper-analysis"
) -> str:
    """Convert annotations to text in a format of ``ANNOTATION_WRITERS``, such as ``sarif``.

    ``suite_name`` is the name of the test suite in JUnit XML.

    Raises:
        KeyError: If the format is unknown.
    """
    if style == "junit":
        return write_junit(annotations, suite_name)
    return ANNOTATION_WRITERS[style](annotations)
