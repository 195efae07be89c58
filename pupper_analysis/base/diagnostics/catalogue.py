"""The catalogue: all that a reader is shown, under keys, in each language.

Diagnostics: per code its severity and its words.

A file a room: ``catalogue/statics.toml`` has what ``statics`` finds; what only a tool says is in
its folder, in ``words.toml``. An entry is a table:

    [effort-limit-differs]
    severity = "warning"
    en = "{subject}: the effort limit is {urdf} in the URDF, {mjcf} in the MJCF"
    zh = "..."

``severity`` is ``note`` where it is left out, and ``group`` ``found`` for notes and ``wrong`` for
all else. See ``templates`` for what may stand in braces.

Other files have a line per entry, ``key = { en = "...", zh = "..." }``: ``terms.toml`` the words
for kinds of things, such as ``joint``; ``texts.toml`` headings, labels and remarks of documents;
``meanings.toml``, by class and field, what results have. A tool has such lines in tables
``[texts]`` and ``[meanings]``. What another's tool does not say in a language is said in English.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

from pupper_analysis.base.tools import other_packages, own_packages

LANGUAGES = ("en", "zh")

_TABLE = re.compile(r"^\[([a-z0-9-]+)\]$", re.MULTILINE)
_LINE = re.compile(r'^"?([^"\n]+?)"? = (\{ en = .*\})$', re.MULTILINE)
_TERMS, _TEXTS, _MEANINGS = "terms.toml", "texts.toml", "meanings.toml"
LINED = (_TERMS, _TEXTS, _MEANINGS)
"""Files with a line per entry."""

_FOLDER = Path(__file__).parent / "catalogue"
_TABLES = {_TERMS: "terms", _TEXTS: "texts", _MEANINGS: "meanings"}
"""{file: the table of a tool's words that has the like}."""


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
    tables = _tables() if code in _tables() else _others()
    stated = tomllib.loads(tables[code])
    severity = stated.get("severity", "note")
    group = stated.get("group", "found" if severity == "note" else "wrong")
    words = {language: stated.get(language, stated["en"]) for language in LANGUAGES}
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
    for file in (_TEXTS, _TERMS):
        if key in list_entries(file):
            return _said(_line(file, key), language)
    return _said(tomllib.loads(_others_lines(_TEXTS)[key])["entry"], language)


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
        ours = owner.__module__.startswith(f"{__name__.partition('.')[0]}.")
        if not ours and key in _others_lines(_MEANINGS):
            return _said(tomllib.loads(_others_lines(_MEANINGS)[key])["entry"], language)
    return ""


def word_files() -> Mapping[str, Path]:
    """Returns {whose: file} of all words of this package: rooms, and tools that have their own."""
    rooms = {path.stem: path for path in sorted(_FOLDER.glob("*.toml"))}
    tools = {name: tool.folder / "words.toml" for name, tool in own_packages().items()}
    return rooms | {f"tools/{name}": path for name, path in tools.items() if path.is_file()}


def _said(words: Mapping[str, str], language: str) -> str:
    return words.get(language) or words["en"]


@cache
def _tables_of(path: Path) -> Mapping[str, str]:
    """Returns {header: its table's text} of a file."""
    _, *parts = _TABLE.split(path.read_text(encoding="utf-8"))
    return MappingProxyType(dict(zip(parts[::2], parts[1::2], strict=True)))


@cache
def _others() -> Mapping[str, str]:
    """Returns {code: its table's text} of what tools of other packages say."""
    paths = [tool.folder / "words.toml" for tool in other_packages().values()]
    tables = [_tables_of(path) for path in paths if path.is_file()]
    return MappingProxyType({code: text for table in tables for code, text in table.items()})


@cache
def _others_lines(file: str) -> Mapping[str, str]:
    """Returns {key: its entry as TOML} of other packages' tools."""
    paths = [tool.folder / "words.toml" for tool in other_packages().values()]
    texts = [_tables_of(path).get(_TABLES[file], "") for path in paths if path.is_file()]
    return MappingProxyType(
        {key: f"entry = {line}" for text in texts for key, line in _LINE.findall(text)}
    )


@cache
def _tables() -> Mapping[str, str]:
    """Returns {code: its table's text}.

    TOML is slow to read (1,000 entries take 50 ms, a tenth of a command's start), and a command
    says a few things only: entries are distinguished by their headers and read when they are
    needed.
    """
    tables: dict[str, str] = {}
    for path in word_files().values():
        if path.name not in LINED:
            tables |= _tables_of(path)
    for lined in _TABLES.values():
        tables.pop(lined, None)
    return MappingProxyType(tables)


@cache
def list_entries(file: str) -> Mapping[str, str]:
    """Returns {key: its entry as TOML} of a file with a line per entry, and of tools' lines."""
    text = (_FOLDER / file).read_text(encoding="utf-8")
    if file in _TABLES:
        tools = [path for path in word_files().values() if path.name not in LINED]
        text = "\n".join([text, *(_tables_of(one).get(_TABLES[file], "") for one in tools)])
    return MappingProxyType(dict(_LINE.findall(text)))


@cache
def _line(file: str, key: str) -> Mapping[str, str]:
    words: dict[str, str] = tomllib.loads(f"entry = {list_entries(file)[key]}")["entry"]
    return MappingProxyType(words)
