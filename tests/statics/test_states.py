"""Gravity compensation of many states at once is that of each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.variants import NAMES, load, stand_of

ROUNDING = 1e-11  # N, N m; the forces are some 10 N


def around(name: str, count: int, size: float = 0.05) -> np.ndarray:
    """States near the stand, turned and bent, no two alike."""
    robot, stand = load(name), stand_of(name)
    random = np.random.default_rng(3)
    states = np.tile(stand.qpos, (count, 1))
    states[:, 3:] += size * random.uniform(-1, 1, (count, robot.nq - 3))
    return states


def assert_same(robot: pa.Robot, states: np.ndarray, **how: Any) -> pa.statics.GravityCompensations:
    """Checks every number of every state against the single call."""
    found = pa.statics.gravity_compensations(robot, states, **how)
    for state, qpos in enumerate(states):
        one = pa.gravity_compensation(pa.Configuration(robot, qpos), **how)
        assert found.joint_names == one.joint_names
        assert found.feet == tuple(one.contact_forces)
        for name in (
            "joint_torques",
            "motor_utilisation",
            "base_wrench",
            "center_of_mass",
        ):
            wanted = getattr(one, name)
            np.testing.assert_allclose(getattr(found, name)[state], wanted, rtol=0, atol=ROUNDING)
        for name in ("contact_forces", "contact_points", "friction_utilisation"):
            wanted = np.array(list(getattr(one, name).values()))
            actual = getattr(found, name)[state]
            np.testing.assert_allclose(actual.ravel(), wanted.ravel(), rtol=0, atol=ROUNDING)
        if one.com_margin is None:
            assert np.isnan(found.com_margin[state])
        else:
            assert found.com_margin[state] == pytest.approx(one.com_margin, abs=1e-13)
        assert found.residual_force[state] < ROUNDING
        assert found.residual_torque[state] < ROUNDING
    assert found.infeasible == {}
    return found


@pytest.mark.parametrize("name", NAMES)
def test_every_state_is_the_single_calls(name: str) -> None:
    robot = load(name)
    found = assert_same(robot, around(name, 12))
    # Against the engines' weight, too: what the feet carry is all of it.
    weight = -robot.total_mass * robot.gravity
    np.testing.assert_allclose(found.contact_forces.sum(axis=1) - weight, 0, atol=1e-9)


@pytest.mark.parametrize(
    "how",
    [
        {"distribution": "minimum torque"},
        {"distribution": pa.statics.ForceDistribution.MIN_MAX_TORQUE},
        {"friction": 0.05},  # binds: the cones decide, state by state
        {"normals": {"FL": (0.05, -0.02, 1.0), "RR": (0.05, -0.02, 1.0)}},
        {"depths": {"FL": 2e-3, "RR": 1e-3}},
        {"contacts": ()},
    ],
    ids=str,
)
def test_whatever_is_asked(how: dict[str, Any]) -> None:
    names = {"FL": 0, "RR": 3}
    robot = load("v3")
    feet = dict(zip(names, (robot.contact_points[0], robot.contact_points[3]), strict=True))
    for key in ("normals", "depths"):
        if key in how:
            how = how | {key: {feet[foot]: value for foot, value in how[key].items()}}
    assert_same(robot, around("v3", 6, 0.02), **how)


def test_a_fixed_base_holds_itself() -> None:
    robot = load("v3", fixed_base=True)
    states = np.random.default_rng(0).uniform(-0.5, 0.5, (4, robot.nq))
    assert_same(robot, states)


def tipped(count: int) -> np.ndarray:
    """States of which those with odd numbers lie on their side, on which no feet hold them."""
    robot = load("v3")
    states = around("v3", count)
    for state in range(1, count, 2):
        tilt = 1.2 + 0.1 * state / count
        states[state, 3:7] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    assert robot.nq == states.shape[1]
    return states


def test_a_state_that_cannot_be_held_is_named() -> None:
    robot, states = load("v3"), tipped(4)
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.statics.gravity_compensations(robot, states)
    assert caught.value.where == "qpos[1]"
    with pytest.raises(pa.StaticsInfeasibleError) as alone:
        pa.gravity_compensation(pa.Configuration(robot, states[1]))
    assert caught.value.reason is alone.value.reason
    assert str(caught.value) == f"qpos[1]: {alone.value}"


def test_states_that_cannot_be_held_can_be_left_out() -> None:
    robot, states = load("v3"), tipped(6)
    found = pa.statics.gravity_compensations(robot, states, keep_going=True)
    assert sorted(found.infeasible) == [1, 3, 5]
    for state, why in found.infeasible.items():
        with pytest.raises(pa.StaticsInfeasibleError) as caught:
            pa.gravity_compensation(pa.Configuration(robot, states[state]))
        assert why == caught.value.diagnostic
        assert found.com_margin[state] == pytest.approx(caught.value.margin)
        assert np.isnan(found.joint_torques[state]).all()
        assert np.isnan(found.contact_forces[state]).all()
    held = assert_same(robot, states[::2])
    np.testing.assert_allclose(found.joint_torques[::2], held.joint_torques, atol=ROUNDING)


def test_states_that_are_none_are_refused() -> None:
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match=r"qpos: its shape must be \(k, 19\)"):
        pa.statics.gravity_compensations(robot, stand_of("v3").qpos)
    states = around("v3", 3)
    states[2, 5] = np.nan
    with pytest.raises(pa.ConfigurationError, match=r"qpos\[2\]: qpos: element 5 is nan"):
        pa.statics.gravity_compensations(robot, states)
    with pytest.raises(pa.UnknownNameError, match="no foot 'XX'"):
        pa.statics.gravity_compensations(robot, states[:2], ["XX"])
    with pytest.raises(pa.ConfigurationError, match="'even' is none of"):
        pa.statics.gravity_compensations(robot, states[:2], distribution="even")
    assert pa.statics.gravity_compensations(robot, np.zeros((0, 19))).joint_torques.shape == (0, 12)


def test_legs_in_singular_positions_are_solved_one_by_one() -> None:
    """Contacts in a row leave the base's rows dependent: singular values decide, as for one."""
    robot = load("v3")
    states = around("v3", 3, 0.0)
    three = robot.contact_points[:3]
    assert_same(robot, states, contacts=three, friction=5.0)
