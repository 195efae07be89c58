"""Findings for machines: GitHub's annotations, JUnit's XML, and SARIF."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree

from pupper_analysis.base.diagnostics import Diagnostic, fill_template, phrase
from pupper_analysis.present.sarif import (
    SarifResult,
    SarifRule,
    code_and_values,
    from_root,
    write_sarif,
)

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


@dataclass(frozen=True)
class Annotation:
    """A remark on a place in a file.

    Attributes:
        level: ``error``, ``warning`` or ``notice``.
        title: A few words.
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
    def file_and_line(self) -> tuple[str, int | None]:
        """The file ("" if there is none), and the line in it, if it has lines."""
        file, _, line = (self.place or "").rpartition(":")
        if line.startswith("<"):
            return file, None
        return (file, int(line)) if file and line.isdecimal() else (self.place or "", None)


SHOWN = 10
"""Annotations of one level that GitHub shows of a step; more are dropped without a word.

Source: GitHub documentation, "Limitations" of annotations of workflow commands.
"""


def group_remarks(annotations: Iterable[Annotation], most: int = SHOWN) -> list[Annotation]:
    """Puts annotations together until no level has more than GitHub shows.

    Those of one rule, in one file, become one, at the place of the first; if there are still too
    many, the last one names the rest.
    """
    result: list[Annotation] = []
    found = list(annotations)
    for level in dict.fromkeys(annotation.level for annotation in found):
        here = [annotation for annotation in found if annotation.level == level]
        if len(here) > most:
            groups: dict[tuple[str, str], list[Annotation]] = {}
            for one in here:
                groups.setdefault((one.rule or one.title, one.file_and_line[0]), []).append(one)
            here = [_together(group, "and-more-of-this-kind") for group in groups.values()]
        if len(here) > most:
            here = [*here[: most - 1], _together(here[most - 1 :], "and-more-of-other-kinds")]
        result += here
    return result


def _together(group: Sequence[Annotation], how: str) -> Annotation:
    first, *others = group
    if not others:
        return first
    named = ", ".join(
        other.title if other.place is None else f"{other.title} ({other.place})" for other in others
    )
    told = {"message": first.message, "count": len(others), "names": named}
    return replace(first, message=fill_template(phrase(how, "en"), told, "en"))


def write_github(annotations: Iterable[Annotation]) -> str:
    """Returns workflow commands, one a line, that GitHub shows beside the files.

    Source: GitHub documentation, "Workflow commands for GitHub Actions".
    """
    lines = []
    for annotation in group_remarks(annotations):
        file, line = annotation.file_and_line
        parameters = [f"file={_property(from_root(file))}"] if file else []
        parameters += [f"line={line}"] if line is not None else []
        parameters.append(f"title={_property(annotation.title)}")
        told = annotation.message
        if annotation.diagnostic is not None:
            told += f" [{annotation.diagnostic.code}]"
        lines.append(f"::{annotation.level} {','.join(parameters)}::{_data(told)}")
    return "\n".join(lines)


def _data(text: str) -> str:
    # Ends of lines have words of their own there; what else would act on a log is shown.
    told = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return escape_control(told)


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


@dataclass(frozen=True)
class CheckedItem:
    """One thing that was checked.

    Attributes:
        name: What.
        failure: Why it failed; None if it did not.
        diagnostics: The same as codes and values.
    """

    name: str
    failure: str | None = None
    diagnostics: tuple[Diagnostic, ...] = ()


def write_junit(suite: str, cases: Iterable[CheckedItem]) -> str:
    """Returns the XML that test reports are made of.

    Args:
        suite: The name of the suite.
        cases: What was checked.
    """
    cases = list(cases)
    failures = sum(case.failure is not None for case in cases)
    counts = {"tests": str(len(cases)), "failures": str(failures), "errors": "0", "skipped": "0"}
    root = ElementTree.Element("testsuites", counts)
    element = ElementTree.SubElement(root, "testsuite", {"name": suite, **counts})
    for case in cases:
        node = ElementTree.SubElement(element, "testcase", name=case.name, classname=suite)
        if case.failure is not None:
            if case.diagnostics:
                _properties(node, case.diagnostics)
            failure = ElementTree.SubElement(node, "failure", message=case.failure)
            failure.text = case.failure
            if case.diagnostics:
                codes = dict.fromkeys(one.code for one in case.diagnostics)
                failure.set("type", ", ".join(codes))
    ElementTree.indent(root)
    declaration = '<?xml version="1.0" encoding="utf-8"?>\n'
    return declaration + ElementTree.tostring(root, encoding="unicode")


def _properties(case: ElementTree.Element, diagnostics: Iterable[Diagnostic]) -> None:
    """Adds codes with their values, as JSON."""
    properties = ElementTree.SubElement(case, "properties")
    for one in diagnostics:
        values = json.dumps(code_and_values(one)["values"], ensure_ascii=False)
        ElementTree.SubElement(properties, "property", name=one.code, value=values)


def for_machines(
    style: str, suite: str, annotations: Iterable[Annotation], cases: Iterable[CheckedItem]
) -> str:
    """Returns what is said to machines.

    Args:
        style: ``github`` (annotations), ``sarif`` (a log for code scanning), ``junit`` (a report).
        suite: The name of the report's suite.
        annotations: What is said in the first two.
        cases: What is said in the report.
    """
    if style == "github":
        return write_github(annotations)
    if style == "sarif":
        return write_sarif(_result(annotation) for annotation in annotations)
    report = "\n".join(escape_control(line) for line in write_junit(suite, cases).split("\n"))
    # A name's own line must not become a workflow command of GitHub's ("::error::", "##[error]").
    return re.sub(r"(?m)^(\s*)([:#])(?=[:#])", lambda at: f"{at[1]}&#{ord(at[2])};", report)


def _result(annotation: Annotation) -> SarifResult:
    file, line = annotation.file_and_line
    rule = SarifRule(annotation.rule or annotation.title, annotation.about)
    return SarifResult(
        rule,
        annotation.level,
        annotation.message,
        annotation.title,
        file,
        line,
        annotation.known,
        annotation.diagnostic,
    )
