"""What a robot stands on, in a URDF and an MJCF: where both can state it, it is compared."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity
from tests.support.repository import ROOT

FOOT = '"collision" type="sphere" size="0.01995"'


def edited(folder: Path, file: str, old: str, new: str) -> tuple[Path, Path]:
    """Returns v3's two files with one edit."""
    for name in ("urdf", "mjcf"):
        shutil.copytree(ROOT / name, folder / name)
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    return folder / "urdf/pupper_v3.urdf", folder / "mjcf/pupper_v3.xml"


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
    found = pa.compare_models(*edited(tmp_path, file, old, new))
    assert not found.agree
    assert [one.kind for one in found.differences] == ["collision"] * 4
    for one in found.differences:
        stated = {key: one.diagnostic.values[key] for key in ("lower", "higher")}
        message = stated["lower"] if lower > 0 else stated["higher"]
        assert isinstance(message, Quantity)
        assert message.value == pytest.approx(abs(lower), abs=1e-9)
        assert stated["higher" if lower > 0 else "lower"] is None
        assert one.urdf_place is not None
        assert one.mjcf_place is not None
        assert (
            "collision"
            in Path(one.urdf_place.rpartition(":")[0])
            .read_text()
            .splitlines()[int(one.urdf_place.rpartition(":")[2]) - 1]
        )


def test_a_foot_on_links_of_two_names_is_said_to_be_on_each(tmp_path: Path) -> None:
    """Its places are in two frames, as a URDF may have a link of its own for it."""
    files = edited(tmp_path, "mjcf/pupper_v3_body.xml", FOOT, FOOT.replace("0.01995", "0.02995"))
    own = files[0].read_text().replace('link="leg_front_l_3"', 'link="shank"')
    files[0].write_text(own.replace('<link name="leg_front_l_3"', '<link name="shank"'))
    found = pa.compare_models(*files)
    said = {
        one.element: (one.diagnostic.values["link"], one.diagnostic.values["body"])
        for one in found.differences
        if one.kind == "collision"
    }
    assert said.pop("leg_front_l_3") == ("shank", "leg_front_l_3")
    assert set(said.values()) == {(None, None)}
