"""Tools that extend `check` by a key of a pair: `contract` compares the sources of a repository
with its models.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import Answer, answer
from tests.support.repository import ROOT
from tests.tools.contract.sources import DEPLOY, GYM

CONFIG = """\
fail-on = "warning"

[[pair]]
name = "v3"
urdf = "v3.urdf"
contract = ["gym_cfg.py:PupperCfg", "deploy.yaml"]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with a URDF, a trainer and a deployment that agree."""
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    (tmp_path / "v3.urdf").write_bytes((ROOT / "urdf/pupper_v3.urdf").read_bytes())
    (tmp_path / "gym_cfg.py").write_text(GYM)
    (tmp_path / "deploy.yaml").write_text(DEPLOY)
    (tmp_path / "pupper-analysis.toml").write_text(CONFIG)
    (tmp_path / "pupper-analysis-baseline.txt").write_text("")
    assert run(tmp_path, "--update-baseline").returncode == 0  # accepts the findings of the audit
    return tmp_path


def run(folder: Path, *arguments: str) -> Answer:
    return answer("check", *arguments, folder=folder)


def slip(folder: Path) -> int:
    """Write another kp of one joint into the deployment file; return its line."""
    text = DEPLOY.replace("stiffness: [5.0, 5.0, 5.0", "stiffness: [5.0, 5.0, 7.0")
    assert text != DEPLOY
    (folder / "deploy.yaml").write_text(text)
    return text[: text.index("stiffness:")].count("\n") + 1


def test_planted_mistake_fails_with_the_lines_of_both_files(folder: Path) -> None:
    line = slip(folder)
    done = run(folder, "--json", "check.json", "--format", "sarif")
    assert done.returncode == 1
    remarks = json.loads((folder / "check.json").read_text())["remarks"]
    (kp,) = [
        remark
        for remark in remarks
        if (remark["check"], remark["kind"]) == ("contract", "kp")
        and remark["element"] == "leg_front_r_3"
    ]
    assert kp["place"].rpartition("/")[2].startswith("gym_cfg.py:")
    assert kp["other_place"].rpartition("/")[2] == f"deploy.yaml:{line}"
    assert kp["fails"]
    results = json.loads(done.stdout)["runs"][0]["results"]
    found = {
        (result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"].rpartition("/")[2],
         result["locations"][0]["physicalLocation"]["region"]["startLine"])
        for result in results if result["ruleId"] == "contract/kp"
    }  # fmt: skip
    assert ("deploy.yaml", line) in found
    assert "gym_cfg.py" in {file for file, _ in found}


def test_contract_remarks_are_accepted_by_the_baseline(folder: Path) -> None:
    slip(folder)
    assert run(folder, "--update-baseline").returncode == 0
    assert "contract" in (folder / "pupper-analysis-baseline.txt").read_text()
    assert run(folder).returncode == 0
    text = (folder / "deploy.yaml").read_text()
    (folder / "deploy.yaml").write_text(text.replace("7.0", "8.0"))
    assert run(folder).returncode == 1


def test_a_source_that_cannot_be_read_fails_and_the_rest_is_checked(folder: Path) -> None:
    (folder / "deploy.yaml").write_text("a: [1,\n")
    done = run(folder)
    assert done.returncode == 1
    assert "invalid YAML" in done.stdout + done.stderr


def test_missing_contract_file_is_refused(folder: Path) -> None:
    (folder / "deploy.yaml").unlink()
    done = run(folder)
    assert done.returncode == 2
    assert "pupper-analysis.toml:6: contract =" in done.stdout + done.stderr
    assert "deploy.yaml" in done.stdout + done.stderr


@pytest.mark.slow
def test_contract_guard_imports_no_placo() -> None:
    code = (
        "import sys; import pupper_analysis.tools.contract.guard; "
        "print(any(one in sys.modules for one in ('placo', 'clarabel', 'matplotlib')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "False"


def test_agreeing_sources_pass(folder: Path) -> None:
    done = run(folder)
    assert done.returncode == 0, done.stdout + done.stderr
