"""The parameters of a model: nothing is lost on the way, and turned frames are no difference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.models import multibody
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.robot.compare.differences import changes_between
from pupper_analysis.robot.coordinates import PinocchioConvention
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from tests.support.cases import some
from tests.support.robots import (
    Parts,
    changed,
    compared,
    found,
    matched,
    mjcf_text,
    quadruped,
    turned_frames,
    urdf_text,
    write,
)
from tests.support.variants import load


def rebuilt(robot: pa.Robot) -> pa.Robot:
    """The robot with the URDF's model taken apart and put together again."""
    values = multibody.from_pinocchio(
        robot.pin_model, robot.base, robot.joint_names, robot.contact_frames
    )
    model = multibody.to_pinocchio(values)
    convention = PinocchioConvention.of(model, robot.joint_names)
    frames = {foot: foot for foot in robot.contact_frames}
    return replace(robot, pin_model=model, pin_convention=convention, contact_frames=frames)


def test_conversion_there_and_back_keeps_every_number_of_the_model(tiny: pa.Robot) -> None:
    """A continuous joint, a slide and branches: joints, limits and inertias as they were."""
    model, again = tiny.pin_model, rebuilt(tiny).pin_model
    assert set(again.names) - {"__free__"} == set(model.names) - {"root_joint"}
    for name in tiny.joint_names:
        one, two = model.getJointId(name), again.getJointId(name)
        a, b = model.joints[one], again.joints[two]
        assert model.inertias[one].isApprox(again.inertias[two], 1e-15)
        assert model.jointPlacements[one].isApprox(again.jointPlacements[two], 1e-15)
        for field in ("effortLimit", "velocityLimit", "armature", "damping", "friction"):
            assert getattr(model, field)[a.idx_v] == getattr(again, field)[b.idx_v], field
        if a.nq == 1:
            assert model.lowerPositionLimit[a.idx_q] == again.lowerPositionLimit[b.idx_q]
            assert model.upperPositionLimit[a.idx_q] == again.upperPositionLimit[b.idx_q]
        else:
            assert again.lowerPositionLimit[b.idx_q] == -np.inf
            assert again.upperPositionLimit[b.idx_q] == np.inf


def test_the_free_joints_own_damping_and_armature_are_kept(tmp_path: Path) -> None:
    free = '<joint type="free" damping="0.5" armature="0.3"/>'
    text = mjcf_text(quadruped()).replace("<freejoint/>", free)
    robot = matched(write(tmp_path, urdf_text(quadruped()), text)).robot
    model = pinocchio_from_mujoco(robot.mj_model)
    values = multibody.from_pinocchio(model, "base", robot.joint_names, {})
    assert (values.base_damping, values.base_armature) == (0.5, 0.3)
    again = multibody.to_pinocchio(values)
    np.testing.assert_array_equal(again.damping[:6], np.full(6, 0.5))
    np.testing.assert_array_equal(again.armature[:6], np.full(6, 0.3))
    assert again.armature[6:].tolist() == [0.01, 0.02] * 4


def test_joints_are_read_as_they_are_written(tiny: pa.Robot) -> None:
    values = multibody.from_pinocchio(tiny.pin_model, "base", tiny.joint_names, {"f": "foot"})
    turn, bend, push = (values.joints[name] for name in ("turn", "bend", "push"))
    assert (turn.parent, bend.parent, push.parent) == ("base", "turn", "base")
    assert (turn.slides, bend.slides, push.slides) == (False, False, True)
    assert (turn.lower, turn.upper) == (-np.inf, np.inf)
    assert (bend.lower, bend.upper, bend.effort, bend.velocity) == (-1, 2, 4, 9)
    np.testing.assert_allclose(turn.rotation, Rotation.from_euler("x", 0.3).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(bend.axis, (0, 1, 0))
    assert values.bodies["bend"].mass == pytest.approx(0.3)
    assert values.frames["f"][0] == "bend"
    np.testing.assert_allclose(values.frames["f"][1], (0, 0, -0.1))
    assert values.children("base") == ["push", "turn"]
    assert values.floating


# ------------------------------------------------------------------------------------- alignment


CHANGES: dict[str, tuple[str, dict[str, Any], tuple[str, str]]] = {
    "base mass": ("base", {"mass": 7.0}, ("mass", "base")),
    "mass": ("shank1", {"mass": 0.5}, ("mass", "knee1")),
    "com": ("thigh2", {"com": (0.01, 0.022, -0.06)}, ("com", "hip2")),
    "inertia": ("thigh0", {"inertia": (0.008, 0.007, 0.003, 0.0, 1e-3, 0.0)}, ("inertia", "hip0")),
    "position": ("thigh3", {"position": (-0.2, 0.13, 0.01)}, ("position", "hip3")),
    "position below": ("shank0", {"position": (0.0, 0.08, -0.25)}, ("position", "knee0")),
    "axis": ("shank2", {"axis": (0.0, 1.0, 0.2)}, ("axis", "knee2")),
    "reversed": ("thigh1", {"axis": (-1.0, 0.0, 0.0)}, ("axis", "hip1")),
    "lower": ("shank3", {"lower": -2.6}, ("lower limit", "knee3")),
    "damping": ("thigh0", {"damping": 0.7}, ("damping", "hip0")),
    "friction": ("thigh0", {"friction": 0.7}, ("friction", "hip0")),
    "effort": ("shank0", {"effort": 30.0}, ("effort", "knee0")),
}


def turned_pair(folder: Path, urdf: Parts, seed: int) -> Any:
    files = write(folder, urdf_text(urdf), mjcf_text(quadruped()))
    files.mjcf.write_text(turned_frames(read_mjcf(files.mjcf).model, seed))
    return compared(files)


@pytest.mark.parametrize("change", some(list(CHANGES), 3))
def test_one_number_changed_under_turned_frames_is_exactly_one_difference(
    tmp_path: Path, change: str
) -> None:
    link, values, expected = CHANGES[change]
    for seed in range(2):
        comparison = turned_pair(tmp_path, changed(quadruped(), link, **values), seed)
        assert found(comparison) == [expected]
        assert comparison.complete
        assert max(comparison.residual.values()) < 1e-12


def test_the_values_are_given_in_the_urdfs_frames(tmp_path: Path) -> None:
    """Though the MJCF's frames are turned, its com is shown where the URDF would have it."""
    comparison = turned_pair(tmp_path, changed(quadruped(), "shank1", com=(0.0, 0.0, -0.1)), 5)
    (difference,) = comparison.differences
    np.testing.assert_allclose(difference.urdf, (0.0, 0.0, -0.1), atol=1e-12)
    np.testing.assert_allclose(difference.mjcf, (0.004, 0.001, -0.12), atol=1e-12)


def test_a_product_of_inertia_is_judged_by_the_greatest_moment() -> None:
    """Not by itself: where it is almost 0, rounding would be a difference."""
    (first, _), tolerances = kinematic_trees(load("v3")), Tolerances()
    name, body = next(iter(first.bodies.items()))
    for share, count in ((0.9, 0), (1.1, 1)):
        off = share * tolerances.inertia * np.abs(body.inertia).max()
        inertia = body.inertia + off * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
        bodies = {**first.bodies, name: replace(body, inertia=inertia)}
        found = list(changes_between(first, replace(first, bodies=bodies), tolerances))
        assert [change.kind for change in found] == ["inertia"] * count
