"""Edits of an MJCF's bodies, compared with the model that MuJoCo compiles."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis.models.spec_tree import SpecTree, set_inertia

MJCF = """<mujoco><worldbody><body name="base"><freejoint/>
  <inertial pos="0.1 0.2 0.3" mass="2" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
  <body name="arm" pos="0 0 1"><joint name="j"/>
    <geom type="box" size="0.1 0.2 0.3" pos="0.05 0 0" density="500"/>
    <geom type="sphere" size="0.1" pos="0 0.1 0" mass="3"/>
    <body name="tip" pos="1 0 0"><geom type="sphere" size="0.05"/></body>
  </body></body></worldbody></mujoco>"""


def tree() -> SpecTree:
    return SpecTree(mujoco.MjSpec.from_string(MJCF))


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
