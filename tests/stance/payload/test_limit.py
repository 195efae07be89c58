"""How much a stand carries: closed forms, other engines, and MuJoCo with the mass on its back."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.analysis.payload import NEAR, study_payload
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import find_place, find_tool
from pupper_analysis.simulation import payload
from pupper_analysis.simulation.payload import simulate_payload
from pupper_analysis.stance.payload.first_order import SmallPayload
from pupper_analysis.stance.payload.limit import contact_limit, motor_limit, payload_limit
from pupper_analysis.stance.payload.servo_limit import (
    Failure,
    PayloadCommand,
    find_first_failing,
    servo_limit,
)
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from tests.support.engines import mujoco_at, with_efforts
from tests.support.random_legged import drawn, written
from tests.support.states import random_state
from tests.support.variants import NAMES, load, stand_of

EVEN = pa.statics.ForceDistribution.MIN_TANGENTIAL
ON_TOP, AHEAD = (0.0, 0.0, 0.05), (0.2, 0.0, 0.05)


# ------------------------------------------------------------------------------------- contacts


@pytest.mark.parametrize("name", NAMES)
def test_tipping_is_the_balance_about_the_edge(name: str) -> None:
    """Ahead of the front feet: m (a - d) = M d, with d and a from the com to edge and mass."""
    robot, stand = load(name), stand_of(name)
    com = pa.Configuration(robot, stand.qpos).center_of_mass()[0]
    edge = max(place[0] for place in stand.contact_points.values()) - com
    arm = stand.qpos[0] + AHEAD[0] - com
    limit = contact_limit(robot, stand, AHEAD)
    assert limit.failure is Failure.TIPPING
    assert limit.mass == pytest.approx(robot.total_mass * edge / (arm - edge), rel=1e-5)
    front = {foot for foot, place in stand.contact_points.items() if place[0] > com}
    assert set(limit.where) == set(robot.contact_points) - front


@pytest.mark.parametrize("pitch", [-0.2, 0.2])
def test_a_point_on_a_tilted_base_is_where_the_base_has_it(pitch: float) -> None:
    """High above a base that looks down it is further ahead, by h sin(pitch), and tips sooner."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(pitch=pitch))
    com = pa.Configuration(robot, stand.qpos).center_of_mass()[0]
    point = (0.2, 0.0, 0.1)
    place = stand.qpos[0] + 0.2 * math.cos(pitch) + 0.1 * math.sin(pitch)
    edge = max(at[0] for at in stand.contact_points.values())
    mass = robot.total_mass * (edge - com) / (place - edge)
    assert contact_limit(robot, stand, point).mass == pytest.approx(mass, rel=1e-5)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_a_payload_is_where_the_base_has_it_in_both_models(name: str) -> None:
    """Off all axes, on a base that is turned about all of them."""
    robot, mass, point = load(name), 0.7, np.array([0.11, -0.06, 0.09])
    loaded = with_payload(robot, mass, tuple(point))
    qpos, qvel = random_state(robot, 3)
    config = pa.Configuration(robot, qpos)
    place = qpos[:3] + Rotation.from_quat(qpos[3:7], scalar_first=True).apply(point)
    total = robot.total_mass + mass
    com = (robot.total_mass * config.center_of_mass() + mass * place) / total
    np.testing.assert_allclose(pa.Configuration(loaded, qpos).center_of_mass(), com, atol=1e-12)
    data = mujoco_at(loaded, qpos, qvel)
    np.testing.assert_allclose(data.subtree_com[1], com, atol=1e-12)
    assert loaded.total_mass == pytest.approx(total, rel=1e-12)
    assert loaded.mj_model.body_mass.sum() == pytest.approx(total, rel=1e-12)
    # Its weight's moment about the base, in the base's axes, is what gravity gains.
    arm = np.cross(point, config.base_rotation().T @ robot.gravity * mass)
    gained = pa.Configuration(loaded, qpos).gravity() - config.gravity()
    np.testing.assert_allclose(gained[:6], [*(-mass * robot.gravity), *-arm], atol=1e-10)
    np.testing.assert_allclose(gained[6:], 0.0, atol=1e-10)


