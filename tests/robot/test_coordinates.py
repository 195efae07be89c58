"""Maps between the public coordinates and those of each engine, compared with the engines' own
integration.
"""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa
from tests.support.engines import integrate, velocity_map
from tests.support.states import positions, velocities


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
    one, two = (pa.Configuration(tiny, q).foot_positions()["foot"] for q in (qpos, turned))
    np.testing.assert_allclose(one, two, atol=1e-14)
