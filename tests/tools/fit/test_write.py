"""Files that a fit writes are read by both engines and by studies, and are written completely or
not at all.
"""

from __future__ import annotations

import csv
import errno
import json
import math
import shutil
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base import files
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.parameters import Parameter
from pupper_analysis.tools.fit.write import FitFiles, draw_samples, write_fit
from pupper_analysis.tools.study.parameters import scale_robot, with_gains
from tests.support.repository import ROOT

JOINT = "leg_front_r_2"

WANTED = {  # parameter: stated, estimate, standard deviation; and what is written of it
    ("mass", "base_link", ""): (1.506, 1.88251, 0.02, 1.8825),
    ("com", "base_link", "x"): (0.025, 0.0371234, 0.001, 0.03712),
    ("com", "leg_front_r_3", "z"): (0.01833, 0.01833 + 1e-7, 0.002, 0.01833),
    ("kp", JOINT, ""): (5.0, 6.123, 0.1, 6.123),
    ("friction", JOINT, ""): (0.01, 0.0432, 0.001, 0.0432),
    ("offset", JOINT, ""): (0.0, -0.02, 0.001, -0.02),
    ("offset", "leg_back_l_1", ""): (0.0, 0.035, 0.002, 0.035),
    ("slope", "floor", "x"): (0.0, 0.001, 0.002, 0.001),
}


@pytest.fixture(scope="module")
def v3() -> pa.Robot:
    return pa.load_variant("v3")


def make_posterior(mass: float = 1.88251) -> Posterior:
    parameters = tuple(Parameter(*name, row[0], 0.5) for name, row in WANTED.items())
    mean = np.array([row[1] for row in WANTED.values()])
    mean[0] = mass
    std = np.array([row[2] for row in WANTED.values()])
    n = len(mean)
    return Posterior(parameters, mean, np.diag(std**2), np.eye(n), np.eye(n), 0.0, 0.0, 0)


@pytest.fixture(scope="module")
def written(v3: pa.Robot, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FitFiles]:
    folder = tmp_path_factory.mktemp("fitted")
    return folder, write_fit(v3, make_posterior(), folder, fit={"stands": 30})


def test_written_models_have_the_significant_digits_of_the_estimates(
    written: tuple[Path, FitFiles], v3: pa.Robot
) -> None:
    """References: mass [kg], CoM [m], kp and friction in Pinocchio's and MuJoCo's models of the
    files.
    """
    folder, made = written
    np.testing.assert_allclose(made.vector, [row[3] for row in WANTED.values()], atol=1e-12)
    urdf, mjcf = folder / "urdf" / "pupper_v3.urdf", folder / "mjcf" / "pupper_v3.xml"
    model = pin.buildModelFromXML(urdf.read_text(), pin.JointModelFreeFlyer())
    assert model.inertias[1].mass == pytest.approx(1.8825, abs=1e-12)
    np.testing.assert_allclose(model.inertias[1].lever, (0.03712, 0.0, 0.015), atol=1e-12)
    ratio = model.inertias[1].inertia / v3.pin_model.inertias[1].inertia.clip(1e-300)
    assert ratio[2, 2] == pytest.approx(1.8825 / 1.506)
    other = mujoco.MjModel.from_xml_path(str(mjcf))
    assert other.body_mass.sum() - v3.mj_model.body_mass.sum() == pytest.approx(1.8825 - 1.506)
    np.testing.assert_allclose(other.body("base_link").ipos, (0.03712, 0.0, 0.015), atol=1e-12)
    actuator = int(np.flatnonzero(other.actuator_trnid[:, 0] == other.joint(JOINT).id)[0])
    assert other.actuator_biasprm[actuator, 1] == -6.123
    assert other.dof_frictionloss[other.joint(JOINT).dofadr[0]] == 0.0432
    changed = {edit.element.split(" > ")[0] for edit in made.models.edits}
    assert not any("leg_front_r_3" in name for name in changed)  # it has not moved


