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
from tests.support.robots import (
    change_part,
    compare_files,
    match_files,
    mjcf_text,
    quadruped,
    turned_frames,
    urdf_text,
    write,
)
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


def test_com_difference_is_stated_in_the_urdf_frame_of_a_turned_body(tmp_path: Path) -> None:
    """The frames of the MJCF are turned; both CoMs [m] are in the frame of the URDF's link."""
    urdf = change_part(quadruped(), "shank1", com=(0.0, 0.0, -0.1))
    files = write(tmp_path, urdf_text(urdf), mjcf_text(quadruped()))
    files.mjcf.write_text(turned_frames(quadruped(), 5))
    comparison = compare_files(files)
    (difference,) = comparison.differences
    np.testing.assert_allclose(difference.urdf, (0.0, 0.0, -0.1), atol=1e-12)
    np.testing.assert_allclose(difference.mjcf, (0.004, 0.001, -0.12), atol=1e-12)
