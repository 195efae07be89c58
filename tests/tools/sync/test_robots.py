"""Published pairs of files are made to agree, in both directions."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compare.compare import compare_files
from pupper_analysis.robot.matching.tolerances import Tolerances
from tests.robots.test_real_robots import MJCF, URDF, file

PAIRS = {
    "mini_cheetah": (
        (MJCF, "mini_cheetah/mini_cheetah.urdf"),
        (MJCF, "mini_cheetah/mini_cheetah.xml"),
    ),
    "hyqreal1": ((MJCF, "hyqreal1/hyqreal1.urdf"), (MJCF, "hyqreal1/hyqreal1.xml")),
    "go1": ((URDF, "go1_description/urdf/go1.urdf"), (MJCF, "go1/go1.xml")),
}


UNWRITTEN = {
    ("go1", "urdf"): ("collision-unwritten", 4),
    ("go1", "mjcf"): ("collision-unwritten", 4),
    ("mini_cheetah", "urdf"): ("stated-in-one-file", 12),
}
"""{(robot, side): why so many differences are left}: Go1's feet have 20 mm in one file, 23 in the
other, and shapes are not written; Mini Cheetah's URDF states no efforts."""


@pytest.mark.slow
@pytest.mark.parametrize("side", ["urdf", "mjcf"])
@pytest.mark.parametrize("robot", PAIRS)
def test_published_files_are_made_to_agree(robot: str, side: str, tmp_path: Path) -> None:
    """Reference: comparison with strict tolerances; a second run changes nothing."""
    urdf, mjcf = (file(*place) for place in PAIRS[robot])
    shutil.copytree(mjcf.parent, tmp_path / "mjcf")
    files = shutil.copy(urdf, tmp_path), tmp_path / "mjcf" / mjcf.name
    result = pa.sync_models(*files, take=side, tolerances=Tolerances.fine())
    assert len(result.differences) > 25
    reason, count = UNWRITTEN.get((robot, side), ("", 0))
    assert [remaining.reason.code for remaining in result.not_mended] == [reason] * count
    compared = compare_files(*files, tolerances=Tolerances.strict()).result
    assert compared.agree is (not count)
    left = {f"{difference.element}: {difference.kind}" for difference in compared.differences}
    assert left == {remaining.difference.removeprefix("joint ") for remaining in result.not_mended}
    assert max(compared.deviations.values()) < 1e-9
    # Lines without a number that is written are the same lines.
    for old, new in zip((urdf, mjcf), files, strict=True):
        kept = [line for line in Path(new).read_bytes().splitlines() if b'="' not in line]
        assert kept == [line for line in old.read_bytes().splitlines() if b'="' not in line]
    again = pa.sync_models(*files, take=side, tolerances=Tolerances.fine())
    assert (again.edits, again.agree) == ((), not count)
