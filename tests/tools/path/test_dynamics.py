"""Inverse dynamics of robots on feet, compared with MuJoCo, with momentum, and with statics at
rest.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import UP
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.tools.path.dynamics import inverse_dynamics, joint_resistance, rolling_levers
from tests.support.engines import integrate, velocity_map, velocity_map_rate
from tests.support.variants import NAMES, load, stand_of

Array = np.ndarray


def motion(name: str, seed: int = 0) -> tuple[Array, Array]:
    """Return a qvel and a qacc (nv,) that four feet can hold."""
    generator, robot = np.random.default_rng(seed), load(name)
    return 0.3 * generator.normal(size=robot.nv), 0.3 * generator.normal(size=robot.nv)


def mujoco_inverse(robot: pa.Robot, qpos: Array, qvel: Array, qacc: Array) -> Array:
    """MuJoCo's M qacc + h - passive - friction loss (nv,), out of reach of the ground."""
    data, public = mujoco.MjData(robot.mj_model), robot.mj_convention
    public.set_state(data, qpos + np.array([0, 0, 1.0, *np.zeros(robot.nq - 3)]), qvel)
    data.qacc[public.qvel_index] = qacc
    mujoco.mj_inverse(robot.mj_model, data)
    assert data.ncon == 0
    return data.qfrc_inverse[public.qvel_index]


@pytest.mark.parametrize("name", NAMES)
def test_contact_forces_balance_mujocos_inverse_dynamics(name: str) -> None:
    """Reference: MuJoCo's mass matrix, bias, damping and dry friction, and its Jacobians at the
    contact points."""
    robot, stand = load(name), stand_of(name)
    for seed in range(5):
        qvel, qacc = motion(name, seed)
        found = inverse_dynamics(pa.Configuration(robot, stand.qpos, qvel), qacc)
        remainder = mujoco_inverse(robot, stand.qpos, qvel, qacc)
        scale = np.abs(remainder).max()
        data, public = mujoco.MjData(robot.mj_model), robot.mj_convention
        public.set_state(data, stand.qpos)
        mujoco.mj_forward(robot.mj_model, data)
        for foot, force in found.contact_forces.items():
            linear, angular = np.zeros((2, 3, robot.mj_model.nv))
            body, place = robot.contact_places[foot]
            centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
            point = centre - robot.contact_radius[foot] * UP
            mujoco.mj_jac(robot.mj_model, data, linear, angular, point, body)
            generalised = linear.T @ force + angular.T @ found.contact_moments[foot]
            remainder -= generalised[public.qvel_index]
        remainder[6:] -= found.joint_torques
        assert np.abs(remainder).max() < 1e-9 * scale
        assert found.residual_force < 1e-9 * scale
        assert found.residual_torque < 1e-9 * scale


@pytest.mark.parametrize("name", ["v3", "long-leg"])
@pytest.mark.parametrize("speed", [0.0, 1e-4, 3.0])
def test_damping_and_dry_friction_equal_mujoco(name: str, speed: float) -> None:
    """Reference: MuJoCo's inverse dynamics, at low speed, where dry friction is regularised, and at
    high speed, where it is constant."""
    robot, stand = load(name), stand_of(name)
    qvel, qacc = motion(name)
    qvel, qacc = speed * qvel, (speed + 1e-3) * qacc
    config = pa.Configuration(robot, stand.qpos, qvel)
    bare = config.mass_matrix() @ qacc + config.bias_forces()
    taken = joint_resistance(robot, qvel, qacc)
    expected = mujoco_inverse(robot, stand.qpos, qvel, qacc) - bare
    np.testing.assert_allclose(taken, expected, atol=1e-12)
    if speed > 1:
        assert (taken[6:] * qvel[6:] > 0).all()  # against the motion


