"""Maps between the public coordinates and those of each engine, compared with the engines' own
integration.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa
from tests.support.engines import addresses, integrate, velocity_map
from tests.support.states import positions, quaternion, random_state, velocities
from tests.support.variants import NAMES, load


@pytest.mark.slow
@given(data=st.data())
def test_velocity_map_agrees_with_both_engines_integration(
    any_robot: pa.Robot, data: st.DataObject
) -> None:
    """Reference: MuJoCo's ``mj_integratePos`` along qvel, and Pinocchio's ``difference`` of both
    ends."""
    qpos, qvel = data.draw(positions(any_robot)), data.draw(velocities(any_robot))
    convention, dt = any_robot.pin_convention, 1e-5
    behind, ahead = (convention.q(integrate(any_robot, qpos, qvel, sign * dt)) for sign in (-1, 1))
    measured = pin.difference(any_robot.pin_model, behind, ahead) / (2 * dt)
    np.testing.assert_allclose(measured, velocity_map(convention, qpos) @ qvel, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_coordinates_of_a_variant_have_the_order_of_its_mjcf(name: str) -> None:
    """Reference: the addresses of the named joints in MuJoCo's qpos and qvel are 0, 1, 2, ..."""
    q, v = addresses(load(name))
    np.testing.assert_array_equal(q, np.arange(19))
    np.testing.assert_array_equal(v, np.arange(18))
    np.testing.assert_array_equal(load(name).mj_convention.qpos_index, q)
    np.testing.assert_array_equal(load(name).mj_convention.qvel_index, v)


def test_joints_are_in_actuator_order_followed_by_joints_without_actuator(tiny: pa.Robot) -> None:
    assert tiny.joint_names == ("bend", "push", "turn")
    assert list(tiny.mj_convention.actuator_index) == [0, 1, -1]


@pytest.mark.parametrize("turns", [-3, -1, 1, 2])
def test_whole_turns_of_a_continuous_joint_have_no_effect(tiny: pa.Robot, turns: int) -> None:
    """Pinocchio's q and the foot position [m] are equal; qpos returns to the range of one turn."""
    qpos = tiny.neutral()
    qpos[-1] = 0.7
    turned = qpos.copy()
    turned[-1] += turns * 2 * np.pi
    convention = tiny.pin_convention
    np.testing.assert_allclose(convention.q(turned), convention.q(qpos), atol=1e-14)
    np.testing.assert_allclose(convention.qpos(convention.q(turned)), qpos, atol=1e-14)
    first, second = (pa.Configuration(tiny, q).foot_positions()["foot"] for q in (qpos, turned))
    np.testing.assert_allclose(first, second, atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_coordinates_of_both_engines_convert_there_and_back(any_robot: pa.Robot, seed: int) -> None:
    qpos, _ = random_state(any_robot, seed)
    model, convention = any_robot.pin_model, any_robot.pin_convention
    q = convention.q(qpos)
    assert q.shape == (model.nq,)
    assert pin.isNormalized(model, q, 1e-12)
    np.testing.assert_allclose(convention.qpos(q), qpos, atol=1e-14)
    velocity = np.random.default_rng(seed).uniform(-2.0, 2.0, model.nv)
    q = pin.integrate(model, pin.neutral(model), velocity)
    np.testing.assert_allclose(convention.q(convention.qpos(q)), q, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_state_of_mujoco_has_the_joints_by_name(any_robot: pa.Robot, seed: int) -> None:
    """Reference: MuJoCo's named access to joint positions and velocities."""
    qpos, qvel = random_state(any_robot, seed)
    data = mujoco.MjData(any_robot.mj_model)
    any_robot.mj_convention.set_state(data, qpos, qvel)
    first = any_robot.nq - any_robot.nu
    for index, name in enumerate(any_robot.joint_names):
        assert data.joint(name).qpos[0] == qpos[first + index]
        assert data.joint(name).qvel[0] == qvel[any_robot.nv - any_robot.nu + index]
    q, v = addresses(any_robot)
    np.testing.assert_array_equal(data.qpos[q], qpos)
    np.testing.assert_array_equal(data.qvel[v], qvel)
    any_robot.mj_convention.set_state(data, qpos)
    assert not data.qvel.any()


def test_quaternion_of_any_length_is_normalised() -> None:
    robot = load("v3")
    qpos, convention = robot.neutral(), robot.pin_convention
    qpos[3:7] = quaternion(np.array([0.3, -0.2, 0.5]))
    scaled = qpos.copy()
    scaled[3:7] *= 7
    np.testing.assert_allclose(convention.q(scaled), convention.q(qpos), atol=1e-15)


def test_continuous_joint_has_no_limits_and_other_joints_have_those_of_the_file(
    tiny: pa.Robot,
) -> None:
    np.testing.assert_array_equal(tiny.lower_limits, [-1, -0.3, -np.inf])
    np.testing.assert_array_equal(tiny.upper_limits, [2, 0.4, np.inf])
    np.testing.assert_array_equal(tiny.effort_limits, [4, 3, 5])
