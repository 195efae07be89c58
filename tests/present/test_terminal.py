"""Documents on a terminal: short view first, wrapped to its width, and no text cut off."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from rich.cells import cell_len

from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    Column,
    Document,
    FileFinding,
    Lines,
    Name,
    Number,
    Table,
    Text,
    diagnostic_text,
    text,
)
from pupper_analysis.present.terminal import (
    MAX_SHORT_FINDINGS,
    MAX_SHORT_NOTES,
    SafeConsole,
    print_document,
    print_head,
)
from tests.support.commands import run_command
from tests.support.printing import printed
from tests.support.repository import ROOT
from tests.support.stubs import REPORTS, problem


def table(columns: int, rows: int = 12, letters: int = 7, **options: bool) -> Table:
    """Return a table whose cells are all different."""
    heads = [Column(Name("joint"), left=True)]
    heads += [Column(Name(f"column {index}"), "N m") for index in range(1, columns)]
    cells = tuple(
        (
            Name(f"joint_{row}"),
            *(
                Number(f"{row:02d}.{column:02d}".rjust(letters, "0"), 0.0)
                for column in range(1, columns)
            ),
        )
        for row in range(rows)
    )
    return Table(Name("Numbers"), tuple(heads), cells, **options)


def print_lines(*blocks: Table | Lines, width: int = 80, everything: bool = True) -> list[str]:
    document = Document(Name(""), Name("robot"), blocks)
    return printed(document, width=width, everything=everything).splitlines()


def test_table_is_printed_in_parts_without_cut_numbers_if_too_wide() -> None:
    """Each cell occurs once, in lines of at most 80 characters."""
    lines = print_lines(table(9, letters=9))
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith("joint") for line in lines) == 2 * (1 + 12)  # header and rows
    words = " ".join(lines).split()
    for cell in (
        f"{row:02d}.{column:02d}".rjust(9, "0") for row in range(12) for column in range(1, 9)
    ):
        assert words.count(cell) == 1
    row = next(index for index, line in enumerate(lines) if line.startswith("joint_0"))
    assert lines[row].endswith("0000" + lines[row][-5:])  # numbers stand on the right
    assert lines[row].index("000000.01") + 9 == lines[row - 2].index("(N m)") + 5


def test_lines_are_wrapped_only_on_a_terminal() -> None:
    wrapped = diagnostic_text(problem("a word " * 40))
    document = Document(Name(""), Name("robot"), (), findings=(Name("x"), wrapped))
    assert len(printed(document).splitlines()) == 2
    file = io.StringIO()
    out = SafeConsole(
        file=file, width=80, force_terminal=True, color_system=None, legacy_windows=False
    )
    print_document(out, document)
    lines = re.sub("\x1b\\[[0-9;]*m", "", file.getvalue()).splitlines()
    assert len(lines) > 3
    assert all(len(line) <= 80 for line in lines)
    assert all(line.startswith("  ") for line in lines[1:])
    assert " ".join(lines).count("word") == 40


def test_chinese_lines_and_tables_are_wrapped_between_characters() -> None:
    """Chinese characters are two cells wide. Names and numbers stay whole, marks end a row."""
    sentence = Text("", "关节 leg_front_r_1 的力矩为 0.47 N m，超过上限（见 pupper_v3.urdf）。" * 4)
    grid = Table(
        Name("table"),
        (Column(Text("joint", "关节"), left=True), Column(Text("cause", "原因"), left=True)),
        ((Name("leg_front_r_1"), sentence),),
    )
    document = Document(Name(""), Name("robot"), (grid,), notes=(sentence,))
    file = io.StringIO()
    out = SafeConsole(
        language="zh", file=file, width=80, force_terminal=True, color_system=None,
        legacy_windows=False,
    )  # fmt: skip
    print_document(out, document, everything=True)
    lines = re.sub("\x1b\\[[0-9;]*m", "", file.getvalue()).splitlines()
    assert max(map(cell_len, lines)) <= 80
    assert sum(cell_len(line) > 70 for line in lines) >= 6  # rows are filled
    assert not any(line.lstrip().startswith(("，", "。", "）")) for line in lines)
    whole = [line.replace("leg_front_r_1", "") for line in lines]
    assert sum(line.count("leg_front_r_1") for line in lines) == 1 + 2 * 4
    assert not any("leg_" in line for line in whole)
    assert sum(line.count("pupper_v3.urdf") for line in lines) == 2 * 4
    assert any(line.startswith("说明：") for line in lines)


def test_answer_is_verdict_limit_and_next_command_and_details_follow_with_v() -> None:
    document = Document(
        Name("stance"),
        Name("robot"),
        (table(2),),
        passed=True,
        verdict=Name("HOLDS"),
        findings=(Name("largest load 1 N m"), Name("it settles 2 mm lower")),
        details=(Name("height 3 mm"),),
        brief=True,
    )
    answer = [
        "HOLDS robot: largest load 1 N m",
        "  it settles 2 mm lower",
        "  next: pupper-analysis payload robot.urdf",
    ]
    short, full = io.StringIO(), io.StringIO()
    for file, everything in ((short, False), (full, True)):
        out = SafeConsole(file=file, width=80)
        print_document(
            out, document, everything=everything, next_command=answer[2].removeprefix("  next: ")
        )
    assert short.getvalue().splitlines() == [*answer, "  with -v: 1 more line, 1 table"]
    lines = full.getvalue().splitlines()
    assert lines[:4] == [*answer[:2], "  height 3 mm", answer[2]]
    assert any(line.startswith("joint_0") for line in lines)


@pytest.mark.slow
def test_stand_fits_80_columns_and_confirms_its_files(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Tables of 12 joints, four feet and others; files in the order in which they are written."""
    paths = [str(tmp_path / name) for name in ("a.png", "a.html", "a.json")]
    options = zip(("--figure", "--report", "--json"), paths, strict=True)
    words = ("stand", "v3", "-v", *(part for pair in options for part in pair))
    status, out, _ = run_command(capfd, *words)
    assert status == 0
    lines = out.splitlines()
    assert [line for line in lines if line.startswith("written: ")] == [
        f"written: {path}" for path in paths
    ]
    tables = [line for line in lines if re.search("─|^(leg_|[FR][RL] )", line)]
    assert sum(line.startswith("leg_") for line in tables) >= 12
    assert max(map(len, tables)) <= 80