@pytest.mark.parametrize("name", ["original", "heavy", "v3"])
def test_zero_moment_point_two_ways(name: str) -> None:
    """References: Pinocchio's rate of the centroidal momentum, and the centre of pressure of the
    contact forces.
    """
    robot, stand = load(name), stand_of(name)
    qvel, qacc = motion(name, 1)
    config = pa.Configuration(robot, stand.qpos, qvel)
    found = inverse_dynamics(config, qacc, resistance=False)
    normal = np.array([force[2] for force in found.contact_forces.values()])
    points = np.array(list(found.contact_points.values()))
    pressure = normal @ points[:, :2] / normal.sum()
    np.testing.assert_allclose(found.zero_moment_point[:2], pressure, atol=1e-12)

    public = robot.pin_convention
    data = robot.pin_model.createData()
    drift = velocity_map_rate(public, config.qpos, qvel)
    turn = velocity_map(public, config.qpos)
    state = (public.q(config.qpos), turn @ qvel, turn @ qacc + drift)
    rate = pin.computeCentroidalMomentumTimeVariation(robot.pin_model, data, *state)
    force = rate.linear - robot.total_mass * robot.gravity
    moment = rate.angular + np.cross(config.center_of_mass(), force)
    closed = np.array([-moment[1], moment[0]]) / force[2]
    np.testing.assert_allclose(found.zero_moment_point[:2], closed, atol=1e-9)
    assert np.abs(closed - config.center_of_mass()[:2]).max() > 1e-3  # it is not the com


def test_rolling_friction_equals_mujoco() -> None:
    """Reference: contact moments in MuJoCo's inverse dynamics, as v3 rises and the feet roll."""
    robot = load("v3")
    stand = solve_stand_on_soft_ground(robot)
    config = pa.Configuration(robot, stand.qpos)
    stacked = np.concatenate([np.eye(robot.nv)[2:6], config.com_jacobian()[:2]])
    depth = max(stand.depths.values()) / 2  # MuJoCo has the contact half way
    for foot in robot.contact_points:
        offset = (depth - robot.contact_radius[foot]) * UP
        rows = config.frame_jacobian(robot.contact_frames[foot], offset)[:3]
        stacked = np.concatenate([stacked, rows])
    rising = np.linalg.lstsq(stacked, np.eye(len(stacked))[0])[0]
    data, public = mujoco.MjData(robot.mj_model), robot.mj_convention
    for speed in (1e-3, 0.1):
        moving = pa.Configuration(robot, stand.qpos, speed * rising)
        levers = rolling_levers(moving, np.zeros(robot.nv), dict.fromkeys(robot.contact_points, UP))
        public.set_state(data, stand.qpos, speed * rising)
        data.qacc[:] = 0
        mujoco.mj_inverse(robot.mj_model, data)
        wrench = np.zeros(6)
        assert data.ncon == 4
        for number, pair in enumerate(data.contact.geom):
            mujoco.mj_contactForce(robot.mj_model, data, number, wrench)
            axes = data.contact.frame[number].reshape(3, 3)
            sign = 1 if pair[0] == 0 else -1
            moment = sign * axes.T @ wrench[3:]
            foot = robot.foot_geoms[int(pair.max())]
            # Its contact gives way vertically here, so the share is not quite even.
            np.testing.assert_allclose(
                levers[foot][:2], moment[:2] / wrench[0], atol=0.03 * np.abs(moment).max()
            )
        if speed == 0.1:
            assert np.linalg.norm(levers["FL"][:2]) == pytest.approx(0.01, rel=1e-6)


def test_rolling_contact_on_a_slope_is_at_the_cone_boundary() -> None:
    """Feet that roll at 1 rad/s: (f_t / mu)^2 + (m / mu_r)^2 = f_n^2, in the ground's axes."""
    robot, ground = load("v3"), pa.Ground(0.4)
    stand = pa.solve_stand(robot, pa.StandTask(ground=ground, pitch=-0.4))
    up = ground.normal()
    qvel = np.zeros(robot.nv)
    qvel[4] = 1.0  # the base pitches, and its feet with it
    found = pa.statics.inverse_dynamics(
        pa.Configuration(robot, stand.qpos, qvel),
        np.zeros(robot.nv),
        normals=dict.fromkeys(robot.contact_points, up),
        held=True,
    )
    assert found.contact_forces
    for foot, force in found.contact_forces.items():
        pressing, moment = float(force @ up), found.contact_moments[foot]
        friction = robot.contacts[foot].friction
        tangential = np.linalg.norm(force - pressing * up) / friction[0]
        rolling = np.linalg.norm(moment - (moment @ up) * up) / friction[3]
        spinning = (moment @ up) / friction[2]
        assert pressing > 0
        assert np.linalg.norm((tangential, rolling, spinning)) == pytest.approx(pressing, rel=0.02)


