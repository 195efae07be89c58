"""Jacobians, momenta, regressors and manipulability: raw Pinocchio and MuJoCo as references.

Raw Pinocchio is ``robot.pin_model`` with its own coordinates and joint order; ``velocity_map`` is
written without the package. Robots: variants, a fixed base, a continuous and a sliding joint, and
random robots with three to six legs, other joint orders, springs and names with prefixes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.arrays import rotation_from_quaternion
from tests.support import random_legged
from tests.support.engines import (
    addresses,
    differentiate_along,
    evaluate_mujoco,
    make_free_mechanism,
    velocity_map,
)
from tests.support.states import random_state
from tests.support.variants import load

QUICK = ("tiny",)
ODD = ("v3", "original", "v3 fixed", "drawn 3", "drawn 12", "drawn 36", "biped 1", "ring 2")
STATES = 20
"""Random states of each robot."""

REFERENCES = {
    "local": pin.LOCAL,
    "world": pin.WORLD,
    "local_world_aligned": pin.LOCAL_WORLD_ALIGNED,
}


@pytest.fixture(
    scope="module", params=[*QUICK, *(pytest.param(odd, marks=pytest.mark.slow) for odd in ODD)]
)
def odd_robot(
    request: pytest.FixtureRequest, tiny: pa.Robot, tmp_path_factory: pytest.TempPathFactory
) -> pa.Robot:
    if request.param == "tiny":
        return tiny
    return load_odd_robot(request.param, tmp_path_factory.mktemp("odd"))


def load_odd_robot(label: str, folder: Path) -> pa.Robot:
    """Load a robot of `ODD`; random robots are written to a folder."""
    name, _, option = label.partition(" ")
    draw = {
        "drawn": random_legged.draw_robot,
        "biped": random_legged.irregular_biped,
        "ring": random_legged.ring,
    }
    if name not in draw:
        return load(name, fixed_base=option == "fixed")
    pair = random_legged.write_robot(draw[name](int(option)), folder)
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf, as_is=True)


def states(robot: pa.Robot) -> Iterator[tuple[pa.Configuration, np.ndarray, np.ndarray]]:
    """Random states with the vector (3,) from a link to a point."""
    for seed in range(STATES):
        qpos, qvel = random_state(robot, seed)
        offset = np.random.default_rng(seed).uniform(-0.3, 0.3, 3)
        yield pa.Configuration(robot, qpos, qvel), qvel, offset


def links(robot: pa.Robot) -> list[tuple[str, int]]:
    """Links with the MuJoCo body of the same name, which may have a prefix."""
    model = robot.mj_model
    bodies = {model.body(body).name.rsplit("/")[-1]: body for body in range(1, model.nbody)}
    bodies = {name.removeprefix("rob_"): body for name, body in bodies.items()}
    frames = [frame.name for frame in robot.pin_model.frames if frame.type == pin.FrameType.BODY]
    shared = [
        (name, bodies[key])
        for name in frames
        if (key := name.rsplit("/")[-1].removeprefix("rob_")) in bodies
    ]
    assert shared
    return shared


def compute_by_pinocchio(
    config: pa.Configuration,
) -> tuple[pin.Data, np.ndarray, np.ndarray, np.ndarray]:
    """Raw Pinocchio at a state: data, q, T with v_pin = T qvel, and dT/dt."""
    robot = config.robot
    model, convention = robot.pin_model, robot.pin_convention
    q = convention.q(config.qpos)
    mapping = velocity_map(convention, config.qpos)
    rate = np.zeros_like(mapping)
    if robot.floating:
        rotation = rotation_from_quaternion(config.qpos[3:7])
        rate[:3, :3] = -pin.skew(config.qvel[3:6]) @ rotation.T
    data = model.createData()
    pin.computeJointJacobiansTimeVariation(model, data, q, mapping @ config.qvel)
    pin.updateFramePlacements(model, data)
    return data, q, mapping, rate


def assert_equal(actual: np.ndarray, expected: np.ndarray, tolerance: float = 1e-12) -> None:
    """Compare relative to the largest element, or to 1."""
    size = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * size)


def test_frame_jacobians_equal_those_of_both_engines(odd_robot: pa.Robot) -> None:
    """References: `getFrameJacobian` in three frames, `mj_jac` at an offset point, and
    manipulability sqrt(det(J J^T)) of MuJoCo's joint columns.
    """
    robot, shared = odd_robot, links(odd_robot)
    _, columns = addresses(robot)
    for config, _, offset in states(robot):
        data, _, mapping, _ = compute_by_pinocchio(config)
        mj = evaluate_mujoco(robot, config.qpos)
        for name, body in shared:
            frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
            for reference, constant in REFERENCES.items():
                theirs = pin.getFrameJacobian(robot.pin_model, data, frame, constant)
                mine = config.frame_jacobian(name, reference=reference)
                assert_equal(mine, theirs.reshape(6, -1) @ mapping)
            point = config.frame_position(name) + offset
            rows = np.zeros((6, robot.mj_model.nv))
            mujoco.mj_jac(robot.mj_model, mj, rows[:3], rows[3:], point, body)
            assert_equal(config.frame_jacobian(name, offset), rows[:, columns])
            turn = np.kron(np.eye(2), config.frame_rotation(name).T)
            local = config.frame_jacobian(name, offset, reference="local")
            assert_equal(local, turn @ rows[:, columns])
            motions = {"linear": rows[:3], "angular": rows[3:], "both": rows}
            for motion, part in motions.items():
                joints = part[:, columns[robot.nv - robot.nu :]]
                expected = np.sqrt(max(0.0, np.linalg.det(joints @ joints.T)))
                found = config.manipulability(name, offset, motion=motion)
                assert found == pytest.approx(expected, abs=1e-7)


def test_jacobian_time_variations_equal_those_of_both_engines(odd_robot: pa.Robot) -> None:
    """References: dJ T + J dT/dt of raw Pinocchio, and `mj_jacDot` at an offset point."""
    robot, shared = odd_robot, links(odd_robot)
    _, columns = addresses(robot)
    for config, _, offset in states(robot):
        data, _, mapping, rate = compute_by_pinocchio(config)
        mj = evaluate_mujoco(robot, config.qpos, config.qvel)
        for name, body in shared:
            frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
            for reference, constant in REFERENCES.items():
                jacobian = pin.getFrameJacobian(robot.pin_model, data, frame, constant)
                variation = pin.getFrameJacobianTimeVariation(
                    robot.pin_model, data, frame, constant
                )
                theirs = variation.reshape(6, -1) @ mapping + jacobian.reshape(6, -1) @ rate
                mine = config.frame_jacobian_time_variation(name, reference=reference)
                assert_equal(mine, theirs)
            point = config.frame_position(name) + offset
            rows = np.zeros((6, robot.mj_model.nv))
            mujoco.mj_jacDot(robot.mj_model, mj, rows[:3], rows[3:], point, body)
            assert_equal(config.frame_jacobian_time_variation(name, offset), rows[:, columns])


def test_local_time_variation_of_a_point_is_a_derivative(odd_robot: pa.Robot) -> None:
    """Reference: central difference of the local Jacobian of a point that moves with its link."""
    robot, (name, _) = odd_robot, links(odd_robot)[-1]
    qpos, qvel = random_state(robot, 1)
    config, offset = pa.Configuration(robot, qpos, qvel), np.array([0.1, -0.2, 0.05])
    mark = config.frame_rotation(name).T @ offset

    def local(at: np.ndarray) -> np.ndarray:
        moved = pa.Configuration(robot, at)
        lever = moved.frame_rotation(name) @ mark
        return moved.frame_jacobian(name, lever, reference="local")

    mine = config.frame_jacobian_time_variation(name, offset, reference="local")
    assert_equal(mine, differentiate_along(robot, local, qpos, qvel), 1e-7)


def test_centroidal_map_equals_those_of_both_engines(odd_robot: pa.Robot) -> None:
    """MuJoCo: ``mj_angmomMat`` and the CoM's Jacobian of the whole world, with fixed mass."""
    robot, model = odd_robot, odd_robot.mj_model
    _, columns = addresses(robot)
    for config, _, _ in states(robot):
        mine, mj = config.centroidal_map(), evaluate_mujoco(robot, config.qpos)
        linear, angular = np.zeros((2, 3, model.nv))
        mujoco.mj_jacSubtreeCom(model, mj, linear, 0)
        mujoco.mj_angmomMat(model, mj, angular, 0)
        assert_equal(mine[:3], model.body_subtreemass[0] * linear[:, columns])
        assert_equal(mine[3:], angular[:, columns])
        if robot.floating:
            _, q, mapping, _ = compute_by_pinocchio(config)
            theirs = pin.computeCentroidalMap(robot.pin_model, robot.pin_model.createData(), q)
            assert_equal(mine, theirs @ mapping)


