"""Documents on a terminal: in its width, the short view first, and nothing cut."""

from __future__ import annotations

import io
import re

import pytest

from pupper_analysis.present.document import (
    Column,
    Document,
    Lines,
    Name,
    Number,
    Table,
    tell,
    text,
)
from pupper_analysis.present.terminal import MOST_NOTES, SafeConsole, print_document
from tests.support.printing import printed
from tests.support.stubs import problem


def table(columns: int, rows: int = 12, letters: int = 7, **options: bool) -> Table:
    """A table whose cells are all different."""
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


def shown(*blocks: Table | Lines, width: int = 80, everything: bool = True) -> list[str]:
    document = Document(Name(""), Name("robot"), blocks)
    return printed(document, width=width, everything=everything).splitlines()


def test_sentences_are_wrapped_and_names_are_not() -> None:
    sentence, name = "it falls over " * 12, "left_shoulder_pitch_joint_of_the_robot"
    row = (Name(name), tell(problem(sentence.strip())), Number("1.5", 1.5))
    columns = (Column(Name("joint")), Column(Name("why"), left=True), Column(Name("load"), "N"))
    lines = shown(Table(Name("t"), columns, (row,)))
    assert max(map(len, lines)) <= 80
    first = next(line for line in lines if name in line)
    assert first.split()[-1] == "1.5"
    assert " ".join(lines).count("falls") == 12


def test_a_bar_is_drawn_where_there_is_room() -> None:
    cells = ((Name("hip"), Number("50.0", 50.0, share=0.5)),)
    bar = Table(Name("t"), (Column(Name("joint")), Column(Name("used"), "%")), cells)
    assert shown(bar)[-1].endswith("50.0 █████")
    assert "█" not in "".join(shown(bar, table(2), width=40)) or len(shown(bar)[-1]) <= 40


def test_what_the_short_view_leaves_out_is_named() -> None:
    short = shown(table(3), table(4, detail=True), everything=False)
    assert short[-1] == "with -v: Numbers"
    assert sum("Numbers" in line for line in short) == 2
    assert sum("Numbers" in line for line in shown(table(3), table(4, detail=True))) == 2


@pytest.mark.parametrize("count", [1, MOST_NOTES, MOST_NOTES + 1, 30])
def test_notes_are_at_most_eight_lines(count: int) -> None:
    notes = tuple(tell(problem(f"note {index}")) for index in range(count))
    document = Document(Name(""), Name("robot"), (), notes=notes)
    lines = printed(document, everything=False).splitlines()[1:]
    assert len(lines) == min(count, MOST_NOTES)
    if count > MOST_NOTES:
        assert lines[-1] == f"… and {count - MOST_NOTES + 1} more notes: -v"
    assert printed(document).count("note: note") == count


def test_lines_are_wrapped_on_a_terminal_alone() -> None:
    wrapped = tell(problem("a word " * 40))
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


def test_verdicts_are_coloured() -> None:
    file = io.StringIO()
    out = SafeConsole(file=file, width=80, force_terminal=True, color_system="standard")
    failed = Document(Name(""), Name("r"), (), passed=False, verdict=text("FAILS"))
    print_document(out, failed)
    assert "\x1b[1;31mFAILS" in file.getvalue()
