"""Patches of text files."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from pupper_analysis.base.patches import make_patch

BEFORE = "<a>\r\n\t<!-- \x85 \u2028 \f -->\n" + 9 * "\t<b/>\n" + "<c x='1.'/>\n</a>"
"""Text with the line ends of two systems, without line end at its end, and with characters that
Unicode calls line ends, but not git."""


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
@pytest.mark.parametrize("name", ["robot.urdf", "my robot/a b.urdf", "../robot.urdf"])
@pytest.mark.parametrize("end", ["", "\n"])
def test_git_applies_a_patch_to_the_bytes_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, end: str
) -> None:
    """Reference: git. A file outside the working folder is patched in its own folder."""
    here = tmp_path / "here"
    path = here / name
    path.parent.mkdir(parents=True, exist_ok=True)
    here.mkdir(exist_ok=True)
    before = (BEFORE + end).encode()
    after = before.replace(b"'1.'", b"'.5'").replace(b"<a>\r", b"<a y='\xc3\xbc'>\r")
    path.write_bytes(before)
    monkeypatch.chdir(here)
    patch = make_patch(path if end else Path(name), before, after)
    folder = path.parent if ".." in name else here
    command = ["git", "apply", "--whitespace=nowarn", "-"]
    subprocess.run(command, input=patch.encode(), cwd=folder, check=True)
    assert path.read_bytes() == after
    assert make_patch(path, before, before) == ""
