"""Names of variants are accepted in place of model files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.pupper.named_robots import find_model
from pupper_analysis.tools.contract.contract import read_contract
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
    with pytest.raises(pa.ConfigurationError, match="only to files, not to a variant"):
        pa.load_robot("v3", feet=["foot"])
    with pytest.raises(pa.VariantError, match=r"known variants: original, .* give a file"):
        pa.load_robot("v4")


@pytest.mark.parametrize("spec", ["v3", pa.pupper.VariantSpec("v3")])
def test_load_robot_refuses_a_variant_beside_another_model(spec: Any) -> None:
    """A variant has both models: each place of a second model is refused, also for variants."""
    for models, options in (
        ((spec, "v3"), {}),
        ((spec, "robot.urdf"), {}),
        ((), {"urdf": spec}),
        ((), {"mjcf": spec}),
        ((spec,), {"mjcf": "robot.xml"}),
    ):
        with pytest.raises(pa.ConfigurationError, match=r"is a variant.*give no other model"):
            pa.load_robot(*models, **options)
    with pytest.raises(pa.ConfigurationError, match="feet"):
        pa.load_robot(spec, feet=np.zeros(3))  # type: ignore[arg-type]


def test_file_takes_precedence_over_a_variant_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("v3").write_text("<html/>")
    with pytest.raises(pa.ModelError, match="root element is <html>"):
        pa.load_robot("v3")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "file"), [("v3", "pupper_v3"), ("long-leg", "long-leg")])
def test_audit_and_crosscheck_accept_the_name_of_a_variant(
    name: str, file: str, tmp_path: Path
) -> None:
    done = answer("audit", name, "--json", "audit.json", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[:2]] == ["OK", "OK"]
    results = json.loads((tmp_path / "audit.json").read_text())
    assert {f"{file}.urdf", f"{file}.xml"} <= set(results)
    done = answer("crosscheck", name, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("AGREE")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3-long-leg", "long-leg"])
def test_models_of_a_variant_equal_the_written_files(name: str, tmp_path: Path) -> None:
    """Reference: both files that ``write_variant`` writes, read by ``diff``."""
    for written, model_format in zip(
        pa.pupper.write_variant(name, tmp_path), ("urdf", "mjcf"), strict=True
    ):
        assert pa.diff_models(written, find_model(name, model_format)).same
        assert pa.diff_models(name, written).same


@pytest.mark.slow
def test_converted_variant_refers_to_existing_meshes(tmp_path: Path) -> None:
    """Reference: the file system, after the conversion of a variant that has no files."""
    for output in (tmp_path / "a.urdf", tmp_path / "a.xml"):
        done = answer("convert", "v3-long-leg", "-o", str(output), folder=tmp_path)
        assert done.returncode == 0, done.stderr
        meshes = re.findall(r"(?:filename|<mesh[^>]* file)=\"([^\"]+)\"", output.read_text())
        assert len(meshes) > 3
        assert all((tmp_path / mesh).is_file() for mesh in meshes)
        assert f"next: pupper-analysis stand {output}" in done.stdout


@pytest.mark.slow
def test_crosscheck_of_a_variant_and_a_file_names_a_next_command_that_runs(tmp_path: Path) -> None:
    """A variant and a file are two robots for ``stand``: the next command has the file alone."""
    pa.pupper.write_variant("v3", tmp_path)
    file = tmp_path / "mjcf" / "v3.xml"
    done = answer("crosscheck", str(file), "v3", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"next: pupper-analysis stand {file}\n" in done.stdout


@pytest.mark.slow
def test_differences_of_a_scaled_variant_are_located_by_its_name() -> None:
    """The model of a scaled variant has no file, and no lines."""
    changes = pa.diff_models("v3", "v3-heavy").changes
    assert {change.new_place for change in changes} == {"v3-heavy"}
    assert all("pupper_v3_body.xml:" in change.old_place for change in changes)


@pytest.mark.slow
def test_scaled_variant_is_compared_by_sync_but_never_written(tmp_path: Path) -> None:
    """Reference: the URDF of the variant with other efforts, and the file system."""
    assert pa.sync_models("v3").agree
    assert pa.sync_models("v3-heavy").agree
    urdf, _ = pa.pupper.write_variant("v3-heavy", tmp_path)
    other = tmp_path / "other.urdf"
    other.write_text(re.sub(r'effort="[^"]+"', 'effort="4"', urdf.read_text()))
    before = other.read_bytes()
    found = pa.sync_models(other, "v3-heavy")
    assert len(found.differences) == 12
    assert not found.written
    assert "tmp" not in "".join(d.mjcf_place for d in found.differences)
    with pytest.raises(pa.ConfigurationError, match="analyze VARIANT --write"):
        pa.sync_models(other, "v3-heavy", take="urdf")
    assert other.read_bytes() == before
    assert pa.sync_models(other, "v3-heavy", take="mjcf").written == (str(other),)
    assert pa.sync_models(other, "v3-heavy").agree
    with pytest.raises(pa.ConfigurationError, match="MJCF is missing"):
        pa.sync_models("robot.urdf")


@pytest.mark.slow
def test_contract_reads_the_files_of_a_scaled_variant(tmp_path: Path) -> None:
    """Reference: the contract of the written files: the same facts, lines and findings."""
    paths = pa.pupper.write_variant("v3-long-leg", tmp_path)
    gains = tmp_path / "deploy.yaml"
    names = "".join(f"    - {name}\n" for name in pa.load_robot("v3-long-leg").joint_names)
    gains.write_text(f"joint_names:\n{names}kps: [{', '.join(['7.0'] * 12)}]\n")
    expected = read_contract(*paths, gains, stand=False)
    found = read_contract("v3-long-leg", gains, stand=False)
    assert found.model == "v3-long-leg"
    assert len(found.findings) == len(expected.findings) > 0
    assert [(fact.quantity, fact.value) for fact in found.facts] == [
        (fact.quantity, fact.value) for fact in expected.facts
    ]
    assert [fact.place for fact in found.facts] == [
        fact.place.replace(f"{tmp_path.resolve()}/", "").replace(f"{tmp_path}/", "")
        if "deploy" not in fact.place
        else fact.place
        for fact in expected.facts
    ]
    assert sorted(source.path for source in found.sources) == sorted(
        [str(gains), "mjcf/v3-long-leg.xml", "urdf/v3-long-leg.urdf"]
    )


def test_contract_names_a_variant_by_the_name_that_was_given() -> None:
    """The next command is typed with this name, not with the path of the variant's file."""
    assert read_contract("v3", stand=False).model == "v3"


def test_crosscheck_of_one_file_names_the_missing_argument() -> None:
    done = answer("crosscheck", "robot.urdf")
    assert done.returncode == 2
    assert "argument MJCF is missing" in done.stderr


def test_variant_accepts_visuals_without_effect() -> None:
    """A variant has no mesh that must be converted."""
    for visuals in (True, False):
        assert pa.load_robot("v3", visuals=visuals).name == "v3"


def test_fixed_base_of_a_variant_is_a_truth_value() -> None:
    """The text "no" was read as True."""
    with pytest.raises(pa.ConfigurationError, match="fixed_base"):
        pa.load_robot("v3", fixed_base="no")  # type: ignore[arg-type]