def test_centroidal_map_time_variation_is_a_derivative_with_pinocchios_bias(
    odd_robot: pa.Robot,
) -> None:
    """Central differences of the map; dAg v of raw Pinocchio, whose dAg keeps the CoM in place."""
    robot = odd_robot
    for number, (config, qvel, _) in enumerate(states(robot)):
        mine = config.centroidal_map_time_variation()
        if robot.floating:
            _, q, mapping, rate = compute_by_pinocchio(config)
            data, velocity = robot.pin_model.createData(), mapping @ qvel
            theirs = pin.computeCentroidalMapTimeVariation(robot.pin_model, data, q, velocity)
            assert_equal(mine @ qvel, theirs @ velocity + data.Ag @ rate @ qvel)
            com_velocity = config.com_jacobian() @ qvel
            theirs[3:] -= pin.skew(com_velocity) @ data.Ag[:3]
            assert_equal(mine, theirs @ mapping + data.Ag @ rate)
        if number < 3:

            def momentum(at: np.ndarray) -> np.ndarray:
                return pa.Configuration(robot, at).centroidal_map()

            assert_equal(mine, differentiate_along(robot, momentum, config.qpos, qvel), 1e-6)


def test_time_variation_of_the_centroidal_map_does_not_depend_on_earlier_calls() -> None:
    """Reference: the value before another call.

    Pinocchio's function reads a CoM velocity that other functions leave in the data.
    """
    robot = pa.load_variant("v3")
    config = pa.Configuration(robot, *random_state(robot, 1))
    expected = config.centroidal_map_time_variation()
    config.com_acceleration(np.ones(robot.nv))
    np.testing.assert_array_equal(config.centroidal_map_time_variation(), expected)


