"""Each model in the other engine."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis.models.conversion import pinocchio_from_mujoco

# Every feature that Pupper has not: joints off the frame's origin, two joints in a body, a slide
# joint, a reference angle, a static child, a rotated inertia.
ODD = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0.1 -0.2 -9.7"/>
  <worldbody>
    <body name="trunk" pos="0.3 0.1 1" quat="0.9 0.1 0.2 0.3">
      <freejoint name="root"/>
      <inertial pos="0.01 0.02 0.03" mass="2" fullinertia="0.02 0.03 0.025 0.001 0.002 -0.001"/>
      <body name="arm" pos="0.1 0.2 0.3" quat="0.5 0.5 0.1 0.7">
        <joint name="shoulder" pos="0.02 -0.03 0.01" axis="1 2 3" ref="0.3" armature="0.01"/>
        <joint name="twist" pos="-0.01 0 0.02" axis="0 1 0.2"/>
        <inertial pos="0.05 0 0.1" quat="0.8 0.1 0.5 0.2" mass="0.7"
                  diaginertia="0.002 0.003 0.004"/>
        <body name="plate" pos="0 0.1 0" quat="1 0.2 0 0">
          <inertial pos="0 0 0.05" mass="0.2" diaginertia="0.0002 0.0002 0.0001"/>
          <body name="hand" pos="0.2 0 0">
            <joint name="lift" type="slide" axis="0 0.6 0.8" ref="0.05"/>
            <geom type="capsule" size="0.02" fromto="0 0 0 0.1 0.1 0" mass="0.3"/>
            <site name="tip" pos="0.1 0.1 0" quat="0.7 0 0.7 0.1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" gear="2" forcerange="-3 3" forcelimited="true"/>
    <motor joint="twist"/>
  </actuator>
</mujoco>
"""


def test_odd_model_has_the_same_dynamics_in_pinocchio() -> None:
    model = mujoco.MjModel.from_xml_string(ODD)
    data = mujoco.MjData(model)
    converted = pinocchio_from_mujoco(model)
    assert converted.nv == model.nv
    rng = np.random.default_rng(0)
    for _ in range(5):
        data.qpos[:] = rng.normal(size=model.nq)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        q = np.concatenate([data.qpos[:3], data.qpos[[4, 5, 6, 3]], data.qpos[7:]])
        pin_data = converted.createData()
        pin.framesForwardKinematics(converted, pin_data, q)
        tip = pin_data.oMf[converted.getFrameId("tip")]
        np.testing.assert_allclose(tip.translation, data.site("tip").xpos, atol=1e-12)
        np.testing.assert_allclose(tip.rotation.ravel(), data.site("tip").xmat, atol=1e-12)
        potential = pin.computePotentialEnergy(converted, pin_data, q)
        mujoco.mj_energyPos(model, data)
        assert potential == pytest.approx(data.energy[0], rel=1e-12)
        # The joints' block of the mass matrix is the same in both conventions.
        mass = pin.crba(converted, pin_data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        np.testing.assert_allclose(mass[6:, 6:], full[6:, 6:], rtol=1e-11, atol=1e-14)
