"""The catalogue: all that is told to a reader, under keys, in each language.

Diagnostics: per code its severity and its words.

A file a room: ``catalogue/statics.toml`` has what ``statics`` finds. An entry is a table:

    [effort-limit-differs]
    severity = "warning"
    en = "{subject}: the effort limit is {urdf} in the URDF, {mjcf} in the MJCF"
    zh = "..."

``severity`` is ``note`` where it is left out, and ``group`` ``found`` for notes and ``wrong`` for
all else. See ``templates`` for what may stand in braces.

Other files have a line per entry, ``key = { en = "...", zh = "..." }``: ``terms.toml`` the words
for kinds of things, such as ``joint``; ``texts.toml`` headings, labels and remarks of documents;
``meanings.toml``, by class and field, what results have.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType

LANGUAGES = ("en", "zh")

_TABLE = re.compile(r"^\[([a-z0-9-]+)\]$", re.MULTILINE)
_LINE = re.compile(r'^"?([^"\n]+?)"? = (\{ en = .*\})$', re.MULTILINE)
_TERMS, _TEXTS, _MEANINGS = "terms.toml", "texts.toml", "meanings.toml"
LINED = (_TERMS, _TEXTS, _MEANINGS)
"""Files with a line per entry."""


@dataclass(frozen=True)
class Entry:
    """What the catalogue says of a code.

    Attributes:
        severity: ``"error"``, ``"warning"`` or ``"note"``.
        group: ``"wrong"``, ``"assumed"`` or ``"found"``.
        templates: {language: its words}.
    """

    severity: str
    group: str
    templates: Mapping[str, str]


def codes() -> Iterator[str]:
    """Returns all codes, in no particular order."""
    return iter(_tables())


@cache
def entry(code: str) -> Entry:
    """Returns what the catalogue says of a code.

    Raises:
        KeyError: If it has no such code.
    """
    stated = tomllib.loads(_tables()[code])
    severity = stated.get("severity", "note")
    group = stated.get("group", "found" if severity == "note" else "wrong")
    words = {language: stated[language] for language in LANGUAGES}
    return Entry(severity, group, MappingProxyType(words))


def term(name: str, language: str) -> str:
    """Returns a word for a kind of thing; the name itself where the catalogue has none."""
    return _line(_TERMS, name)[language] if name in list_entries(_TERMS) else name


def is_term(name: str) -> bool:
    """Tells whether the catalogue has a word for a kind of thing."""
    return name in list_entries(_TERMS)


@cache
def phrase(key: str, language: str) -> str:
    """Returns the template of a text of documents and pages, or a term.

    Raises:
        KeyError: If the catalogue has neither.
    """
    return _line(_TEXTS if key in list_entries(_TEXTS) else _TERMS, key)[language]


def meaning(kind: type, field: str, language: str) -> str:
    """Returns what a field of a result means, its unit included; empty if that is not said.

    Args:
        kind: The result's class.
        field: A field of it, or of a class that it is one of.
        language: In which language.
    """
    for owner in kind.__mro__:
        key = f"{owner.__name__}.{field}"
        if key in list_entries(_MEANINGS):
            return _line(_MEANINGS, key)[language]
    return ""


@cache
def _tables() -> Mapping[str, str]:
    """Returns {code: its table's text}.

    TOML is slow to read (1,000 entries take 50 ms, a tenth of a command's start), and a command
    says a few things only: entries are told apart by their headers and read when they are needed.
    """
    tables: dict[str, str] = {}
    for file in files(__package__).joinpath("catalogue").iterdir():
        if file.name.endswith(".toml") and file.name not in LINED:
            _, *parts = _TABLE.split(file.read_text(encoding="utf-8"))
            tables.update(zip(parts[::2], parts[1::2], strict=True))
    return MappingProxyType(tables)


@cache
def list_entries(file: str) -> Mapping[str, str]:
    """Returns {key: its entry as TOML} of a file with a line per entry."""
    text = files(__package__).joinpath("catalogue", file).read_text(encoding="utf-8")
    return MappingProxyType(dict(_LINE.findall(text)))


@cache
def _line(file: str, key: str) -> Mapping[str, str]:
    words: dict[str, str] = tomllib.loads(f"entry = {list_entries(file)[key]}")["entry"]
    return MappingProxyType(words)
