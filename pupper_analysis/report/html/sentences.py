"""Sentences that results say in English, said in Simplified Chinese too.

Results hold plain sentences, which the terminal, JSON and CI print as they are. Here each is
recognised by its pattern, so that no result needs to know of languages.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from types import MappingProxyType

from pupper_analysis.diagnostics import phrase
from pupper_analysis.diagnostics.catalogue import LINED, lines

_HOLE = re.compile(r"\{(\w+)\}")

_REMEMBERED = 4096
"""Sentences: more than one page has; the same are asked for in its summary and its sections."""

_LONGEST = 4000
"""Characters; a longer text is a listing, and patterns with many holes would try for long."""

_FEW = 4
"""Letters outside of holes with which a pattern would fit any sentence that has a word of it: its
holes are single names, as of ``{foot} on {body}``."""


@dataclass(frozen=True)
class Pattern:
    """A sentence with holes.

    Attributes:
        english: It, as a regular expression with a named group per hole.
        chinese: The same in Chinese, with the same holes in braces.
        literal: Characters of it that are not holes.
        start: What it begins with, before the first hole.
    """

    english: re.Pattern[str]
    chinese: str
    literal: int
    start: str


@cache
def catalogue() -> Mapping[str, str]:
    """Returns {English: Simplified Chinese} of the catalogue's texts and terms."""
    keys = {key: None for file in LINED[:2] for key in lines(file)}
    return MappingProxyType({phrase(key, "en"): phrase(key, "zh") for key in keys})


@cache
def patterns() -> tuple[Pattern, ...]:
    """Returns all patterns, those with the most words of their own first."""
    made = [_pattern(english, chinese) for english, chinese in sentences().items()]
    return tuple(sorted(made, key=lambda pattern: -pattern.literal))


@cache
def sentences() -> Mapping[str, str]:
    """Returns {English: Simplified Chinese} of the patterns, as they are written."""
    file = files("pupper_analysis.report.html").joinpath("templates", "sentences.toml")
    return MappingProxyType(tomllib.loads(file.read_text(encoding="utf-8")))


@lru_cache(maxsize=_REMEMBERED)
def in_chinese(sentence: str) -> str | None:
    """Returns a sentence in Chinese, or several that semicolons join; None if no pattern fits."""
    if len(sentence) > _LONGEST:
        return None
    if sentence in catalogue():
        return catalogue()[sentence]
    for pattern in patterns():
        if not sentence.startswith(pattern.start):
            continue
        found = pattern.english.fullmatch(sentence)
        if found:
            filled = {name: _filled(name, value) for name, value in found.groupdict().items()}
            return pattern.chinese.format(**filled)
    return _all_of(sentence, "; ", "；")  # noqa: RUF001 (Chinese)


def _filled(name: str, value: str) -> str:
    """Returns what stands in a hole; in Chinese, if the hole is for words."""
    if not name.isupper():
        return value
    return in_chinese(value) or _all_of(value, ", ", "、") or value


def _all_of(text: str, comma: str, chinese: str) -> str | None:
    """Returns parts that were joined, if each can be said."""
    parts = text.split(comma)
    if len(parts) == 1:
        return None
    said = [in_chinese(part) for part in parts]
    return None if None in said else chinese.join(part for part in said if part is not None)


def _pattern(english: str, chinese: str) -> Pattern:
    pieces = _HOLE.split(english)  # words and names of holes, by turns
    literal = sum(len(words) for words in pieces[::2])
    named = [_hole(name, pieces[1::2], literal) for name in pieces[1::2]]
    words = [re.escape(piece) for piece in pieces[::2]]
    expression = "".join(part for pair in zip(words, [*named, ""], strict=True) for part in pair)
    return Pattern(re.compile(expression, re.DOTALL), chinese, literal, pieces[0])


def _hole(name: str, names: list[str], literal: int) -> str:
    """Returns what may stand in a hole, of a pattern with so many letters of its own."""
    if name.startswith("word"):
        return f"(?P<{name}>[^ ;]+)"
    if any(other.startswith("word") for other in names):
        return f"(?P<{name}>[^;]+?)"
    return f"(?P<{name}>.+?)" if literal > _FEW else rf"(?P<{name}>\S+)"
