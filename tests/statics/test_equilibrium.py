"""Motor torques and contact forces of robots at rest, compared with closed forms, the Newton-Euler
balance, linear programs, and MuJoCo's inverse dynamics.
"""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, optimize

import pupper_analysis as pa
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.statics.cone_program import Balance
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.equilibrium import (
    balance_load,
    find_hardest_motor,
    friction_utilisation_of,
)
from pupper_analysis.statics.support_polygon import com_margin
from tests.support import random_legged
from tests.support.bound import belts
from tests.support.engines import addresses, evaluate_mujoco, with_efforts
from tests.support.states import numbers
from tests.support.variants import NAMES, load, stand_of

GRAVITY = 9.81  # [m/s^2]
UP = np.array([0.0, 0.0, 1.0])
DISTRIBUTIONS = tuple(pa.statics.ForceDistribution)


def at_stand(name: str) -> pa.Configuration:
    return pa.Configuration(load(name), stand_of(name).qpos)


def near_stand(name: str, share: np.ndarray) -> pa.Configuration:
    """Return a configuration near the stand: base rotated, joints displaced by random shares."""
    qpos = stand_of(name).qpos.copy()
    qpos[4:7] += 0.1 * share[:3]
    qpos[7:] += 0.15 * share[3:]
    return pa.Configuration(load(name), qpos)


near_stands = st.builds(near_stand, st.sampled_from(NAMES), numbers(15, 1.0))


def weight(config: pa.Configuration) -> float:
    return config.robot.total_mass * GRAVITY


def check_newton_euler(config: pa.Configuration, result: pa.statics.GravityCompensation) -> None:
    """Check that the contact forces equal the weight, and have no moment about the CoM."""
    total = sum(result.contact_forces.values(), np.zeros(3))
    moment = sum(
        (
            np.cross(result.contact_points[foot] - config.center_of_mass(), force)
            for foot, force in result.contact_forces.items()
        ),
        np.zeros(3),
    )
    np.testing.assert_allclose(total, weight(config) * UP, atol=1e-9)
    np.testing.assert_allclose(moment, 0, atol=1e-9)


def check_cones(
    result: pa.statics.GravityCompensation,
    friction: float,
    normals: dict[str, np.ndarray] | None = None,
) -> None:
    """Assert unilateral forces inside the friction cones, and |f_t| / (mu f_n) as utilisations."""
    for foot, force in result.contact_forces.items():
        normal = UP if normals is None else normals[foot]
        push = float(force @ normal)
        slide = float(np.linalg.norm(force - push * normal))
        assert push >= -1e-9
        assert slide <= friction * push + 1e-9
        if push > 1e-6:
            expected = pytest.approx(slide / (friction * push), abs=1e-6)
            assert result.friction_utilisation[foot] == expected


def mujoco_joint_torques(
    config: pa.Configuration, result: pa.statics.GravityCompensation
) -> np.ndarray:
    """Inverse dynamics of the MJCF at rest under the given forces on its feet: (nv,)."""
    robot = config.robot
    model = robot.description.mjcf.copy().compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT.value
    model.dof_frictionloss[:] = 0.0
    data = evaluate_mujoco(robot, config.qpos, model=model)
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    needed = data.qfrc_inverse.copy()
    for foot, force in result.contact_forces.items():
        ground_torques = np.zeros(model.nv)
        body = int(model.site(robot.contact_frames[foot]).bodyid[0])
        point = result.contact_points[foot]
        mujoco.mj_applyFT(model, data, force, np.zeros(3), point, body, ground_torques)
        needed -= ground_torques
    return needed[addresses(robot)[1]]


# ------------------------------------------------------------------------------------- balance


@pytest.mark.slow
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@settings(max_examples=60)
@given(config=near_stands)
def test_contact_forces_and_torques_balance_gravity(
    distribution: pa.statics.ForceDistribution, config: pa.Configuration
) -> None:
    """References: Newton and Euler for the whole robot, and MuJoCo's inverse dynamics for the
    joints."""
    try:
        feet = config.robot.contact_points
        result = pa.gravity_compensation(config, feet, distribution=distribution)
    except pa.StaticsInfeasibleError:
        return  # test_feasible_balance_is_always_found judges refusals
    friction = config.robot.contacts[config.robot.contact_points[0]].sliding_friction
    check_newton_euler(config, result)
    check_cones(result, friction)
    needed = mujoco_joint_torques(config, result)
    np.testing.assert_allclose(needed[:6], 0, atol=1e-9)
    np.testing.assert_allclose(needed[6:], result.joint_torques, atol=1e-9)
    assert result.residual_force < 1e-9 * weight(config)
    assert result.residual_torque < 1e-9 * weight(config)
    np.testing.assert_array_equal(result.base_wrench, 0)
    np.testing.assert_allclose(
        result.motor_utilisation, np.abs(result.joint_torques) / config.robot.effort_limits
    )
    assert result.joint_names == config.robot.joint_names


# ------------------------------------------------------------------------------------- optimality


def null_space(result: pa.statics.GravityCompensation) -> np.ndarray:
    """Contact forces (3 n, m) without resultant force or moment, from the contact points."""
    columns = []
    for point in result.contact_points.values():
        x, y, z = point
        columns.append(np.vstack([np.eye(3), [[0, -z, y], [z, 0, -x], [-y, x, 0]]]))
    return np.asarray(linalg.null_space(np.hstack(columns)))


def jacobians(config: pa.Configuration, result: pa.statics.GravityCompensation) -> list[np.ndarray]:
    """Return the Jacobians, shape (3, nv), of the contact points with forces."""
    frames, points = config.robot.contact_frames, result.contact_points
    return [config.point_jacobian(frames[foot], points[foot]) for foot in result.contact_forces]


