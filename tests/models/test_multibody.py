"""Parameters of multibody models: conversions keep all values, and rotated frames are no
difference.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.robot.compare.differences import changes_between
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from tests.support.engines import to_pinocchio
from tests.support.robots import match_files, mjcf_text, quadruped, urdf_text, write
from tests.support.variants import load


def test_damping_and_armature_of_a_free_joint_are_kept(tmp_path: Path) -> None:
    """Reference: the values of the MJCF, and of all hinges, after the conversion to Pinocchio and
    back.
    """
    free = '<joint type="free" damping="0.5" armature="0.3"/>'
    text = mjcf_text(quadruped()).replace("<freejoint/>", free)
    robot = match_files(write(tmp_path, urdf_text(quadruped()), text)).robot
    model = pinocchio_from_mujoco(robot.mj_model)
    values = multibody.from_pinocchio(model, "base", robot.joint_names, {})
    assert (values.base_damping, values.base_armature) == (0.5, 0.3)
    again = to_pinocchio(values)
    np.testing.assert_array_equal(again.damping[:6], np.full(6, 0.5))
    np.testing.assert_array_equal(again.armature[:6], np.full(6, 0.3))
    assert again.armature[6:].tolist() == [0.01, 0.02] * 4


# ------------------------------------------------------------------------------------- alignment


def test_product_of_inertia_is_compared_with_the_largest_moment() -> None:
    """Products that are 0.9 and 1.1 times the tolerance of the largest moment; relative to a
    product near 0, rounding would be a difference."""
    (first, _), tolerances = kinematic_trees(load("v3")), Tolerances()
    name, body = next(iter(first.bodies.items()))
    for share, count in ((0.9, 0), (1.1, 1)):
        off = share * tolerances.inertia * np.abs(body.inertia).max()
        inertia = body.inertia + off * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
        bodies = {**first.bodies, name: replace(body, inertia=inertia)}
        found = list(changes_between(first, replace(first, bodies=bodies), tolerances))
        assert [change.kind for change in found] == ["inertia"] * count
