"""Writes the pages that follow from the package: commands, rules, codes, results, API, tables.

``conf.py`` calls ``write`` before each build. Nothing that it writes is committed, so no page can
be out of step with the code: ``commands/`` are the argument parser's, ``audit-rules`` and
``diagnostics`` the catalogue's, ``results`` the meanings that pages show, ``api/`` the docstrings,
``tables/`` the files of ``docs/data``.
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
DATA = Path(__file__).resolve().parent / "data"
GENERATED = "generated"
"""The folder of a site's reference with what is written here; git ignores it."""

WORDS = tomllib.loads((Path(__file__).resolve().parent / "words.toml").read_text("utf-8"))
"""What stands on these pages beside the package's own words, {language: {key: words}}."""


def write(site: Path, language: str) -> None:
    """Write a site's generated pages; files that would stay as they are are not touched.

    Args:
        site: The folder of its sources.
        language: ``en`` or ``zh``.
    """
    folder = site / "reference" / GENERATED
    words = WORDS[language]
    pages = {
        "audit-rules.md": audit_rules(words, language),
        "diagnostics.md": diagnostic_codes(words, language),
        "results.md": result_fields(words, language),
    }
    if language == "en":
        pages |= command_pages() | api_pages() | table_pages()
    for old in folder.rglob("*.*"):
        if old.relative_to(folder).as_posix() not in pages:
            old.unlink()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# ---------------------------------------------------------------------------------- small parts


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    """Return a text as the cell of a Markdown table holds it."""
    return escape_control(" ".join(text.split())).replace("|", "\\|").replace("<", "&lt;")


def _plain(text: str) -> str:
    """Return a text of which Markdown takes no letter for its own, outside `code`."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a backtick that stands alone
        parts = [text.replace("`", "\\`")]
    marked = [re.sub(r"([*_\[\]#$]|\\(?!`))", r"\\\1", part) for part in parts[::2]]
    parts[::2] = marked
    return "`".join(parts)


def _toctree(names: Iterable[str], depth: int = 1) -> str:
    return f"```{{toctree}}\n:maxdepth: {depth}\n\n" + "\n".join(names) + "\n```\n"


# ------------------------------------------------------------------- the catalogue of diagnostics


def audit_rules(words: Mapping[str, Any], language: str) -> str:
    """Return the page of the audit's rules."""
    rows = []
    for rule in RULES.values():
        said = rule.chinese if language == "zh" else vars(rule)
        where = "all" if rule.formats == MODEL_FORMATS else ", ".join(rule.formats).upper()
        words_of = (_plain(said[key]) for key in ("title", "why", "todo"))
        rows.append((f"`{rule.id}`", str(rule.severity), where, *words_of))
    return f"# {words['rules']}\n\n{words['rules-about']}\n\n" + _table(words["rule-columns"], rows)


def diagnostic_codes(words: Mapping[str, Any], language: str) -> str:
    """Return the page of all codes, with the words of their entries."""
    parts = [f"# {words['codes']}\n\n{words['codes-about']}\n"]
    for whose, path in word_files().items():
        if path.name not in LINE_ENTRY_FILES:
            entries = tomllib.loads(path.read_text("utf-8"))
            for lined in ("texts", "meanings", "terms"):
                entries.pop(lined, None)
            if not entries:
                continue
            rows = [
                (f"`{code}`", entry.get("severity", "note"), _plain(_readable(entry[language])))
                for code, entry in entries.items()
            ]
            parts.append(f"## {whose}\n\n" + _table(words["code-columns"], rows))
    return "\n".join(parts)


def _readable(template: str) -> str:
    """Return a template of the catalogue with its values named, and all that is optional said."""
    text = re.sub(r"\[!?\w+\?([^\[\]]*)\]", r"\1", template)
    text = re.sub(r"\{\w+\|[^{}|]*\|([^{}|]*)\}", r"\1", text)
    text = re.sub(r"(?<!\{)\{(\w+)[^{}]*\}(?!\})", r"⟨\1⟩", text)
    return text.replace("{{", "{").replace("}}", "}")


def result_fields(words: Mapping[str, Any], language: str) -> str:
    """Return the page of what the fields of results mean."""
    meanings: dict[str, Any] = {}
    for whose, path in word_files().items():
        read = tomllib.loads(path.read_text("utf-8"))
        meanings |= read if whose == "meanings" else read.get("meanings", {})
    parts = [f"# {words['results']}\n\n{words['results-about']}\n"]
    for name, fields in sorted(meanings.items()):
        rows = [(f"`{field}`", _plain(said[language])) for field, said in fields.items()]
        parts.append(f"## {name}\n\n" + _table(words["result-columns"], rows))
    return "\n".join(parts)


# --------------------------------------------------------------------------------- command line


def command_pages() -> dict[str, str]:
    """Return a page for each command with its help and options, and the list of commands."""
    commands = {name: cli.find_command(name) for name in cli.COMMAND_NAMES}
    pages = {f"commands/{name}.md": _command(name, command) for name, command in commands.items()}
    rows = [
        (f"[{name}](commands/{name}.md)", _plain(command.get_short_help_str(limit=200)))
        for name, command in commands.items()
    ]
    first = f"# {WORDS['en']['commands']}\n\n{WORDS['en']['commands-about']}\n\n"
    table = _table(("Command", "Purpose"), rows)
    hidden = _toctree(pages_without_suffix(pages)).replace(":maxdepth: 1", ":hidden:")
    return pages | {"commands.md": f"{first}{table}\n{hidden}"}