def joint_torques(
    config: pa.Configuration, result: pa.statics.GravityCompensation, forces: np.ndarray
) -> np.ndarray:
    """Return the joint torques that go with contact forces (3 n,)."""
    torques = config.gravity()
    for jacobian, force in zip(jacobians(config, result), forces.reshape(-1, 3), strict=True):
        torques -= jacobian.T @ force
    return torques[6:]


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.15, 0.8])
@settings(max_examples=30)
@given(config=near_stands, seed=st.integers(0, 1000))
def test_distribution_is_optimal_among_feasible_perturbations(
    friction: float, config: pa.Configuration, seed: int
) -> None:
    """Reference: costs of random forces in the null space of the balance, inside the friction
    cones."""
    random = np.random.default_rng(seed)
    for distribution in DISTRIBUTIONS:
        try:
            feet = config.robot.contact_points
            best = pa.gravity_compensation(
                config, feet, friction=friction, distribution=distribution
            )
        except pa.StaticsInfeasibleError:
            return
        check_cones(best, friction)
        forces = np.concatenate(list(best.contact_forces.values()))

        def cost(
            forces: np.ndarray,
            best: pa.statics.GravityCompensation = best,
            distribution: pa.statics.ForceDistribution = distribution,
        ) -> float:
            if distribution is not pa.statics.ForceDistribution.MIN_TANGENTIAL:
                torques = joint_torques(config, best, forces)
                if distribution is pa.statics.ForceDistribution.MIN_TORQUE:
                    return float(torques @ torques)
                return float(np.abs(torques / config.robot.effort_limits).max())
            return float(np.sum(forces.reshape(-1, 3)[:, :2] ** 2))

        free = null_space(best)
        assert free.shape[1] == 6
        # Among forces with equal tangential parts, those with the smallest normal parts are
        # optimal, unless the constraint that an unloaded foot must not pull is active.
        bears = forces[2::3].min() > 1e-3 * forces.max()
        if distribution is pa.statics.ForceDistribution.MIN_TANGENTIAL and bears:
            sideways = linalg.null_space(np.delete(np.eye(12), np.s_[2::3], axis=0) @ free)
            assert np.abs(forces[2::3] @ (free @ sideways)[2::3]).max() < 1e-4 * forces.max()
        for size in (1e-3, 1e-2, 1e-1, 1.0):
            for direction in random.standard_normal((40, 6)):
                other = forces + size * free @ (direction / np.linalg.norm(direction))
                push = other[2::3]
                slide = np.hypot(other[0::3], other[1::3])
                if (slide <= friction * push * (1 - 1e-5)).all():
                    least = 1e-9 * float(forces @ forces)
                    if (
                        distribution is pa.statics.ForceDistribution.MIN_MAX_TORQUE
                    ):  # its peak is within 1e-7 of the least
                        least = 0.0
                    assert cost(other) >= cost(forces) * (1 - 1e-6) - least


def linear_programme(
    config: pa.Configuration,
    result: pa.statics.GravityCompensation,
    share: np.ndarray,
    friction: float,
) -> float:
    """Return the smallest peak of share * |torque| with friction pyramids of 64 sides, by HiGHS."""
    sides = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    count = len(result.contact_forces)
    jacobian = np.concatenate(jacobians(config, result))
    faces = np.column_stack([np.cos(sides), np.sin(sides), np.full(64, -friction)])
    cones = np.column_stack([np.kron(np.eye(count), faces), np.zeros(64 * count)])
    torque = -share[:, None] * jacobian.T[6:]
    column = -np.ones((len(share), 1))
    hanging = share * config.gravity()[6:]
    outcome = optimize.linprog(
        [*np.zeros(3 * count), 1.0],
        A_ub=np.vstack([cones, np.hstack([torque, column]), np.hstack([-torque, column])]),
        b_ub=np.concatenate([np.zeros(64 * count), -hanging, hanging]),
        A_eq=np.column_stack([jacobian.T[:6], np.zeros(6)]),
        b_eq=config.gravity()[:6],
        bounds=(None, None),
    )
    assert outcome.status == 0
    return float(outcome.fun)


@pytest.mark.parametrize("friction", [0.1, 0.8])
def test_min_max_torque_equals_a_linear_program(variant: str, friction: float) -> None:
    """Reference: linear programs with pyramids inside and around the friction cone, whose friction
    coefficients differ by the factor cos(pi / 64).
    """
    robot = load(variant)
    stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, com=(0.01, 0.01)))
    config = pa.Configuration(robot, stand.qpos)
    strength = robot.effort_limits * np.linspace(1.0, 2.0, robot.nu)  # unequal motors
    weaker = pa.Configuration(with_efforts(robot, strength), stand.qpos)
    result = pa.gravity_compensation(weaker, friction=friction, distribution="min-max torque")
    peak = result.motor_utilisation.max()
    around, inside = (
        linear_programme(config, result, 1 / strength, friction * factor)
        for factor in (1.0, np.cos(np.pi / 64))
    )
    assert around * (1 - 1e-6) <= peak <= inside * (1 + 1e-6)
    even = pa.gravity_compensation(weaker, friction=friction)
    assert peak < 0.95 * even.motor_utilisation.max()


def test_min_max_torque_minimises_the_torque_without_limits() -> None:
    """Reference: the result with equal limits, which scale all torques alike."""
    config = at_stand("v3")
    free = pa.Configuration(with_efforts(config.robot, np.full(12, np.inf)), config.qpos)
    first, second = (
        pa.gravity_compensation(c, distribution="min-max torque") for c in (config, free)
    )
    np.testing.assert_allclose(first.joint_torques, second.joint_torques, atol=1e-6)


def test_min_max_torque_ignores_motors_with_a_limit_of_zero() -> None:
    """The peak of the other motors is at most the peak with twelve equal motors."""
    config = at_stand("v3")
    efforts = np.full(12, 3.0)
    efforts[0] = 0.0
    result = pa.gravity_compensation(
        pa.Configuration(with_efforts(config.robot, efforts), config.qpos),
        distribution="min-max torque",
    )
    assert np.isinf(result.motor_utilisation[0])
    least = pa.gravity_compensation(config, distribution="min-max torque").motor_utilisation.max()
    assert result.motor_utilisation[1:].max() <= least * (1 + 1e-6)


