"""Write the documentation pages that are generated from the package.

``conf.py`` calls ``write_pages`` before each build. Generated pages are not committed, so that they
always agree with the code. Sources are the argument parser (``commands/``), the catalogue
(``audit-rules``, ``diagnostics``), the meanings of fields (``results``), docstrings (``api/``), and
the files of ``docs/data`` (``tables/``).
"""

from __future__ import annotations

import csv
import functools
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_origin

import click
import numpy as np
from numpy.typing import NDArray

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base import array_types
from pupper_analysis.base.diagnostics.catalogue import LINE_ENTRY_FILES, word_files
from pupper_analysis.base.diagnostics.templates import OPTIONAL_TEXT
from pupper_analysis.present.formats import escape_control
from pupper_analysis.tools.audit.registry import MODEL_FORMATS, RULES

PACKAGE = Path(pa.__file__).parent
"""Folder of the package."""

DATA = Path(__file__).resolve().parent / "data"
"""Folder of the tables."""

GENERATED = "generated"
"""Folder for generated pages in a site's reference; Git ignores it."""

WORDS = tomllib.loads((Path(__file__).resolve().parent / "words.toml").read_text("utf-8"))
"""{language: {key: text}} of texts on the pages that are not from the package."""


def write_pages(site: Path, language: str) -> None:
    """Write the generated pages of a site; unchanged files are not touched.

    Args:
        site: Folder of the site's sources.
        language: ``en`` or ``zh``.
    """
    folder = site / "reference" / GENERATED
    words = WORDS[language]
    pages = {
        "audit-rules.md": make_rules_page(words, language),
        **make_codes_pages(words, language),
        **make_results_pages(words, language),
    }
    if language == "en":
        pages |= make_command_pages() | make_api_pages() | make_table_pages()
    for old in folder.rglob("*.*"):
        if old.relative_to(folder).as_posix() not in pages:
            old.unlink()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# ---------------------------------------------------------------------------------- small parts


def _format_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(_format_cell, line)) + " |" for line in lines) + "\n"