def test_momentum_of_a_falling_robot_changes_by_its_weight_only() -> None:
    """MuJoCo's acceleration without motors and contacts: A qacc + dA/dt qvel = (m g, 0)."""
    robot = load("v3")
    model = make_free_mechanism(robot)
    model.dof_armature[:] = 0.0
    _, columns = addresses(robot)
    for config, qvel, _ in states(robot):
        mj = evaluate_mujoco(robot, config.qpos, qvel, model)
        rate = config.centroidal_map() @ mj.qacc[columns]
        rate += config.centroidal_map_time_variation() @ qvel
        expected = [*(robot.total_mass * robot.gravity), 0, 0, 0]
        np.testing.assert_allclose(rate, expected, atol=1e-9)


def test_regressor_times_parameters_is_the_inverse_dynamics_of_both_engines(
    odd_robot: pa.Robot,
) -> None:
    """MuJoCo: ``mj_rne`` with acceleration, which has no armature."""
    robot, model = odd_robot, odd_robot.mj_model
    _, columns = addresses(robot)
    for config, qvel, _ in states(robot):
        qacc = np.random.default_rng(len(qvel)).uniform(-5, 5, robot.nv)
        torques = config.joint_torque_regressor(qacc) @ config.dynamic_parameters()
        mj = evaluate_mujoco(robot, config.qpos, qvel)
        mj.qacc[columns] = qacc
        theirs = np.zeros(model.nv)
        mujoco.mj_rne(model, mj, 1, theirs)
        assert_equal(torques, theirs[columns])
        _, q, mapping, rate = compute_by_pinocchio(config)
        armature, data = robot.pin_model.armature.copy(), robot.pin_model.createData()
        acceleration = mapping @ qacc + rate @ qvel
        forces = pin.rnea(robot.pin_model, data, q, mapping @ qvel, acceleration)
        assert_equal(torques, mapping.T @ (forces - armature * acceleration))


def test_regressor_columns_equal_those_of_raw_pinocchio() -> None:
    """Blocks of ten columns: the free base, then the joints in actuator order."""
    robot = load("v3")
    qpos, qvel = random_state(robot, 4)
    config, qacc = pa.Configuration(robot, qpos, qvel), np.linspace(-3, 3, robot.nv)
    _, q, mapping, rate = compute_by_pinocchio(config)
    model, data = robot.pin_model, robot.pin_model.createData()
    theirs = pin.computeJointTorqueRegressor(
        model, data, q, mapping @ qvel, mapping @ qacc + rate @ qvel
    )
    order = [1, *(model.getJointId(name) for name in robot.joint_names)]
    blocks = [theirs[:, 10 * (joint - 1) : 10 * joint] for joint in order]
    assert_equal(config.joint_torque_regressor(qacc), mapping.T @ np.hstack(blocks))
    parameters = np.concatenate([model.inertias[joint].toDynamicParameters() for joint in order])
    assert_equal(config.dynamic_parameters(), parameters)


def test_mass_matrix_and_bias_equal_those_of_raw_pinocchio(odd_robot: pa.Robot) -> None:
    """M = T^T M_pin T, h = T^T (h_pin + M_pin dT/dt qvel)."""
    robot = odd_robot
    for config, qvel, _ in states(robot):
        _, q, mapping, rate = compute_by_pinocchio(config)
        model, data = robot.pin_model, robot.pin_model.createData()
        upper = np.triu(pin.crba(model, data, q))
        inertia = upper + np.triu(upper, 1).T
        assert_equal(config.mass_matrix(), mapping.T @ inertia @ mapping)
        bias = pin.nonLinearEffects(model, model.createData(), q, mapping @ qvel)
        assert_equal(config.bias_forces(), mapping.T @ (bias + inertia @ rate @ qvel))


def test_unknown_reference_and_motion_are_refused_with_the_valid_names() -> None:
    config = pa.Configuration(load("v3"), load("v3").neutral())
    for function in (config.frame_jacobian, config.frame_jacobian_time_variation):
        with pytest.raises(pa.ConfigurationError, match="local_world_aligned"):
            function("base_link", reference="body")  # type: ignore[arg-type]
    with pytest.raises(pa.ConfigurationError, match="angular"):
        config.manipulability("base_link", motion="spin")  # type: ignore[arg-type]
    with pytest.raises(pa.UnknownNameError):
        config.frame_jacobian_time_variation("tail")