@pytest.mark.parametrize("distribution", ["x", None, 3, "MIN_TANGENTIAL"])
def test_unknown_distribution_raises(distribution: object) -> None:
    """The message lists the valid values."""
    with pytest.raises(
        pa.ConfigurationError, match=r"distribution.*'minimum tangential', 'minimum torque'"
    ):
        pa.gravity_compensation(at_stand("v3"), distribution=distribution)  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------- by hand

# v3 at zero angles: feet at x = 0.06881 and -0.08119 m, com at x = -0.00272409 m.
FRONT_SHARE = (0.08119 - 0.00272409) / 0.15


def v3_at_zero() -> pa.Configuration:
    return pa.Configuration(load("v3"), load("v3").neutral())


def test_minimum_tangential_forces_equal_the_lever_arm_shares() -> None:
    """Reference: the lever rule, by the distances of the CoM to the front and hind feet."""
    result = pa.gravity_compensation(
        v3_at_zero(), distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    )
    load_ = 3.170 * GRAVITY
    for foot, share in (("FR", FRONT_SHARE), ("RR", 1 - FRONT_SHARE)):
        for side in (foot, foot[0] + "L"):
            np.testing.assert_allclose(
                result.contact_forces[side], [0, 0, share * load_ / 2], atol=1e-5
            )


@pytest.mark.parametrize("name", ["long-leg", "v3"])
def test_minimum_tangential_forces_let_all_feet_creep_as_one_body(name: str) -> None:
    """Reference: rigid motion.

    With f_t = c v the velocities v of the feet on a slope are those of one rigid body.
    """
    robot, ground = load(name), pa.Ground(0.2, 0.7, {"FL": 0.01})
    task = pa.StandTask(ground=ground, com="inside", offset=None, com_margin=0.02)
    stand = pa.solve_stand(robot, task)
    result = pa.stance.stand_statics(
        robot, stand, distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    )
    assert max(result.friction_utilisation.values()) < 0.9
    normal = ground.normal()
    along = np.linalg.qr(np.column_stack([normal, np.eye(3)[:, :2]]))[0][:, 1:]  # (3, 2)
    rows, velocities = [], []
    for foot, force in result.contact_forces.items():
        law = GroundLaw.of_contact(robot, foot)
        viscosity = law.viscosity(law.depth(float(force @ normal)))
        velocities.append(along.T @ force / viscosity)
        turn = along.T @ np.cross(normal, result.contact_points[foot])
        rows.append(np.column_stack([np.eye(2), turn]))
    rigid = np.concatenate(rows)
    velocity = np.concatenate(velocities)
    motion = np.linalg.lstsq(rigid, velocity)[0]
    np.testing.assert_allclose(rigid @ motion, velocity, atol=1e-7 * np.abs(velocity).max())


def test_force_acts_at_half_the_depth_of_a_sunk_foot() -> None:
    """On a slope the arm of the tangential forces is shorter by half the depth."""
    robot = load("v3")
    task = pa.StandTask(ground=pa.Ground(0.2), pitch=-0.2)
    stand = pa.solve_stand(robot, task)
    config = pa.Configuration(robot, stand.qpos)
    depths = dict.fromkeys(robot.contact_points, 0.004)
    result = pa.gravity_compensation(config, normals=stand.normals, depths=depths)
    for foot, point in result.contact_points.items():
        centre = config.foot_positions()[foot]
        reach = robot.contact_radius[foot] - 0.002
        np.testing.assert_allclose(centre - point, reach * stand.normals[foot], atol=1e-12)
    torque = np.zeros(3)
    for foot, force in result.contact_forces.items():
        torque += np.cross(result.contact_points[foot] - config.center_of_mass(), force)
    np.testing.assert_allclose(torque, 0, atol=1e-9)


def test_knee_torque_equals_the_lever_arm_formula() -> None:
    """Closed form: ground force less the weights of foot and calf, each times its lever arm about
    the knee.
    """
    config = at_stand("original")
    result = pa.gravity_compensation(
        config, distribution=pa.statics.ForceDistribution.MIN_TANGENTIAL
    )
    for leg in ("FL", "FR", "RL", "RR"):
        knee = config.frame_position(f"{leg}_calf")
        foot = config.frame_position(f"{leg}_foot")
        arm = foot[0] - knee[0]  # of the foot; the calf's centre is half-way
        vertical = result.contact_forces[leg][2] - 0.02 * GRAVITY
        torque = (
            vertical - 0.05 * GRAVITY / 2
        ) * arm  # about y, an upward force in front: negative
        index = result.joint_names.index(f"{leg}_KFE")
        roll = config.qpos[7 + result.joint_names.index(f"{leg}_HAA")]
        assert roll == pytest.approx(0, abs=1e-9)
        assert result.joint_torques[index] == pytest.approx(torque, abs=1e-9)


# ------------------------------------------------------------------------------------- hanging


def test_hanging_torques_equal_the_joint_part_of_gravity(variant: str) -> None:
    """Reference: Pinocchio's gravity torques; the base bears the weight and its moment about the
    base."""
    config = near_stand(variant, np.linspace(-1, 1, 15))
    result = pa.gravity_compensation(config, [])
    np.testing.assert_allclose(result.joint_torques, config.gravity()[6:], atol=1e-15)
    np.testing.assert_allclose(result.base_wrench[:3], weight(config) * UP, atol=1e-9)
    arm = config.center_of_mass() - config.qpos[:3]
    moment = config.base_rotation().T @ np.cross(arm, weight(config) * UP)
    np.testing.assert_allclose(result.base_wrench[3:], moment, atol=1e-12)
    assert result.contact_forces == {}
    assert result.com_margin is None
    assert result.residual_force == pytest.approx(0, abs=1e-12)


# ------------------------------------------------------------------------------------- slopes


