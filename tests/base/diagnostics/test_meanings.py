"""Meanings of result fields: in both languages, in English equal to the docstring and the unit.

``python -m tests.base.diagnostics.test_meanings`` writes the English texts anew after docstrings
have changed. Chinese texts are edited by hand.
"""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import re
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import LANGUAGES
from pupper_analysis.base.diagnostics.catalogue import list_entries
from pupper_analysis.base.results import Result
from tests.base.diagnostics.test_diagnostic import HAN, MEANINGS
from tests.support.names import public, public_modules

OWN_PAGES = {
    *("Analysis", "Stance", "Hold", "PushedStance", "PathThere", "FilesCompared", "Audit"),
    "StudyOutcome",
}
"""Results with documentation pages of their own; the table of meanings omits their fields."""


@cache
def read_field_docs(kind: type) -> dict[str, str]:
    """Return {field: text of the class docstring, without code marks}."""
    attributes = inspect.cleandoc(kind.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for names, words in re.findall(r"^    ([\w, ]+): (.*(?:\n {8}.*)*)", attributes, flags=re.M):
        plain = re.sub(r"\s+", " ", words).replace("``", "")
        found |= dict.fromkeys(names.split(", "), plain)
    return found


def list_meanings() -> dict[str, dict[str, str]]:
    """{class.field: its words} of the catalogue."""
    return {f"{kind}.{name}": both for kind, of in MEANINGS.items() for name, both in of.items()}


def all_results(kind: type = Result) -> set[type]:
    """Import all modules, and return all subclasses of a result class."""
    for module in pkgutil.walk_packages(pa.__path__, "pupper_analysis."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    return {s for subclass in kind.__subclasses__() for s in (subclass, *all_results(subclass))}


def with_unit(text: str, unit: str | None) -> str:
    """Add the unit of a field to its text, if the text does not contain the unit."""
    if unit in (None, "1") or re.search(rf"(^|[(\[, ]){re.escape(str(unit))}([)\],;. ]|$)", text):
        return text
    first, stop, rest = text.partition(".")
    return f"{first} ({unit}){stop}{rest}"


def english_meanings() -> dict[str, str]:
    """Return the text of each field that pages list: docstring and unit, by ``class.field``."""
    wanted = {}
    for kind in all_results():
        is_ours = kind.__module__.startswith("pupper_analysis.")
        if is_ours and is_dataclass(kind) and not {c.__name__ for c in kind.__mro__} & OWN_PAGES:
            for field in fields(kind):
                if field.name.startswith("_"):
                    continue
                owner = next(c for c in kind.__mro__ if field.name in read_field_docs(c))
                text = read_field_docs(owner)[field.name]
                wanted[f"{owner.__name__}.{field.name}"] = with_unit(
                    text, field.metadata.get("unit")
                )
    return wanted


@pytest.mark.slow
def test_english_meanings_equal_the_docstrings_of_listed_fields() -> None:
    """Reference: docstring and unit metadata of each field; each field has a Chinese text."""
    assert {key: both["en"] for key, both in list_meanings().items()} == english_meanings()
    assert [key for key, both in list_meanings().items() if not both["zh"]] == []


@pytest.mark.slow
def test_fields_of_public_results_are_documented() -> None:
    """Inherited fields may be documented by the base class."""
    values = [value for module in (pa, *public_modules()) for value in public(module).values()]
    kinds = [value for value in values if isinstance(value, type) and issubclass(value, Result)]
    assert len(kinds) > 20
    for kind in kinds:
        known = {name for ancestor in kind.__mro__ for name in read_field_docs(ancestor)}
        assert {field.name for field in fields(kind)} <= known, kind  # type: ignore[arg-type]


def test_meanings_are_in_both_languages_with_the_same_units() -> None:
    """Units in parentheses are equal in both texts. Reference of the keys: `tomllib`."""
    units = r"[(（\[](N m|N|m|rad|kg|m/s|rad/s|N s|Hz|s)[)）\]]"
    assert list_meanings()
    assert set(list_entries("meanings.toml")) == set(list_meanings())
    for key, both in list_meanings().items():
        assert set(both) == set(LANGUAGES), key
        assert both["en"].endswith("."), key  # not cut at a line with too little indentation
        assert re.findall(units, both["en"]) == re.findall(units, both["zh"]), key
        if re.search("[a-z]{4}", both["en"]):
            assert HAN.search(both["zh"]), key


def write_english_meanings() -> None:
    """Replace the English texts of all catalogues by the docstrings."""
    wanted = english_meanings()
    for path in Path(pa.__file__).parent.rglob("*.toml"):
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        for index, line in enumerate(lines):
            texts = r"""("(?:[^"\\]|\\.)*"|'[^']*')"""  # basic and literal strings of TOML
            found = re.match(rf"([A-Za-z]\w*\.\w+) = \{{ en = {texts}(.*)", line, re.S)
            if found and found[1] in wanted:
                text = json.dumps(wanted[found[1]], ensure_ascii=False)
                lines[index] = f"{found[1]} = {{ en = {text}{found[3]}"
        path.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    write_english_meanings()
