"""Markdown documents for comments on pull requests, in which names of a model act as no markup."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pupper_analysis.present.document import (
    Column,
    Document,
    FileFinding,
    FilePlace,
    Lines,
    Listing,
    Name,
    Number,
    Report,
    Table,
    diagnostic_text,
    text,
)
from pupper_analysis.present.markdown import MAX_COMMENT_LENGTH, write_markdown
from tests.support.commands import answer
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.stubs import problem

TABLE = Table(
    text("motor-torques"),
    (Column(text("joint"), left=True), Column(text("torque"), "N m"), Column(text("verdict"))),
    (
        (Name("knee_1"), Number("-0.1234", -0.1234, bar_fraction=0.5), text("ok")),
        (Name("hip"), Number("9.9", 9.9, "bad"), text("differs").with_mark("bad")),
    ),
    (text("objections"),),
)
MASS, SANK = (diagnostic_text(problem(message)) for message in ("mass 1 kg", "it sank"))
PLACES = (FilePlace(Name("a.urdf:5"), Name('<mass value="1"/>'), "models/a.urdf:5"),)
DOCUMENT = Document(
    text("stance"),
    Name("v3"),
    (
        TABLE,
        FileFinding(
            diagnostic_text(problem("mass 1 kg")),
            PLACES,
            (text("no-change"),),
            text("all-ok").with_mark("warn"),
        ),
        Lines((diagnostic_text(problem("it sank")),), "bad", text("objections"), detail=True),
        Listing(text("no-change"), "-a\n+```b", "diff"),
    ),
    passed=False,
    verdict=text("FAILS"),
    failures=(diagnostic_text(problem("the robot fell over")),),
    findings=(diagnostic_text(problem("height 0.13 m")),),
    notes=(diagnostic_text(problem("a floor was added")),),
)


def test_document_is_written_as_markdown() -> None:
    report = Report(text("report"), (DOCUMENT,))
    assert (
        write_markdown(report)
        == """\
### ❌ FAILS v3

- **the robot fell over**
- height 0.13 m

**Motor torques**

| joint | torque (N m) | verdict |
| :--- | ---: | ---: |
| knee\\_1 | -0.1234 | ok |
| hip | **9.9** | **DIFFERS** |

- Objections

- OK **mass 1 kg**
  - models/a.urdf:5: ` <mass value="1"/> `
  - no change

<details><summary>Objections</summary>

**Objections**

- it sank

</details>

**no change**

````diff
-a
+```b
````

<details><summary>1 notes</summary>

- a floor was added

</details>
"""
    )


EVIL = (
    *("@everyone", "#1", "GH-7", ":tada:", "https://evil.example", "www.evil.example"),
    *("[a](javascript:b)", "![a](b)", "<img src=x onerror=alert(1)>", "<!-- a", "&lt;b&gt;", "`a"),
    *("a | b", "**a**", "~~a~~", "$a$", "- a", "1. a", "+ a", "a\n\n# b", "\u202eb", "</details>"),
)


@pytest.mark.parametrize("name", EVIL)
def test_names_with_markup_are_escaped(name: str) -> None:
    """Mentions, references, links, HTML, formulas and lists of GitHub's Markdown; a table row keeps
    its columns.
    """
    said, place = diagnostic_text(problem(name)), FilePlace(Name(name), Name(name), name)
    blocks = (
        Table(said, (Column(said, "N"),), ((said,),), (said,)),
        FileFinding(said, (place,), (said,), said),
        Lines((said,), title=said, detail=True),
        Listing(said, name, "diff"),
    )
    evil = Document(said, said, blocks, True, said, findings=(said,), notes=(said,))
    shown = write_markdown(Report(said, (replace(evil, passed=False),)))
    # Text between fences and ticks is displayed literally.
    outside = re.sub(r"```diff\n.*?```|` .*? `", "", shown, flags=re.S)
    plain = re.sub(r"\\[\\`*_\[\]<>#|~&$]", "", outside)
    assert not re.search(r"[@#]\w|GH-\d|:\w+:|https?://|www\.", plain.replace(r"\#", ""))
    assert "\u202e" not in shown
    tags = set(re.findall(r"<[^>]*>", plain))
    assert tags == {"<details>", "</details>", "<summary>", "</summary>"}
    assert shown.count("\n### ") == 0
    row = next(line for line in shown.split("\n") if line.startswith("| "))
    assert len(re.findall(r"(?<!\\)\|", row)) == 2


def test_markdown_is_cut_to_the_length_of_a_comment() -> None:
    rows = tuple((Name("x" * 500), Number("1", 1.0), Name("")) for _ in range(100))
    long = replace(TABLE, rows=rows)
    shown = write_markdown(Report(text("report"), (replace(DOCUMENT, blocks=(long,)),)))
    assert shown.count("x" * 500) == 100
    assert "--json" not in shown
    shown = write_markdown(Report(text("report"), (replace(DOCUMENT, blocks=(long,) * 3),)))
    assert len(shown) < MAX_COMMENT_LENGTH
    assert shown.startswith("### ❌ FAILS v3\n\n- **the robot fell over**")
    assert "`--json` has all numbers" in shown


def test_tables_that_compare_several_documents_are_written_once() -> None:
    """The two documents are in short: without tables of their own."""
    shown = write_markdown(Report(text("report"), (DOCUMENT, DOCUMENT), (TABLE,)))
    assert shown.count("Motor torques") == 1
    assert shown.count("### ❌ FAILS v3") == 2


@pytest.mark.slow
def test_markdown_is_the_only_text_on_standard_output(tmp_path: Path) -> None:
    """Written files are confirmed on standard error."""
    path, page = tmp_path / "a.json", tmp_path / "a.html"
    words = ("--format", "markdown", "--json", str(path), "--report", str(page))
    found = answer("audit", str(ROOT / "urdf" / "pupper_v3.urdf"), *words)
    assert found.stdout.startswith("### ✅ OK pupper\\_v3.urdf\n\n- 0 errors, ")
    assert "written" not in found.stdout
    assert found.stderr == f"written: {page}\nwritten: {path}\n"
    assert Page(page.read_text(encoding="utf-8")).root.find(".//h1") is not None