def tilt_vertical(angle: float, heading: float = 0.0) -> np.ndarray:
    """Return a unit vector at an angle to the vertical."""
    across = np.array([math.cos(heading), math.sin(heading), 0])
    return np.asarray(math.cos(angle) * UP + math.sin(angle) * across)


@settings(max_examples=10)
@given(angle=st.floats(0.05, 0.6), heading=st.floats(-3.0, 3.0))
def test_required_friction_on_a_slope_is_the_tangent_of_its_angle(
    angle: float, heading: float
) -> None:
    """However the feet share, the weight must be in the cone about the common normal."""
    config = at_stand("v3")
    normals = dict.fromkeys(config.robot.contact_points, tilt_vertical(angle, heading))
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.gravity_compensation(config, friction=0.9 * math.tan(angle), normals=normals)
    error = caught.value
    assert error.reason is pa.errors.Infeasibility.FRICTION
    assert error.friction_needed == pytest.approx(math.tan(angle), rel=1e-4)
    assert error.margin > 0
    assert error.feet == config.robot.contact_points
    enough = 1.01 * math.tan(angle)
    result = pa.gravity_compensation(config, friction=enough, normals=normals)
    check_newton_euler(config, result)
    check_cones(result, enough, normals)
    radius = config.robot.contact_radius["FR"]
    for foot, point in result.contact_points.items():
        down = config.foot_positions()[foot] - radius * normals[foot]
        np.testing.assert_allclose(point, down, atol=1e-12)


def test_friction_can_differ_between_feet() -> None:
    """References: Newton and Euler, and the friction cone of each foot."""
    config = at_stand("original")
    coefficients = {"FL": 0.0, "FR": 0.3, "RL": 1.0, "RR": 0.0}
    result = pa.gravity_compensation(config, friction=coefficients)
    check_newton_euler(config, result)
    for foot, force in result.contact_forces.items():
        assert np.hypot(*force[:2]) <= coefficients[foot] * force[2] + 1e-9


def test_length_of_a_normal_has_no_effect() -> None:
    """Reference: the result with a unit normal."""
    config = at_stand("original")
    first, second = (
        pa.gravity_compensation(config, normals={"FL": scale * tilt_vertical(0.2)})
        for scale in (1, 7)
    )
    np.testing.assert_allclose(first.joint_torques, second.joint_torques, atol=1e-9)


# ------------------------------------------------------------------------------------- infeasible


def test_two_feet_fail_if_the_com_is_beside_their_line() -> None:
    """Both right feet: the com is to the left of the line through them."""
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.gravity_compensation(v3_at_zero(), ["FR", "RR"])
    error = caught.value
    assert error.reason is pa.errors.Infeasibility.COM_OUTSIDE
    first, second = np.array([0.06881, -0.1015]), np.array([-0.08119, -0.0905])
    along = (second - first) / np.linalg.norm(second - first)
    arm = np.array([-0.00272409, 0]) - first
    distance = abs(along[0] * arm[1] - along[1] * arm[0])
    assert error.margin == pytest.approx(-distance, abs=1e-7)
    assert error.friction_needed is None
    assert f"{1e3 * distance:.1f} mm" in str(error)


def test_foot_that_would_pull_is_named_if_forces_are_below_one_newton() -> None:
    """Gravity of 0.3 m/s^2: all forces are below 1 N, and only RR would have to pull."""
    description = load("v3").description
    light = description.mjcf.copy()
    light.option.gravity = (0.0, 0.0, -0.3)
    robot = build_robot(replace(description, mjcf=light))
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.gravity_compensation(pa.Configuration(robot, v3_at_zero().qpos), ["FR", "RR", "RL"])
    assert caught.value.feet == ("RR",)


@pytest.mark.parametrize(
    "task",
    [pa.StandTask(swing={"FR": 0.02}), pa.StandTask(ground=pa.Ground(slope=0.1))],
    ids=["swing foot", "slope"],
)
def test_default_contacts_off_level_ground_are_refused(task: pa.StandTask) -> None:
    """Level ground under all feet gave the swing foot 2.3 N. References: weight, friction."""
    robot = load("v3")
    stand = pa.solve_stand(robot, task)
    config = pa.Configuration(robot, stand.qpos)
    for compute in (
        pa.gravity_compensation,
        pa.statics.support_region,
        lambda config: pa.statics.inverse_dynamics(config, np.zeros(robot.nv)),
    ):
        with pytest.raises(pa.ConfigurationError, match=r"pa\.stand_statics\(robot, stand\)"):
            compute(config)
    partial = dict(list(stand.normals.items())[:2])
    with pytest.raises(pa.ConfigurationError, match="contacts: "):
        pa.gravity_compensation(config, normals=partial)
    right = pa.stand_statics(robot, stand)
    assert right.contact_forces.keys() == set(stand.stance_feet)
    check_newton_euler(config, right)
    stated = pa.gravity_compensation(config, stand.stance_feet, normals=stand.normals)
    assert stated.joint_torques == pytest.approx(right.joint_torques, abs=1e-9)


def test_default_contacts_on_level_ground_at_any_height_are_accepted() -> None:
    """Gravity is uniform: height does not change the forces. A penetration is no inclination."""
    config = at_stand("v3")
    lifted = config.qpos.copy()
    lifted[2] += 1.0
    lifted[8] += 0.004  # less than a penetration of soft ground
    result = pa.gravity_compensation(pa.Configuration(config.robot, lifted))
    check_newton_euler(pa.Configuration(config.robot, lifted), result)
    known = pa.gravity_compensation(config).joint_torques
    assert result.joint_torques == pytest.approx(known, abs=0.02)


