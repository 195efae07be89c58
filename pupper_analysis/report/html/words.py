"""The report's own texts, in English and in Simplified Chinese.

A text is asked for by its English words, so that none is without a translation: what is not in the
catalogue is refused.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from pupper_analysis.report.html.document import Name, Said, Text


@cache
def catalogue() -> Mapping[str, str]:
    """Returns {English: Simplified Chinese} of all texts."""
    file = files("pupper_analysis.report.html").joinpath("templates", "chinese.toml")
    return MappingProxyType(tomllib.loads(file.read_text(encoding="utf-8")))


def text(english: str, **values: object) -> Text:
    """Returns a text in both languages.

    Args:
        english: A key of the catalogue.
        **values: What stands in its braces; a ``Text`` in its own two languages.

    Raises:
        KeyError: If the catalogue lacks it.
    """
    return Text(
        english.format(**{name: _in(value, "en") for name, value in values.items()}),
        catalogue()[english].format(**{name: _in(value, "zh") for name, value in values.items()}),
    )


def word(english: str) -> Text | Name:
    """Returns a word of a result's in both languages, or as it is, where the catalogue lacks it."""
    return text(english) if english in catalogue() else Name(english)


def joined(parts: Iterable[Text | Name]) -> Text:
    """Returns words as a list, with each language's own comma."""
    listed = list(parts)
    comma = text(", ")
    return Text(
        comma.en.join(str(_in(part, "en")) for part in listed),
        comma.zh.join(str(_in(part, "zh")) for part in listed),
    )


def _in(value: object, language: str) -> object:
    if isinstance(value, Text):
        return getattr(value, language)
    return value.text if isinstance(value, Name | Said) else value
