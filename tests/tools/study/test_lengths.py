"""Links with scaled lengths, compared with variants and between both engines."""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.arrays import make_inertia
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.pupper.variants import get_variant_spec
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.design import Variants
from pupper_analysis.tools.study.lengths import find_stretch, stretch_inertia
from pupper_analysis.tools.study.parameters import scale_robot
from tests.support.legged import quadruped
from tests.support.random_legged import irregular_biped, write_robot
from tests.support.variants import load


def test_a_stretched_box_is_the_longer_box() -> None:
    """Reference: MuJoCo's mass and inertia of a rotated box of twice the length."""

    def weighed(half_length: float) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(
            f'<mujoco><worldbody><body><freejoint/><geom type="box" euler="20 -30 40" density="800"'
            f' size="0.02 0.03 {half_length}"/></body></worldbody></mujoco>'
        )

    def inertia(model: mujoco.MjModel) -> np.ndarray:
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[1])
        axes = rotation.reshape(3, 3)
        return axes @ np.diag(model.body_inertia[1]) @ axes.T

    short, long = weighed(0.1), weighed(0.2)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, short.geom_quat[0])
    data = mujoco.MjData(short)
    mujoco.mj_kinematics(short, data)
    along = data.geom_xmat[0].reshape(3, 3)[:, 2]
    matrix = np.eye(3) + np.outer(along, along)
    com = np.array([0.1, 0.2, 0.3])
    got = stretch_inertia(
        make_inertia(short.body_mass[1], com, inertia(short)), matrix, np.zeros(3), 2.0
    )
    assert got.mass == pytest.approx(long.body_mass[1], rel=1e-12)
    np.testing.assert_allclose(got.inertia, inertia(long), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.lever, com + along * (along @ com), rtol=1e-12)


def test_pupper_by_patterns_is_pupper_by_scale() -> None:
    """Reference: ``leg_scale``, which uses separate code with yourdfpy and MjSpec."""
    source = Variants(get_variant_spec("v3"))
    expected = source.robot({"leg_scale": 1.3})
    found = scale_robot(source.robot({}), {"length:*_2": 1.3, "length:*_3": 1.3})
    for name in ("body_mass", "body_pos", "body_ipos", "body_inertia", "site_pos", "key_qpos",
                 "geom_size", "geom_pos"):  # fmt: skip
        np.testing.assert_allclose(
            getattr(found.mj_model, name), getattr(expected.mj_model, name), atol=1e-12
        )
    for first, second in zip(found.pin_model.inertias, expected.pin_model.inertias, strict=True):
        np.testing.assert_allclose(
            first.toDynamicParameters(), second.toDynamicParameters(), atol=1e-12
        )
    for first, second in zip(
        found.pin_model.jointPlacements, expected.pin_model.jointPlacements, strict=True
    ):
        np.testing.assert_allclose(first.homogeneous, second.homogeneous, atol=1e-12)
    assert found.stand_height == pytest.approx(expected.stand_height, rel=1e-6)