def test_shared_contacts_are_read_only() -> None:
    """The contacts on level ground are cached per robot, so a change would affect all callers."""
    robot = load("v3")
    shared = make_contacts(robot, None, None, None, None)
    assert make_contacts(robot, None, None, None, None) is shared
    for array in (shared.normals, shared.friction, shared.offsets):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_required_friction_is_found_if_it_is_several_hundred() -> None:
    """Reference: a linear program. Three feet on slopes need 400 times their friction.

    The cone program failed for coefficients of 1,000 and more, and the message named a foot that
    would pull, instead of the friction.
    """
    share = np.zeros(15)
    share[[1, 2, 6, 7, 9, 13]] = 0.71875, 0.75, -0.46875, -0.5, -0.46875, -0.90625
    config = near_stand("original", share)
    tilts = [(0.0, 0.0), (0.6015625, 3.0), (0.4140625, -1.0), (0.11156, -0.0390625)]
    feet = config.robot.contact_points
    slopes = {foot: tilt_vertical(*tilt) for foot, tilt in zip(feet, tilts, strict=True)}
    normals = {foot: slopes[foot] for foot in ("FR", "RL", "RR")}
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.gravity_compensation(config, [*normals], friction=1.0, normals=normals)
    assert caught.value.reason is pa.errors.Infeasibility.FRICTION
    needed = caught.value.friction_needed
    assert needed is not None
    radius = config.robot.contact_radius
    points = {
        foot: config.foot_positions()[foot] - radius[foot] * normal
        for foot, normal in normals.items()
    }
    com = config.center_of_mass()
    assert forces_exist(points, com, 1.02 * needed, normals)  # the pyramid is 1 % inside the cone
    # Near the limit the forces grow beyond 1,000 weights, and tolerances decide: HiGHS has 420.
    assert not forces_exist(points, com, 0.85 * needed, normals)


def forces_exist(
    points: dict[str, np.ndarray],
    com: np.ndarray,
    friction: float,
    normals: dict[str, np.ndarray],
) -> bool:
    """Return True if forces in pyramids inside the friction cones balance a unit weight, by
    HiGHS.
    """
    wrenches = []
    for foot, point in points.items():
        normal = normals[foot]
        across = linalg.null_space(normal[None, :])
        for angle in np.linspace(0, 2 * math.pi, 24, endpoint=False):
            side = across @ [math.cos(angle), math.sin(angle)]
            force = normal + friction * side
            wrenches.append(np.concatenate([force, np.cross(point - com, force)]))
    columns = np.array(wrenches).T
    wrench = np.array([0, 0, 1.0, 0, 0, 0])
    found = optimize.linprog(np.zeros(columns.shape[1]), A_eq=columns, b_eq=wrench, method="highs")
    return bool(found.status == 0)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    name=st.sampled_from(["original", "v3"]),
    share=numbers(15, 1.0),
    feet=st.sets(st.sampled_from(["FR", "FL", "RR", "RL"]), min_size=1),
    friction=st.floats(0.05, 1.2),
    tilts=st.lists(
        st.tuples(st.floats(0, 1.2), st.floats(-math.pi, math.pi)), min_size=4, max_size=4
    ),
)
def test_feasible_balance_is_always_found(
    name: str,
    share: np.ndarray,
    feet: set[str],
    friction: float,
    tilts: list[tuple[float, float]],
) -> None:
    """Reference: a linear program for one to four feet on random slopes. A refusal means that the
    linear program finds no forces either.
    """
    config = near_stand(name, share)
    contacts = sorted(feet)
    normals = {
        foot: tilt_vertical(*tilt)
        for foot, tilt in zip(config.robot.contact_points, tilts, strict=True)
    }
    normals = {foot: normals[foot] for foot in contacts}
    try:
        result = pa.gravity_compensation(config, contacts, friction=friction, normals=normals)
    except pa.StaticsInfeasibleError as error:
        refusal = error
    else:
        check_newton_euler(config, result)
        check_cones(result, friction, normals)
        return
    points = {
        foot: config.foot_positions()[foot] - config.robot.contact_radius[foot] * normals[foot]
        for foot in contacts
    }
    com = config.center_of_mass()
    assert not forces_exist(points, com, 0.999 * friction, normals)
    if refusal.reason is pa.errors.Infeasibility.FRICTION:
        assert refusal.friction_needed is not None
        assert refusal.friction_needed > 0.999 * friction
        needed = refusal.friction_needed
        if needed < 5:  # a pyramid of 24 sides is 1 % inside its cone
            assert forces_exist(points, com, 1.02 * needed, normals)
            assert not forces_exist(points, com, 0.99 * needed, normals)
    else:
        assert not forces_exist(points, com, 1e3, normals)


@pytest.mark.parametrize(
    "tilts",
    [
        {"FR": (0.6, -2.5), "FL": (0.9, 0.7), "RL": (0.4, -2.3)},
        {"FR": (0.8, -2.4), "FL": (0.5, -0.3), "RR": (0.8, -0.5), "RL": (0.5, -2.9)},
        {"FR": (0.7, 2.6), "FL": (0.8, 2.1), "RL": (0.5, 2.8)},
        {"FR": (0.4, 2.2), "FL": (0.5, 2.1), "RL": (0.4, -2.7)},
    ],
)
def test_infeasibility_error_has_no_numerical_warnings(
    tilts: dict[str, tuple[float, float]],
) -> None:
    """Warnings are errors in tests; the solver's result for an infeasible program may be huge."""
    normals = {foot: tilt_vertical(*tilt) for foot, tilt in tilts.items()}
    with pytest.raises(pa.StaticsInfeasibleError, match="friction too low"):
        pa.gravity_compensation(at_stand("v3"), list(tilts), friction=0.3, normals=normals)


def test_feet_on_a_ceiling_fail_because_they_would_pull() -> None:
    """All normals point downwards, so that only pulling forces could hold the weight."""
    config = at_stand("v3")
    normals = dict.fromkeys(config.robot.contact_points, -UP)
    with pytest.raises(pa.StaticsInfeasibleError, match="pull") as caught:
        pa.gravity_compensation(config, normals=normals)
    assert caught.value.reason is pa.errors.Infeasibility.PULL
    assert set(caught.value.feet) == set(config.robot.contact_points)
    assert caught.value.friction_needed is None


# ------------------------------------------------------------------------------------- margins


