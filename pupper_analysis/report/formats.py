"""Findings for machines: GitHub's annotations and JUnit's XML."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree

_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's categories of what is not seen but acts: controls, directions, ends of lines."""


def visible(text: str) -> str:
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
    """

    level: str
    title: str
    message: str
    place: str | None = None


def github(annotations: Iterable[Annotation]) -> str:
    """Returns workflow commands, one a line, that GitHub shows beside the files.

    Source: GitHub documentation, "Workflow commands for GitHub Actions".
    """
    lines = []
    for annotation in annotations:
        parameters = []
        if annotation.place:
            file, _, line = annotation.place.rpartition(":")
            if file and line.isdigit():
                parameters = [f"file={_property(file)}", f"line={line}"]
            else:
                parameters = [f"file={_property(annotation.place)}"]
        parameters.append(f"title={_property(annotation.title)}")
        lines.append(f"::{annotation.level} {','.join(parameters)}::{_data(annotation.message)}")
    return "\n".join(lines)


def _data(text: str) -> str:
    # Ends of lines have words of their own there; what else would act on a log is shown.
    told = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return visible(told)


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


@dataclass(frozen=True)
class Case:
    """One thing that was checked.

    Attributes:
        name: What.
        failure: Why it failed; None if it did not.
    """

    name: str
    failure: str | None = None


def junit(suite: str, cases: Iterable[Case]) -> str:
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
            failure = ElementTree.SubElement(node, "failure", message=case.failure)
            failure.text = case.failure
    ElementTree.indent(root)
    declaration = '<?xml version="1.0" encoding="utf-8"?>\n'
    return declaration + ElementTree.tostring(root, encoding="unicode")


def for_machines(
    style: str, suite: str, annotations: Iterable[Annotation], cases: Iterable[Case]
) -> str:
    """Returns what is said to machines: annotations (``github``) or a report (``junit``)."""
    if style == "github":
        return github(annotations)
    report = "\n".join(visible(line) for line in junit(suite, cases).split("\n"))
    # A name's own line must not become a workflow command of GitHub's ("::error::", "##[error]").
    return re.sub(r"(?m)^(\s*)([:#])(?=[:#])", lambda at: f"{at[1]}&#{ord(at[2])};", report)
