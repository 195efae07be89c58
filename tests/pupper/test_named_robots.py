"""Names of variants are accepted in place of model files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.pupper.named_robots import variant_model_files
from tests.support.commands import answer


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "v3-heavy"])
def test_load_robot_accepts_the_name_of_a_variant(name: str) -> None:
    """Reference: mass [kg], feet and initial configuration of ``load_variant``."""
    robot, expected = pa.load_robot(name, fixed_base=True), pa.load_variant(name, fixed_base=True)
    assert robot.name == name
    assert robot.total_mass == expected.total_mass
    assert [*robot.feet] == [*expected.feet]
    assert np.array_equal(robot.mj_model.qpos0, expected.mj_model.qpos0)


def test_load_robot_refuses_options_of_files_for_a_variant() -> None:
    with pytest.raises(pa.ConfigurationError, match="robot of your own"):
        pa.load_robot("v3", feet=["foot"])
    with pytest.raises(pa.ModelError, match="no such file"):
        pa.load_robot("v4")


def test_file_takes_precedence_over_a_variant_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("v3").write_text("<html/>")
    with pytest.raises(pa.ModelError, match="root element is <html>"):
        pa.load_robot("v3")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "long-leg"])
def test_audit_and_crosscheck_accept_the_name_of_a_variant(name: str, tmp_path: Path) -> None:
    """Temporary files of a scaled variant are removed afterwards."""
    done = answer("audit", name, "--json", "audit.json", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[:2]] == ["OK", "OK"]
    results = json.loads((tmp_path / "audit.json").read_text())
    with variant_model_files(name) as files:
        assert {file.name for file in files} <= set(results)
    own = name == "v3"  # a base model has files; those of a scaled one are gone again
    assert [file.exists() for file in files] == [own, own]
    done = answer("crosscheck", name, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("AGREE")


def test_crosscheck_of_one_file_names_the_missing_argument() -> None:
    done = answer("crosscheck", "robot.urdf")
    assert done.returncode == 2
    assert "argument MJCF is missing" in done.stderr


def test_variant_accepts_visuals_without_effect() -> None:
    """A variant has no mesh that must be converted."""
    for visuals in (True, False):
        assert pa.load_robot("v3", visuals=visuals).name == "v3"