@pytest.mark.parametrize(
    ("com", "margin"),
    [
        ((0, 0, 5), 1.0),  # at the middle, whatever its height
        ((1.5, 0, 0), 0.5),
        ((1.5, 0.8, 0), 0.2),
        ((2, 0, 0), 0.0),
        ((2.5, 0, 0), -0.5),
        ((5, 5, 0), -5.0),
    ],
)
def test_com_margin_equals_the_distance_to_a_rectangles_edge(
    com: tuple[float, ...], margin: float
) -> None:
    """Reference: the closed form for a rectangle of 4 m by 2 m; negative outside."""
    points = {f"{x}{y}": np.array([x, y, 0.1 * x]) for x in (-2, 2) for y in (-1, 1)}
    assert com_margin(np.array(com, dtype=float), points) == pytest.approx(margin, abs=1e-12)


# ------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"contacts": ["FR", "FL", "FR"]}, "named twice"),
        ({"friction": -0.1}, "friction"),
        ({"friction": {"FR": 1.0}}, "friction"),
        ({"friction": "much"}, "friction"),
        ({"normals": {"FR": (0, 0, 0)}}, "normals"),
        ({"normals": {"FR": (0, 1)}}, "normals"),
        ({"normals": {"FR": "up"}}, "normals"),
        ({"normals": {"FR": None}}, "normals"),
        ({"depths": {"FR": math.nan}}, "depths"),  # was LinAlgError
        ({"depths": {"FR": math.inf}}, "depths"),
        ({"depths": {"FR": "deep"}}, "depths"),
        ({"depths": {"FR": None}}, "depths"),
        ({"depths": {"FR": 5e3, "FL": -5e3}}, r"depths\[FR\]"),  # the sum of the depths is 0
        ({"contacts": ""}, "contacts"),  # a text was read as a list without contacts
        ({"contacts": "FR"}, "contacts"),
    ],
)
def test_gravity_compensation_raises_for_invalid_arguments(
    arguments: dict[str, object], message: str
) -> None:
    """The message names the argument."""
    with pytest.raises(pa.ConfigurationError, match=message):
        pa.gravity_compensation(at_stand("v3"), **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "arguments",
    [
        {"contacts": ["FR", "tail"]},
        {"normals": {"tail": UP}},
        {"friction": {"tail": 1.0, "FR": 1, "FL": 1, "RR": 1, "RL": 1}},
    ],
)
def test_unknown_feet_raise(arguments: dict[str, object]) -> None:
    """The message lists the known feet."""
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        pa.gravity_compensation(at_stand("v3"), **arguments)  # type: ignore[arg-type]


def test_contacts_of_a_robot_with_a_fixed_base_raise() -> None:
    """A fixed base bears all loads, so that contact forces are not determined."""
    robot = load("v3", fixed_base=True)
    with pytest.raises(pa.ConfigurationError, match="fixed base"):
        pa.gravity_compensation(pa.Configuration(robot, robot.neutral()), ["FR"])


@pytest.mark.parametrize("torqueless", [0, 1, 2])
@pytest.mark.parametrize("feet", [3, 4, 8])
def test_minimum_torques_equal_the_null_space_solution(feet: int, torqueless: int) -> None:
    """Reference: pseudoinverse in the null space of the balance.

    With forces that cost no torque, the shortest of these forces.
    """
    random = np.random.default_rng(feet)
    base, joints = random.normal(size=(6, 3 * feet)), random.normal(size=(12, 3 * feet))
    free = linalg.null_space(base)
    idle = free[:, :torqueless]
    joints -= joints @ idle @ idle.T
    weight, torques = random.normal(size=6), random.normal(size=12)
    problem = Balance(base, weight, joints, torques, np.tile(UP, (feet, 1)))
    found = problem.solve(None, problem.joint_rows, problem.joint_load)
    particular = np.linalg.pinv(base) @ weight
    best = np.linalg.pinv(joints @ free, rcond=1e-10) @ (torques - joints @ particular)
    np.testing.assert_allclose(found, particular + free @ best, rtol=0, atol=1e-11)


def test_three_feet_fail_if_the_com_is_beyond_their_diagonal() -> None:
    """The CoM is outside the support triangle, so that the single foot would have to pull."""
    with pytest.raises(pa.StaticsInfeasibleError, match="com outside") as caught:
        pa.gravity_compensation(v3_at_zero(), ["FR", "RR", "RL"])
    assert caught.value.margin < 0
    assert caught.value.feet == ("RR",)  # the foot that would have to pull


@pytest.mark.parametrize(
    ("force", "friction", "utilisation"),
    [
        ((3.0, 4.0, 10.0), 0.5, 1.0),
        ((0.0, 0.0, 0.0), 0.5, 0.0),
        ((1.0, 0.0, 0.0), 0.5, math.inf),
        ((1.0, 0.0, 5.0), 0.0, math.inf),
    ],
)
def test_friction_utilisation_without_normal_force_or_friction_is_infinite(
    force: tuple[float, float, float], friction: float, utilisation: float
) -> None:
    """Closed form: |f_t| / (mu f_n), here 5 N / (0.5 x 10 N)."""
    assert friction_utilisation_of(force, (0.0, 0.0, 1.0), friction, 1e-9) == utilisation


def test_load_of_zero_needs_no_torques_and_forces() -> None:
    """As without gravity: zero forces balance a load of exactly zero without any tolerance."""
    config = v3_at_zero()
    contacts = make_contacts(config.robot, None, None, None, None)
    held = balance_load(config, np.zeros(config.robot.nv), contacts)
    assert not held.joint_torques.any()
    assert not np.array(list(held.contact_forces.values())).any()


