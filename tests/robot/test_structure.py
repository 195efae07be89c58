"""Many configurations of one robot at once: none changes another, in any order, from any thread."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.coordinates import PinocchioConvention
from pupper_analysis.robot.structure import Structure
from pupper_analysis.stance.sag.equilibrium import integrate_step
from tests.stance.sag.test_contact_kinematics import differences
from tests.support.engines import velocity_map
from tests.support.states import random_state
from tests.support.variants import NAMES, load

QUANTITIES: dict[str, Callable[[pa.Configuration], object]] = {
    "feet": lambda config: list(config.foot_positions().values()),
    "jacobians": lambda config: list(config.foot_jacobians().values()),
    "contacts": lambda config: list(config.contact_jacobians().values()),
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


@pytest.fixture(scope="module", params=[*NAMES, "v3 fixed", "tiny"])
def any_robot(request: pytest.FixtureRequest, tiny: pa.Robot) -> pa.Robot:
    if request.param == "tiny":
        return tiny
    return load(request.param.split()[0], fixed_base="fixed" in request.param)


def looked_at(config: pa.Configuration, order: np.ndarray) -> dict[str, np.ndarray]:
    """All quantities of a configuration, asked for in some order."""
    names = list(QUANTITIES)
    return {names[i]: np.array(QUANTITIES[names[i]](config)) for i in order}


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    """To the last bit: what is left in a workspace must not matter at all."""
    for name in QUANTITIES:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_configurations_alive_at_once_do_not_change_each_other(any_robot: pa.Robot) -> None:
    rng = np.random.default_rng(0)
    states = [random_state(any_robot, seed) for seed in range(8)]
    in_order = np.arange(len(QUANTITIES))
    fresh = []
    for state in states:
        any_robot.__dict__.pop("structure", None)  # a workspace that nobody had before
        fresh.append(looked_at(pa.Configuration(any_robot, *state), in_order))
    for _ in range(3):
        alive = [pa.Configuration(any_robot, *state) for state in states]
        for _ in range(2):
            for index in rng.permutation(len(states)):
                same(looked_at(alive[index], rng.permutation(in_order)), fresh[index])
        del alive  # the next ones have these workspaces


def test_results_are_not_views_of_a_workspace(any_robot: pa.Robot) -> None:
    config = pa.Configuration(any_robot, *random_state(any_robot, 1))
    before = looked_at(config, np.arange(len(QUANTITIES)))
    kept = {name: quantity(config) for name, quantity in QUANTITIES.items()}
    del config
    other = pa.Configuration(any_robot, *random_state(any_robot, 2))
    looked_at(other, np.arange(len(QUANTITIES)))
    same({name: np.array(value) for name, value in kept.items()}, before)
    # ... and who changes a result changes that alone.
    rotation, expected = other.base_rotation(), other.base_rotation()
    rotation[:] = 0.0
    np.testing.assert_array_equal(other.base_rotation(), expected)


def test_a_copy_keeps_its_workspace(any_robot: pa.Robot) -> None:
    config = pa.Configuration(any_robot, *random_state(any_robot, 7))
    order = np.arange(len(QUANTITIES))
    before, twin = looked_at(config, order), copy.copy(config)
    del config
    gc.collect()
    others = [pa.Configuration(any_robot, *random_state(any_robot, seed)) for seed in range(3)]
    for other in others:
        looked_at(other, order)
    same(looked_at(twin, order), before)


def test_threads_do_not_change_each_others_configurations(any_robot: pa.Robot) -> None:
    """Configurations that are made in one thread, asked in another, and dropped in a third."""
    states = [random_state(any_robot, seed) for seed in range(6)]
    order = np.arange(len(QUANTITIES))
    expected = [looked_at(pa.Configuration(any_robot, *state), order) for state in states]
    shared = [pa.Configuration(any_robot, *state) for state in states]

    def work(seed: int) -> None:
        own = np.random.default_rng(seed)
        for _ in range(20):
            index = int(own.integers(len(states)))
            for config in (shared[index], pa.Configuration(any_robot, *states[index])):
                same(looked_at(config, own.permutation(order)), expected[index])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))


def test_joints_may_be_in_any_order(any_robot: pa.Robot) -> None:
    """Also in one that Pinocchio cannot have: it wants what a joint carries behind the joint."""
    model, (qpos, _) = any_robot.pin_model, random_state(any_robot, 3)
    base = any_robot.nq - any_robot.nu
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(any_robot.nu)
        names = [any_robot.joint_names[index] for index in order]
        convention = PinocchioConvention.of(model, names)
        structure = Structure(model, convention, names, any_robot.contact_frames)
        mixed = np.concatenate([qpos[:base], qpos[base:][order]])
        held, q = structure.workspace(), structure.convention.unit_q(mixed)
        data, turn = model.createData(), velocity_map(convention, mixed)
        upper = np.triu(np.atleast_2d(pin.crba(model, data, convention.q(mixed))))
        full = upper + np.triu(upper, 1).T
        found = structure.inertia(pin.crba(structure.loaded(), held.data, q))
        numbers_agree(found, turn.T @ full @ turn)
        forces = pin.computeGeneralizedGravity(model, data, convention.q(mixed))
        own = pin.computeGeneralizedGravity(structure.model, held.data, q)
        numbers_agree(structure.dual(own), turn.T @ forces)


def test_armature_that_changes_is_heeded() -> None:
    robot = pa.load_variant("v3")
    config = pa.Configuration(robot, robot.home)
    before, rest = config.mass_matrix(), config.forward_dynamics(np.zeros(robot.nv))
    robot.pin_model.armature[robot.pin_convention.v_index] += 0.25
    np.testing.assert_allclose(
        np.diag(config.mass_matrix() - before)[6:], np.full(robot.nu, 0.25), rtol=1e-12
    )
    slower = config.forward_dynamics(np.zeros(robot.nv))
    assert np.abs(slower[6:]).max() < 0.5 * np.abs(rest[6:]).max()


def test_nobody_changes_a_velocity_of_zero(any_robot: pa.Robot) -> None:
    for robot in (any_robot, pickle.loads(pickle.dumps(any_robot))):
        config = pa.Configuration(robot, random_state(robot, 0)[0])
        with pytest.raises(ValueError, match="read-only"):
            config.qvel[0] = 1.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            config.qvel.flags.writeable = True


def numbers_agree(actual: np.ndarray, expected: np.ndarray) -> None:
    size = float(np.abs(expected).max()) or 1.0
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * size)


def test_rates_of_joints_in_another_order(tiny: pa.Robot) -> None:
    """Rows and columns of what gravity and a foot's wrench do, against differences of both."""
    rng = np.random.default_rng(4)
    config = pa.Configuration(tiny, integrate_step(tiny.neutral(), 0.3 * rng.normal(size=tiny.nv)))
    wrenches = {foot: rng.normal(size=6) for foot in tiny.contact_points}

    def left(step: np.ndarray) -> np.ndarray:
        at = pa.Configuration(tiny, integrate_step(config.qpos, step))
        return at.gravity() - sum(
            at.frame_jacobian(tiny.contact_frames[foot]).T @ wrench
            for foot, wrench in wrenches.items()
        )

    rates = config.static_rates(wrenches)
    np.testing.assert_allclose(rates, differences(left, tiny.nv, 1e-4), rtol=0, atol=1e-8)
