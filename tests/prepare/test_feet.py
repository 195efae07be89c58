"""Fits of contact points."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.prepare.contact_points import ContactPoint
from pupper_analysis.prepare.feet import Foot, have_contact_points_moved
from tests.support.legged import quadruped, rewrite_file


@pytest.mark.parametrize(
    ("name", "geom", "displacement", "moved"),
    [
        ("FL", 3, 0.0, False),
        ("FL", 3, 5e-7, False),
        ("FL", 3, 1e-5, True),
        ("FL", 4, 1e-5, False),
        ("FR", 3, 1e-5, False),
    ],
)
def test_contact_points_have_moved_if_the_same_points_are_displaced(
    name: str, geom: int, displacement: float, moved: bool
) -> None:
    """Other feet or geoms are no displacement; displacements up to 1 um are none either."""

    def foot(name: str, geom: int, x: float) -> Foot:
        return Foot(name, 2, (ContactPoint(geom, np.array([x, 0.0, 0.0]), 0.02),))

    assert (
        have_contact_points_moved([foot("FL", 3, 0.0)], [foot(name, geom, displacement)]) is moved
    )


def test_floor_without_contacts_is_no_ground_for_feet(tmp_path: Path) -> None:
    """In bare MuJoCo the robot falls through this floor. Loading ended in a ValueError."""
    path = quadruped(tmp_path, floor=True).mjcf
    rewrite_file(path, ('type="plane"', 'type="plane" contype="0" conaffinity="0"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    assert data.subtree_com[1][2] < -5.0
    with pytest.raises(ModelError, match="no feet"):
        pa.load_robot(mjcf=path, visuals=False)
