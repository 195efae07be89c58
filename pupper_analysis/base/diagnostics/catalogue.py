"""Catalogue of the texts of diagnostics and documents, by key and language.

Each TOML file contains the texts of a package or of a part of a package: ``catalogue/statics.toml``
the texts of ``statics``. Texts of a tool are in ``words.toml`` in its folder. A diagnostic is a
table:

    [effort-limit-differs]
    severity = "warning"
    en = "{subject}: the effort limit is {urdf} in the URDF, {mjcf} in the MJCF"
    zh = "..."
    short = "{subject}: effort limits {urdf} and {mjcf}"
    short_zh = "..."

The default of ``severity`` is ``note``. The default of ``group`` is ``found`` for notes and
``wrong`` for all other severities. ``templates`` describes the syntax in braces.

Three files have a line per entry, ``key = { en = "...", zh = "..." }``. ``terms.toml`` contains
names of kinds of things, such as ``joint``. ``texts.toml`` contains headings, labels and remarks of
documents. ``meanings.toml`` contains descriptions of the fields of results, by class and field. The
``words.toml`` of a tool has such lines in its tables ``[terms]``, ``[texts]`` and ``[meanings]``.
The English text replaces a missing Chinese text of a diagnostic or a document.
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
"""Codes of the languages of all catalogue texts: English and Simplified Chinese."""

SHORT_FORM = "short"
"""Key of the short English form of a catalogue text, for short answers. Most texts have no short
form."""

CHINESE_SHORT_FORM = "short_zh"
"""Key of the short Chinese form of a catalogue text. Each text of this package that has a short
English form also has a short Chinese form, with the same values."""

_TABLE_HEADER = re.compile(r"^\[([a-z0-9-]+)\]$", re.MULTILINE)
"""Pattern of the header line of a TOML table."""

_LINE_ENTRY = re.compile(r'^"?([^"\n]+?)"? = (\{ en = .*\})$', re.MULTILINE)
"""Pattern of an entry on one line: key and inline table with the text per language."""

_TERMS_FILE, _TEXTS_FILE, _MEANINGS_FILE = "terms.toml", "texts.toml", "meanings.toml"
"""Catalogue files of terms, of texts of documents, and of descriptions of the fields of results."""

LINE_ENTRY_FILES = (_TERMS_FILE, _TEXTS_FILE, _MEANINGS_FILE)
"""Catalogue files in which each entry is a single line ``key = { en = "...", zh = "..." }``, with
optional texts ``short`` and ``short_zh``."""

_CATALOGUE_FOLDER = Path(__file__).parent / "catalogue"
"""Folder of the catalogue files."""

_TABLES_BY_FILE = {_TERMS_FILE: "terms", _TEXTS_FILE: "texts", _MEANINGS_FILE: "meanings"}
"""{catalogue file: table with the same kind of entries in a tool's file ``words.toml``}. A tool is
a subpackage of ``pupper_analysis.tools``, or a package of another distribution."""


@dataclass(frozen=True)
class Entry:
    """Catalogue entry of a diagnostic's code: severity, group and texts.

    Attributes:
        severity: ``"error"``, ``"warning"`` or ``"note"``.
        group: ``"wrong"``, ``"assumed"`` or ``"found"``.
        templates: {language: template of the text}.
        short_templates: {language: template of the short form}; an empty template if there is none.
    """

    severity: str
    group: str
    templates: Mapping[str, str]
    short_templates: Mapping[str, str]


def codes() -> Iterator[str]:
    """Return the codes of the diagnostics of this package and its tools, in no particular order."""
    return iter(_load_tables())


@cache
def entry(code: str) -> Entry:
    """Return the severity, the group and the text templates of a diagnostic's code.

    Raises:
        KeyError: If neither this package's catalogue nor a plug-in's catalogue contains the code.
    """
    tables = _load_tables() if code in _load_tables() else _load_plugin_tables()
    fields = tomllib.loads(tables[code])
    severity = fields.get("severity", "note")
    group = fields.get("group", "found" if severity == "note" else "wrong")
    templates = {language: fields.get(language, fields["en"]) for language in LANGUAGES}
    short_forms = dict(zip(LANGUAGES, (SHORT_FORM, CHINESE_SHORT_FORM), strict=True))
    short_templates = {language: fields.get(form, "") for language, form in short_forms.items()}
    return Entry(severity, group, MappingProxyType(templates), MappingProxyType(short_templates))


def term(name: str, language: str) -> str:
    """Return the word for a term in a language; the name itself for an unknown term.

    Args:
        name: Key of the term in the catalogue, such as ``joint``.
        language: ``"en"`` or ``"zh"``.
    """
    return (
        _parse_catalogue_entry(_TERMS_FILE, name)[language]
        if name in list_entries(_TERMS_FILE)
        else name
    )


def is_term(name: str) -> bool:
    """Return True if the catalogue contains a term with this key."""
    return name in list_entries(_TERMS_FILE)


@cache
def phrase(key: str, language: str) -> str:
    """Return a text of documents and pages, or a term, in a language.

    Args:
        key: Key of the text or term in a catalogue file.
        language: ``"en"`` or ``"zh"``; or `SHORT_FORM` or `CHINESE_SHORT_FORM` for a short form.
            The English text replaces a missing Chinese text.

    Returns:
        Template, whose placeholders the caller replaces with ``fill_template``. Empty for a short
        form that the text does not have.

    Raises:
        KeyError: If there is no entry with this key.
    """
    for file in (_TEXTS_FILE, _TERMS_FILE):
        if key in list_entries(file):
            return _select_language(_parse_catalogue_entry(file, key), language)
    entries = _load_plugin_entries(_TEXTS_FILE)
    return _select_language(tomllib.loads(entries[key])["entry"], language)


def meaning(kind: type, field: str, language: str) -> str:
    """Return the description of a field of a result class, with the unit, from the catalogue.

    Args:
        kind: Class of the result.
        field: Field of the class, or of a base class.
        language: ``"en"`` or ``"zh"``.

    Returns:
        Description; "" if the catalogue has no description.
    """
    for owner in kind.__mro__:
        key = f"{owner.__name__}.{field}"
        if key in list_entries(_MEANINGS_FILE):
            return _parse_catalogue_entry(_MEANINGS_FILE, key)[language]
        is_own = owner.__module__.startswith(f"{__name__.partition('.')[0]}.")
        if not is_own and key in _load_plugin_entries(_MEANINGS_FILE):
            return _select_language(
                tomllib.loads(_load_plugin_entries(_MEANINGS_FILE)[key])["entry"], language
            )
    return ""


def word_files() -> Mapping[str, Path]:
    """Return {name: path} of the TOML files with texts for users, without those of plug-ins.

    A file of the folder ``catalogue`` has its file name without suffix as name; the file
    ``words.toml`` of a tool or format has the name "tools/NAME".
    """
    catalogues = {path.stem: path for path in sorted(_CATALOGUE_FOLDER.glob("*.toml"))}
    tools = {name: tool.folder / "words.toml" for name, tool in own_packages().items()}
    return catalogues | {f"tools/{name}": path for name, path in tools.items() if path.is_file()}


def _select_language(words: Mapping[str, str], language: str) -> str:
    """Return the text in a language, else in English; a missing short form is empty."""
    if language in (SHORT_FORM, CHINESE_SHORT_FORM):
        return words.get(language, "")
    return words.get(language) or words["en"]


@cache
def _split_tables(path: Path) -> Mapping[str, str]:
    """Split a TOML file at its table headers, and return {header: unparsed text of the table}."""
    _, *parts = _TABLE_HEADER.split(path.read_text(encoding="utf-8"))
    return MappingProxyType(dict(zip(parts[::2], parts[1::2], strict=True)))


@cache
def _load_plugin_tables() -> Mapping[str, str]:
    """Return {table header: TOML text of the table} of the ``words.toml`` files of plug-ins.

    The header of a table is the code of a diagnostic, or a table name of `_TABLES_BY_FILE`.
    """
    paths = [tool.folder / "words.toml" for tool in other_packages().values()]
    tables = [_split_tables(path) for path in paths if path.is_file()]
    return MappingProxyType({code: text for table in tables for code, text in table.items()})


@cache
def _load_plugin_entries(file: str) -> Mapping[str, str]:
    """Return {key: TOML text ``entry = ...``} of the one-line entries of plug-ins.

    ``file`` is the catalogue file with entries of the same kind, a key of `_TABLES_BY_FILE`.
    """
    paths = [tool.folder / "words.toml" for tool in other_packages().values()]
    texts = [_split_tables(path).get(_TABLES_BY_FILE[file], "") for path in paths if path.is_file()]
    return MappingProxyType(
        {key: f"entry = {line}" for text in texts for key, line in _LINE_ENTRY.findall(text)}
    )


@cache
def _load_tables() -> Mapping[str, str]:
    """Return {code of a diagnostic: unparsed TOML text of its table} from this package's files.

    An entry is parsed at its first use, because parsing all entries would delay each command.
    """
    tables: dict[str, str] = {}
    for path in word_files().values():
        if path.name not in LINE_ENTRY_FILES:
            tables |= _split_tables(path)
    for table in _TABLES_BY_FILE.values():
        tables.pop(table, None)
    return MappingProxyType(tables)


@cache
def list_entries(file: str) -> Mapping[str, str]:
    """Return the one-line TOML entries of a catalogue file, with those of this package's tools.

    Args:
        file: ``terms.toml``, ``texts.toml`` or ``meanings.toml`` (``LINE_ENTRY_FILES``).

    Returns:
        {key: TOML text ``{ en = "...", zh = "..." }``}.
    """
    text = (_CATALOGUE_FOLDER / file).read_text(encoding="utf-8")
    if file in _TABLES_BY_FILE:
        paths = [path for path in word_files().values() if path.name not in LINE_ENTRY_FILES]
        text = "\n".join(
            [text, *(_split_tables(path).get(_TABLES_BY_FILE[file], "") for path in paths)]
        )
    return MappingProxyType(dict(_LINE_ENTRY.findall(text)))


@cache
def _parse_catalogue_entry(file: str, key: str) -> Mapping[str, str]:
    """Return {language: text} of an entry of a catalogue file, from its single TOML line."""
    texts: dict[str, str] = tomllib.loads(f"entry = {list_entries(file)[key]}")["entry"]
    return MappingProxyType(texts)
