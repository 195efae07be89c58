"""The tool of the guide *Write a tool*, installed beside the package, is a command like others."""

from __future__ import annotations

import gzip
import json
import os
import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.support.repository import ROOT

PAGE = ROOT / "docs/how-to/write-a-tool.md"
PARTS = dict(
    re.findall(r"```(?:python|toml)\n# ([a-z_]+\.\w+)\n(.*?)```", PAGE.read_text("utf-8"), re.S)
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what pip installs of it: the package, and its entry point."""
    folder = tmp_path_factory.mktemp("site")
    package = folder / "inertia_tool"
    package.mkdir()
    stated = tomllib.loads(PARTS["pyproject.toml"])
    data = stated["tool"]["setuptools"]["package-data"]["inertia_tool"]
    for name in PARTS.keys() - {"pyproject.toml"}:
        if any(fnmatchcase(name, one) for one in ("*.py", *data)):
            (package / name).write_text(PARTS[name], encoding="utf-8")
    project = stated["project"]
    about = folder / "inertia_tool-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    ((group, points),) = project["entry-points"].items()
    lines = [f"{name} = {package}" for name, package in points.items()]
    (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]) + "\n")
    return folder


def run(installed: Path, folder: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "pupper_analysis", *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{installed}{os.pathsep}{ROOT}", "NO_COLOR": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_it_is_short() -> None:
    code = [PARTS[name] for name in ("__init__.py", "document.py", "command.py")]
    lines = [line for part in code for line in part.splitlines() if line.strip()]
    assert len(lines) <= 60


def test_help_lists_it_and_imports_it_not(installed: Path, tmp_path: Path) -> None:
    said = run(installed, tmp_path, "--help")
    assert re.search(r"^  inertia +How hard is a robot to turn\?$", said, re.M)
    assert re.search(r"^  payload ", said, re.M)
    code = (
        "import sys; from pupper_analysis.cli import list_tools; "
        "print('inertia' in list_tools(), 'inertia_tool' in sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": f"{installed}{os.pathsep}{ROOT}"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.split() == ["True", "False"]


def test_it_has_options_a_page_json_and_markdown(installed: Path, tmp_path: Path) -> None:
    assert "about its base" in run(installed, tmp_path, "inertia", "--help")
    words = ("inertia", "v3", "--json", "inertia.json", "--report", "inertia.html")
    said = run(installed, tmp_path, *words, "--format", "markdown")
    moments = json.loads((tmp_path / "inertia.json").read_text())["moments"]
    assert len(moments) == 3
    assert 0 < moments[0] < moments[1] < moments[2] < moments[0] + moments[1]
    assert "Rotational inertia" in said
    assert f"| 3 | {moments[2]:.5f} |" in said
    page = (tmp_path / "inertia.html").read_text("utf-8")
    assert "Rotational inertia" in page
    assert "轴" in page  # and what has no Chinese is there in English


def test_a_format_from_outside_is_audited_and_compared(tmp_path: Path) -> None:
    package, about = tmp_path / "urdfz_format", tmp_path / "urdfz-1.0.dist-info"
    package.mkdir()
    (package / "__init__.py").touch()
    for name in ("format.toml", "reader.py"):
        (package / name).write_text(PARTS[name], encoding="utf-8")
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: urdfz\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[pupper_analysis.formats]\nurdfz = urdfz_format\n")
    sound = (ROOT / "urdf/pupper_v3.urdf").read_bytes()
    heavy = re.sub(rb'<mass value="[^"]*"', b'<mass value="-1"', sound, count=1)
    for name, text in (("sound", sound), ("heavy", heavy)):
        (tmp_path / f"{name}.urdfz").write_bytes(gzip.compress(text))
    mjcf = str(ROOT / "mjcf/pupper_v3.xml")
    run(tmp_path, tmp_path, "audit", "sound.urdfz")
    assert "AGREE" in run(tmp_path, tmp_path, "crosscheck", "sound.urdfz", mjcf)
    with pytest.raises(AssertionError, match="mass-not-positive"):
        run(tmp_path, tmp_path, "audit", "heavy.urdfz")
