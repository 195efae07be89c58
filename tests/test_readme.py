"""The README is true: its snippets run, its commands exist, its numbers are the program's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import pupper_analysis as pa

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("snippet", SNIPPETS, ids=range(len(SNIPPETS)))
def test_snippet_runs(snippet: str, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", snippet],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr


def test_there_are_snippets() -> None:
    assert len(SNIPPETS) >= 2


def test_links_and_scripts_exist() -> None:
    named = set(re.findall(r"\]\(((?!http)[^)#]+)\)", README))
    named |= set(re.findall(r"(scripts/\w+\.py)", README))
    for path in named:
        assert (ROOT / path).is_file(), path


def test_the_two_commands_are_targets() -> None:
    commands = re.findall(r"^    make (\w+)$", README, flags=re.MULTILINE)
    assert commands == ["analyze", "test"]
    makefile = (ROOT / "Makefile").read_text()
    for target in commands:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE)


def test_the_table_of_variants_is_true() -> None:
    rows = re.findall(r"^\| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| (.*) \|$", README, re.M)
    assert [row[0] for row in rows] == list(pa.VARIANTS)
    for name, mass, mass_ratio, thigh_ratio, rest in rows:
        robot = pa.load_variant(name)
        base = pa.load_variant(pa.VariantSpec(base=pa.VARIANTS[name].base))
        stand = pa.solve_stand(robot)
        statics = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
        peak, utilisation = rest.split(" | ")[:2]
        assert float(mass) == pytest.approx(robot.total_mass, abs=5e-4)
        assert float(mass_ratio) == pytest.approx(robot.total_mass / base.total_mass, abs=5e-4)
        assert float(thigh_ratio) == pa.VARIANTS[name].leg_scale
        assert float(peak) == pytest.approx(abs(statics.joint_torques).max(), abs=5e-4)
        assert float(utilisation.split()[0]) == pytest.approx(
            100 * statics.motor_utilisation.max(), abs=0.05
        )
