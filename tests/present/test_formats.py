"""GitHub's workflow commands and JUnit's XML, parsed as their readers parse them."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pupper_analysis.present.document import (
    Column,
    Document,
    FileFinding,
    FilePlace,
    Lines,
    Listing,
    Name,
    Table,
    diagnostic_text,
)
from pupper_analysis.present.formats import Annotation, escape_control, write_github, write_junit
from pupper_analysis.present.terminal import SafeConsole, print_document
from tests.support.commands import run_command
from tests.support.stubs import problem


def read_command(line: str) -> tuple[str, dict[str, str], str]:
    """Read a workflow command as GitHub's runner does (ActionCommand.cs)."""
    parts = re.fullmatch(r"::(\w+) ?(.*?)::(.*)", line)
    assert parts is not None, line
    properties = {}
    for text in parts[2].split(","):
        name, _, value = text.partition("=")
        for escaped, plain in (("%0D", "\r"), ("%0A", "\n"), ("%3A", ":"), ("%2C", ",")):
            value = value.replace(escaped, plain)
        properties[name] = value.replace("%25", "%")
    message = parts[3].replace("%0D", "\r").replace("%0A", "\n").replace("%25", "%")
    return parts[1], properties, message


TEXT = st.text(st.sampled_from("ab%:,\n\r=0A25D3C ") | st.characters(codec="utf-8"), max_size=30)


def escape_controls(text: str) -> str:
    """Return a text with its control characters escaped, except for line ends."""
    return "".join(letter if letter in "\r\n" else escape_control(letter) for letter in text)


@pytest.mark.slow
@given(title=TEXT, message=TEXT)
def test_workflow_command_is_read_back_with_any_characters(title: str, message: str) -> None:
    """Reference: the parser of GitHub's runner (ActionCommand.cs)."""
    level, properties, read = read_command(
        write_github([Annotation("error", title, message, "r.xml:3")])
    )
    assert level == "error"
    assert properties["file"] == "r.xml"
    assert properties["line"] == "3"
    if "%3A" not in title and "%2C" not in title and "%0" not in title:  # as GitHub reads
        assert properties["title"] == escape_controls(title)
    if "%0" not in message:
        assert read == escape_controls(message)


def test_separators_and_line_ends_of_a_workflow_command_are_escaped() -> None:
    line = write_github([Annotation("notice", "a: b, c %\nd", "5 %: a, b\r\n100 %25", None)])
    assert line == "::notice title=a%3A b%2C c %25%0Ad::5 %25: a, b%0D%0A100 %2525"


@pytest.mark.parametrize(
    ("place", "parameters"),
    [
        (None, "title=t"),
        ("", "title=t"),
        ("robot.urdf", "file=robot.urdf,title=t"),
        ("C:/models/robot.urdf", "file=C%3A/models/robot.urdf,title=t"),
        ("C:/models/robot.urdf:7", "file=C%3A/models/robot.urdf,line=7,title=t"),
        ("a,b.urdf:7", "file=a%2Cb.urdf,line=7,title=t"),
        ("50%.urdf:7", "file=50%25.urdf,line=7,title=t"),
    ],
)
def test_place_of_an_annotation_is_file_and_line(place: str | None, parameters: str) -> None:
    assert write_github([Annotation("warning", "t", "m", place)]) == f"::warning {parameters}::m"


def test_junit_cases_fail_unless_notice_or_in_the_baseline() -> None:
    found = [
        Annotation("error", "mass", "5 % < 4 & more", "go1.urdf:7", rule="mass"),
        Annotation("error", "limit", "0.9 rad\nand 1.1 rad", known=True),
        Annotation("notice", "name", "other"),
    ]
    root = ElementTree.fromstring(write_junit(found, "pupper-analysis audit a.urdf").encode())
    assert [suite.get("name") for suite in root] == ["pupper-analysis audit a.urdf"]
    (suite,) = root
    assert [(element.get("tests"), element.get("failures")) for element in (root, suite)] == [
        ("3", "1")
    ] * 2
    assert [(case.get("name"), len(case)) for case in suite] == [
        ("mass", 1),
        ("limit", 0),
        ("name", 0),
    ]
    assert (suite[0].get("file"), suite[0].get("line")) == ("go1.urdf", "7")
    assert suite[0][0].get("message") == "5 % < 4 & more"
    assert suite[0][0].get("type") == "mass"
    with_code = Annotation("error", "feet", "off", diagnostic=problem("off"))
    (failure,) = ElementTree.fromstring(write_junit([with_code]).encode()).iter("failure")
    assert failure.get("type") == "problem"
    assert ElementTree.fromstring(write_junit([]).encode()).get("tests") == "1"


PRINTABLE = st.text(
    st.characters(
        codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufffe\uffff"
    ),
    max_size=30,
)


@pytest.mark.slow
@given(title=PRINTABLE, message=PRINTABLE)
def test_junit_is_valid_xml_with_any_characters(title: str, message: str) -> None:
    root = ElementTree.fromstring(write_junit([Annotation("error", title, message)]).encode())
    assert [testcase.get("name") for testcase in root.iter("testcase")] == [escape_control(title)]


HOSTILE = "a\n::error::forged\x1b[31mred\x9b31m\u202eb\u2028c\rd [bold]e[/bold] :smile:"


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("hostile", [HOSTILE, f"::error::{HOSTILE}", f"##[error]{HOSTILE}"])
def test_console_escapes_control_characters(hostile: str, terminal: bool) -> None:
    """No escape sequences, text directions, line breaks or workflow commands of names; markup is
    printed as text.
    """
    out = SafeConsole(file=io.StringIO(), force_terminal=terminal, width=400, emoji=False)
    out.print(f"robot {hostile.replace(chr(10), '')}")
    name, place = Name(hostile), FilePlace(Name(hostile), Name(hostile), hostile)
    blocks = (
        Table(name, (Column(name, hostile),), ((name,),), (name,)),
        Lines((name,), title=name),
        FileFinding(diagnostic_text(problem(hostile)), (place,), (name,), name),
        Listing(name, hostile.replace("\n", "")),
    )
    document = Document(name, name, blocks, passed=False, verdict=name, failures=(name, name))
    print_document(out, replace(document, notes=(name,)), everything=True)
    assert isinstance(out.file, io.StringIO)
    text = out.file.getvalue()
    plain = re.sub("\x1b\\[[0-9;]*m", "", text) if terminal else text
    assert not set("\x1b\x9b\u202e\u2028\r") & set(plain)
    assert not any(line.lstrip().startswith("::") for line in plain.splitlines())
    assert "##[" not in plain
    assert "\x1b[31m" not in text
    assert "[bold]e" in plain
    assert ":smile:" in plain


def test_workflow_commands_cannot_be_forged_by_names_in_a_model(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """GitHub executes printed lines that begin with ``::``, also in JUnit's XML."""
    file = tmp_path / "robot\n::error::forged.urdf"
    name = "a&#10;::error::forged&#x9b;31m&#x202e;"
    file.write_text(
        f'<robot name="r"><link name="{name}"><inertial><mass value="-1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    for style in ("text", "github", "junit", "sarif"):
        status, out, err = run_command(capfd, "audit", str(file), "--format", style)
        assert status in (1, 2)
        text = out + err
        assert not set("\x1b\x9b\u202e") & set(text)
        assert not any(line.lstrip().startswith("::error::forged") for line in text.splitlines())