@pytest.mark.parametrize("width", [60, 80, 120, 200])
@pytest.mark.parametrize(("columns", "rows"), [(4, 12), (9, 3), (17, 3)])
def test_each_cell_is_printed_once_at_any_width(columns: int, rows: int, width: int) -> None:
    made = table(columns, rows)
    lines = print_lines(made, width=width)
    assert max(map(len, lines)) <= width
    for row in made.rows:
        for cell in row[1:]:
            assert sum(f" {cell.text}" in line for line in lines) == 1  # type: ignore[union-attr]


@pytest.mark.parametrize("count", [1, MAX_SHORT_NOTES, MAX_SHORT_NOTES + 1, 30])
def test_short_view_has_a_largest_number_of_notes(count: int) -> None:
    notes = tuple(diagnostic_text(problem(f"note {index}")) for index in range(count))
    document = Document(Name(""), Name("robot"), (), notes=notes)
    lines = printed(document, everything=False).splitlines()[1:]
    assert len(lines) == min(count, MAX_SHORT_NOTES)
    if count > MAX_SHORT_NOTES:
        assert lines[-1] == f"… and {count - MAX_SHORT_NOTES + 1} more notes: -v"
    assert printed(document).count("note: note") == count


def test_sentences_in_a_table_are_wrapped_and_names_are_not() -> None:
    sentence, name = "it falls over " * 12, "left_shoulder_pitch_joint_of_the_robot"
    row = (Name(name), diagnostic_text(problem(sentence.strip())), Number("1.5", 1.5))
    columns = (Column(Name("joint")), Column(Name("why"), left=True), Column(Name("load"), "N"))
    lines = print_lines(Table(Name("t"), columns, (row,)))
    assert max(map(len, lines)) <= 80
    assert any(name in line for line in lines)
    assert " ".join(lines).count("falls") == 12


def test_failing_verdict_is_bold_and_red() -> None:
    file = io.StringIO()
    out = SafeConsole(file=file, width=80, force_terminal=True, color_system="standard")
    failed = Document(Name(""), Name("r"), (), passed=False, verdict=text("FAILS"))
    print_document(out, failed)
    assert "\x1b[1;31mFAILS" in file.getvalue()


def test_short_view_counts_the_tables_that_it_omits() -> None:
    short = print_lines(table(3), table(4, detail=True), everything=False)
    assert short[-1] == "  with -v: 1 table"
    assert sum("Numbers" in line for line in short) == 1
    assert sum("Numbers" in line for line in print_lines(table(3), table(4, detail=True))) == 2


def test_files_are_not_confirmed_if_data_goes_to_standard_output(
    capfd: pytest.CaptureFixture[str],
) -> None:
    file = str(ROOT / "urdf" / "pupper_v3.urdf")
    _, out, err = run_command(capfd, "audit", file, "--json", "-")
    assert out.startswith("{")
    assert err.startswith("OK")
    assert "written" not in out + err


