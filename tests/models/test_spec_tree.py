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
