"""Write the documentation pages that are generated from the package.

``conf.py`` calls ``write_pages`` before each build. Generated pages are not committed, so that they
always agree with the code. Sources are the argument parser (``commands/``), the catalogue
(``audit-rules``, ``diagnostics``), the meanings of fields (``results``), docstrings (``api/``), and
the files of ``docs/data`` (``tables/``).
"""

from __future__ import annotations

import csv
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import click

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.diagnostics.catalogue import LINE_ENTRY_FILES, word_files
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
        "diagnostics.md": make_codes_page(words, language),
        "results.md": make_results_page(words, language),
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


def _format_toctree(names: Iterable[str], depth: int = 1) -> str:
    """Return a table of contents for Sphinx."""
    return f"```{{toctree}}\n:maxdepth: {depth}\n\n" + "\n".join(names) + "\n```\n"


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


def make_codes_page(words: Mapping[str, Any], language: str) -> str:
    """Return the page of all codes, with the texts of their entries."""
    parts = [f"# {words['codes']}\n\n{words['codes-about']}\n"]
    for whose, path in word_files().items():
        if path.name not in LINE_ENTRY_FILES:
            entries = tomllib.loads(path.read_text("utf-8"))
            for lined in ("texts", "meanings", "terms"):
                entries.pop(lined, None)
            if not entries:
                continue
            rows = [
                (
                    f"`{code}`",
                    entry.get("severity", "note"),
                    _escape_markdown(_simplify_template(entry[language])),
                )
                for code, entry in entries.items()
            ]
            parts.append(f"## {whose}\n\n" + _format_table(words["code-columns"], rows))
    return "\n".join(parts)


def _simplify_template(template: str) -> str:
    """Return a template with the names of its values, and with all optional texts."""
    text = re.sub(r"\[!?\w+\?([^\[\]]*)\]", r"\1", template)
    text = re.sub(r"\{\w+\|[^{}|]*\|([^{}|]*)\}", r"\1", text)
    text = re.sub(r"(?<!\{)\{(\w+)[^{}]*\}(?!\})", r"⟨\1⟩", text)
    return text.replace("{{", "{").replace("}}", "}")


def make_results_page(words: Mapping[str, Any], language: str) -> str:
    """Return the page with the meanings of the fields of results."""
    meanings: dict[str, Any] = {}
    for whose, path in word_files().items():
        read = tomllib.loads(path.read_text("utf-8"))
        meanings |= read if whose == "meanings" else read.get("meanings", {})
    parts = [f"# {words['results']}\n\n{words['results-about']}\n"]
    for name, fields in sorted(meanings.items()):
        rows = [(f"`{field}`", _escape_markdown(said[language])) for field, said in fields.items()]
        parts.append(f"## {name}\n\n" + _format_table(words["result-columns"], rows))
    return "\n".join(parts)


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
    hidden = _format_toctree(remove_suffixes(pages)).replace(":maxdepth: 1", ":hidden:")
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
    """Return {path: text} of the pages of the public interface: the package, and each module."""
    own = [name for name in pa.__all__ if not isinstance(getattr(pa, name), ModuleType)]
    pages = {"api/pupper_analysis.md": _make_api_page("pa", pa.__name__, pa, own)}
    for name in pa.__all__:
        module = getattr(pa, name)
        if isinstance(module, ModuleType):
            public = f"{pa.__name__}.{name}"
            pages[f"api/{name}.md"] = _make_api_page(
                f"pa.{name}", public, module, _list_public_names(module)
            )
    first = f"# {WORDS['en']['api']}\n\n{WORDS['en']['api-about']}\n\n"
    return pages | {"api.md": first + _format_toctree(remove_suffixes(pages), 2)}


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


def _make_api_page(title: str, public: str, module: ModuleType, names: Sequence[str]) -> str:
    """Return the page of a module with names, each under its public import path.

    Args:
        title: Heading of the page.
        public: Public path of the module, such as ``pupper_analysis.identification``.
        module: The module.
        names: Names in the module.
    """
    about = (module.__doc__ or "").strip().split("\n\n")[0]
    lines = [f"# {title}", "", _escape_markdown(" ".join(about.split())), "", "```{eval-rst}"]
    lines += [f".. currentmodule:: {public}", ""]
    for name in sorted(names, key=lambda name: (name[0].isupper(), name)):
        lines += _format_directive(public, name, getattr(module, name))
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


def shorten_aliases(*event: Any) -> tuple[str, str] | None:
    """Replace Sphinx's marker of an aliased type by the name of the alias, such as ``ArrayLike``.

    Args:
        event: Arguments of ``autodoc-process-signature``; the last two are signature and return
            annotation, None for an object without a signature.
    """
    signature, returned = event[-2:]
    if signature is None:
        return None
    marker = r"TypeAliasForwardRef\('(\w+)'\)"
    return re.sub(marker, r"\1", signature), re.sub(marker, r"\1", returned or "")


def escape_docstring(*event: Any) -> None:
    """Escape ``*``, ``|`` and ``_`` in docstrings, which Sphinx would take as markup.

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


def make_table_pages() -> dict[str, str]:
    """Return {path: text} of a page per group of tables in ``docs/data``, and of their list.

    ``tables.toml`` contains the groups, and the title, description and command of each table.
    """
    groups = tomllib.loads((DATA / "tables.toml").read_text("utf-8"))
    pages = {}
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
            parts.append(_format_table(header, [map(_escape_markdown, row) for row in rows]))
        pages[f"tables/{group}.md"] = "\n\n".join(parts)
    first = f"# {WORDS['en']['tables']}\n\n{WORDS['en']['tables-about']}\n\n"
    return pages | {"tables.md": first + _format_toctree([f"tables/{name}" for name in groups])}
