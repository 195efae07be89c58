"""Many configurations of one robot: none changes another, in any order and from any thread."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.sag.equilibrium import integrate_step
from tests.stance.sag.test_contact_kinematics import differences
from tests.support.states import random_state
from tests.support.variants import load

QUANTITIES: dict[str, Callable[[pa.Configuration], object]] = {
    "feet": lambda config: list(config.foot_positions().values()),
    "jacobians": lambda config: list(config.foot_jacobians().values()),
    "axes": lambda config: [config.joint_axis(name) for name in config.robot.joint_names],
    "com": lambda config: config.center_of_mass(),
    "com jacobian": lambda config: config.com_jacobian(),
    "inertia": lambda config: config.mass_matrix(),
    "bias": lambda config: config.bias_forces(),
    "gravity": lambda config: config.gravity(),
    "qacc": lambda config: config.forward_dynamics(np.ones(config.robot.nv)),
    "com acceleration": lambda config: config.com_acceleration(np.ones(config.robot.nv)),
    "accelerations": lambda config: list(
        config.foot_accelerations(np.ones(config.robot.nv)).values()
    ),
}


def evaluate_quantities(config: pa.Configuration, order: np.ndarray) -> dict[str, np.ndarray]:
    """Return all quantities of a configuration, evaluated in the given order."""
    names = list(QUANTITIES)
    return {names[i]: np.array(QUANTITIES[names[i]](config)) for i in order}


def assert_equal_quantities(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    """Assert equality to the last bit: content that remains in a workspace must have no effect."""
    for name in QUANTITIES:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.slow
def test_results_are_not_views_of_a_workspace(any_robot: pa.Robot) -> None:
    """Results are equal to the last bit after another configuration is evaluated; changing a result
    changes no other result.
    """
    config = pa.Configuration(any_robot, *random_state(any_robot, 1))
    before = evaluate_quantities(config, np.arange(len(QUANTITIES)))
    kept = {name: quantity(config) for name, quantity in QUANTITIES.items()}
    del config
    other = pa.Configuration(any_robot, *random_state(any_robot, 2))
    evaluate_quantities(other, np.arange(len(QUANTITIES)))
    assert_equal_quantities({name: np.array(value) for name, value in kept.items()}, before)
    # ... and who changes a result changes that alone.
    rotation, expected = other.base_rotation(), other.base_rotation()
    rotation[:] = 0.0
    np.testing.assert_array_equal(other.base_rotation(), expected)


@pytest.mark.slow
def test_copied_configuration_keeps_its_values(any_robot: pa.Robot) -> None:
    """The original is deleted and three other configurations are evaluated before the copy is
    read.
    """
    config = pa.Configuration(any_robot, *random_state(any_robot, 7))
    order = np.arange(len(QUANTITIES))
    before, twin = evaluate_quantities(config, order), copy.copy(config)
    del config
    gc.collect()
    others = [pa.Configuration(any_robot, *random_state(any_robot, seed)) for seed in range(3)]
    for other_config in others:
        evaluate_quantities(other_config, order)
    assert_equal_quantities(evaluate_quantities(twin, order), before)


@pytest.mark.slow
def test_configurations_are_not_changed_by_other_threads(any_robot: pa.Robot) -> None:
    """Reference: values of a single thread.

    Four threads evaluate shared and new configurations in random order.
    """
    states = [random_state(any_robot, seed) for seed in range(6)]
    order = np.arange(len(QUANTITIES))
    expected = [evaluate_quantities(pa.Configuration(any_robot, *state), order) for state in states]
    shared = [pa.Configuration(any_robot, *state) for state in states]

    def work(seed: int) -> None:
        own = np.random.default_rng(seed)
        for _ in range(20):
            index = int(own.integers(len(states)))
            for config in (shared[index], pa.Configuration(any_robot, *states[index])):
                assert_equal_quantities(
                    evaluate_quantities(config, own.permutation(order)), expected[index]
                )

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))


def test_static_load_derivative_equals_differences_if_joint_orders_differ(tiny: pa.Robot) -> None:
    """Reference: differences of gravity torques and of a wrench on a foot."""
    rng = np.random.default_rng(4)
    config = pa.Configuration(tiny, integrate_step(tiny.neutral(), 0.3 * rng.normal(size=tiny.nv)))
    wrenches = {foot: rng.normal(size=6) for foot in tiny.contact_points}

    def left(step: np.ndarray) -> np.ndarray:
        at = pa.Configuration(tiny, integrate_step(config.qpos, step))
        return at.gravity() - sum(
            at.frame_jacobian(tiny.contact_frames[foot]).T @ wrench
            for foot, wrench in wrenches.items()
        )

    rates = config.static_load_derivative(wrenches)
    np.testing.assert_allclose(rates, differences(left, tiny.nv, 1e-4), rtol=0, atol=1e-8)


def test_changed_armature_of_pinocchios_model_is_used_by_the_same_configuration() -> None:
    """The diagonal of the mass matrix grows by the added armature of 0.25 kg m^2."""
    robot = pa.load_variant("v3")
    config = pa.Configuration(robot, robot.home)
    before, rest = config.mass_matrix(), config.forward_dynamics(np.zeros(robot.nv))
    robot.pin_model.armature[robot.pin_convention.v_index] += 0.25
    added = np.diag(config.mass_matrix() - before)[6:]
    np.testing.assert_allclose(added, np.full(robot.nu, 0.25), rtol=1e-12)
    slower = config.forward_dynamics(np.zeros(robot.nv))
    assert np.abs(slower[6:]).max() < 0.5 * np.abs(rest[6:]).max()


def test_velocity_of_zero_cannot_be_changed() -> None:
    """Configurations without a velocity share one array, also after pickling the robot."""
    for robot in (load("v3"), pickle.loads(pickle.dumps(load("v3")))):
        config = pa.Configuration(robot, random_state(robot, 0)[0])
        with pytest.raises(ValueError, match="read-only"):
            config.qvel[0] = 1.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            config.qvel.flags.writeable = True
