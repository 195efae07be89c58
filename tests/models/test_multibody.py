"""Parameters of multibody models: conversions keep all values, and rotated frames are no
difference.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
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
from tests.support.engines import to_pinocchio
from tests.support.robots import (
    arm,
    change_part,
    compare_files,
    list_differences,
    match_files,
    mjcf_text,
    quadruped,
    turned_about,
    turned_frames,
    urdf_text,
    write,
)
from tests.support.states import random_state
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


def rebuild_by_tree(robot: pa.Robot) -> pa.Robot:
    """Return the robot with its URDF's model converted to a tree and back."""
    frames = {foot: foot for foot in robot.contact_frames}
    values = multibody.from_pinocchio(
        robot.pin_model, robot.base, robot.joint_names, robot.contact_frames
    )
    model = to_pinocchio(values)
    convention = PinocchioConvention.from_model(model, robot.joint_names)
    return replace(robot, pin_model=model, pin_convention=convention, contact_frames=frames)


@pytest.mark.parametrize("name", ["original", "v3"])
@pytest.mark.parametrize("fixed", [False, True], ids=["free", "fixed"])
def test_tree_of_a_pinocchio_model_has_its_dynamics(name: str, fixed: bool) -> None:
    """Reference: Pinocchio with the original model, at a random state."""
    robot = load(name, fixed_base=fixed)
    qpos, qvel = random_state(robot)
    first, second = (
        pa.Configuration(model, qpos, qvel) for model in (robot, rebuild_by_tree(robot))
    )
    force = np.linspace(-1, 1, robot.nv)
    pairs = [
        (first.mass_matrix(), second.mass_matrix()),
        (first.bias_forces(), second.bias_forces()),
        (first.gravity(), second.gravity()),
        (first.center_of_mass(), second.center_of_mass()),
        (first.forward_dynamics(force), second.forward_dynamics(force)),
        *zip(first.foot_positions().values(), second.foot_positions().values(), strict=True),
    ]
    for joint in robot.joint_names:
        pairs.append((first.joint_position(joint), second.joint_position(joint)))
        pairs.append((first.joint_axis(joint), second.joint_axis(joint)))
    for expected, found in pairs:
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * scale)


@pytest.mark.slow
def test_tree_keeps_limits_and_inertias_of_continuous_and_sliding_joints(tiny: pa.Robot) -> None:
    """Reference: each number of Pinocchio's model; a continuous joint has no position limits."""
    model, again = tiny.pin_model, rebuild_by_tree(tiny).pin_model
    assert set(again.names) - {"__free__"} == set(model.names) - {"root_joint"}
    for name in tiny.joint_names:
        first, second = model.getJointId(name), again.getJointId(name)
        old, new = model.joints[first], again.joints[second]
        assert model.inertias[first].isApprox(again.inertias[second], 1e-15)
        assert model.jointPlacements[first].isApprox(again.jointPlacements[second], 1e-15)
        for field in ("effortLimit", "velocityLimit", "armature", "damping", "friction"):
            assert getattr(model, field)[old.idx_v] == getattr(again, field)[new.idx_v], field
        limits = again.lowerPositionLimit[new.idx_q], again.upperPositionLimit[new.idx_q]
        if old.nq == 1:
            assert limits[0] == model.lowerPositionLimit[old.idx_q]
            assert limits[1] == model.upperPositionLimit[old.idx_q]
        else:
            assert limits == (-np.inf, np.inf)


# ------------------------------------------------------------------------------------- alignment


