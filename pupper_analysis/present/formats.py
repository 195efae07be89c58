"""Findings for machines: GitHub's annotations, JUnit's XML, and SARIF, which code scanning reads.

Sources: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0"; what GitHub asks
for beyond it: GitHub documentation, "SARIF support for code scanning".
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
from pupper_analysis.base.results import to_json

SARIF_SCHEMA_URL = "https://json.schemastore.org/sarif-2.1.0.json"

_LEVELS = {"error": "error", "warning": "warning", "notice": "note"}
"""SARIF's names of the levels of annotations."""


@dataclass(frozen=True)
class Annotation:
    """A remark on a place in a file.

    Attributes:
        level: ``error``, ``warning`` or ``notice``.
        title: What it is about, by name: with rule and file it distinguishes one from another, also
            after the line, or the number in the message, has changed.
        message: One sentence.
        place: ``file:line``, ``file``, or None.
        rule: What kind of thing it is about, the same for all such; the title, if empty.
        about: The rule in a few words.
        known: Whether a baseline has it; None where there is no baseline.
        diagnostic: It as a code and values.
    """

    level: str
    title: str
    message: str
    place: str | None = None
    rule: str = ""
    about: str = ""
    known: bool | None = None
    diagnostic: Diagnostic | None = None

    @property
    def kind(self) -> str:
        """Its rule."""
        return self.rule or self.title

    @property
    def file_and_line(self) -> tuple[str, int | None]:
        """The file ("" if there is none), and the line in it, if it has lines."""
        file, _, line = (self.place or "").rpartition(":")
        if line.startswith("<"):
            return file, None
        return (file, int(line)) if file and line.isdecimal() else (self.place or "", None)


def relative_to_checkout(file: str | Path) -> str:
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


def write_sarif(annotations: Iterable[Annotation]) -> str:
    """Returns a log of one run, as indented JSON."""
    listed = list(annotations)
    rules = {one.kind: one.about or one.kind for one in listed}
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
        "results": list(_results(listed, numbers)),
    }
    return json.dumps({"$schema": SARIF_SCHEMA_URL, "version": "2.1.0", "runs": [run]}, indent=2)


def _results(
    annotations: Iterable[Annotation], numbers: dict[str, int]
) -> Iterator[dict[str, Any]]:
    before: Counter[tuple[str, str, str]] = Counter()
    for one in annotations:
        entry: dict[str, Any] = {
            "ruleId": one.kind,
            "ruleIndex": numbers[one.kind],
            "level": _LEVELS[one.level],
            "message": {"text": _plain(one.message)},
        }
        file, line = one.file_and_line
        file = relative_to_checkout(file) if file else ""
        if file:
            entry["locations"] = [{"physicalLocation": _location(file, line)}]
        same = (one.kind, file, one.title)
        fingerprint = hashlib.sha256("\0".join((*same, str(before[same]))).encode(errors="replace"))
        before[same] += 1
        entry["partialFingerprints"] = {"subject/v1": fingerprint.hexdigest()[:32]}
        if one.known is not None:
            entry["baselineState"] = "unchanged" if one.known else "new"
        if one.diagnostic is not None:
            entry["properties"] = get_code_and_values(one.diagnostic)
        yield entry


def get_code_and_values(diagnostic: Diagnostic) -> dict[str, Any]:
    """Returns what a program wants to know of a diagnostic, as JSON has it."""
    content = json.loads(to_json(diagnostic))
    return {name: content[name] for name in ("code", "values")}


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


_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's categories of what is not seen but acts: controls, directions, ends of lines."""


def escape_control(text: str) -> str:
    """Returns a text with what would act on a terminal, or begin a line, shown as its number.

    Names in model files, and names of files, are anybody's.
    """
    if text.isprintable():
        return text
    return "".join(
        letter.encode("unicode_escape").decode()
        if unicodedata.category(letter) in _HIDDEN
        else letter
        for letter in text
    )


def write_github(annotations: Iterable[Annotation]) -> str:
    """Returns workflow commands, one a line, that GitHub shows beside the files.

    It shows ten of each level of a step; all of them stand in the step's log.

    Source: GitHub documentation, "Workflow commands for GitHub Actions".
    """
    lines = []
    for annotation in annotations:
        file, line = annotation.file_and_line
        parameters = [f"file={_property(relative_to_checkout(file))}"] if file else []
        parameters += [f"line={line}"] if line is not None else []
        parameters.append(f"title={_property(annotation.title)}")
        messages = annotation.message
        if annotation.diagnostic is not None:
            messages += f" [{annotation.diagnostic.code}]"
        lines.append(f"::{annotation.level} {','.join(parameters)}::{_data(messages)}")
    return "\n".join(lines)


def _data(text: str) -> str:
    # Ends of lines have words of their own there; what else would act on a log is shown.
    message = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return escape_control(message)


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def write_junit(annotations: Iterable[Annotation]) -> str:
    """Returns the XML of test reports: a case per annotation, or one that passes if there is none.

    Notices pass, and what a baseline has.
    """
    listed = list(annotations) or [Annotation("notice", "nothing found", "")]
    failing = [one.level != "notice" and not one.known for one in listed]
    counts = {"tests": str(len(listed)), "failures": str(sum(failing)), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "pupper-analysis"} | counts)
    for one, fails in zip(listed, failing, strict=True):
        file, line = one.file_and_line
        names = {"name": escape_control(one.title), "classname": escape_control(one.kind)}
        names |= {"file": escape_control(relative_to_checkout(file))} if file else {}
        names |= {"line": str(line)} if line is not None else {}
        case = ElementTree.SubElement(suite, "testcase", names)
        if fails:
            code = one.kind if one.diagnostic is None else one.diagnostic.code
            said = escape_control(one.message)
            failure = ElementTree.SubElement(case, "failure", message=said, type=code)
            failure.text = f"{escape_control(str(one.place or ''))}: {said}"
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


ANNOTATION_WRITERS = {"github": write_github, "sarif": write_sarif, "junit": write_junit}
"""{format: what writes annotations in it}."""


def write_annotations(style: str, annotations: Iterable[Annotation]) -> str:
    """Returns annotations in one of the formats of ``WRITERS``."""
    return ANNOTATION_WRITERS[style](annotations)
