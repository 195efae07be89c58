"""The reader of the page on `contract`, built, installed beside the package by pip, is used."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support.repository import ROOT

PAGE = (ROOT / "docs/how-to/contract.md").read_text("utf-8")
READER = re.search(r"```python\n(# our_firmware/limits.py.*?)```", PAGE, re.S)
PROJECT = re.search(r"```toml\n(\[project.entry-points.*?)```", PAGE, re.S)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder into which pip installed the package's wheel."""
    assert READER is not None
    assert PROJECT is not None
    folder = tmp_path_factory.mktemp("firmware")
    wheel = folder / "our_firmware-1.0-py3-none-any.whl"
    about = "our_firmware-1.0.dist-info"
    ((group, points),) = tomllib.loads(PROJECT[1])["project"]["entry-points"].items()
    lines = [f"[{group}]", *(f"{name} = {module}" for name, module in points.items())]
    texts = {
        "our_firmware/__init__.py": "",
        "our_firmware/limits.py": READER[1],
        f"{about}/METADATA": "Metadata-Version: 2.1\nName: our_firmware\nVersion: 1.0\n",
        f"{about}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{about}/entry_points.txt": "\n".join(lines) + "\n",
    }
    with zipfile.ZipFile(wheel, "w") as file:
        for name, text in texts.items():
            file.writestr(name, text)
        file.writestr(f"{about}/RECORD", "".join(f"{name},,\n" for name in texts))
    target = folder / "site"
    words = [sys.executable, "-m", "pip", "install", "--no-index", "--no-deps", "--quiet",
             "--target", target, wheel]  # fmt: skip
    subprocess.run(words, check=True, capture_output=True, text=True)
    return target


def run(site: Path | None, folder: Path, *sources: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join(str(path) for path in (site, ROOT) if path is not None)
    return subprocess.run(
        [sys.executable, "-m", "pupper_analysis", "contract", ROOT / "urdf/pupper_v3.urdf",
         *sources, "--no-stand"],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, "NO_COLOR": "1", "COLUMNS": "200"},
        check=False,
    )  # fmt: skip


def test_it_is_short() -> None:
    assert READER is not None
    assert len([line for line in READER[1].splitlines() if line.strip()]) <= 60


def test_its_files_are_read_and_compared(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "motors.limits").write_text("leg_front_r_1,3.0\nleg_front_r_2,4.5\n")
    done = run(installed, tmp_path, "motors.limits")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "motors.limits:2" in done.stdout
    assert "leg_front_r_1" not in done.stdout
    assert re.search(r"effort of joint leg_front_r_2: 4.5 .* 3 N m", done.stdout)


def test_without_it_they_are_of_no_kind(tmp_path: Path) -> None:
    (tmp_path / "motors.limits").write_text("leg_front_r_1,3.0\n")
    done = run(None, tmp_path, "motors.limits")
    assert done.returncode == 2
    assert "motors.limits: it is of no kind that is read" in done.stderr