@pytest.mark.slow
def test_passive_joints_have_no_torque_if_other_forces_balance(tmp_path: Path) -> None:
    """Reference: the forces lift the weight, and have no moment about the centre of mass.

    The roll joints of both flat feet are passive, with springs of 38 N m/rad that are displaced by
    0.01 rad. The minimum tangential forces do not balance the springs; other centres of pressure
    do.
    """
    drawn = replace(
        random_legged.draw_robot(720007), motors="position", base="free", keyframe=True, floor=True
    )
    pair = random_legged.write_robot(drawn, tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    passive = [robot.joint_names.index(name) for name in robot.description.passive_joints]
    assert len(passive) == 2
    qpos = pa.solve_stand(robot).qpos.copy()
    qpos[7:][passive] += 0.01
    config = pa.Configuration(robot, qpos)
    driven = replace(robot, description=replace(robot.description, passive_joints=()))
    usual = pa.gravity_compensation(pa.Configuration(driven, config.qpos))
    assert np.abs(usual.joint_torques[passive]).min() > 0.3
    found = pa.gravity_compensation(config)
    assert np.abs(found.joint_torques[passive]).max() < 1e-9
    forces = np.array([*found.contact_forces.values()])
    levers = np.array([*found.contact_points.values()]) - config.center_of_mass()
    assert forces.sum(axis=0) == pytest.approx([0.0, 0.0, robot.weight], abs=1e-7)
    assert np.cross(levers, forces).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-7)
    assert forces[:, 2].min() >= 0.0


def test_three_feet_share_the_weight_by_barycentric_coordinates() -> None:
    """Closed form: with FR, FL and RL on the ground the balance has a single solution. Foot
    positions, CoM and mass are those of the files."""
    corners = np.array([[0.06881, -0.1015, 1], [0.06881, 0.1015, 1], [-0.08119, 0.0905, 1]]).T
    shares = np.linalg.solve(corners, [-0.00272409, 0, 1])
    assert (shares > 0).all()
    feet = ("FR", "FL", "RL")
    for distribution in DISTRIBUTIONS:
        result = pa.gravity_compensation(v3_at_zero(), feet, distribution=distribution)
        loads = [result.contact_forces[foot][2] for foot in feet]
        np.testing.assert_allclose(loads, shares * 3.170 * GRAVITY, atol=1e-5)
        assert set(result.contact_forces) == set(feet)


def test_torques_do_not_depend_on_the_velocity() -> None:
    still = at_stand("v3")
    moving = pa.Configuration(still.robot, still.qpos, np.ones(18))
    first, second = (pa.gravity_compensation(config) for config in (still, moving))
    np.testing.assert_array_equal(first.joint_torques, second.joint_torques)


def test_more_friction_needs_no_more_torque() -> None:
    """More friction permits more forces, so the smallest torque does not increase."""
    config, least = at_stand("v3"), pa.statics.ForceDistribution.MIN_TORQUE
    torques = [
        np.linalg.norm(
            pa.gravity_compensation(config, friction=mu, distribution=least).joint_torques
        )
        for mu in (0.0, 0.05, 0.1, 0.2, 0.5, 1.0)
    ]
    assert all(after <= before + 1e-6 for before, after in itertools.pairwise(torques))
    assert torques[0] > 1.02 * torques[-1]


def test_feet_without_friction_do_not_pull() -> None:
    """The CoM of ``original`` is 3.8 mm outside of three feet. A foot that pulls balanced it."""
    with pytest.raises(pa.StaticsInfeasibleError, match=r"3\.8 mm outside"):
        pa.gravity_compensation(at_stand("original"), ["FR", "RL", "RR"], friction=0.0)


def test_foot_without_friction_is_unloaded_beside_the_com() -> None:
    """The CoM is near the edge of the feet, so that a foot has no load. Reference: the forces with
    friction, which are vertical as well."""
    robot = load("v3")
    config = pa.Configuration(
        robot, pa.solve_stand(robot, pa.StandTask(offset=(0.055, 0.045))).qpos
    )
    smooth, rough = (pa.gravity_compensation(config, friction=mu) for mu in (0.0, 0.6))
    loads = [float(smooth.contact_forces[point][2]) for point in smooth.contact_forces]
    assert min(loads) == pytest.approx(0.0, abs=1e-4)
    for point, force in smooth.contact_forces.items():
        assert force == pytest.approx(rough.contact_forces[point], abs=1e-3)


def test_forces_without_friction_are_vertical() -> None:
    """References: closed form, no tangential force; Newton and Euler."""
    result = pa.gravity_compensation(at_stand("v3"), friction=0.0)
    for force in result.contact_forces.values():
        np.testing.assert_allclose(force[:2], 0, atol=1e-9)
    check_newton_euler(at_stand("v3"), result)


@pytest.mark.parametrize("name", ["long-leg", "v3"])
def test_minimum_tangential_forces_are_vertical_on_level_steps(name: str) -> None:
    """Minimum torque has horizontal forces of more than 0.5 % of the weight there."""
    robot = load(name)
    ground = pa.Ground(heights={"FR": 0.02, "RL": 0.01})
    stand = pa.solve_stand(robot, pa.StandTask(ground=ground, com=(0.02, -0.015)))
    distributions = pa.statics.ForceDistribution
    horizontal = {
        distribution: max(
            np.linalg.norm(force[:2])
            for force in pa.stance.stand_statics(
                robot, stand, distribution=distribution
            ).contact_forces.values()
        )
        for distribution in (distributions.MIN_TANGENTIAL, distributions.MIN_TORQUE)
    }
    scale = weight(at_stand(name))
    assert horizontal[distributions.MIN_TANGENTIAL] < 1e-6 * scale
    assert horizontal[distributions.MIN_TORQUE] > 5e-3 * scale


def test_stands_of_variants_share_the_weight_in_quarters_with_the_margin_of_their_feet(
    variant: str,
) -> None:
    """The CoM is at the centre of the feet, 0.075 m from the front and the rear edge."""
    config = at_stand(variant)
    result = pa.gravity_compensation(config)
    for force in result.contact_forces.values():
        np.testing.assert_allclose(force, [0.0, 0.0, weight(config) / 4], atol=1e-7)
    assert result.com_margin == pytest.approx(0.075, abs=1e-9)
    np.testing.assert_allclose(result.center_of_mass, config.center_of_mass())


