"""Specs of compiled models, against the model itself and MuJoCo's dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.decompile import make_spec_of_model
from tests.support.variants import NAMES, load

# Examples of the supported elements.
RICH_MJCF = """
<mujoco model="rich">
  <compiler angle="radian"/>
  <option timestep="0.003" integrator="implicitfast" gravity="0 0.1 -9"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="free"/>
      <geom name="round" size="0.2"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" fluidshape="ellipsoid"/>
      <site name="imu" pos="0.1 0 0"/>
      <body name="arm" pos="0.2 0 0">
        <joint name="hinge" axis="0 1 0" range="-1 1" ref="0.3" springref="0.1" stiffness="3"
          damping="2" armature="0.1" frictionloss="0.2" actuatorfrcrange="-3 3"/>
        <geom name="tip" size="0.1" mass="1"/>
        <site name="end"/>
        <body name="rod" pos="0.2 0 0" gravcomp="0.5">
          <joint name="slide" type="slide" pos="0.1 0.2 0.3"/>
          <geom type="capsule" size="0.1 0.2" mass="1"/>
        </body>
      </body>
      <body pos="0 0.5 0">
        <joint type="ball" name="ball" range="0 1" stiffness="2"/>
        <geom type="mesh" mesh="wedge" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.2 0  0 0 0.3  0.1 0.1 0.05"/>
  </asset>
  <contact>
    <exclude body1="trunk" body2="arm"/>
    <pair geom1="floor" geom2="tip" friction="1 1 0.1 0.2 0.3"/>
  </contact>
  <tendon>
    <fixed name="fixed" range="-1 1" stiffness="2" damping="1">
      <joint joint="hinge" coef="2"/><joint joint="slide" coef="-1"/>
    </fixed>
    <spatial springlength="0.1">
      <site site="imu"/><geom geom="round"/><site site="end"/>
    </spatial>
  </tendon>
  <equality>
    <connect body1="rod" body2="arm" anchor="0 0 0.1"/>
    <joint joint1="hinge" joint2="slide" polycoef="0 1 0 0 0"/>
    <weld site1="imu" site2="end" active="false"/>
  </equality>
  <actuator>
    <position joint="hinge" kp="20" kv="2" ctrlrange="-1 1" forcerange="-5 5"/>
    <motor joint="slide" gear="3"/>
    <general tendon="fixed" dyntype="filter" dynprm="0.1"/>
    <motor site="imu" refsite="end" gear="1 0 0 0 0 0"/>
  </actuator>
  <sensor><gyro site="imu"/><accelerometer site="imu"/></sensor>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.2 0.1 1 0 0 0"/></keyframe>
</mujoco>
"""


def make_rich_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(RICH_MJCF)


def accelerations(model: mujoco.MjModel, seed: int) -> np.ndarray:
    """Joint accelerations of MuJoCo at a random state with random commands."""
    random, data = np.random.default_rng(seed), mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, random.uniform(-0.5, 0.5, model.nv), 1.0)
    data.qvel[:] = random.uniform(-1, 1, model.nv)
    data.ctrl[:] = random.uniform(-1, 1, model.nu)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rich", *NAMES])
def test_spec_of_model_has_equal_dynamics(name: str) -> None:
    """Reference: MuJoCo's ``mj_forward`` of the original model at five random states."""
    model = make_rich_model() if name == "rich" else load(name).mj_model
    made = make_spec_of_model(model, "model").compile()
    for seed in range(5):
        expected = accelerations(model, seed)
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(accelerations(made, seed), expected, atol=1e-6 * scale)


def test_spec_of_a_muscle_keeps_the_stated_length_range() -> None:
    """The force of a muscle depends on its length relative to the range: the file states
    -0.5 to 0.7 rad, from which MuJoCo's own search over the motion differs."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
    <geom size="0.1" mass="1"/></body></worldbody>
    <actuator><muscle name="muscle" joint="hinge" lengthrange="-0.5 0.7"/></actuator></mujoco>
    """)
    made = make_spec_of_model(model, "model").compile()
    assert made.actuator_lengthrange.tolist() == [[-0.5, 0.7]]
    forces = []
    for compiled in (model, made):
        data = mujoco.MjData(compiled)
        data.act[:] = 1.0  # fully activated
        mujoco.mj_forward(compiled, data)
        forces.append(data.actuator_force[0])
    assert forces[0] < 0
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)


def test_model_is_not_modified_by_writing_its_spec() -> None:
    model = make_rich_model()
    before = accelerations(model, 0)
    spec = make_spec_of_model(model, "model")
    spec.joints[1].armature = 9.0
    np.testing.assert_array_equal(accelerations(model, 0), before)


def test_spec_of_a_changed_model_has_the_changed_numbers() -> None:
    """A model whose mass and time step were changed after compilation."""
    model = make_rich_model()
    model.body_mass[2] = 3.5
    model.opt.timestep = 0.004
    made = make_spec_of_model(model, "model").compile()
    assert made.body_mass[2] == 3.5
    assert made.opt.timestep == 0.004


def test_bodies_without_name_get_names_and_geoms_do_not() -> None:
    """A foot is named after its body if its geom has no name."""
    spec = make_spec_of_model(make_rich_model(), "model")
    names = [body.name for body in spec.bodies]
    assert all(names)
    assert len(set(names)) == len(names)
    assert [geom.name for geom in spec.geoms] == ["floor", "round", "", "tip", "", ""]


@pytest.mark.parametrize("kind", ["none", "pos vel", "voltage"])
def test_actuators_with_several_controls_or_none_are_reproduced(kind: str) -> None:
    """Indices of actuators are no indices of controls."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><body name="a"><joint name="j"/><geom size="0.1"/>
    <body name="b"><joint name="k"/><geom size="0.1"/></body></body></worldbody>
    <actuator>
    <dcmotor name="m" joint="j" motorconst="0.1" resistance="1" input="{kind}"/>
    <position name="p" joint="k" kp="5" gear="3" ctrlrange="-1 1"/>
    </actuator></mujoco>""")
    made = make_spec_of_model(model, "model").compile()
    np.testing.assert_array_equal(made.actuator_ctrlrange, model.actuator_ctrlrange)
    np.testing.assert_array_equal(made.actuator_gear, model.actuator_gear)


def test_model_without_names_is_refused() -> None:
    text = "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
    with pytest.raises(pa.ModelError, match="name"):
        make_spec_of_model(mujoco.MjModel.from_xml_string(text), "model")


def test_model_with_flex_is_refused() -> None:
    text = """
    <mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body>
    <body name="mat">
    <flexcomp name="cloth" type="grid" count="3 3 1" spacing="1 1 1" dim="2" radius="0.1"/>
    </body></worldbody></mujoco>"""
    with pytest.raises(pa.ModelError, match="flex"):
        make_spec_of_model(mujoco.MjModel.from_xml_string(text), "model")


def test_model_that_no_spec_reproduces_is_refused() -> None:
    """An inertia that MuJoCo's compiler does not accept."""
    model = make_rich_model()
    model.body_inertia[2] = (1.0, 1.0, 5.0)  # violates the triangle inequality
    with pytest.raises(pa.ModelError):
        make_spec_of_model(model, "model")