def _format_cell(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return escape_control(" ".join(text.split())).replace("|", "\\|").replace("<", "&lt;")


def _escape_markdown(text: str) -> str:
    """Return a text whose characters are no Markdown syntax, except in `code`."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a backtick that stands alone
        parts = [text.replace("`", "\\`")]
    marked = [re.sub(r"([*_\[\]#$]|\\(?!`))", r"\\\1", part) for part in parts[::2]]
    parts[::2] = marked
    return "`".join(parts)


def _format_toctree(names: Iterable[str], depth: int = 1, *, hidden: bool = False) -> str:
    """Return a table of contents for Sphinx."""
    option = ":hidden:" if hidden else f":maxdepth: {depth}"
    return f"```{{toctree}}\n{option}\n\n" + "\n".join(names) + "\n```\n"


def _format_entry(anchor: str, text: str, target: str, about: str = "") -> str:
    """Return an entry of an index, with the anchor that the section had on the index's page.

    Links to this anchor, for example from other sites, then lead to the entry.
    """
    return f'- <a id="{anchor}"></a>[{text}]({target}){about}'


# ------------------------------------------------------------------- the catalogue of diagnostics


def make_rules_page(words: Mapping[str, Any], language: str) -> str:
    """Return the page of the audit rules."""
    rows = []
    for rule in RULES.values():
        said = rule.chinese if language == "zh" else vars(rule)
        where = "all" if rule.formats == MODEL_FORMATS else ", ".join(rule.formats).upper()
        words_of = (_escape_markdown(said[key]) for key in ("title", "why", "todo"))
        rows.append((f"`{rule.id}`", str(rule.severity), where, *words_of))
    return f"# {words['rules']}\n\n{words['rules-about']}\n\n" + _format_table(
        words["rule-columns"], rows
    )


def make_codes_pages(words: Mapping[str, Any], language: str) -> dict[str, str]:
    """Return {path: text} of a page per folder with codes and their texts, and of the index."""
    pages: dict[str, str] = {}
    entries = []
    for whose, path in word_files().items():
        if path.name in LINE_ENTRY_FILES:
            continue
        codes = tomllib.loads(path.read_text("utf-8"))
        for lined in ("texts", "meanings", "terms"):
            codes.pop(lined, None)
        if not codes:
            continue
        rows = [
            (
                f"`{code}`",
                entry.get("severity", "note"),
                _escape_markdown(_simplify_template(entry[language])),
            )
            for code, entry in codes.items()
        ]
        anchor = whose.replace("/", "-")
        page = f"diagnostics/{anchor}.md"
        pages[page] = f"# {whose}\n\n" + _format_table(words["code-columns"], rows)
        entries.append(_format_entry(anchor, whose, page, f" ({len(rows)})"))
    return pages | {"diagnostics.md": _make_index(words, "codes", entries, pages)}


def _make_index(
    words: Mapping[str, Any], title: str, entries: Sequence[str], pages: Iterable[str]
) -> str:
    """Return the page that lists entries, each of one of the pages.

    Args:
        words: Texts of the language; contains the title and, as ``TITLE-about``, the description.
        title: Key of the title.
        entries: Lines of the list.
        pages: Paths of the pages.
    """
    first = f"# {words[title]}\n\n{words[f'{title}-about']}\n\n"
    tree = _format_toctree(remove_suffixes(pages), hidden=True)
    return first + "\n".join(entries) + "\n\n" + tree


def _simplify_template(template: str) -> str:
    """Return a template with the names of its values, and with optional texts in brackets."""
    text = re.sub(r"\{\w+\|[^{}|]*\|([^{}|]*)\}", r"\1", template)
    text = re.sub(r"(?<!\{)\{(\w+)[^{}]*\}(?!\})", r"⟨\1⟩", text)
    text = re.sub(rf"(?:{OPTIONAL_TEXT.pattern})+", _bracket_optional_texts, text)
    return text.replace("{{", "{").replace("}}", "}")


_SEPARATOR = re.compile(r"[\s,.;:()，。；：、！？（）]")  # noqa: RUF001 - Chinese punctuation
"""Pattern of a character that separates two successive optional texts of a message."""


def _bracket_optional_texts(found: re.Match[str]) -> str:
    """Return successive optional texts of a template in brackets: "[+ / -]", "[beyond ⟨limit⟩]".

    Two texts are alternatives, separated by " / ", if their conditions exclude each other, as in
    ``[more?+][!more?-]``. They are also alternatives if no separator is between them, as in
    ``[slow?slows down][fast?diverges]``: a message with both texts would not be readable.
    """
    groups: list[list[str]] = []
    last = ("", "", "")
    for current in OPTIONAL_TEXT.findall(found[0]):
        (negation, name, text), (last_negation, last_name, last_text) = current, last
        opposite = name == last_name and negation != last_negation
        ends = last_text[-1:], text[:1]
        glued = all(end and not _SEPARATOR.fullmatch(end) for end in ends)
        if opposite or glued:
            groups[-1].append(text)
        else:
            groups.append([text])
        last = current
    return "".join(map(_bracket_alternatives, groups))


def _bracket_alternatives(texts: Sequence[str]) -> str:
    """Return texts as "[one / two]"; spaces at their ends are outside of the brackets."""
    written = [text for text in texts if text.strip()]
    if not written:
        return ""
    before = " " if any(text[0] == " " for text in written) else ""
    after = " " if any(text[-1] == " " for text in written) else ""
    return f"{before}[{' / '.join(text.strip() for text in written)}]{after}"


def make_results_pages(words: Mapping[str, Any], language: str) -> dict[str, str]:
    """Return {path: text} of a page of result fields per initial letter, and of the index."""
    meanings: dict[str, Any] = {}
    for whose, path in word_files().items():
        read = tomllib.loads(path.read_text("utf-8"))
        meanings |= read if whose == "meanings" else read.get("meanings", {})
    pages: dict[str, str] = {}
    entries = []
    for name, fields in sorted(meanings.items()):
        page = f"results/{name[0].lower()}.md"
        rows = [(f"`{field}`", _escape_markdown(said[language])) for field, said in fields.items()]
        pages.setdefault(page, f"# {words['results']}: {name[0]}\n")
        pages[page] += f"\n## {name}\n\n" + _format_table(words["result-columns"], rows)
        entries.append(_format_entry(name.lower(), name, f"{page}#{name.lower()}"))
    return pages | {"results.md": _make_index(words, "results", entries, pages)}


# --------------------------------------------------------------------------------- command line


def make_command_pages() -> dict[str, str]:
    """Return {path: text} of a page per command, and of the list of commands."""
    commands = {name: cli.find_command(name) for name in cli.COMMAND_NAMES}
    pages = {
        f"commands/{name}.md": _make_command_page(name, command)
        for name, command in commands.items()
    }
    rows = [
        (f"[{name}](commands/{name}.md)", _escape_markdown(command.get_short_help_str(limit=200)))
        for name, command in commands.items()
    ]
    first = f"# {WORDS['en']['commands']}\n\n{WORDS['en']['commands-about']}\n\n"
    table = _format_table(("Command", "Purpose"), rows)
    hidden = _format_toctree(remove_suffixes(pages), hidden=True)
    return pages | {"commands.md": f"{first}{table}\n{hidden}"}


def remove_suffixes(pages: Iterable[str]) -> list[str]:
    """Return the names of pages without suffix, as a table of contents requires."""
    return [page.removesuffix(".md") for page in pages]


def _make_command_page(name: str, command: click.Command) -> str:
    """Return the page of a command: usage, help and table of options."""
    context = click.Context(command, info_name=f"pupper-analysis {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    parts = [f"# {name}", f"```text\npupper-analysis {name} {usage}\n```"]
    for paragraph in re.split(r"\n\s*\n", command.help or ""):
        lines = [line.strip("\b") for line in paragraph.splitlines()]
        text = "\n".join(line.strip() for line in lines if line.strip())
        if "\b" in paragraph and "pupper-analysis " in paragraph:
            parts.append("```sh\n" + "\n".join(text.splitlines()[1:]) + "\n```")
        elif "\b" in paragraph:
            parts.append("```text\n" + text + "\n```")
        elif text:
            parts.append(_escape_markdown(text))
    rows = []
    for option in command.params:
        record = option.get_help_record(context)
        if record is not None and isinstance(option, click.Option):
            rows.append((f"`{record[0]}`", _escape_markdown(record[1])))
    return "\n\n".join(parts) + "\n\n" + _format_table(("Option", "Effect"), rows)


# ------------------------------------------------------------------------------------------ API


def make_api_pages() -> dict[str, str]:
    """Return {path: text} of the pages of the public interface: the package, and each module.

    Each function and class of the package has its own page; all its errors share a page.
    """
    own = {name: getattr(pa, name) for name in pa.__all__}
    own = {name: value for name, value in own.items() if not isinstance(value, ModuleType)}
    described = {name: value for name, value in own.items() if callable(value)}
    parts: dict[str, list[str]] = {}
    lists: dict[str, list[str]] = {"functions": [], "classes": [], "errors": []}
    for name, value in described.items():
        kind = "functions" if not isinstance(value, type) else "classes"
        kind = "errors" if kind == "classes" and issubclass(value, BaseException) else kind
        page = "errors" if kind == "errors" else name
        parts.setdefault(page, []).append(name)
        about = f": {_escape_markdown(_read_summary(value))}"
        target = f"{pa.__name__}/{page}.md"
        lists[kind].append(_format_entry(f"{pa.__name__}.{name}", name, target, about))
    first = _make_api_page("pa", pa.__name__, pa, [name for name in own if name not in described])
    listed = "\n\n".join(
        f"## {WORDS['en'][kind]}\n\n" + "\n".join(entries) for kind, entries in lists.items()
    )
    tree = _format_toctree([f"{pa.__name__}/{page}" for page in parts], hidden=True)
    pages = {f"api/{pa.__name__}.md": f"{first}\n{listed}\n\n{tree}"}
    members = {
        f"api/{pa.__name__}/{page}.md": _make_api_page(
            f"pa.{page}" if page in own else WORDS["en"]["errors"], pa.__name__, None, names
        )
        for page, names in parts.items()
    }
    for name in pa.__all__:
        module = getattr(pa, name)
        if isinstance(module, ModuleType):
            public = f"{pa.__name__}.{name}"
            pages[f"api/{name}.md"] = _make_api_page(
                f"pa.{name}", public, module, _list_public_names(module)
            )
    first = f"# {WORDS['en']['api']}\n\n{WORDS['en']['api-about']}\n\n"
    tree = _format_toctree(remove_suffixes(pages), 2)
    return pages | members | {"api.md": first + tree}


def _read_summary(value: object) -> str:
    """Return the first paragraph of a docstring in one line."""
    return " ".join((value.__doc__ or "").strip().split("\n\n")[0].split())


def _list_public_names(module: ModuleType) -> list[str]:
    """Return the public names of a module: ``__all__``, or the names that it defines."""
    names = getattr(module, "__all__", None)
    if names is not None:
        return list(names)
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]


def _make_api_page(title: str, public: str, module: ModuleType | None, names: Sequence[str]) -> str:
    """Return a page with names of a module, each under its public import path.

    Args:
        title: Heading of the page.
        public: Public path of the module, such as ``pupper_analysis.identification``.
        module: The module, whose docstring begins the page; None for a page of the package without
            a description.
        names: Names in the module.
    """
    about = "" if module is None else _escape_markdown(_read_summary(module))
    lines = [f"# {title}", "", about, "", "```{eval-rst}", f".. currentmodule:: {public}", ""]
    for name in sorted(names, key=lambda name: (name[0].isupper(), name)):
        lines += _format_directive(public, name, getattr(module or pa, name))
    return "\n".join([*lines, "```", ""])


def _format_directive(module: str, name: str, value: object) -> list[str]:
    """Return the Sphinx directive of a name, as lines."""
    full = f"{module}.{name}"
    # What is the package's own, too, is referred to there: of two places none is the one meant.
    twice = module != pa.__name__ and getattr(pa, name, None) is value
    index = ["   :no-index:"] if twice else []
    if isinstance(value, type):
        return [f".. autoclass:: {full}", "   :members:", *index, ""]
    if callable(value):
        return [f".. autofunction:: {full}", *index, ""]
    return [f".. autodata:: {full}", "   :no-value:", *index, ""]


@functools.cache
def map_private_paths() -> dict[str, str]:
    """Return {path of the definition: public path} of all public classes and functions."""
    modules = {pa.__name__: pa}
    for name in pa.__all__:
        if isinstance(value := getattr(pa, name), ModuleType):
            modules[f"{pa.__name__}.{name}"] = value
    paths: dict[str, str] = {}
    for public, module in modules.items():
        for name in _list_public_names(module):
            value = getattr(module, name)
            if isinstance(value, type) or callable(value):
                paths.setdefault(f"{value.__module__}.{value.__qualname__}", f"{public}.{name}")
    return paths


ARRAY_TYPES = {
    get_args(get_args(alias)[1])[0].__name__.rstrip("_"): name
    for name, alias in vars(array_types).items()
    if get_origin(alias) is np.ndarray and alias is not NDArray
}
"""{dtype: name of the array type}, such as {"float64": "Array"}; the API page explains them."""


def shorten_types(text: str) -> str:
    """Return a signature or type as a reader writes it.

    Array types have their short names, and names of this package their public paths. A name of
    this package without a public path is printed without its module. ``~`` makes Sphinx print only
    the last part of a path; a text with ``<factory>`` would be printed as it is, including ``~``.
    """
    text = re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text).replace("<factory>", "...")

    def shorten_array(found: re.Match[str]) -> str:
        return ARRAY_TYPES.get(found[1], found[0])

    path = r"~?(?:\w+\.)*"
    shape = rf"{path}tuple\[{path}Any, \.\.\.\]"
    array = rf"{path}ndarray\[{shape}, {path}dtype\[{path}(\w+?)_?\]\]"
    text = re.sub(array, shorten_array, text)
    text = re.sub(rf"{path}NDArray\[{path}(\w+?)_?\]", shorten_array, text)

    def shorten_path(found: re.Match[str]) -> str:
        name = found[1]
        public = map_private_paths().get(name, name)
        hidden = public == name and name not in map_private_paths().values()
        return name.rpartition(".")[2] if hidden else f"~{public}"

    text = re.sub(r"\b(pinocchio|mujoco)(?:\.\w+)+\.(\w+)", r"\1.\2", text)
    return re.sub(rf"~?\b({pa.__name__}(?:\.\w+)+)", shorten_path, text)


def shorten_signature(*event: Any) -> tuple[str, str] | None:
    """Shorten the types of a signature.

    Args:
        event: Arguments of ``autodoc-process-signature``; the last two are signature and return
            annotation, None for an object without a signature.
    """
    signature, returned = event[-2:]
    if signature is None:
        return None
    return shorten_types(signature), shorten_types(returned or "")


def escape_docstring(*event: Any) -> None:
    """Escape ``*``, ``|`` and ``_`` in docstrings, which Sphinx would take as markup.

    Types of fields, which napoleon has inserted, are shortened.

    Args:
        event: Arguments of ``autodoc-process-docstring``; the last is the list of lines, which
            is modified.
    """
    lines: list[str] = event[-1]
    literal: int | None = None
    for index, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        if literal is None and re.match(r"\s*:(?:var)?type \S+:|\s*:rtype:", line):
            line = shorten_types(line)
        if literal is None:
            lines[index] = _escape_line(line)
            if line.rstrip().endswith("::"):
                literal = indent


def _escape_line(line: str) -> str:
    """Return a line with escaped markup characters, except in ``literals`` and roles."""
    parts = re.split(r"(``.*?``|:\w+:`[^`]*`|^\s*:[^:]+:\s|^\s*\.\. .*$)", line)
    return "".join(
        part if index % 2 else re.sub(r"(?<!\\)([*|`]|_(?!\w))", r"\\\1", part)
        for index, part in enumerate(parts)
    )


# --------------------------------------------------------------------------------------- tables


def summarise_robots(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the number of robots with a defect, and the numbers of verdicts, as text."""
    judged = Counter(row["stand or hold"].split(",")[0].split(":")[0] for row in rows)
    compared = [row["crosscheck"] for row in rows if row["crosscheck"] != "-"]
    agree = sum(one == "AGREE" for one in compared)
    found = sum(row["first defect"] != "-" for row in rows)
    verdicts = "; ".join(f"{count} {verdict}" for verdict, count in judged.most_common())
    return (
        f"{len(rows)} robots, {found} of them with a defect whose line is named. Of "
        f"{len(compared)} pairs of a URDF and an MJCF {agree} agree. Verdicts: {verdicts}."
    )


def summarise_removed_tests(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the number of removed tests of each class as text, and the evidence of merged ones."""
    classes = Counter(row["class"] for row in rows)
    merged = Counter(
        row["test or line of the changelog today"].partition(":")[0]
        for row in rows
        if row["class"] == "merged"
    )
    counts = ", ".join(f"{count} {name}" for name, count in classes.most_common())
    kinds = "same assertion", "fault seen", "nearest"
    evidence = ", ".join(f"{merged[kind]} *{kind}*" for kind in kinds)
    return f"{len(rows)} rows: {counts}. Of the merged rows: {evidence}."


MAX_TABLE_LENGTH = 12_000
"""Largest number of characters of the cells of a table on one page; chosen. On a phone, such a page
is at most about 20 000 px high."""


def split_rows(rows: Sequence[tuple[str, ...]]) -> list[list[tuple[str, ...]]]:
    """Split a table into successive parts, each with at most ``MAX_TABLE_LENGTH`` characters."""
    parts: list[list[tuple[str, ...]]] = [[]]
    length = 0
    for row in rows:
        added = sum(map(len, row))
        if parts[-1] and length + added > MAX_TABLE_LENGTH:
            parts.append([])
            length = 0
        parts[-1].append(row)
        length += added
    return parts


def make_table_pages() -> dict[str, str]:
    """Return {path: text} of a page per group of tables in ``docs/data``, and of their list.

    ``tables.toml`` contains the groups, and the title, description and command of each table.
    """
    groups = tomllib.loads((DATA / "tables.toml").read_text("utf-8"))
    pages: dict[str, str] = {}
    long: dict[str, str] = {}
    for group, tables in groups.items():
        parts = [f"# {tables.pop('title')}"]
        for name, table in tables.items():
            with (DATA / f"{name}.csv").open(encoding="utf-8", newline="") as file:
                header, *rows = csv.reader(file)
            parts += [f"## {table['title']}", table["about"].strip()]
            if name == "robots-of-packages":
                parts.append(
                    summarise_robots([dict(zip(header, row, strict=True)) for row in rows])
                )
            if name == "reduced-tests":
                parts.append(
                    summarise_removed_tests([dict(zip(header, row, strict=True)) for row in rows])
                )
            if "command" in table:
                parts.append(f"```sh\n{table['command']}\n```")
            written = [tuple(map(_escape_markdown, row)) for row in rows]
            pieces = split_rows(written)
            if len(pieces) == 1:
                parts.append(_format_table(header, written))
                continue
            entries = []
            for number, piece in enumerate(pieces, 1):
                page = f"tables/{group}/{name}-{number}.md"
                start = sum(map(len, pieces[: number - 1])) + 1
                rows_of = f"rows {start} to {start + len(piece) - 1}"
                long[page] = f"# {table['title']}, {rows_of}\n\n" + _format_table(header, piece)
                entries.append(f"- [{rows_of}]({page.removeprefix('tables/')})")
            parts.append("\n".join(entries))
        own = [page for page in remove_suffixes(long) if page.startswith(f"tables/{group}/")]
        if own:
            names = [page.removeprefix("tables/") for page in own]
            parts.append(_format_toctree(names, hidden=True))
        pages[f"tables/{group}.md"] = "\n\n".join(parts)
    first = f"# {WORDS['en']['tables']}\n\n{WORDS['en']['tables-about']}\n\n"
    tree = _format_toctree([f"tables/{name}" for name in groups])
    return pages | long | {"tables.md": first + tree}