def test_a_plane_slides_at_one_angle_whatever_it_carries() -> None:
    robot = load("v3")
    steep = pa.StandTask(ground=pa.Ground(slope=0.7), pitch=-0.6)
    stand = pa.solve_stand(robot, steep)
    limit = contact_limit(robot, stand, (0.0, 0.0, 0.0))
    assert limit.failure is not Failure.SLIDING


@pytest.mark.parametrize("name", ["v3", "original"])
def test_a_mass_far_ahead_tips_it_over_its_fore_feet(name: str) -> None:
    """On soft ground its feet are not quite level, which no grip makes use of."""
    robot = load(name)
    stand = pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask())
    ahead = 2 * robot.stand_height
    limit = contact_limit(robot, stand, (ahead, 0.0, 0.0))
    assert limit.failure is Failure.TIPPING
    assert set(limit.where) == {"RL", "RR"}
    # Of moments about the line through the fore feet, with the mass ahead of it.
    fore = min(stand.contact_points[foot][0] for foot in ("FL", "FR"))
    com = pa.Configuration(robot, stand.qpos).center_of_mass()[0]
    lever = stand.qpos[0] + ahead - fore
    assert limit.mass == pytest.approx(robot.total_mass * (fore - com) / lever, rel=1e-3)


# ------------------------------------------------------------------------------------- motors


@pytest.mark.parametrize("name", NAMES)
def test_at_the_motors_limit_one_is_at_its_end_with_the_forces_that_last(name: str) -> None:
    robot, stand = load(name), stand_of(name)
    limit = motor_limit(robot, stand, ON_TOP)
    held = pa.stance.stand_statics(
        with_payload(robot, limit.mass, ON_TOP), stand, distribution=EVEN
    )
    assert held.motor_utilisation.max() == pytest.approx(1.0, abs=1e-9)
    busiest = robot.joint_names[int(held.motor_utilisation.argmax())]
    assert limit.failure is Failure.MOTOR
    assert busiest in limit.where
    assert max(held.friction_utilisation.values()) == 0.0  # vertical forces
    below = pa.stance.stand_statics(
        with_payload(robot, 0.9 * limit.mass, ON_TOP), stand, distribution=EVEN
    )
    assert below.motor_utilisation.max() < 1


def test_a_payload_on_a_leg_is_held_by_the_motors_that_carry_it() -> None:
    robot, stand = load("v3"), stand_of("v3")
    tool = find_tool(robot, "leg_front_l_2").moved((0.0, 0.02, 0.06))
    at = tool.position(pa.Configuration(robot, stand.qpos)) - stand.qpos[:3]
    limits = []
    for place in (tool, find_place(robot, at)):  # the same point, of another link
        limit = motor_limit(robot, stand, place)
        for share, held in ((0.99, True), (1.01, False)):
            laden = with_payload(robot, share * limit.mass, place)
            torques = pa.stance.stand_statics(laden, stand, distribution=EVEN).joint_torques
            assert bool((np.abs(torques) < robot.effort_limits).all()) is held
        limits.append(limit.mass)
    assert abs(limits[0] - limits[1]) > 0.1 * limits[1]


@pytest.mark.longest
def test_a_payload_on_a_tail_is_borne_until_its_motor_or_a_foot_gives_way(tmp_path: Path) -> None:
    pair = written(drawn(57), tmp_path)
    strong = pa.load_robot(pair.urdf, pair.mjcf)
    tail = next(name for name in strong.joint_names if "wag" in name)
    place = find_tool(strong, "tail").moved((0.02, 0.05, 0.0))
    efforts = np.where(np.array(strong.joint_names) == tail, 8.0, strong.effort_limits)
    stand = pa.solve_stand(strong)
    for robot, failure in (
        (strong, Failure.TIPPING),
        (with_efforts(strong, efforts), Failure.MOTOR),
    ):
        limit = payload_limit(robot, stand, place)
        assert limit.failure is failure
        assert limit.link == "tail"
        assert (limit.where == (tail,)) is (failure is Failure.MOTOR)
        trials = [
            simulate_payload(robot, stand, share * limit.mass, place, duration=3)
            for share in (0.95, 1.05)
        ]
        assert [trial.held for trial in trials] == [True, False]