def test_samples_have_the_covariance_of_the_posterior(written: tuple[Path, FitFiles]) -> None:
    """A sum that is known to 0.5 % has that width in the samples, although each mass is known to 50
    %. A link without mass has no column."""
    folder, _ = written
    first, names, *rows = (folder / "samples.csv").read_text().splitlines()
    assert first.startswith("# Samples of a fitted robot.")
    assert "mass:base_link" in names.split(",")
    assert len(rows) == 512
    table = np.array([row.split(",") for row in rows], dtype=float)
    mass = table[:, names.split(",").index("mass:base_link")]
    assert mass.std() == pytest.approx(0.02 / 1.8825, rel=0.1)
    assert mass.mean() == pytest.approx(1.0, abs=2e-3)
    # Two links of 50 % each, whose sum is known to 0.5 %.
    parameters = tuple(Parameter("mass", name, "", 1.0, 0.5) for name in ("one", "other"))
    covariance = 0.25 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1.25e-5
    mean, n = np.array([1.0, 1.0]), np.eye(2)
    narrow = Posterior(parameters, mean, covariance, n, n, 0.0, 0.0, 0)
    _, drawn = draw_samples(narrow, mean, 2000)
    assert drawn.min() > 0
    assert drawn[:, 0].std() > 0.4
    assert drawn.sum(axis=1).std() == pytest.approx(math.sqrt(4 * 1.25e-5), rel=0.1)
    assert drawn.sum(axis=1).mean() == pytest.approx(2.0, abs=1e-3)


def test_offsets_and_parameters_are_written(written: tuple[Path, FitFiles]) -> None:
    folder, _ = written
    with (folder / "offsets.csv").open() as file:
        rows = {row["joint"]: row for row in csv.DictReader(file)}
    assert float(rows[JOINT]["offset_rad"]) == -0.02
    assert float(rows["leg_back_l_1"]["offset_deg"]) == pytest.approx(2.0053523, rel=1e-6)
    content = json.loads((folder / "fit.json").read_text())
    assert content["fit"] == {"stands": 30}
    mass = content["parameters"][0]
    assert (mass["name"], mass["written"]) == ("mass base_link", 1.8825)
    assert mass["high"] - mass["mean"] == pytest.approx(1.96 * 0.02, rel=1e-3)


def test_samples_are_factors_of_a_study(written: tuple[Path, FitFiles], v3: pa.Robot) -> None:
    """Total mass [kg] of the robot that is scaled by one sample."""
    folder, _ = written
    _, names, row, *_ = csv.reader((folder / "samples.csv").read_text().splitlines())
    drawn = dict(zip(names, map(float, row), strict=True))
    gains = {name: value for name, value in drawn.items() if name.startswith("kp")}
    assert f"frictionloss:{JOINT}" in drawn
    other = scale_robot(v3, {name: value for name, value in drawn.items() if name not in gains})
    assert other.total_mass - v3.total_mass == pytest.approx(1.506 * (drawn["mass:base_link"] - 1))
    assert with_gains(v3, None, None, gains) is not v3


def test_no_file_is_left_if_one_cannot_be_written(v3: pa.Robot, tmp_path: Path) -> None:
    (tmp_path / "samples.csv").mkdir()
    with pytest.raises(pa.OutputError):
        write_fit(v3, make_posterior(), tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.slow
def test_fit_overwrites_its_own_models_unless_edited(v3: pa.Robot, tmp_path: Path) -> None:
    urdf = tmp_path / "urdf" / "pupper_v3.urdf"
    write_fit(v3, make_posterior(), tmp_path)
    first = urdf.read_bytes()
    write_fit(v3, make_posterior(mass=1.8), tmp_path)
    second = urdf.read_bytes()
    assert first != second
    edited = second.replace(b"<robot", b"<!-- mine --><robot", 1)
    urdf.write_bytes(edited)
    before = (tmp_path / "fit.json").read_bytes()
    with pytest.raises(pa.OutputError, match="not a model of a fit"):
        write_fit(v3, make_posterior(), tmp_path)
    assert (urdf.read_bytes(), (tmp_path / "fit.json").read_bytes()) == (edited, before)
    write_fit(v3, make_posterior(), tmp_path, force=True)
    assert urdf.read_bytes() == first


@pytest.mark.slow
def test_fit_never_overwrites_the_source_files(tmp_path: Path) -> None:
    for name in ("urdf", "mjcf"):
        shutil.copytree(ROOT / name, tmp_path / name)
    robot = pa.load_robot(tmp_path / "urdf/pupper_v3.urdf", tmp_path / "mjcf/pupper_v3.xml")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(pa.OutputError, match="an input of this run"):
        write_fit(robot, make_posterior(), tmp_path, force=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_full_disk_leaves_no_file(
    v3: pa.Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, written = files.write_new, list[Path]()

    def full(path: Path, data: bytes, **how: Any) -> None:
        written.append(path)
        real(path, data[:100], **how)
        if len(written) > 3:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "write_new", full)
    with pytest.raises(pa.OutputError, match="No space left"):
        write_fit(v3, make_posterior(), tmp_path)
    assert len(written) == 4
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
