"""Written XML: a comment contains the name of the source file, whatever characters it has."""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import etree

from pupper_analysis.models.xml import new_file_text
from tests.support.commands import answer
from tests.support.legged import quadruped


def test_file_is_converted_if_its_name_has_an_escape(tmp_path: Path) -> None:
    """An escape character and `--` may not occur in an XML comment or on a terminal."""
    pair = quadruped(tmp_path, floor=True, actuators="position")
    pair.mjcf.rename(tmp_path / "a\x1b[31m--b.xml")
    done = answer("convert", "a\x1b[31m--b.xml", "-o", "new.urdf", folder=tmp_path)
    assert done.returncode < 2, done
    assert "\x1b" not in done.stdout + done.stderr
    tree = etree.parse(tmp_path / "new.urdf")
    assert any("\\x1b[31m- -b.xml" in str(comment.text) for comment in tree.xpath("//comment()"))


@pytest.mark.parametrize("header", ["a\x1b[31mb", "a--b", "--->", "a\0b", "\ufffe", "b-"])
def test_header_of_any_characters_is_a_valid_comment(header: str) -> None:
    root = etree.fromstring(new_file_text(etree.Element("robot"), header).encode())
    [comment] = root.itersiblings(preceding=True)
    assert comment.tag is etree.Comment
    assert "a" not in header or comment.text.strip().startswith("a")