def test_answer_joins_the_short_forms_of_warnings_and_counts_the_remaining_warnings() -> None:
    """The full text with -v; without, one line of at most ``MAX_ANSWER_WIDTH`` characters."""
    warnings = [
        Text(f"{name} is a long explanation", "zh", "warn", short=f"{name} is short")
        for name in ("first", "second" * 5, "third" * 8)
    ]
    document = Document(
        Name("stance"),
        Name("robot"),
        (),
        passed=True,
        verdict=Text("HOLDS (in full)", "zh", short="HOLDS"),
        findings=(Name("largest load 1 N m"), *warnings),
        notes=(Name("a"), Name("b")),
        brief=True,
    )
    short = printed(document, everything=False).splitlines()
    assert short == [
        "HOLDS robot: largest load 1 N m",
        f"  first is short; {'second' * 5} is short",
        "  with -v: 1 more line, 2 notes",
    ]
    assert all(len(line) <= MAX_ANSWER_WIDTH for line in short)
    full = printed(document).splitlines()
    assert full[:4] == [
        "HOLDS (in full) robot: largest load 1 N m",
        *(f"  {warning.en}" for warning in warnings),
    ]


@pytest.mark.parametrize(
    ("title", "shown"),
    [
        ("legged_robot.urdf", "legged_robot"),
        ("legged_robot.urdf + 2 kg", "legged_robot + 2 kg"),
        ("robot.urdf+scene.xml", "robot.urdf+scene.xml"),
    ],
)
def test_suffix_of_a_file_is_dropped_if_the_verdict_is_too_wide(title: str, shown: str) -> None:
    """The verdict of a G1 was cut before the joint. Two files need their suffixes."""
    width = MAX_ANSWER_WIDTH - len(f"{shown}: ")
    for message, expected in (("x" * (width - 9), title), ("x" * width, shown)):
        file = io.StringIO()
        document = Document(Name(""), Name(title), (), findings=(Name(message),))
        print_head(SafeConsole(file=file, width=200), document)
        assert file.getvalue() == f"{expected}: {message}\n"


def test_message_that_is_too_wide_ends_at_a_clause() -> None:
    """No word and no bracket is cut; the omitted clauses are with -v."""
    first = "link 'base': joint knee at 0 deg, outside the limits"
    clauses = f"{first} (4 of 12, {'9 ' * 40})"
    document = Document(
        Name("audit"), Name("r"), (), findings=(Name("OK"), Name(clauses), Name("x")), brief=True
    )
    short = printed(document, everything=False).splitlines()
    assert short[1] == f"  {first} …; x"
    assert clauses.rstrip() in printed(document)
    wide = Name(f"{clauses}; z")
    document = Document(Name("audit"), Name("r"), (), findings=(wide,), brief=True)
    assert printed(document, everything=False).splitlines() == [f"r: {first} …"]
    # A path is never cut away.
    path = Name(f"{first}; the file is {'folder/' * 9}a.txt")
    document = Document(Name("audit"), Name("r"), (), findings=(path,), brief=True)
    assert printed(document, everything=False).splitlines() == [f"r: {path.text}"]
    # The name of an element alone states nothing.
    named = Name(f"link 'base': {'mesh' * 30}")
    document = Document(Name("audit"), Name("r"), (), findings=(Name("OK"), named), brief=True)
    assert "…" not in printed(document, everything=False)


@pytest.mark.parametrize("name", REPORTS)
def test_answers_have_at_most_100_characters(name: str) -> None:
    """The first two lines of each result; the third is a command to copy."""
    for document in REPORTS[name]().documents:
        for line in printed(document, everything=False).splitlines()[:2]:
            assert len(line) <= MAX_ANSWER_WIDTH == 100


def test_short_view_counts_the_findings_beyond_the_first() -> None:
    """Findings keep their numbers, by which `sync --take` selects them."""
    blocks = tuple(FileFinding(Name(f"finding {number}"), ()) for number in range(1, 12))
    document = Document(Name("check"), Name("robot"), blocks)
    lines = printed(document, everything=False).splitlines()
    shown = [line for line in lines if "finding " in line]
    assert shown == [f"{number}. finding {number}" for number in range(1, MAX_SHORT_FINDINGS + 1)]
    assert lines[-1] == f"  with -v: {11 - MAX_SHORT_FINDINGS} findings"
    assert sum("finding " in line for line in printed(document).splitlines()) == 11
