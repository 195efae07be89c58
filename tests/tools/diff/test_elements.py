"""What touches, options and keyframes of two versions: each change, its line, and what it does."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT

SHARED = "pupper_v3_shared.xml"
CONTACT = 'solimp="0.015 1 0.015"'


def edited(folder: Path, file: str, old: str, new: str) -> Path:
    """Returns v3's MJCF with one edit."""
    place = folder / "new"
    shutil.copytree(ROOT / "mjcf", place, ignore=shutil.ignore_patterns("*.md"))
    text = (place / file).read_text()
    assert old in text
    (place / file).write_text(text.replace(old, new))
    return place / "pupper_v3.xml"


def rest_height(file: Path) -> float:
    """Returns the height of the base after 2 s of bare MuJoCo from the keyframe."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
    return float(data.qpos[2])


FELT = {
    "conaffinity": (SHARED, 'conaffinity="1"', 'conaffinity="0"', 40),
    "shape": ("pupper_v3_body.xml", '"collision" type="sphere" size="0.01995"',
              '"collision" type="sphere" size="0.0399"', 23),
    "margin": (SHARED, CONTACT, CONTACT + ' margin="0.02"', 40),
    "solref": (SHARED, CONTACT, CONTACT + ' solref="0.3 1"', 40),
    "condim": (SHARED, 'condim="6"', 'condim="1"', 35),
    "impratio": (SHARED, 'impratio="100"', 'impratio="1"', 5),
    "cone": (SHARED, 'cone="elliptic"', 'cone="pyramidal"', 5),
    "timestep": (SHARED, 'timestep="0.002"', 'timestep="0.01"', 5),
}  # fmt: skip
HARMLESS = {
    "friction": (SHARED, 'friction="0.8', 'friction="0.3', 40),  # the floor's is 1, the larger
    "gap": (SHARED, CONTACT, CONTACT + ' gap="0.001"', 40),
}


@pytest.mark.parametrize("word", [*FELT, *HARMLESS])
def test_one_edit_is_one_change_with_its_line_and_what_mujoco_makes_of_it(
    tmp_path: Path, word: str
) -> None:
    file, old, new, line = (FELT | HARMLESS)[word]
    before, after = ROOT / "mjcf/pupper_v3.xml", edited(tmp_path, file, old, new)
    diff = pa.diff_models(before, after)
    assert not diff.same
    assert {str(change.diagnostic.values["what"] or change.element) for change in diff.changes} == {
        word
    }
    change = diff.changes[0]
    assert change.new_place.endswith(f"{file}:{line}")
    assert ("simulated motion" in change.effects) is (word in FELT)
    codes = {told.code for told in change.consequences}
    assert ("simulation-unchanged" in codes) is (word in HARMLESS)
    # The height it tells is the one that bare MuJoCo has.
    told = next((one for one in change.consequences if one.code == "simulation-changes"), None)
    rise = rest_height(after) - rest_height(before)
    if told is not None and word != "shape":  # left and right are one change each there
        stated = told.values["higher"] or told.values["lower"] or told.values["falls"]
        if stated is not None:
            assert float(stated.value) == pytest.approx(abs(rise), rel=0.01, abs=2e-3)  # of the com
            assert bool(told.values["higher"]) is (rise > 0)


def test_a_flag_and_a_keyframe(tmp_path: Path) -> None:
    flag = edited(tmp_path, SHARED, '-9.81"/>', '-9.81"><flag contact="disable"/></option>')
    (change,) = pa.diff_models(ROOT / "mjcf/pupper_v3.xml", flag).changes
    assert (change.kind, change.element, change.new) == ("flag", "contact", 0.0)
    assert change.consequences[0].values["falls"].value > 10


def test_shapes_of_a_urdf_that_touch_are_compared(tmp_path: Path) -> None:
    text = (ROOT / "urdf/pupper_v3.urdf").read_text()
    folder = tmp_path / "urdf"
    shutil.copytree(ROOT / "urdf", folder)
    shutil.copytree(ROOT / "mjcf/meshes", tmp_path / "mjcf/meshes")
    assert 'radius="0.01995"' in text
    (folder / "pupper_v3.urdf").write_text(text.replace('radius="0.01995"', 'radius="0.09"'))
    diff = pa.diff_models(ROOT / "urdf/pupper_v3.urdf", folder / "pupper_v3.urdf")
    feet = [
        name
        for change in diff.changes
        for name in (change.element, *change.diagnostic.values["others"])
    ]
    assert len(feet) == 4
    moved = [told for change in diff.changes for told in change.consequences]
    assert all(told.values["distance"].value == pytest.approx(0.09 - 0.01995) for told in moved)