def test_where_a_foot_lets_go_the_motors_limit_is_found_by_search() -> None:
    """Off to a corner three feet carry in the end: beyond where torques are linear."""
    robot, stand = load("original"), stand_of("original")
    point = (0.04, 0.035, 0.05)
    limit = motor_limit(robot, stand, point)
    assert limit.failure is Failure.MOTOR
    held = pa.stance.stand_statics(with_payload(robot, limit.mass, point), stand, distribution=EVEN)
    assert held.motor_utilisation.max() == pytest.approx(1.0, abs=2e-3)
    assert held.motor_utilisation.max() <= 1 + 1e-12  # rounding


@pytest.mark.parametrize("strength", [1.1, 2.0])
def test_a_foot_that_begins_to_carry_is_no_line(strength: float) -> None:
    """With the com at a corner the far foot carries nothing, until the load is laid above it.

    Torques were taken as linear from there on: 4.5 % below the limit, and 3.3 % above.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(com=(0.05, 0.04)))
    empty = pa.stance.stand_statics(robot, stand, distribution=EVEN)
    assert min(force[2] for force in empty.contact_forces.values()) < 1e-3
    weak = with_efforts(robot, strength * float(np.abs(empty.joint_torques).max()))
    limit = motor_limit(weak, stand, (-0.05, -0.05, 0.05))
    laden = with_payload(weak, limit.mass, (-0.05, -0.05, 0.05))
    held = pa.stance.stand_statics(laden, stand, distribution=EVEN)
    assert held.motor_utilisation.max() == pytest.approx(1.0, abs=1e-3)
    assert limit.where


def test_on_a_slope_the_motors_limit_is_found_by_search() -> None:
    robot = load("v3")
    stand = pa.stance.solve_stand_on_soft_ground(
        robot, pa.StandTask(ground=pa.Ground(slope=0.2), pitch=-0.2)
    )
    limit = motor_limit(robot, stand, ON_TOP)
    held = pa.stance.stand_statics(
        with_payload(robot, limit.mass, ON_TOP), stand, distribution=EVEN
    )
    assert held.motor_utilisation.max() == pytest.approx(1.0, abs=2e-3)
    assert held.motor_utilisation.max() <= 1 + 1e-12  # rounding


def test_more_torque_carries_more_in_proportion() -> None:
    """The knees' limit doubled carries twice the total weight, but for the legs' own."""
    robot, stand = load("v3"), stand_of("v3")
    one = motor_limit(robot, stand, ON_TOP).mass
    two = motor_limit(with_efforts(robot, 2 * robot.effort_limits), stand, ON_TOP).mass
    assert (two + robot.total_mass) / (one + robot.total_mass) == pytest.approx(2.0, rel=0.03)


def test_motors_without_effort_limits_say_nothing_about_a_payload() -> None:
    robot, stand = with_efforts(load("v3"), np.inf), stand_of("v3")
    limit = payload_limit(robot, stand)
    assert limit.motors.mass == math.inf
    assert limit.motors.failure is Failure.NOTHING
    assert limit.unlimited == robot.joint_names
    assert limit.binding == "servos"
    assert limit.mass < 10  # its servos are no stiffer for that


def test_a_limit_of_zero_carries_nothing_and_divides_nothing() -> None:
    limits = load("v3").effort_limits.copy()
    limits[2] = 0.0
    robot, stand = with_efforts(load("v3"), limits), stand_of("v3")
    with np.errstate(all="raise"):
        bound = motor_limit(robot, stand, ON_TOP)
    assert bound.mass == 0.0
    assert bound.where == (robot.joint_names[2],)


def test_motors_too_weak_for_the_robot_itself() -> None:
    robot = pa.load_variant(pa.pupper.VariantSpec(base="v3", torso_mass_scale=12.0))
    stand = pa.solve_stand(robot)
    limit, held = (
        payload_limit(robot, stand),
        pa.stance.stand_statics(robot, stand, distribution=EVEN),
    )
    assert limit.mass == limit.motors.mass == 0.0
    assert limit.failure is Failure.MOTOR
    over = [n for n, u in zip(held.joint_names, held.motor_utilisation, strict=True) if u > 1]
    assert list(limit.where) == over
    np.testing.assert_array_equal(limit.joint_torques, held.joint_torques)


# ------------------------------------------------------------------------------------- servos


def test_at_the_servos_limit_the_equilibrium_stops_being_stable() -> None:
    robot, stand = load("v3"), stand_of("v3")
    bound = servo_limit(robot, stand, ON_TOP)
    assert bound.failure is Failure.BUCKLING
    stiffness = []
    for share in (0.98, 1.02):
        heavy = with_payload(robot, share * bound.mass, ON_TOP)
        pose = pa.steady_state(heavy, solve_loaded_stand(heavy, stand), feedforward=True)
        stiffness.append(pose.stiffness)
        assert max(abs(pose.joint_torques)) < 0.6 * robot.effort_limits.max()
    assert stiffness[0] > 0 > stiffness[1]


def test_stiffer_servos_carry_more_until_the_motors_saturate() -> None:
    robot, stand = load("v3"), stand_of("v3")
    bounds = [servo_limit(robot, stand, ON_TOP, kp=kp) for kp in (4.0, 8.0, 60.0)]
    assert bounds[0].mass < bounds[1].mass < bounds[2].mass
    assert bounds[0].failure is Failure.BUCKLING
    assert bounds[2].failure is Failure.MOTOR
    motors = motor_limit(robot, stand, ON_TOP).mass
    assert bounds[2].mass == pytest.approx(motors, rel=0.1)  # longer legs on soft ground


def test_feet_that_sink_bring_the_calves_down() -> None:
    """The calves of the skeleton are 7 mm above the ground, and MuJoCo's gives way by that."""
    robot, stand = load("original"), stand_of("original")
    bound = servo_limit(robot, stand, ON_TOP)
    assert bound.failure is Failure.GROUND
    assert all(body.endswith("calf") for body in bound.where)
    sunk = solve_loaded_stand(with_payload(robot, bound.mass, ON_TOP), stand)
    assert stand.ground_clearance is not None
    deepest = max(sunk.depths.values())
    assert deepest == pytest.approx(stand.ground_clearance.distance, rel=0.02)