def test_infeasible_acceleration_states_its_reason() -> None:
    """Closed forms: below -g feet would have to pull; a sideways acceleration of 3 m/s^2 needs a
    friction of 3 / 9.81.
    """
    robot, stand = load("v3"), stand_of("v3")
    config, qacc = pa.Configuration(robot, stand.qpos), np.zeros(robot.nv)
    for index, acceleration, reason in (
        (2, -15.0, pa.errors.Infeasibility.PULL),
        (1, 12.0, pa.errors.Infeasibility.ZMP_OUTSIDE),
    ):
        qacc[:] = 0
        qacc[index] = acceleration
        with pytest.raises(pa.StaticsInfeasibleError) as caught:
            inverse_dynamics(config, qacc)
        assert caught.value.reason is reason
        held = inverse_dynamics(config, qacc, held=True)
        assert min(force[2] for force in held.contact_forces.values()) < 0
        assert held.residual_force < 1e-9
    with pytest.raises(pa.StaticsInfeasibleError, match="friction") as caught:
        inverse_dynamics(config, np.array([0, 3.0, *np.zeros(16)]), friction=0.2)
    assert caught.value.friction_needed == pytest.approx(3 / 9.81, rel=1e-5)  # bisection
    with pytest.raises(pa.ConfigurationError, match="qacc"):
        inverse_dynamics(config, np.zeros(3))
    with pytest.raises(pa.UnknownNameError):
        inverse_dynamics(config, np.zeros(robot.nv), ["XX"])


def test_fixed_base_carries_all_of_the_load() -> None:
    """Reference: M qacc + h of Pinocchio."""
    robot = load("v3", fixed_base=True)
    generator = np.random.default_rng(0)
    qpos, qvel, qacc = generator.normal(size=(3, robot.nu))
    found = inverse_dynamics(pa.Configuration(robot, qpos, qvel), qacc, resistance=False)
    config = pa.Configuration(robot, qpos, qvel)
    expected = config.mass_matrix() @ qacc + config.bias_forces()
    np.testing.assert_allclose(found.joint_torques, expected, atol=1e-12)
    assert found.zmp_margin is None


def test_spinning_foot_has_only_torsional_friction() -> None:
    """Closed form: the lever arm [m] is the torsional coefficient, against the rotation."""
    robot, stand = load("v3"), stand_of("v3")
    qvel = np.zeros(robot.nv)
    qvel[5] = 50.0  # far beyond where friction saturates
    levers = rolling_levers(
        pa.Configuration(robot, stand.qpos, qvel),
        np.zeros(robot.nv),
        dict.fromkeys(robot.contact_points, UP),
    )
    assert len(levers) == 4
    for foot, lever in levers.items():
        spin, roll = robot.contacts[foot].friction[2:4]
        assert roll > 0
        np.testing.assert_allclose(lever, (0.0, 0.0, -spin), atol=1e-2 * spin)


@pytest.mark.parametrize("name", NAMES)
def test_inverse_dynamics_at_rest_equals_the_gravity_compensation(name: str) -> None:
    """Reference: `gravity_compensation` with minimum tangential forces."""
    robot, stand = load(name), stand_of(name)
    config = pa.Configuration(robot, stand.qpos)
    found = inverse_dynamics(config, np.zeros(robot.nv))
    still = pa.gravity_compensation(
        config, distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    )
    np.testing.assert_allclose(found.joint_torques, still.joint_torques, atol=1e-12)
    assert found.zmp_margin == pytest.approx(still.com_margin, abs=1e-12)
    np.testing.assert_allclose(found.zero_moment_point[:2], still.center_of_mass[:2], atol=1e-12)


def test_accelerations_are_derivatives_of_velocities() -> None:
    """Reference: central differences along a motion with constant acceleration."""
    robot, stand, step = load("v3"), stand_of("v3"), 1e-5
    qvel, qacc = motion("v3", 3)

    def at(time: float) -> pa.Configuration:
        qpos = integrate(robot, stand.qpos, qvel + time / 2 * qacc, time)
        return pa.Configuration(robot, qpos, qvel + time * qacc)

    now, before, after = at(0.0), at(-step), at(step)
    for foot, found in now.foot_accelerations(qacc).items():
        frame = robot.contact_frames[foot]
        rates = [config.frame_jacobian(frame) @ config.qvel for config in (before, after)]
        np.testing.assert_allclose(found, (rates[1] - rates[0]) / (2 * step), atol=1e-8)
    rates = [config.com_jacobian() @ config.qvel for config in (before, after)]
    found = now.com_acceleration(qacc)
    np.testing.assert_allclose(found, (rates[1] - rates[0]) / (2 * step), atol=1e-8)
