"""Tools, formats and readers of the guides, installed beside the package, work as those of the
package.
"""

from __future__ import annotations

import fnmatch
import gzip
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.repository import ROOT

PAGE = (ROOT / "docs/how-to/write-a-tool.md").read_text("utf-8")
PARTS = dict(re.findall(r"```(?:python|toml)\n# ([a-z_]+\.\w+)\n(.*?)```", PAGE, re.S))
CONTRACT = (ROOT / "docs/how-to/contract.md").read_text("utf-8")


def install(folder: Path, package: str, files: dict[str, str], stated: str) -> Path:
    """Write the files and entry points of a package as pip installs them."""
    (folder / package).mkdir()
    for name, text in ({"__init__.py": ""} | files).items():
        (folder / package / name).write_text(text, encoding="utf-8")
    about = folder / f"{package}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    ((group, points),) = tomllib.loads(stated)["project"]["entry-points"].items()
    lines = [f"[{group}]", *(f"{name} = {module}" for name, module in points.items())]
    (about / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the tool of the page."""
    stated = tomllib.loads(PARTS["pyproject.toml"])
    data = stated["tool"]["setuptools"]["package-data"]["inertia_tool"]
    files = {
        name: PARTS[name] for pattern in ("*.py", *data) for name in fnmatch.filter(PARTS, pattern)
    }
    return install(tmp_path_factory.mktemp("site"), "inertia_tool", files, PARTS["pyproject.toml"])


def run_command_with_packages(
    site: Path | None, folder: Path, *words: object, status: int = 0
) -> str:
    """Run a command with the packages of a folder installed; return the printed text."""
    paths = os.pathsep.join(str(path) for path in (site, ROOT) if path is not None)
    done = subprocess.run(
        [sys.executable, "-m", "pupper_analysis", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, "NO_COLOR": "1", "COLUMNS": "200"},
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == status, said
    return said


def test_example_tool_has_at_most_60_lines() -> None:
    code = [PARTS[name] for name in ("__init__.py", "document.py", "command.py")]
    lines = [line for part in code for line in part.splitlines() if line.strip()]
    assert len(lines) <= 60


def test_help_lists_an_installed_tool_without_importing_it(installed: Path, tmp_path: Path) -> None:
    said = run_command_with_packages(installed, tmp_path, "--help")
    assert re.search(r"^  inertia +Rotational inertia of a robot about its base\.$", said, re.M)
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


@pytest.mark.slow
def test_installed_tool_has_options_page_json_and_markdown(installed: Path, tmp_path: Path) -> None:
    """Moments of inertia satisfy the triangle inequality, and are printed with five digits."""
    assert "about its base" in run_command_with_packages(installed, tmp_path, "inertia", "--help")
    words = ("inertia", "v3", "--json", "inertia.json", "--report", "inertia.html")
    said = run_command_with_packages(installed, tmp_path, *words, "--format", "markdown")
    moments = json.loads((tmp_path / "inertia.json").read_text())["moments"]
    assert len(moments) == 3
    assert 0 < moments[0] < moments[1] < moments[2] < moments[0] + moments[1]
    assert "Rotational inertia" in said
    assert f"| 3 | {moments[2]:.5f} |" in said
    page = (tmp_path / "inertia.html").read_text("utf-8")
    assert "Rotational inertia" in page
    assert "轴" in page  # and what has no Chinese is there in English


@pytest.mark.slow
def test_format_of_another_package_is_audited_and_compared(tmp_path: Path) -> None:
    stated = '[project.entry-points."pupper_analysis.formats"]\nurdfz = "urdfz_format"'
    install(tmp_path, "urdfz_format", {n: PARTS[n] for n in ("format.toml", "reader.py")}, stated)
    sound = (ROOT / "urdf/pupper_v3.urdf").read_bytes()
    heavy = re.sub(rb'<mass value="[^"]*"', b'<mass value="-1"', sound, count=1)
    for name, text in (("sound", sound), ("heavy", heavy)):
        (tmp_path / f"{name}.urdfz").write_bytes(gzip.compress(text))
    mjcf = str(ROOT / "mjcf/pupper_v3.xml")
    run_command_with_packages(tmp_path, tmp_path, "audit", "sound.urdfz")
    assert "AGREE" in run_command_with_packages(
        tmp_path, tmp_path, "crosscheck", "sound.urdfz", mjcf
    )
    assert "mass-not-positive" in run_command_with_packages(
        tmp_path, tmp_path, "audit", "heavy.urdfz", status=1
    )


@pytest.mark.slow
def test_reader_of_the_guide_is_used_by_contract(tmp_path: Path) -> None:
    """With the reader, a file of limits is compared with the URDF; without, the file is of
    unknown kind."""
    reader = re.search(r"```python\n(# our_firmware/limits.py.*?)```", CONTRACT, re.S)
    project = re.search(r"```toml\n(\[project.entry-points.*?)```", CONTRACT, re.S)
    assert reader is not None
    assert project is not None
    assert len([line for line in reader[1].splitlines() if line.strip()]) <= 60
    site = tmp_path / "site"
    site.mkdir()
    install(site, "our_firmware", {"limits.py": reader[1]}, project[1])
    (tmp_path / "motors.limits").write_text("leg_front_r_1,3.0\nleg_front_r_2,4.5\n")
    words = ("contract", ROOT / "urdf/pupper_v3.urdf", "motors.limits", "--no-stand")
    said = run_command_with_packages(site, tmp_path, *words, status=1)
    assert "motors.limits:2" in said
    assert "leg_front_r_1" not in said
    assert re.search(r"effort of joint leg_front_r_2: 4.5 .* 3 N m", said)
    said = run_command_with_packages(None, tmp_path, *words, status=2)
    assert "motors.limits: unknown kind of file" in said


METRICS = """
def measure_margin(design):
    return float(design.stand.com_margin)


METRICS = {"own_margin": {"function": measure_margin, "unit": "m"}}
"""


@pytest.mark.slow
def test_a_metric_without_a_meaning_is_listed_by_its_name(tmp_path: Path) -> None:
    """``study --list-metrics`` ended in KeyError as soon as such a package was installed."""
    stated = tomllib.loads(PARTS["pyproject.toml"])
    data = stated["tool"]["setuptools"]["package-data"]["inertia_tool"]
    files = {
        name: PARTS[name] for pattern in ("*.py", *data) for name in fnmatch.filter(PARTS, pattern)
    }
    files |= {"metrics.py": METRICS}
    site = tmp_path / "site"
    site.mkdir()
    install(site, "inertia_tool", files, PARTS["pyproject.toml"])
    printed = run_command_with_packages(site, tmp_path, "study", "--list-metrics")
    assert re.search(r"own_margin\W+m\W+own_margin", printed)
    assert "com_margin" in printed
