"""Round trips of public robots between the formats: each loss is reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.robots.test_real_robots import MJCF, URDF, file
from tests.support.round_trips import round_trip

URDFS = (
    "a1_description/urdf/a1", "go1_description/urdf/go1", "go2_description/urdf/go2",
    "solo_description/robots/solo12", "panda_description/urdf/panda",
    "ur_description/urdf/ur5_robot", "z1_description/urdf/z1", "xarm_description/urdf/xarm7",
    "bolt_description/robots/bolt", "kinova_description/robots/kinova",
)  # fmt: skip
MJCFS = ("go2", "aliengo", "mini_cheetah", "go1", "b2", "hyqreal1", "spot", "a2")


@pytest.mark.slow
@pytest.mark.parametrize("name", URDFS)
def test_urdf_round_trip_reports_each_loss(tmp_path: Path, name: str) -> None:
    """Reference: all numbers of the file before and after; `lost` are the differences without a
    report.
    """
    lost, count = round_trip(file(URDF, f"{name}.urdf"), tmp_path)
    assert count > 30
    assert not lost


@pytest.mark.slow
@pytest.mark.parametrize("name", MJCFS)
def test_mjcf_round_trip_reports_each_loss(tmp_path: Path, name: str) -> None:
    """Reference: all numbers of the file before and after; `lost` are the differences without a
    report.
    """
    lost, count = round_trip(file(MJCF, f"{name}/{name}.xml"), tmp_path)
    assert count > 100
    assert not lost
