"""The tree of a URDF and its edits, compared with Pinocchio's model of the written text."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from tests.support.robots import quadruped, urdf_text


@pytest.fixture
def tree() -> UrdfTree:
    return UrdfTree.of(urdf_text(quadruped()))


def build_pinocchio_model(tree: UrdfTree) -> pin.Model:
    """Return Pinocchio's model of the tree's text, with a free base."""
    return pin.buildModelFromXML(to_text(tree.root), pin.JointModelFreeFlyer())


def test_the_base_is_the_link_that_no_joint_moves(tree: UrdfTree) -> None:
    assert tree.base.name == "base"
    assert "base" not in tree.parent_joints
    assert len(tree.links) == len(tree.joints) + 1
    for name, joint in tree.joints.items():
        assert tree.parent_joints[joint.child].name == name
        assert name in [child_joint.name for child_joint in tree.child_joints[joint.parent]]


def test_links_on_fixed_joints_form_one_group(tree: UrdfTree) -> None:
    """Reference: the links of `quadruped()`; with all joints fixed the group is the whole robot."""
    assert tree.fixed_group("shank1") == ["shank1", "foot1"]
    assert set(tree.fixed_group("base")) == {"base"}
    leg = list(tree.subtree("thigh2"))
    assert leg[0] == "thigh2"
    assert set(leg) == {"thigh2", "shank2", "foot2"}
    tree.fix([joint.name for joint in tree.moving])
    assert set(tree.fixed_group("base")) == set(tree.links)


def test_chain_of_joints_ends_at_the_base_and_equals_pinocchio(tree: UrdfTree) -> None:
    """The product of the joint origins equals Pinocchio's frame placement at zero angles."""
    chain = list(tree.chain("foot3"))
    assert chain[0].child == "foot3"
    assert chain[-1].parent == "base"
    assert all(first.parent == second.child for first, second in itertools.pairwise(chain))
    placed = pin.SE3.Identity()
    for joint in reversed(chain):
        placed = placed * joint.origin
    model = build_pinocchio_model(tree)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    there = data.oMf[model.getFrameId("foot3")]
    np.testing.assert_allclose(placed.homogeneous, there.homogeneous, atol=1e-14)


def test_a_subtree_is_removed_with_its_joint(tree: UrdfTree) -> None:
    """Reference: total mass [kg] of Pinocchio's model, less the masses of the subtree."""
    mass = build_pinocchio_model(tree).inertias
    total = sum(inertia.mass for inertia in mass)
    part = sum(tree.links[name].mass or 0.0 for name in tree.subtree("thigh0"))
    tree.remove_subtree("thigh0")
    assert {"thigh0", "shank0", "foot0"}.isdisjoint(tree.links)
    assert all(joint.child in tree.links for joint in tree.joints.values())
    assert sum(inertia.mass for inertia in build_pinocchio_model(tree).inertias) == pytest.approx(
        total - part
    )


def test_added_link_adds_its_inertia_at_its_place(tree: UrdfTree) -> None:
    """Reference: Pinocchio's sum of spatial inertias, with the inertia moved to the place."""
    before = build_pinocchio_model(tree)
    mover = before.frames[before.getFrameId("shank2")].parentJoint
    weight = pin.Inertia(0.7, np.array([0.01, 0.02, 0.03]), np.diag([1e-3, 2e-3, 2.5e-3]))
    place = np.array([0.1, -0.2, 0.3])
    tree.add_link("rod", "shank2", "rod_held", place, weight)
    assert tree.parent_joints["rod"].is_fixed
    assert tree.links["rod"].mass == pytest.approx(0.7)
    after = build_pinocchio_model(tree)
    frame = before.frames[before.getFrameId("shank2")].placement * pin.SE3(np.eye(3), place)
    expected = before.inertias[mover] + frame.act(weight)
    assert after.inertias[mover].isApprox(expected, 1e-12)


def test_a_copy_is_independent_of_the_tree(tree: UrdfTree) -> None:
    other = tree.copy()
    other.remove_subtree("thigh0")
    other.fix(["hip1"])
    assert "thigh0" in tree.links
    assert tree.joints["hip1"].moves


def test_a_range_turns_a_continuous_joint_into_a_revolute_joint(tree: UrdfTree) -> None:
    """Reference: position limits [rad] of Pinocchio's model."""
    joint = tree.moving[0]
    joint.element.set("type", "continuous")
    joint.remove("limit")
    joint.set_range(-0.25, 0.5)
    model = build_pinocchio_model(tree)
    index = model.joints[model.getJointId(joint.name)].idx_q
    assert model.lowerPositionLimit[index] == pytest.approx(-0.25)
    assert model.upperPositionLimit[index] == pytest.approx(0.5)
