"""Results contain their provenance: command, date, versions, and digests of the input files."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import mujoco
import pytest
from PIL import Image

from pupper_analysis.base.provenance import collect_provenance
from tests.support.commands import answer
from tests.support.repository import ROOT


@pytest.mark.slow
def test_json_page_markdown_and_pictures_contain_their_provenance(tmp_path: Path) -> None:
    """References: the words of the command, MuJoCo's version, and the SHA-256 of the file."""
    file = tmp_path / "own.urdf"
    file.write_bytes((ROOT / "urdf" / "pupper_skeleton.urdf").read_bytes())
    words = ("push", "own.urdf", "--directions", "3", "--payload", "200g", "--format", "markdown",
             "--json", "p.json", "--report", "p.html", "--figure", "p.png")  # fmt: skip
    done = answer(*words, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "p.json").read_text())["provenance"]
    assert found["command"] == " ".join(("pupper-analysis", *words))
    assert found["request"] == {"directions": 3, "payload": 0.2, "format": "markdown"}
    age = datetime.now(UTC) - datetime.fromisoformat(found["date"])
    assert timedelta() <= age < timedelta(minutes=5)
    assert found["versions"]["mujoco"] == mujoco.__version__
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert found["files"] == {"own.urdf": digest}
    with Image.open(tmp_path / "p.png") as opened:
        picture = opened.info["Source"]
    for shown in (done.stdout, (tmp_path / "p.html").read_text(), picture):
        assert found["command"] in shown
        assert f"own.urdf sha256:{digest[:12]}" in shown
        assert f"mujoco {mujoco.__version__}" in shown


def test_provenance_in_python_has_no_command() -> None:
    found = collect_provenance()
    assert (found.command, found.files) == ("", {})
    assert found.lines()[0] == found.date


def test_provenance_of_many_files_lists_the_first_ones() -> None:
    many = replace(collect_provenance(), files={f"{n:02}.stl": "0" * 64 for n in range(20)})
    assert "11.stl" in many.lines()[-2]
    assert many.lines()[-1].startswith("... 8 more")
