"""Written XML: a comment contains the name of the source file, whatever characters it has."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from tests.support.commands import answer
from tests.support.legged import quadruped


def test_file_is_converted_if_its_name_has_an_escape(tmp_path: Path) -> None:
    """An escape character and `--` may not occur in an XML comment or on a terminal."""
    pair = quadruped(tmp_path, floor=True, actuators="position")
    pair.mjcf.rename(tmp_path / "a\x1b[31m--b.xml")
    given = answer("convert", "a\x1b[31m--b.xml", "-o", "new.urdf", folder=tmp_path)
    assert given.returncode < 2, given
    assert "\x1b" not in given.stdout + given.stderr
    tree = etree.parse(tmp_path / "new.urdf")
    assert any("\\x1b[31m- -b.xml" in str(one.text) for one in tree.xpath("//comment()"))
