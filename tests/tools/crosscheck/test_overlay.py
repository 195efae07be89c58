"""Both files over each other: where they are, and what is marked."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.present.html.write import scene_of
from pupper_analysis.tools.crosscheck.document import OverlayScene
from tests.present.test_html import comparison, page_of, written
from tests.support.html_page import Page
from tests.support.repository import ROOT
from tests.support.variants import load


def test_the_overlay_marks_what_differs() -> None:
    page = page_of(comparison())
    drawn = next(json.loads(text) for text in page.strict.scripts if '"lines"' in text)
    names = [body["name"] for body in drawn["bodies"]]
    marked = {names[geom["body"]] for geom in drawn["geoms"] if geom["marked"]}
    assert marked == {"base_link"}
    values = {
        body["name"]: body["differences"] for body in drawn["bodies"] if "differences" in body
    }
    assert list(values) == ["base_link"]
    assert "mass 1.625 kg in the URDF" in values["base_link"]["en"]
    assert "质量在 URDF 中为 1.625 kg" in values["base_link"]["zh"]
    assert all(joint["differences"] == {"en": "", "zh": ""} for joint in drawn["joints"])


def test_the_two_files_lie_on_each_other(tmp_path: Path) -> None:
    """Pinocchio's joints of the URDF are on MuJoCo's axes of the MJCF, whose base is turned."""
    for folder in ("urdf", "mjcf"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    urdf, mjcf = tmp_path / "urdf" / "pupper_v3.urdf", tmp_path / "mjcf" / "pupper_v3.xml"
    turned = '<body name="base_link" quat="0.9 0 0 0.3"'
    mjcf.write_text(mjcf.read_text().replace('<body name="base_link"', turned))
    drawn = scene_of(OverlayScene(pa.compare_models(urdf, mjcf)))
    assert drawn is not None
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = np.array([line[1] for line in drawn["lines"]])
    assert len(ends) == 12
    for name in load("v3").joint_names:
        joint = model.joint(name).id
        away = ends - data.xanchor[joint]
        beside = np.linalg.norm(np.cross(away, data.xaxis[joint]), axis=1)
        assert beside.min() < 2e-5
    feet = [geom for geom in range(model.ngeom) if model.geom_type[geom] == 2]
    lowest = min(data.geom_xpos[foot][2] - model.geom_size[foot][0] for foot in feet)
    assert drawn["ground"][2] == pytest.approx(lowest, abs=2e-5)


def test_files_that_have_gone_are_not_drawn(tmp_path: Path) -> None:
    gone = replace(comparison(), mjcf=str(tmp_path / "gone.xml"))
    assert scene_of(OverlayScene(gone)) is None
    assert "The two files over each other" not in Page(written(gone)).shown()
