"""Edits of an MJCF's bodies, compared with the model that MuJoCo compiles."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.spec_tree import SpecTree, delete_joint, set_inertia

MJCF = """<mujoco><worldbody><body name="base"><freejoint/>
  <inertial pos="0.1 0.2 0.3" mass="2" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
  <body name="arm" pos="0 0 1"><joint name="j"/>
    <geom type="box" size="0.1 0.2 0.3" pos="0.05 0 0" density="500"/>
    <geom type="sphere" size="0.1" pos="0 0.1 0" mass="3"/>
    <body name="tip" pos="1 0 0"><geom type="sphere" size="0.05"/></body>
  </body></body></worldbody></mujoco>"""


def tree() -> SpecTree:
    return SpecTree(mujoco.MjSpec.from_string(MJCF))


def test_inertia_is_read_again_after_an_edit() -> None:
    edited = tree()
    before = edited.read_inertia("base")
    edited.scale_inertia("base", 2.0)
    np.testing.assert_allclose(edited.read_inertia("base").inertia, 2 * before.inertia, rtol=1e-9)
    offset = np.array([0.01, 0.0, 0.0])
    edited.move_com("base", offset)
    np.testing.assert_allclose(edited.read_inertia("base").lever, before.lever + offset)


def test_scaling_an_inertia_from_geoms_raises() -> None:
    with pytest.raises(ValueError, match="arm"):
        tree().scale_inertia("arm", 2.0)


@pytest.mark.parametrize(
    "stated",
    [
        'diaginertia="1 1.2 1.3" euler="30 40 50"',
        'fullinertia="1 1.2 1.3 0.1 0.05 0.02"',
        'diaginertia="1 1 1"',
    ],
)
@pytest.mark.parametrize("products", [0.0, 0.001])
def test_new_inertia_replaces_each_form_of_the_old_one(stated: str, products: float) -> None:
    """Reference: inertia compiled by MuJoCo, which a remaining orientation would rotate."""
    tensor = np.array([[0.02, products, 0.0], [products, 0.03, 0.0], [0.0, 0.0, 0.04]])
    inertial = f'<inertial pos="1 1 1" mass="1" {stated}/>'
    body = f'<body name="a"><freejoint/>{inertial}</body>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    set_inertia(spec.body("a"), pin.Inertia(2.0, np.array([0.1, 0.0, 0.2]), tensor))
    model, turn = spec.compile(), np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    made = axes @ np.diag(model.body_inertia[1]) @ axes.T
    np.testing.assert_allclose(made, tensor, atol=1e-15)
    np.testing.assert_allclose(model.body_ipos[1], [0.1, 0.0, 0.2])


@pytest.mark.parametrize(("angle", "ref"), [("radian", 0.1), ("degree", 20.0)])
def test_coupled_joints_stay_on_their_line_in_a_simulation(angle: str, ref: float) -> None:
    """Reference: q2 = 0.25 - 0.5 q1 in MuJoCo after 0.6 s; ``ref`` of q2 is in rad or degrees."""
    rod = '<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02"/>'
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><compiler angle="{angle}"/><worldbody><body><joint name="q1" axis="0 1 0"/>{rod}'
        f'<body pos="0 0 -.1"><joint name="q2" axis="0 1 0" ref="{ref}"/>{rod}</body></body>'
        "</worldbody></mujoco>"
    )
    SpecTree(spec).add_coupling("q2", "q1", -0.5, 0.25)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.8, 0.25 - 0.5 * 0.8
    for _ in range(300):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[0] - 0.8) > 0.01
    assert data.qpos[1] == pytest.approx(0.25 - 0.5 * data.qpos[0], abs=1e-3)


def test_spec_tree_has_the_structure_of_the_model() -> None:
    one = tree()
    assert tuple(one.names) == ("base", "arm", "tip")
    assert [one.parent(name) for name in one.names] == [None, "base", "arm"]
    assert [one.movers(name) for name in one.names] == [(), ("j",), ()]
    assert one.fixed_group("arm") == [*one.subtree("arm")] == ["arm", "tip"]
    assert one.moved_by("j") == "arm"
    assert one.moved_by("k") is None


@pytest.mark.parametrize("name", ["base", "arm"])
def test_scaled_mass_scales_the_inertia_and_keeps_the_com(name: str) -> None:
    """Reference: MuJoCo's compiled bodies; the base states its mass, the arm has it from geoms."""
    before, one = tree().spec.compile(), tree()
    one.scale_mass(name, 1.5)
    after, body = one.spec.compile(), before.body(name).id
    assert after.body_mass[body] == pytest.approx(1.5 * before.body_mass[body], rel=1e-12)
    np.testing.assert_allclose(after.body_inertia[body], 1.5 * before.body_inertia[body])
    np.testing.assert_allclose(after.body_ipos[body], before.body_ipos[body], atol=1e-12)
    assert one.link_mass(name) == pytest.approx(1.5 * tree().link_mass(name))


