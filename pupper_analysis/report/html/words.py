"""The report's own texts, in English and in Simplified Chinese.

A text is asked for by its English words, so that none is without a translation: what is not in the
catalogue is refused.
"""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.report.document import Name, Said, Text, Words
from pupper_analysis.report.html import sentences
from pupper_analysis.report.html.sentences import catalogue


def text(english: str, **values: object) -> Text:
    """Returns a text in both languages.

    Args:
        english: A key of the catalogue.
        **values: What stands in its braces; a ``Text`` in its own two languages.

    Its Chinese is made when it is asked for, and that raises KeyError if the catalogue lacks it.
    """
    return Text(
        english.format(**{name: _in(value, "en") for name, value in values.items()}),
        lambda: catalogue()[english].format(
            **{name: _in(value, "zh") for name, value in values.items()}
        ),
    )


def word(english: str) -> Text | Name:
    """Returns a word of a result's in both languages, or as it is, where the catalogue lacks it."""
    return text(english) if english in catalogue() else Name(english)


def joined(parts: Iterable[Words], comma: str = ", ") -> Text:
    """Returns words as a list, with each language's own comma (or what else is a text)."""
    listed = list(parts)
    between = text(comma)
    return Text(
        between.en.join(str(_in(part, "en")) for part in listed),
        lambda: between.zh.join(str(_in(part, "zh")) for part in listed),
    )


def english(words: Words) -> str:
    """Returns words in English."""
    return words.en if isinstance(words, Text) else str(words.text)


def spoken(words: Words) -> Words:
    """Returns words with what a result says in both languages, where somebody has translated it."""
    return sentences.said(words.text) if isinstance(words, Said) else words


def _in(value: object, language: str) -> object:
    if isinstance(value, Text):
        return getattr(value, language)
    if isinstance(value, Said) and language == "zh":
        translated = sentences.said(value.text)
        return translated.zh if isinstance(translated, Text) else str(value.text)
    return value.text if isinstance(value, Name | Said) else value
