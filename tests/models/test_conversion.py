"""Models converted into the other engine have equal kinematics, energy and masses."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.conversion import pinocchio_from_mujoco, pinocchio_from_urdf

# Features that Pupper does not have: joints off the frame's origin, two joints in a body, a slide
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
    """Reference: MuJoCo's site pose [m], potential energy [J] and joint block of the mass matrix at
    five random states.
    """
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


def test_bodies_equal_those_of_pinocchios_own_parser(tmp_path: Path) -> None:
    """Reference: Pinocchio's MJCF parser. The file has explicit inertials and no ``<include>``,
    which the parser does not read.
    """
    _, path = pa.pupper.write_variant("v3", tmp_path)
    ours = pinocchio_from_mujoco(mujoco.MjModel.from_xml_path(str(path)))
    theirs = pin.buildModelFromMJCF(str(path))
    assert len(ours.names) == 14
    for name in ours.names[2:]:
        first, second = (
            ours.inertias[ours.getJointId(name)],
            theirs.inertias[theirs.getJointId(name)],
        )
        assert first.mass == pytest.approx(second.mass, rel=1e-12)
        np.testing.assert_allclose(first.lever, second.lever, atol=1e-12)
        np.testing.assert_allclose(first.inertia, second.inertia, atol=1e-12)


def test_ball_joint_is_refused_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint type="ball" name="hip"/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(ModelError, match=r"hip.*ball"):
        pinocchio_from_mujoco(model)


def test_negative_masses_of_a_urdf_add_up_exactly() -> None:
    """Reference: closed form, with a link of 0.5 kg and links of -0.75 kg and 0.1 kg fixed to it.

    Pinocchio's own sum divides by 5e-32 kg if the total mass is negative.
    """
    inertia = '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'

    def link(name: str, mass: float, z: float) -> str:
        inertial = f'<origin xyz="0 0 {z}"/><mass value="{mass}"/>{inertia}'
        return f'<link name="{name}"><inertial>{inertial}</inertial></link>'

    def joint(name: str, kind: str, parent: str, child: str, z: float) -> str:
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {z}"/>'
        limit = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{limit}</joint>'

    links = link("base", 1, 0) + link("arm", 0.5, 0.1) + link("tip", -0.75, 0.2)
    joints = joint("turn", "revolute", "base", "arm", 0.3) + joint("a", "fixed", "arm", "tip", 0.1)
    more = link("end", 0.1, 0.0) + joint("b", "fixed", "tip", "end", 0.4)
    text = f'<robot name="arm">{links}{more}{joints}</robot>'
    model = pinocchio_from_urdf(text, Path("arm.urdf"), floating=True)
    arm = model.inertias[model.getJointId("turn")]
    masses, places = np.array([0.5, -0.75, 0.1]), np.array([0.1, 0.3, 0.5])
    com = float(masses @ places) / -0.15
    around = 0.02 * 3 + float(masses @ (places - com) ** 2)
    assert arm.mass == pytest.approx(-0.15, abs=1e-12)
    np.testing.assert_allclose(arm.lever, (0, 0, com), atol=1e-9)
    np.testing.assert_allclose(np.diag(arm.inertia), (around - 0.03, around, 0.06), atol=1e-9)
    assert model.inertias[1].mass == 1.0