@pytest.mark.longest
def test_a_surprise_is_carried_less_well() -> None:
    robot, stand = load("v3"), stand_of("v3")
    known = payload_limit(robot, stand)
    surprise = payload_limit(robot, stand, command=PayloadCommand.UNLOADED)
    assert surprise.servos.mass < 0.9 * known.servos.mass
    assert surprise.motors.mass == known.motors.mass
    with pytest.raises(pa.ConfigurationError, match="command"):
        payload_limit(robot, stand, command="shout")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["original", "v3", "v3-long-leg"])
def test_first_order_is_near_the_limit(name: str) -> None:
    robot, stand = load(name), stand_of(name)
    small = SmallPayload(robot, find_place(robot, ON_TOP), model_with_servos(robot).kp)
    first = small.borne(stand)
    assert first is not None
    limit = payload_limit(robot, stand, ON_TOP).mass
    assert first.limit(robot.effort_limits) == pytest.approx(limit, rel=0.08)


def test_the_first_failure_is_bracketed_and_rounded_down() -> None:
    assert find_first_failing(lambda mass: mass > 3.7, 1.0, 100.0) == pytest.approx(3.7, rel=1e-3)
    assert find_first_failing(lambda mass: mass > 3.7, 1.0, 100.0) <= 3.7
    assert find_first_failing(lambda mass: mass > 0.02, 1.0, 100.0) == pytest.approx(0.02, rel=1e-3)
    assert find_first_failing(lambda mass: 2.0 < mass < 3.1, 1.0, 100.0) <= 2.0  # and not 100
    assert find_first_failing(lambda mass: False, 1.0, 100.0) == 100.0


# ------------------------------------------------------------------------------------- simulated


def check_by_simulation(
    robot: pa.Robot,
    stand: pa.Stand,
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    command: PayloadCommand = PayloadCommand.LOADED,
) -> None:
    limit = payload_limit(robot, stand, point, command=command)
    bounds = (limit.motors.mass, limit.servos.mass, limit.contacts.mass)
    assert limit.mass == min(bounds)
    below, above = (
        simulate_payload(robot, stand, share * limit.mass, point, command=command)
        for share in (0.95, 1.05)
    )
    assert below.held, (below.failure, below.where, below.time)
    assert below.duration >= 12
    assert not above.held
    assert above.failure is limit.failure, (above.where, above.time)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_mujoco_agrees_on_the_limit(name: str) -> None:
    check_by_simulation(load(name), stand_of(name))


