"""Sentences of refused stances, said in Chinese."""

from __future__ import annotations

import re
from string import Formatter

import pytest

from pupper_analysis.report.html.sentences import in_chinese, patterns, sentences

HAN = re.compile("[\u4e00-\u9fff]")


def holes(pattern: str) -> list[str]:
    return sorted(name for _, name, _, _ in Formatter().parse(pattern) if name)


def filled(pattern: str) -> str:
    """Returns the sentence with another number in each hole."""
    names = list(dict.fromkeys(holes(pattern)))
    return pattern.format(**{name: f"-{8 + place}.25" for place, name in enumerate(names)})


def test_both_languages_have_the_same_holes() -> None:
    for english, chinese in sentences().items():
        assert holes(english) == holes(chinese), english
        assert len(set(holes(english))) == len(holes(english)), english


def test_each_pattern_is_met_and_not_hidden_by_another() -> None:
    assert len(patterns()) == len(sentences())
    for english, chinese in sentences().items():
        assert in_chinese(filled(english)) == filled(chinese), english


@pytest.mark.parametrize(
    "sentence",
    [
        "",
        "no such sentence",
        "it fell over; and nobody knows why",
        "<script>",
        "x" * 100_000,
        "{a}",
        "Newton steps, on all of the way from the stand.",
    ],
)
def test_what_is_not_known_stays_english(sentence: str) -> None:
    assert in_chinese(sentence) is None
