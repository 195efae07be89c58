"""Words of documents, in English and in Simplified Chinese: those of the catalogue, by key."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.base.diagnostics import fill_template, is_term, phrase
from pupper_analysis.present.document import Name, Text, Words


def text(key: str, **values: object) -> Text:
    """Returns a text in both languages.

    Args:
        key: The catalogue's, of ``texts.toml`` or ``terms.toml``.
        **values: What stands in its braces; a ``Text`` in its own two languages.

    Its Chinese is made when it is asked for.

    Raises:
        KeyError: If the catalogue lacks it.
    """
    return Text(_filled(key, values, "en"), lambda: _filled(key, values, "zh"))


def word(name: str) -> Text | Name:
    """Returns a word of a result's in both languages, or as it is, where it is no term."""
    return text(name) if is_term(name) else Name(name)


def join_words(parts: Iterable[Words], comma: str = "comma") -> Text:
    """Returns words as a list, with each language's own comma (or what else is a text)."""
    listed = list(parts)
    between = text(comma)
    return Text(
        between.en.join(str(_in(part, "en")) for part in listed),
        lambda: between.zh.join(str(_in(part, "zh")) for part in listed),
    )


def in_english(words: Words) -> str:
    """Returns words in English."""
    return words.en if isinstance(words, Text) else words.text


def _filled(key: str, values: dict[str, object], language: str) -> str:
    template = phrase(key, language)
    said = {name: _in(value, language) for name, value in values.items()}
    return fill_template(template, said, language) if said else template


def _in(value: object, language: str) -> object:
    if isinstance(value, Text):
        return getattr(value, language)
    return value.text if isinstance(value, Name) else value