def test_random_frames_of_the_generator_keep_the_dynamics(tmp_path: Path) -> None:
    """Control of `turned_frames`: all frames below the base rotate by more than 0.1 rad. Mass
    matrix and bias forces of Pinocchio are unchanged.
    """
    files = write(tmp_path, urdf_text(quadruped()), mjcf_text(quadruped()))
    model = read_mjcf(files.mjcf).model
    files.mjcf.write_text(turned_frames(quadruped(), seed=1))
    turned = read_mjcf(files.mjcf).model
    for body in range(2, model.nbody):
        before, after = (
            Rotation.from_quat(compiled.body_quat[body], scalar_first=True)
            for compiled in (model, turned)
        )
        assert (before.inv() * after).magnitude() > 0.1
    first, second = pinocchio_from_mujoco(model), pinocchio_from_mujoco(turned)
    q = pin.integrate(first, pin.neutral(first), np.linspace(-1, 1, first.nv))
    v = np.linspace(1, -1, first.nv)
    for compute in (pin.crba, lambda *state: pin.nonLinearEffects(*state, v)):
        expected, found = (compute(model, model.createData(), q) for model in (first, second))
        np.testing.assert_allclose(found, expected, atol=1e-12)


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_rotated_frames_are_no_difference(tmp_path: Path, seed: int) -> None:
    """With the finest tolerances, for a quadruped, and an arm with slides and continuous joints."""
    for number, (parts, free) in enumerate(((quadruped(), True), (arm(), False))):
        folder = tmp_path / str(number)
        folder.mkdir()
        files = write(folder, urdf_text(parts), mjcf_text(parts, free=free))
        files.mjcf.write_text(turned_frames(parts, seed))
        comparison = compare_files(files, tolerances=Tolerances.fine())
        assert list_differences(comparison) == []
        assert comparison.agree
        deviations = dict(comparison.deviations)
        # Solving with the mass matrix magnifies rounding errors by its condition number.
        assert deviations.pop("forward dynamics") < 1e-13
        assert max(deviations.values()) < 1e-14


CHANGES: dict[str, tuple[str, dict[str, Any], tuple[str, str]]] = {
    "base mass": ("base", {"mass": 7.0}, ("mass", "base")),
    "inertia": (
        "thigh0",
        {"inertia": (0.008, 0.007, 0.003, 0.0, 1e-3, 0.0)},
        ("inertia", "hip0"),
    ),
    "position": ("thigh3", {"position": (-0.2, 0.13, 0.01)}, ("position", "hip3")),
    "position below": ("shank0", {"position": (0.0, 0.08, -0.25)}, ("position", "knee0")),
    "axis": ("shank2", {"axis": (0.0, 1.0, 0.2)}, ("axis", "knee2")),
    "reversed": ("thigh1", {"axis": (-1.0, 0.0, 0.0)}, ("axis", "hip1")),
    "lower": ("shank3", {"lower": -2.6}, ("lower limit", "knee3")),
}
"""{change: (link of the URDF, its new values, (kind, element) of the only difference)}."""


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_changed_number_is_the_only_difference_of_files_with_rotated_frames(
    tmp_path: Path, change: str
) -> None:
    """The difference explains all deviations: less than 1e-12 is left."""
    link, values, expected = CHANGES[change]
    files = write(tmp_path, urdf_text(change_part(quadruped(), link, **values)), "<mujoco/>")
    files.mjcf.write_text(turned_frames(quadruped(), 1))
    comparison = compare_files(files)
    assert list_differences(comparison) == [expected]
    assert comparison.complete
    assert max(comparison.residual.values()) < 1e-12


@pytest.mark.slow
def test_other_zero_angle_with_rotated_frames_is_explained_completely(tmp_path: Path) -> None:
    """The rotation about the axis cannot be distinguished from that of the frame."""
    part = quadruped()["shank1"]
    urdf = change_part(quadruped(), "shank1", quaternion=turned_about(part, part.axis, 0.2))
    files = write(tmp_path, urdf_text(urdf), "<mujoco/>")
    files.mjcf.write_text(turned_frames(quadruped(), 0))
    comparison = compare_files(files)
    assert not comparison.agree
    assert comparison.complete
    assert {element for _, element in list_differences(comparison)} <= {"knee1", "foot1"}


@pytest.mark.slow
def test_tree_has_the_parents_axes_and_limits_of_the_file(tiny: pa.Robot) -> None:
    """References: the numbers of the URDF of the robot."""
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