@pytest.mark.longest
@pytest.mark.parametrize("name", ["long-leg", "heavy", "v3-long-leg", "v3-heavy"])
def test_mujoco_agrees_on_the_limit_of_the_others(name: str) -> None:
    check_by_simulation(load(name), stand_of(name))


@pytest.mark.longest
@pytest.mark.parametrize("name", ["original", "heavy"])
def test_mujoco_agrees_on_tipping(name: str) -> None:
    check_by_simulation(load(name), stand_of(name), AHEAD)


@pytest.mark.longest
def test_mujoco_agrees_where_motors_bind() -> None:
    """Stiff servos: then the motors are what gives way."""
    robot, stand = load("v3"), stand_of("v3")
    limit = payload_limit(robot, stand, kp=60.0)
    assert limit.binding == "motors"
    below, above = (
        simulate_payload(robot, stand, share * limit.mass, kp=60.0, kd=0.8) for share in (0.95, 1.1)
    )
    assert below.held
    assert above.failure is Failure.MOTOR


def test_dry_friction_holds_up_what_is_not_stable() -> None:
    """So that a robot which nobody touches proves nothing."""
    robot, stand = load("v3"), stand_of("v3")
    heavy = 1.1 * servo_limit(robot, stand, (0.0, 0.0, 0.0)).mass
    assert simulate_payload(robot, stand, heavy, dry_friction=True, duration=6).held
    assert not simulate_payload(robot, stand, heavy, duration=6).held


@pytest.mark.parametrize("point", [(0, 0), (0, 0, np.nan), "top"])
def test_payload_limit_refuses_bad_points(point: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="point"):
        payload_limit(load("v3"), stand_of("v3"), point)  # type: ignore[arg-type]
    with pytest.raises(pa.ConfigurationError, match="point"):
        simulate_payload(load("v3"), stand_of("v3"), 1.0, point)  # type: ignore[arg-type]


# ---------------------------------------------------------------------------------- buckling


def test_an_unstable_payload_buckles_as_fast_as_a_simulation_leaves() -> None:
    """Above the limit of 5.64 kg, without dry friction: from one that is nudged, by bare MuJoCo."""
    robot, stand, point = load("v3"), stand_of("v3"), np.array([0.0, 0.0, 0.08])
    found = pa.simulation.payload_buckling(robot, stand, 6.2, point)  # type: ignore[arg-type]
    laid = payload._laid(robot, stand, 6.2, point, PayloadCommand.LOADED, None, None)
    laid.free()
    model = laid.drive.model
    still, nudged = mujoco.MjData(model), mujoco.MjData(model)
    laid.robot.mj_convention.set_state(still, laid.qpos)
    still.ctrl[:] = laid.ctrl
    mujoco.mj_copyData(nudged, model, still)
    nudged.qvel[0] += 1e-6
    passed = []
    for way in (3e-5, 3e-4):
        while np.abs(nudged.qpos - still.qpos)[7:].max() < way:
            mujoco.mj_step(model, still)
            mujoco.mj_step(model, nudged)
        passed.append(still.time)
    doubling = (passed[1] - passed[0]) * np.log(2) / np.log(10)
    assert found.free_doubling_time == pytest.approx(doubling, rel=0.02)
    assert found.doubling_time > 10 * found.free_doubling_time


@pytest.mark.longest
def test_the_study_of_a_payload_tells_how_fast_it_buckles_near_the_limit() -> None:
    found = study_payload(load("v3"), pa.StandTask(), (0.0, 0.0, 0.08))
    assert [one.mass / found.payload.mass for one in found.buckling] == pytest.approx(NEAR)
    times = np.array([(one.doubling_time, one.free_doubling_time) for one in found.buckling])
    assert (np.diff(times, axis=0) < 0).all()
    assert times[0, 1] > 60.0
    assert times[-1, 1] < 1.0
