"""Collision shapes of feet in URDF and MJCF are compared if both files specify them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity
from tests.support.legged import rewrite_file
from tests.support.repository import ROOT
from tests.support.robots import line_at

FOOT = '"collision" type="sphere" size="0.01995"'


def write_edited(folder: Path, file: str, old: str, new: str) -> tuple[Path, Path]:
    """Return v3's two files with one edit."""
    for name in ("urdf", "mjcf"):
        shutil.copytree(ROOT / name, folder / name)
    rewrite_file(folder / file, (old, new))
    return folder / "urdf/pupper_v3.urdf", folder / "mjcf/pupper_v3.xml"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "old", "new", "lower"),
    [
        ("mjcf/pupper_v3_body.xml", FOOT, FOOT.replace("0.01995", "0.02995"), 0.01),
        ("urdf/pupper_v3.urdf", '<sphere radius="0.01995"', '<sphere radius="0.09"', -0.07005),
    ],
)
def test_another_radius_is_a_difference_of_each_foot(
    tmp_path: Path, file: str, old: str, new: str, lower: float
) -> None:
    """Closed form: a foot with 10 mm more radius reaches 10 mm lower; one with 0.09 m in the URDF
    70.05 mm lower there. Values in m, and both files' lines.
    """
    files = write_edited(tmp_path, file, old, new)
    found = pa.compare_models(*files)
    assert not found.agree
    assert [difference.kind for difference in found.differences] == ["collision"] * 4
    for difference in found.differences:
        stated = {key: difference.diagnostic.values[key] for key in ("lower", "higher")}
        message = stated["lower"] if lower > 0 else stated["higher"]
        assert isinstance(message, Quantity)
        assert message.value == pytest.approx(abs(lower), abs=1e-9)
        assert stated["higher" if lower > 0 else "lower"] is None
        places = {"pupper_v3.urdf": files[0], "pupper_v3.xml": files[1]}
        assert "collision" in line_at(difference.urdf_place, places)
        assert difference.mjcf_place is not None


def test_feet_without_contact_in_one_file_are_differences(tmp_path: Path) -> None:
    """With ``conaffinity`` 0 MuJoCo tests no geom of the MJCF against the floor."""
    files = write_edited(
        tmp_path, "mjcf/pupper_v3_shared.xml", 'conaffinity="1"', 'conaffinity="0"'
    )
    found = pa.compare_models(*files)
    assert not found.agree
    codes = [difference.diagnostic.code for difference in found.differences]
    assert codes == ["foot-touches-in-one-file"] * 4


def test_foot_excluded_from_the_world_is_a_difference(tmp_path: Path) -> None:
    """Its contact bits are unchanged; MuJoCo lets the excluded body through the floor."""
    exclude = '<contact><exclude body1="leg_front_l_3" body2="world"/></contact></mujoco>'
    found = pa.compare_models(*write_edited(tmp_path, "mjcf/pupper_v3.xml", "</mujoco>", exclude))
    (difference,) = found.differences
    assert difference.diagnostic.code == "foot-touches-in-one-file"


@pytest.mark.slow
def test_equal_feet_agree() -> None:
    found = pa.compare_models(ROOT / "urdf/pupper_v3.urdf", ROOT / "mjcf/pupper_v3.xml")
    assert found.agree
    assert not [note for note in found.notes if note.code.startswith("collisions")]