def test_torques_of_a_fixed_base_equal_those_of_the_hanging_robot() -> None:
    free, fixed = load("v3"), load("v3", fixed_base=True)
    qpos = free.neutral()
    qpos[7:] = np.linspace(-0.3, 0.4, 12)
    hanging = pa.gravity_compensation(pa.Configuration(free, qpos), [])
    held = pa.gravity_compensation(pa.Configuration(fixed, qpos[7:]))
    np.testing.assert_allclose(held.joint_torques, hanging.joint_torques, atol=1e-12)
    assert held.contact_forces == {}


def test_friction_between_two_walls_carries_the_weight() -> None:
    """References: Newton and Euler, and the friction cones. The normals of left and right feet are
    opposite and horizontal.
    """
    config = at_stand("original")
    normals = {
        foot: np.array([0, -1.0 if foot.endswith("L") else 1.0, 0])
        for foot in config.robot.contact_points
    }
    result = pa.gravity_compensation(config, friction=0.8, normals=normals)
    check_newton_euler(config, result)
    check_cones(result, 0.8, normals)
    assert all(result.contact_forces[foot] @ normal > 1 for foot, normal in normals.items())


@settings(max_examples=30)
@given(com=numbers(2, 3.0))
def test_com_margin_of_a_triangle_ignores_a_contact_inside(com: np.ndarray) -> None:
    """Reference: the half-planes of the three edges."""
    corners = np.array([[0.0, 0], [2, 0], [0, 1]])
    points = {str(i): np.array([*corner, 0]) for i, corner in enumerate([*corners, (0.4, 0.3)])}
    inward = [(0, 1), (1, 0), (-1 / math.sqrt(5), -2 / math.sqrt(5))]
    edges = [
        np.dot(normal, com - corner)
        for normal, corner in zip(inward, [corners[0], corners[0], corners[1]], strict=True)
    ]
    margin = com_margin(np.array([*com, 1.0]), points)
    if min(edges) > 0:
        assert margin == pytest.approx(min(edges), abs=1e-12)
    else:  # the nearest point may be a corner
        assert margin <= min(edges) + 1e-12
        assert margin >= -np.linalg.norm(corners - com, axis=1).min() - 1e-12


def test_com_in_front_of_all_feet_is_the_cause_with_its_distance() -> None:
    """Reference: distance [m] of the CoM ahead of the front feet."""
    robot = load("original")
    qpos = robot.neutral()
    qpos[8::3] = 1.2
    config = pa.Configuration(robot, qpos)
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        pa.gravity_compensation(config)
    assert caught.value.reason is pa.errors.Infeasibility.COM_OUTSIDE
    ahead = config.center_of_mass()[0] - config.foot_positions()["FL"][0]
    assert caught.value.margin == pytest.approx(-ahead, abs=1e-9)


def test_text_instead_of_a_list_of_feet_is_refused() -> None:
    with pytest.raises(pa.PupperAnalysisError):
        pa.gravity_compensation(at_stand("v3"), "FR")


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_distribution_may_be_given_by_its_value(distribution: pa.statics.ForceDistribution) -> None:
    config = at_stand("v3")
    first, second = (
        pa.gravity_compensation(config, distribution=form)
        for form in (distribution, distribution.value)
    )
    np.testing.assert_array_equal(first.joint_torques, second.joint_torques)


def test_minimum_torque_is_below_that_of_minimum_tangential_forces(variant: str) -> None:
    """For v3, the norm of the torques is smaller by more than 0.1 %. For variants with equal legs
    and feet below the hips, the norms are equal. Minimum tangential forces are the default.
    """
    config, kinds = at_stand(variant), pa.statics.ForceDistribution
    least, tangential, default = (
        pa.gravity_compensation(config, **options).joint_torques
        for options in (
            {"distribution": kinds.MIN_TORQUE},
            {"distribution": kinds.MIN_TANGENTIAL},
            {},
        )
    )
    np.testing.assert_array_equal(default, tangential)
    if variant.startswith("v3"):
        assert np.linalg.norm(least) < 0.999 * np.linalg.norm(tangential)
    else:
        assert np.linalg.norm(least) == pytest.approx(np.linalg.norm(tangential), rel=1e-9)


def test_a_larger_torque_with_an_unknown_limit_is_the_hardest_load() -> None:
    """Reference: the definition. Earlier, the result for i2rt's YAM was a finger with 0.00 N = 0 %,
    although another joint had a larger torque with an unknown limit.
    """
    statics = pa.gravity_compensation(at_stand("v3"))
    torques = np.zeros_like(statics.joint_torques)
    torques[:4] = 0.5, -8.6, 2.0, 3.0

    def hardest(*shares: float) -> int:
        utilisation = np.zeros_like(torques)
        utilisation[:4] = shares
        changed = replace(statics, joint_torques=torques, motor_utilisation=utilisation)
        return find_hardest_motor(changed)

    nan, inf = math.nan, math.inf
    assert hardest(0.5, nan, 0.1, nan) == 1
    assert hardest(0.5, 0.4, 0.1, nan) == 3  # 3 N m with an unknown limit, 0.5 N m at 50 %
    assert hardest(0.1, 0.9, 0.1, nan) == 1
    assert hardest(nan, nan, nan, nan) == 1
    assert hardest(inf, nan, inf, 0.9) == 2


def test_dependent_joints_have_no_utilisation_if_no_limit_is_known(tmp_path: Path) -> None:
    """Reference: a robot whose belts drive its knees; the knees have no motor of their own."""
    robot = pa.load_robot(*belts(tmp_path))
    assert robot.closure is not None
    config = pa.Configuration(robot, pa.solve_stand(robot).qpos)
    dependent = robot.closure.dependent_joints
    known = pa.gravity_compensation(config).motor_utilisation
    assert known[dependent] == pytest.approx(0.0, abs=0.0)
    unlimited = with_efforts(robot, np.full(robot.nu, np.inf))
    unknown = pa.gravity_compensation(pa.Configuration(unlimited, config.qpos))
    assert np.isnan(unknown.motor_utilisation).all()
