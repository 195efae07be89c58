"""Which result is shown how."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from pupper_analysis.analysis.path import PathThere
from pupper_analysis.analysis.push import PushedStance
from pupper_analysis.analysis.robot import Analysis
from pupper_analysis.analysis.stance import Stance
from pupper_analysis.checks.audit import Audit
from pupper_analysis.checks.compare import Comparison
from pupper_analysis.report.html import document as doc
from pupper_analysis.report.html.analysis import analysis_section
from pupper_analysis.report.html.audit import audit_section
from pupper_analysis.report.html.comparison import comparison_section
from pupper_analysis.report.html.stance import (
    path_section,
    push_plot,
    push_section,
    push_table,
    stance_section,
)
from pupper_analysis.report.html.study import study_section
from pupper_analysis.report.html.values import value_cell
from pupper_analysis.report.html.words import text
from pupper_analysis.results import Result, Tabular
from pupper_analysis.robot.robot import Robot
from pupper_analysis.study.outcome import StudyOutcome

MOST_ROWS = 500
"""Of a table of which nothing is known: more than anyone reads."""


def section_of(result: Result, name: str | None, robots: Mapping[str, Robot]) -> doc.Section:
    """Returns what is shown of a result.

    Args:
        result: The result.
        name: What it is called; by default as its robot, or its file.
        robots: The robots at hand, by name.
    """
    if isinstance(result, Analysis):
        return analysis_section(result, robots.get(result.name))
    if isinstance(result, Stance):
        return stance_section(result, robots.get(result.name))
    if isinstance(result, PushedStance):
        return push_section(result, robots.get(result.name))
    if isinstance(result, PathThere):
        return path_section(result, robots.get(result.name))
    if isinstance(result, Comparison):
        return comparison_section(result)
    if isinstance(result, Audit):
        return audit_section(result)
    if isinstance(result, StudyOutcome):
        return study_section(result)
    return _any(result, name or type(result).__name__)


def overview_of(results: Sequence[Result]) -> tuple[doc.Block, ...]:
    """Returns what compares several results."""
    pushes = [result for result in results if isinstance(result, PushedStance)]
    alike = {pushed.recovery.directions.tobytes() for pushed in pushes}
    if len(pushes) > 1 and len(alike) == 1:
        return push_table(pushes), push_plot(pushes)
    return ()


def title_of(results: Sequence[object]) -> doc.Words:
    """Returns a page's title: what kind of result it shows."""
    titles = {
        Analysis: text("Analysis of robots"),
        Stance: text("A stance"),
        PushedStance: text("How hard robots can be pushed"),
        PathThere: text("A path to a stance"),
        StudyOutcome: text("A study of designs"),
    }
    kinds = {type(result) for result in results if isinstance(result, Result)}
    if len(kinds) == 1:
        (kind,) = kinds
        first = next(result for result in results if isinstance(result, Result))
        if isinstance(first, Comparison):
            names = [Path(first.urdf).name, Path(first.mjcf).name]
            return text("Cross-check of {urdf} and {mjcf}", urdf=names[0], mjcf=names[1])
        if isinstance(first, Audit):
            return text("Audit of {file}", file=Path(first.file).name)
        if kind in titles:
            return titles[kind]
    return text("Report of pupper_analysis")


def _any(result: Result, name: str) -> doc.Section:
    """Returns the fields of a result that has no page of its own, with what they mean."""
    said = meanings(type(result))
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(field.name),
            value_cell(getattr(result, field.name)),
            _said_meaning(said.get(field.name, "")),
        )
        for field in fields(result)  # type: ignore[arg-type]  # all results are dataclasses
    ]
    table = doc.Table(
        doc.Name(type(result).__name__),
        (
            doc.Column(text("field"), left=True),
            doc.Column(text("value"), left=True),
            doc.Column(text("meaning and unit"), left=True),
        ),
        tuple(rows),
    )
    blocks: list[doc.Block] = [table]
    if isinstance(result, Tabular):
        columns = {key: list(values) for key, values in result._columns().items()}  # type: ignore[arg-type]
        cells = list(zip(*columns.values(), strict=True))[:MOST_ROWS]
        blocks.append(
            doc.Table(
                text("As a table"),
                tuple(doc.Column(doc.Name(key)) for key in columns),
                tuple(tuple(map(value_cell, row)) for row in cells),
                (text("Units are those of the fields."),),
            )
        )
    passed = getattr(result, "passed", None)
    verdict = None if passed is None else text("PASSED") if passed else text("FAILED")
    return doc.Section(doc.Name(name), tuple(blocks), passed, verdict)


def meanings(kind: type) -> dict[str, str]:
    """Returns {field: what the docstring of its class says of it, unit included}."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        said = inspect.cleandoc(one.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
        entries = re.findall(r"^    ([\w, ]+): (.*(?:\n {8}.*)*)", said, flags=re.MULTILINE)
        for names, meaning in entries:
            found |= dict.fromkeys(names.split(", "), re.sub(r"\s+", " ", meaning))
    return found


def _said_meaning(meaning: str) -> doc.Text | doc.Said:
    """Returns what a field means in both languages, or as it is."""
    chinese = chinese_meanings().get(meaning)
    plain = meaning.replace("``", "")  # the marks of code in docstrings
    return doc.Said(plain) if chinese is None else doc.Text(plain, chinese.replace("``", ""))


@cache
def chinese_meanings() -> Mapping[str, str]:
    """Returns {what a docstring says of a field: the same in Simplified Chinese}."""
    file = files("pupper_analysis.report.html").joinpath("templates", "meanings.toml")
    return MappingProxyType(tomllib.loads(file.read_text(encoding="utf-8")))