def pages_without_suffix(pages: Iterable[str]) -> list[str]:
    """Return the names of pages as a toctree refers to them."""
    return [page.removesuffix(".md") for page in pages]


def _command(name: str, command: click.Command) -> str:
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
            parts.append(_plain(text))
    rows = []
    for option in command.params:
        record = option.get_help_record(context)
        if record is not None and isinstance(option, click.Option):
            rows.append((f"`{record[0]}`", _plain(record[1])))
    return "\n\n".join(parts) + "\n\n" + _table(("Option", "Effect"), rows)


# ------------------------------------------------------------------------------------------ API


def api_pages() -> dict[str, str]:
    """Return the pages of the public interface: the package's own names, and each module's."""
    own = [name for name in pa.__all__ if not isinstance(getattr(pa, name), ModuleType)]
    pages = {"api/pupper_analysis.md": _api("pa", pa.__name__, pa, own)}
    for name in pa.__all__:
        module = getattr(pa, name)
        if isinstance(module, ModuleType):
            public = f"{pa.__name__}.{name}"
            pages[f"api/{name}.md"] = _api(f"pa.{name}", public, module, _public(module))
    first = f"# {WORDS['en']['api']}\n\n{WORDS['en']['api-about']}\n\n"
    return pages | {"api.md": first + _toctree(pages_without_suffix(pages), 2)}


def _public(module: ModuleType) -> list[str]:
    """Return what a module offers: its list, or what is defined in it."""
    names = getattr(module, "__all__", None)
    if names is not None:
        return list(names)
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]


def _api(title: str, public: str, module: ModuleType, names: Sequence[str]) -> str:
    """Return the page of a module's names, each under the path by which users import it.

    Args:
        title: Heading of the page.
        public: Public path of the module, such as ``pupper_analysis.identification``.
        module: The module.
        names: Names in the module.
    """
    about = (module.__doc__ or "").strip().split("\n\n")[0]
    lines = [f"# {title}", "", _plain(" ".join(about.split())), "", "```{eval-rst}"]
    lines += [f".. currentmodule:: {public}", ""]
    for name in sorted(names, key=lambda name: (name[0].isupper(), name)):
        lines += _directive(public, name, getattr(module, name))
    return "\n".join([*lines, "```", ""])


def _directive(module: str, name: str, value: object) -> list[str]:
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
    """Replace Sphinx' marker of an aliased type by the name of the alias, as ``ArrayLike``.

    Args:
        event: Arguments of ``autodoc-process-signature``; the last two are signature and return
            annotation, None for an object without a signature.
    """
    signature, returned = event[-2:]
    if signature is None:
        return None
    marker = r"TypeAliasForwardRef\('(\w+)'\)"
    return re.sub(marker, r"\1", signature), re.sub(marker, r"\1", returned or "")


def plain_text(*event: Any) -> None:
    """Has Sphinx take docstrings as they are written: ``*``, ``|x|``, ``name_`` are no markup.

    Args:
        event: What ``autodoc-process-docstring`` passes; the last is the lines, which are changed.
    """
    lines: list[str] = event[-1]
    literal: int | None = None
    for index, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        if literal is None:
            lines[index] = _unmarked(line)
            if line.rstrip().endswith("::"):
                literal = indent


def _unmarked(line: str) -> str:
    """Return a line with all that stands outside ``literals`` and roles taken as plain text."""
    parts = re.split(r"(``.*?``|:\w+:`[^`]*`|^\s*:[^:]+:\s|^\s*\.\. .*$)", line)
    return "".join(
        part if index % 2 else re.sub(r"(?<!\\)([*|`]|_(?!\w))", r"\\\1", part)
        for index, part in enumerate(parts)
    )


# --------------------------------------------------------------------------------------- tables


def robots_summary(rows: Sequence[Mapping[str, str]]) -> str:
    """Return how many robots have a defect with its line, and what becomes of them."""
    judged = Counter(row["stand or hold"].split(",")[0].split(":")[0] for row in rows)
    compared = [row["crosscheck"] for row in rows if row["crosscheck"] != "-"]
    agree = sum(one == "AGREE" for one in compared)
    found = sum(row["first defect"] != "-" for row in rows)
    verdicts = "; ".join(f"{count} {verdict}" for verdict, count in judged.most_common())
    return (
        f"{len(rows)} robots, {found} of them with a defect whose line is named. Of "
        f"{len(compared)} pairs of a URDF and an MJCF {agree} agree. Verdicts: {verdicts}."
    )


def table_pages() -> dict[str, str]:
    """Return a page for each group of tables of ``docs/data``, and their list.

    ``tables.toml`` has the groups, and of each table a title, what it says and the command that
    measures it.
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
                parts.append(robots_summary([dict(zip(header, row, strict=True)) for row in rows]))
            if "command" in table:
                parts.append(f"```sh\n{table['command']}\n```")
            parts.append(_table(header, [map(_plain, row) for row in rows]))
        pages[f"tables/{group}.md"] = "\n\n".join(parts)
    first = f"# {WORDS['en']['tables']}\n\n{WORDS['en']['tables-about']}\n\n"
    return pages | {"tables.md": first + _toctree([f"tables/{name}" for name in groups])}