@pytest.fixture(scope="module", params=["straight", "irregular"])
def own(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Load a quadruped with two links per leg, or a biped with five links per leg and rotated
    frames.
    """
    folder = tmp_path_factory.mktemp("own")
    straight = request.param == "straight"
    pair = quadruped(folder) if straight else write_robot(irregular_biped(7), folder)
    return pa.load_robot(pair.urdf, pair.mjcf)


def with_length(robot: Robot) -> list[str]:
    """Return the joints whose links have a length."""
    found = []
    for joint in robot.joint_names:
        with contextlib.suppress(pa.ConfigurationError):
            find_stretch(robot, joint, 1.0)
            found.append(joint)
    return found


def locate_link(robot: Robot, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of a joint's link by Pinocchio and by MuJoCo, at angles other than
    zero.
    """
    qpos = robot.make_qpos(np.linspace(-0.2, 0.3, robot.nu))
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    link = UrdfTree.of(robot.description.urdf).moved_links[joint]
    return Configuration(robot, qpos).frame_position(link), data.joint(joint).xanchor.copy()


@pytest.mark.slow
def test_scaled_link_lengths_are_equal_in_both_engines(own: Robot) -> None:
    """Links between two joints get longer by the factor, across the second joint's axis alone."""
    urdf = UrdfTree.of(own.description.urdf)
    upper = {
        joint: next(joint.name for joint in urdf.child_joints[link] if joint.moves)
        for joint, link in urdf.moved_links.items()
        if sum(child_joint.moves for child_joint in urdf.child_joints.get(link, ())) == 1
    }
    measurable = [joint for joint in with_length(own) if joint in upper][:2]
    found = {
        (joint, upper[joint]): scale_robot(own, {f"length:{joint}": 1.5}) for joint in measurable
    }
    assert len(found) == 2
    for (joint, end), longer in found.items():
        link = urdf.moved_links[joint]
        normal = urdf.joints[end].origin.rotation @ np.array(
            [float(word) for word in urdf.joints[end].element.find("axis").get("xyz").split()]
        )
        at = urdf.joints[end].origin.translation
        across = at - normal * (normal @ at) / (normal @ normal)
        moved = locate_link(longer, end)[0] - locate_link(own, end)[0]
        assert np.linalg.norm(moved) == pytest.approx(0.5 * np.linalg.norm(across), rel=1e-9)
        both = locate_link(longer, end)
        apart = both[0] - both[1]
        before = locate_link(own, end)[0] - locate_link(own, end)[1]
        np.testing.assert_allclose(apart, before, atol=1e-9)  # the files' frames stay as apart
        mass = own.mj_model.body_mass.sum()
        body = own.mj_model.body(own.mj_model.jnt_bodyid[own.mj_model.joint(joint).id])
        grown = longer.mj_model.body_mass.sum() - mass
        group = own.mj_model.body_weldid == own.mj_model.body_weldid[body.id]
        assert grown == pytest.approx(0.5 * own.mj_model.body_mass[group].sum(), rel=1e-9), link


@pytest.mark.slow
def test_engines_agree_on_a_stretched_robot(own: Robot) -> None:
    """Reference: MuJoCo's mass matrix at a random state; a CoM or inertia that is scaled in one
    file only would differ."""
    factors = {f"length:{joint}": 1.3 for joint in with_length(own)}
    assert len(factors) >= 4
    longer = scale_robot(own, factors)
    for robot in (own, longer):
        qpos = robot.make_qpos(np.random.default_rng(3).uniform(-0.3, 0.3, robot.nu))
        ours = Configuration(robot, qpos).mass_matrix()
        data = mujoco.MjData(robot.mj_model)
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(robot.mj_model, data)
        dense = np.zeros((robot.mj_model.nv, robot.mj_model.nv))
        mujoco.mj_fullM(robot.mj_model, data, dense)
        index = robot.mj_convention.qvel_index
        np.testing.assert_allclose(ours, dense[np.ix_(index, index)], atol=1e-9)
    assert longer.stand_height > own.stand_height


@pytest.mark.parametrize("factor", [0.0, -1.0, float("inf"), float("nan")])
def test_length_factor_that_is_not_positive_and_finite_is_refused(factor: float) -> None:
    with pytest.raises(pa.ConfigurationError):
        scale_robot(load("v3"), {"length:*": factor})


@pytest.mark.slow
@pytest.mark.parametrize(("pattern", "message"), [
    ("{base}", "has no length, since no joint moves the base"),
    ("nothing*", "nothing"),
])  # fmt: skip
def test_length_of_a_link_without_length_is_refused(own: Robot, pattern: str, message: str) -> None:
    with pytest.raises(pa.PupperAnalysisError, match=message):
        scale_robot(own, {f"length:{pattern.format(base=own.base)}": 1.2})