@pytest.mark.parametrize("name", ["base", "arm"])
def test_moved_com_keeps_mass_and_inertia(name: str) -> None:
    """Reference: MuJoCo's compiled bodies."""
    before, one, offset = tree().spec.compile(), tree(), np.array([0.01, -0.02, 0.03])
    one.move_com(name, offset)
    after, body = one.spec.compile(), before.body(name).id
    moved = after.body_ipos[body] - before.body_ipos[body]
    np.testing.assert_allclose(moved, offset, atol=1e-12)
    np.testing.assert_allclose(after.body_mass, before.body_mass, rtol=1e-12)
    np.testing.assert_allclose(after.body_inertia, before.body_inertia, rtol=1e-9)


def test_added_link_has_the_given_inertia() -> None:
    """Reference: the tensor of the compiled body, from its principal moments and axes."""
    tensor = np.array([[2.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 4.0]])
    inertia = pin.Inertia(0.5, np.array([0.1, 0.0, 0.2]), tensor)
    one = tree()
    one.add_link("load", "arm", "weld", np.array([0.0, 0.5, 0.0]), inertia)
    model = one.spec.compile()
    body, turn = model.body("load"), np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, tensor, atol=1e-9)
    np.testing.assert_allclose(body.ipos, inertia.lever)
    assert (body.mass[0], model.body("arm").id) == (0.5, int(body.parentid[0]))


def test_subtree_is_removed_with_its_joints() -> None:
    one = tree()
    one.remove_subtree("arm")
    assert tuple(one.names) == ("base",)
    assert one.spec.compile().njnt == 1


NAMESAKES = """<mujoco><worldbody><site name="hook" pos="0 0 1"/><body name="lone" pos="1 0 0">
  <freejoint/><geom size="0.1"/><site name="knee"/></body><body name="knee"><joint name="knee"/>
  <geom size="0.1"/><site name="eye"/><body><joint name="ankle"/><geom size="0.1"/></body></body>
  </worldbody><tendon><spatial name="knee"><site site="hook"/><site site="eye"/></spatial></tendon>
  <actuator><motor name="at joint" joint="knee" forcerange="-2 2" ctrlrange="-2 2"/>
  <motor name="in parent" jointinparent="knee" forcerange="-3 3"/>
  <motor name="at tendon" tendon="knee" forcerange="-5 5" ctrlrange="-5 5"/>
  <motor name="at site" site="knee" forcerange="-7 7"/></actuator>
  <sensor><jointpos name="angle" joint="knee"/>
  <framepos name="place" objtype="body" objname="knee"/>
  <tendonpos name="length" tendon="knee"/><actuatorfrc name="force" actuator="at joint"/></sensor>
  </mujoco>"""
"""A joint, a body, a site and a tendon have the same name."""


def test_scaled_effort_changes_only_the_actuators_of_the_joint() -> None:
    """Reference: the ranges in the text. The cached model is compiled again."""
    tree = SpecTree(mujoco.MjSpec.from_string(NAMESAKES))
    before = tree._compiled_model
    tree.scale("knee", BY_KIND["effort"], 10.0)
    model = tree._compiled_model
    assert model is not before
    assert model.actuator_forcerange[:, 1].tolist() == [20.0, 30.0, 5.0, 7.0]
    assert model.actuator_ctrlrange[:, 1].tolist() == [20.0, 0.0, 5.0, 0.0]


def test_effort_limit_bounds_each_transmission_at_a_joint() -> None:
    """Reference: the joint torques that MuJoCo computes for large controls."""
    text = """<mujoco><worldbody><body>
      <joint name="a" actuatorfrcrange="-5 5"/><joint name="b" axis="0 1 0"/>
      <joint name="c" axis="1 0 0" actuatorfrcrange="-5 5"/>
      <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
      <tendon><fixed name="t"><joint joint="c" coef="2"/></fixed></tendon>
      <actuator><motor joint="a" gear="3"/><motor jointinparent="b"/><motor tendon="t"/></actuator>
      </mujoco>"""
    tree = SpecTree(mujoco.MjSpec.from_string(text))
    limits = {"a": 2.0, "b": 3.0, "c": 4.0}
    for joint, effort in limits.items():
        tree.limit_effort(joint, effort)
    model = tree.spec.compile()
    data = mujoco.MjData(model)
    for sign in (1.0, -1.0):
        data.ctrl[:] = sign * 100
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator, sign * np.array(list(limits.values())))


def test_deleted_joint_leaves_the_elements_of_the_same_name() -> None:
    spec = mujoco.MjSpec.from_string(NAMESAKES)
    delete_joint(spec, spec.joint("knee"))
    model = spec.compile()
    assert [model.actuator(number).name for number in range(model.nu)] == ["at tendon", "at site"]
    assert [model.sensor(number).name for number in range(model.nsensor)] == ["place", "length"]
    assert [model.joint(number).name for number in range(1, model.njnt)] == ["ankle"]
