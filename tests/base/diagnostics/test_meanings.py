"""What the fields of results mean: in both languages, in English as docstrings say it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from functools import cache

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import LANGUAGES, meaning
from pupper_analysis.base.results import Result
from tests.base.diagnostics.test_diagnostic import HAN, MEANINGS

OWN_PAGES = {
    *("Analysis", "Stance", "Hold", "PushedStance", "PathThere", "FilesCompared", "Audit"),
    "StudyOutcome",
}
"""Results that have pages of their own: their fields are not listed with what they mean."""


@cache
def documented(kind: type) -> dict[str, str]:
    """{field: what the class's own docstring says of it, marks of code left out}."""
    said = inspect.cleandoc(kind.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for names, words in re.findall(r"^    ([\w, ]+): (.*(?:\n {8}.*)*)", said, flags=re.M):
        plain = re.sub(r"\s+", " ", words).replace("``", "")
        found |= dict.fromkeys(names.split(", "), plain)
    return found


def listed() -> dict[str, dict[str, str]]:
    """{class.field: its words} of the catalogue."""
    return {f"{kind}.{name}": both for kind, of in MEANINGS.items() for name, both in of.items()}


def all_results(kind: type = Result) -> set[type]:
    """All kinds of results, which are there as their modules are."""
    for module in pkgutil.walk_packages(pa.__path__, "pupper_analysis."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    return {s for one in kind.__subclasses__() for s in (one, *all_results(one))}


@pytest.mark.slow
def test_each_field_that_pages_list_has_a_meaning_that_is_its_docstrings() -> None:
    """Of a corrected docstring only ``en`` is to be corrected, too; the Chinese stays."""
    wanted = {}
    for kind in all_results():
        own = kind.__module__.startswith("pupper_analysis.")
        if own and is_dataclass(kind) and not {one.__name__ for one in kind.__mro__} & OWN_PAGES:
            for field in fields(kind):
                owner = next(one for one in kind.__mro__ if field.name in documented(one))
                wanted[f"{owner.__name__}.{field.name}"] = documented(owner)[field.name]
                assert meaning(kind, field.name, "zh"), (kind, field.name)
    assert {key: both["en"] for key, both in listed().items()} == wanted


def test_meanings_are_in_both_languages_with_the_same_units() -> None:
    units = r"[(（](N m|N|m|rad|kg|m/s|rad/s|N s|Hz|s)[)）]"
    for key, both in listed().items():
        assert set(both) == set(LANGUAGES), key
        assert re.findall(units, both["en"]) == re.findall(units, both["zh"]), key
        if re.search("[a-z]{4}", both["en"]):
            assert HAN.search(both["zh"]), key
