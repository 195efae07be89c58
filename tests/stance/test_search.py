"""Stands on slopes, steps and three legs, against MuJoCo's kinematics; limits that refusals
state.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.floor import find_floor
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance import programme
from pupper_analysis.stance import search as search_module
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.search import minimise_foot_errors, solve_constraints
from pupper_analysis.stance.soft_ground import compute_loop_opening, solve_stand_on_soft_ground
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.support_polygon import com_margin
from tests.support import random_legged
from tests.support.bound import belts
from tests.support.engines import evaluate_mujoco
from tests.support.variants import NAMES, SKELETON_NAMES, load

TASKS = {
    "offset": pa.StandTask(offset=(0.012, -0.008)),
    "com": pa.StandTask(com=(0.005, 0.01)),
    "moved foot": pa.StandTask(foot_offsets={"FR": (0.02, -0.01)}),
    "placed feet": pa.StandTask(feet={"FL": (0.08, 0.10), "RR": (-0.08, -0.09)}),
    "slope": pa.StandTask(ground=pa.Ground(slope=0.15, uphill=2.0)),
    "steps": pa.StandTask(ground=pa.Ground(heights={"FL": 0.015, "RR": 0.01})),
    "joint margin": pa.StandTask(joint_margin=0.1, roll=0.05),
    "three legs": pa.StandTask(swing={"FL": 0.01}),
    "everything": pa.StandTask(
        roll=0.05,
        pitch=-0.05,
        yaw=0.1,
        swing={"FR": 0.005},
        com="inside",
        com_margin=0.01,
        ground=pa.Ground(slope=0.05, uphill=-1.0, heights={"RL": 0.005}),
        foot_offsets={"RR": (-0.005, 0.0)},
    ),
}


def mujoco_feet(robot: pa.Robot, qpos: np.ndarray) -> dict[str, np.ndarray]:
    """Return the centres of the feet [m] by MuJoCo's kinematics."""
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    return {
        foot: data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        for foot, (body, place) in robot.contact_places.items()
    }


@pytest.mark.parametrize(("name", "kind"), list(product(NAMES, TASKS)))
def test_stand_satisfies_the_requested_task(name: str, kind: str) -> None:
    """References: MuJoCo's foot positions, closed forms of plane and steps, and the statics."""
    robot, task = load(name), TASKS[kind]
    stand = pa.solve_stand(robot, task)
    for error in (stand.foot_error, stand.orientation_error, stand.height_error, stand.com_error):
        assert error < 1e-9
    feet, ground = mujoco_feet(robot, stand.qpos), task.ground
    normal = ground.normal()
    for foot, centre in feet.items():
        np.testing.assert_allclose(centre, stand.foot_targets[foot], atol=1e-9)
        above = centre[2] - task.swing.get(foot, 0.0) - ground.heights.get(foot, 0.0)
        distance = normal @ (centre[0], centre[1], above)
        assert distance == pytest.approx(robot.contact_radius[foot], abs=1e-9)
    assert set(stand.stance_feet) == set(robot.contact_points) - set(task.swing)
    contacts = [feet[foot] - robot.contact_radius[foot] * normal for foot in stand.stance_feet]
    centre = np.mean(contacts, axis=0)
    config = pa.Configuration(robot, stand.qpos)
    wanted = robot.stand_height if task.height is None else task.height
    assert stand.qpos[2] - centre[2] == pytest.approx(wanted, abs=1e-9)
    com = config.center_of_mass()[:2]
    if task.offset is not None:
        np.testing.assert_allclose(stand.qpos[:2] - centre[:2], task.offset, atol=1e-9)
    elif task.com in (None, "centre"):
        np.testing.assert_allclose(com, centre[:2], atol=1e-9)
    elif not isinstance(task.com, str):
        np.testing.assert_allclose(com, task.com, atol=1e-9)
    joints = stand.joint_positions(robot)
    assert (joints >= robot.lower_limits + task.joint_margin - 1e-9).all()
    assert (joints <= robot.upper_limits - task.joint_margin + 1e-9).all()
    statics = stand_statics(robot, stand)
    assert statics.residual_force < 1e-9
    assert statics.residual_torque < 1e-9
    assert statics.com_margin is not None
    assert statics.com_margin > task.com_margin - 1e-9
    for foot, force in statics.contact_forces.items():
        assert force @ stand.normals[foot] > 0
        assert statics.friction_utilisation[foot] <= 1 + 1e-6


def test_refusal_names_the_blocking_requirement_and_its_limit() -> None:
    """References: stands at the printed limits are solved, and 1 % beyond are refused."""
    robot = load("v3")
    requested = {"height": 0.16, "roll": 0.4}
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, pa.StandTask(**requested))
    error = caught.value
    assert set(error.possible) == {"height", "roll"}
    # The printed limits are solved, and 1 % more is not.
    roll = math.radians(float(str(error.possible["roll"]).split()[1]))
    height = float(str(error.possible["height"]).split()[1]) / 1000
    assert error.limits == {"roll": {"roll": roll}, "height": {"height": height}}
    for task in (
        pa.StandTask(0.16, roll),
        pa.StandTask(height, 0.4),
    ):
        assert pa.solve_stand(robot, task, explain=False).foot_error < 1e-9
    above = robot.stand_height + 1.01 * (height - robot.stand_height)
    for task in (pa.StandTask(0.16, 1.01 * roll), pa.StandTask(above, 0.4)):
        with pytest.raises(pa.StanceUnreachableError):
            pa.solve_stand(robot, task, explain=False)
    assert error.nearest is not None
    assert error.nearest.foot_error < 1e-9
    near = error.nearest.task
    assert (near.height, near.roll) in [(height, 0.4), (0.16, roll)]


def test_refusal_of_a_joint_margin_states_its_limit() -> None:
    """The pitch is in reach without the margin."""
    task = pa.StandTask(joint_margin=0.5, pitch=0.3)
    assert "joint-limit margin" in str(task)
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load("v3"), task)
    assert list(caught.value.limits) == ["joint_margin"]


@pytest.mark.parametrize(
    ("task", "named"),
    [
        (pa.StandTask(swing={"FL": 0.01, "FR": 0.01}), "swing"),
        (pa.StandTask(ik_seed=[0.0]), "ik_seed"),
        (pa.StandTask(joint_margin=3.0), "joint_margin"),
        (pa.StandTask(com=(1.0, 0.0), com_margin=0.01), "outside the support polygon"),
        (pa.StandTask(com_margin=0.5), "com_margin"),
    ],
)
def test_requests_that_no_robot_can_meet_are_refused(task: pa.StandTask, named: str) -> None:
    """The message names the field or the reason."""
    with pytest.raises(pa.ConfigurationError, match=named):
        pa.solve_stand(load("v3"), task)


# ------------------------------------------------------------------------------------- slopes


def test_foot_depths_on_a_slope_balance_the_weight() -> None:
    """The forces are vertical; their parts along the normals are W cos(slope) in all."""
    robot, slope = load("v3"), 0.3
    stand = pa.stance.solve_stand_on_soft_ground(
        robot, pa.StandTask(ground=pa.Ground(slope, 0.4), pitch=-0.25)
    )
    pressing = sum(
        GroundLaw.of_contact(robot, foot).force(depth) for foot, depth in stand.depths.items()
    )
    weight = robot.total_mass * np.linalg.norm(robot.gravity)
    assert pressing == pytest.approx(weight * math.cos(slope), rel=1e-6)


@pytest.mark.parametrize("priority", [-1, 0, 3])  # the feet's is 0
def test_contact_with_a_step_has_the_parameters_of_the_floor(priority: int) -> None:
    """Reference: MuJoCo's contacts.

    The floor has unusual friction, condim, solref, solimp and solmix, and a priority below, equal
    to, or above that of the feet.
    """
    plain = load("v3")
    spec = plain.description.mjcf.copy()
    floor = find_floor(spec)
    assert floor is not None
    floor.friction, floor.condim = (1.31, 0.0171, 0.00031), 4
    floor.solref, floor.solimp = (0.013, 0.9), (0.31, 0.83, 0.0021, 0.4, 3.0)
    floor.solmix, floor.priority = 2.5, priority
    robot = build_robot(replace(plain.description, mjcf=spec))
    heights = {"RR": 0.02, "FL": 0.01}
    stand = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(heights=heights)))
    there = build_on_ground(robot, stand.task.ground, stand.foot_targets)
    qpos = stand.qpos.copy()
    qpos[2] -= 5e-4
    data, touched = evaluate_mujoco(there, qpos), set()
    for contact in data.contact:
        foot = next(there.foot_geoms[geom] for geom in contact.geom if geom in there.foot_geoms)
        other = next(geom for geom in contact.geom if geom not in there.foot_geoms)
        touched.add((foot, there.mj_model.geom(other).name.startswith("step")))
        meant = robot.contacts[foot]
        assert contact.dim == meant.condim
        np.testing.assert_allclose(contact.friction, meant.friction, rtol=1e-12)
        np.testing.assert_allclose(contact.solref, meant.solref, rtol=1e-12)
        np.testing.assert_allclose(contact.solimp, meant.solimp, rtol=1e-12)
    assert touched == {(foot, foot in heights) for foot in robot.contact_points}
    assert (robot.contacts["FR"].friction[0] == 1.31) is (priority >= 0)


# ------------------------------------------------------------------------------------- sag


@pytest.mark.parametrize("offset", [(-0.04, 0.02), (0.045, -0.02)])
def test_contact_sag_off_the_centre_equals_mujocos_at_the_base(offset: tuple[float, float]) -> None:
    """Reference: MuJoCo's base height with feed-forward.

    The feet sink unequally, so the loss at the base is not the mean penetration. Stiff servos with
    feed-forward do not yield.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(offset=offset))
    pose = pa.steady_state(robot, stand, feedforward=True, kp=200.0)
    run = pa.verify_stand(robot, stand, kp=200.0, kd=2.0, duration=3.0, nudged=0)
    forces = pose.contact_forces.items()
    depths = [GroundLaw.of_contact(robot, foot).depth(force[2]) for foot, force in forces]
    assert np.ptp(depths) > 1e-3  # so the loss at the centre of the feet differs
    assert abs(pose.servo_sag) < 2e-5
    assert abs(run.servo_sag) < 2e-5
    assert pose.contact_sag == pytest.approx(run.contact_sag, abs=2e-5)
    assert abs(pose.contact_sag - np.mean(depths)) > 1e-4


def test_search_terminates_if_it_returns_to_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each reached stand is tried once; a cycle of stands would be searched for ever."""
    pair = random_legged.write_robot(random_legged.draw_robot(95000), tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    tried: list[object] = []

    def met(search: search_module._StandSearch, program: object, qpos: object) -> object:
        tried.append(qpos)
        assert len(tried) < 100
        return original(search, program, qpos)  # type: ignore[arg-type]

    original = search_module._StandSearch.solve_program
    monkeypatch.setattr(search_module._StandSearch, "solve_program", met)
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, pa.StandTask(pitch=-1.24609375), explain=False)
    assert len(tried) > 1


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_foot_lifted_over_its_step_is_above_the_step_by_the_swing_height(slope: float) -> None:
    """Reference: the step's box in MuJoCo's model; the simulation reports no touching foot."""
    robot = load("v3")
    ground = pa.Ground(slope=slope, heights={"FL": 0.01})
    task = pa.StandTask(swing={"FL": 0.015}, ground=ground, com="inside", com_margin=0.01)
    stand = pa.solve_stand(robot, task)
    model = build_on_ground(robot, ground, stand.foot_targets).mj_model
    step, normal = model.geom("step_FL"), ground.normal()
    above = (stand.foot_targets["FL"] - step.pos) @ normal - step.size[2]
    assert above == pytest.approx(robot.contact_radius["FL"] + 0.015 * normal[2], abs=1e-9)
    failures = pa.verify_stand(robot, stand, duration=2.0, nudged=0).failures
    assert not any("touches" in str(failure) for failure in failures)


def test_two_jacobians_of_an_iteration_count_as_one_step_without_progress() -> None:
    """SLSQP evaluates the Jacobians of equalities and inequalities at the same variables."""
    progress = programme._Progress(enough=0.1, patience=1)
    points = [np.array([float(number)]) for number in range(3)]
    for point in points[:2]:  # the second makes no progress
        for _ in range(2):
            progress.update(point, 1.0)
    with pytest.raises(programme._NoProgressError):
        progress.update(points[2], 1.0)
    np.testing.assert_array_equal(progress.x, points[0])


def test_solved_constraints_keep_feet_ground_clearance_and_com_margin() -> None:
    """From a stand whose thigh is 1 mm too low. References: MuJoCo's kinematics of the feet, and
    Pinocchio's CoM."""
    robot = load("v3")
    task = pa.StandTask(height=0.092, roll=0.2, com="inside", com_margin=0.01)
    stand = pa.solve_stand(robot, task, explain=False)
    assert stand.ground_clearance is not None
    required = replace(task, ground_clearance=stand.ground_clearance.distance + 1e-3)
    found, _ = solve_constraints(
        SearchContext(robot), compute_targets(robot, required, {}), stand.qpos
    )
    assert found is not None
    assert found.ground_clearance is not None
    assert found.ground_clearance.distance >= required.ground_clearance - 1e-6
    for foot, centre in mujoco_feet(robot, found.qpos).items():
        np.testing.assert_allclose(centre, found.foot_targets[foot], atol=1e-9)
    com = pa.Configuration(robot, found.qpos).center_of_mass()
    assert com_margin(com, found.contact_points) > 0.01 - 1e-9
    assert np.abs(found.qpos - stand.qpos).max() > 1e-4


# ------------------------------------------------------------------------------------- reach


@pytest.mark.slow
@pytest.mark.parametrize("name", SKELETON_NAMES)
def test_hip_of_a_lifted_hind_foot_is_at_its_limit_with_the_com_in_the_centre(name: str) -> None:
    """The skeletons lift a hind foot by 10 to 20 mm only; the refusal names the hip joint."""
    for foot in ("RL", "RR"):
        with pytest.raises(pa.StanceUnreachableError) as caught:
            pa.solve_stand(load(name), pa.StandTask(swing={foot: 0.02}))
        assert "swing" in caught.value.possible
        assert set(caught.value.at_limit) == {f"{foot}_HFE"}
        assert caught.value.nearest is not None
        assert 0.01 < caught.value.nearest.task.swing[foot] < 0.02


@pytest.mark.parametrize(
    "task",
    [
        pa.StandTask(yaw=math.radians(30)),
        pa.StandTask(yaw=math.radians(-30)),
        pa.StandTask(pitch=math.radians(-40)),
        pa.StandTask(roll=math.radians(17.8), pitch=math.radians(-25.5)),
    ],
    ids=str,
)
def test_another_ik_branch_of_a_leg_reaches_the_task(task: pa.StandTask) -> None:
    """Reference: MuJoCo's kinematics of the feet. Mirrored initial joint positions succeed too."""
    robot = load("v3")
    for seed in (None, tuple(-robot.home[7:])):
        stand = pa.solve_stand(robot, replace(task, ik_seed=seed))
        assert max(stand.com_error, stand.orientation_error) < 1e-9
        for foot, centre in mujoco_feet(robot, stand.qpos).items():
            np.testing.assert_allclose(centre, stand.foot_targets[foot], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "task", "requirement", "degrees"),
    [
        ("original", pa.StandTask(pitch=-0.6, com="inside"), "pitch", -29.2),
        pytest.param(
            *("v3", pa.StandTask(yaw=0.6, roll=0.2, com="inside"), "yaw", 32.0),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_limit_with_the_com_inside_is_reached(
    name: str, task: pa.StandTask, requirement: str, degrees: float
) -> None:
    """References: limits [deg] of an earlier search, and a direct solution at the limit."""
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load(name), task)
    limit = caught.value.limits[requirement][requirement]
    assert math.degrees(limit) == pytest.approx(degrees, abs=0.15)
    assert pa.solve_stand(load(name), replace(task, **{requirement: limit}), explain=False).solved


@pytest.mark.parametrize("height", [0.25, 50.0])
def test_limit_of_the_height_does_not_depend_on_the_requested_height(height: float) -> None:
    """v3 reaches 0.192 m; a search in steps of the request of 50 m would find a coarse limit."""
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load("v3"), pa.StandTask(height=height))
    assert caught.value.limits["height"]["height"] == pytest.approx(0.1919, abs=2e-4)


def test_com_inside_is_in_the_centre_unless_only_another_place_is_in_reach() -> None:
    """A hind foot lifted by 14 mm is out of reach with the CoM in the centre."""
    robot = load("original")
    free = pa.solve_stand(robot, pa.StandTask(com="inside", com_margin=0.02))
    np.testing.assert_allclose(free.qpos, pa.solve_stand(robot).qpos, atol=1e-12)
    lifted = pa.StandTask(swing={"RL": 0.014})
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, lifted, explain=False)
    stand = pa.solve_stand(robot, replace(lifted, com="inside", com_margin=0.005))
    assert stand.foot_error < 1e-9
    margin = stand_statics(robot, stand).com_margin
    assert margin is not None
    assert margin >= 0.005 - 1e-9


@pytest.mark.parametrize("field", ["feet", "foot_offsets", "swing"])
def test_unknown_foot_of_a_task_is_refused_with_the_known_feet(field: str) -> None:
    value = 0.01 if field == "swing" else (0.0, 0.0)
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        pa.solve_stand(load("v3"), pa.StandTask(**{field: {"XX": value}}))


AT_THE_END_OF_REACH = {
    # 4 of 200 searches from random configurations find it; usual initial guesses do not.
    "heavy": pa.StandTask(
        pitch=-0.8117438192799574,
        yaw=0.0591940397518404,
        ground=pa.Ground(0.8571316777641277, 0.0, {"FR": 0.02530521874872173}),
        com="inside",
    ),
    # The CoM is far from the centre, with legs bent as they cannot be with the CoM in the centre.
    "v3-heavy": pa.StandTask(
        height=0.14617486966800353,
        pitch=-0.6343753376059421,
        swing={"RL": 0.01951351776307491},
        ground=pa.Ground(0.702530529323462, 0.0),
        com="inside",
        com_margin=0.02798345952672495,
    ),
    "v3-long-leg": pa.StandTask(
        height=0.19492922158665457,
        pitch=-0.9272205413226478,
        yaw=-0.13303548640285823,
        swing={"RR": 0.017947598579123102},
        ground=pa.Ground(0.9023699907892164, 0.0, {"FR": 0.01582060163532399}),
        com="inside",
        com_margin=0.022563368373973824,
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param("heavy", marks=pytest.mark.slow), "v3-heavy", "v3-long-leg"]
)
def test_stand_at_the_end_of_reach_is_found(name: str) -> None:
    """References: MuJoCo's kinematics of the feet, and Pinocchio's CoM."""
    robot, task = load(name), AT_THE_END_OF_REACH[name]
    stand = pa.solve_stand(robot, task, explain=False)
    for foot, centre in mujoco_feet(robot, stand.qpos).items():
        np.testing.assert_allclose(centre, stand.foot_targets[foot], atol=1e-9)
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    assert com_margin(com, stand.contact_points) > task.com_margin - 1e-9


@pytest.mark.slow
def test_nearest_stand_keeps_the_com_margin_that_is_in_reach() -> None:
    """With a foot lifted high the CoM moves to the edge. Reference: the margin of the statics."""
    robot = load("original")
    task = pa.StandTask(swing={"RL": 0.04}, com="inside", com_margin=0.036)
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, task)
    limits, nearest = caught.value.limits, caught.value.nearest
    assert set(limits) == {"swing", "com_margin"}
    assert nearest is not None
    assert 0.03 < nearest.task.com_margin < 0.036
    limit = limits["com_margin"]["com_margin"]
    for stand in (nearest, pa.solve_stand(robot, replace(task, com_margin=limit))):
        margin = stand_statics(robot, stand).com_margin
        assert margin == pytest.approx(stand.task.com_margin, abs=1e-4)
        assert margin >= stand.task.com_margin - 1e-9
    with pytest.raises(pa.StanceUnreachableError):
        pa.solve_stand(robot, replace(task, com_margin=1.01 * limit), explain=False)


# ------------------------------------------------------------------------------------- balance


def test_stand_on_a_slope_beyond_the_friction_angle_is_solved_without_balance() -> None:
    """On 48 deg the feet reach the ground; the required friction is tan(48 deg), above 1."""
    robot = load("v3")
    task = pa.StandTask(ground=pa.Ground(slope=math.radians(48)), pitch=-0.7)
    stand = pa.solve_stand(robot, task)
    with pytest.raises(pa.StaticsInfeasibleError) as caught:
        stand_statics(robot, stand)
    assert caught.value.reason is pa.errors.Infeasibility.FRICTION
    assert caught.value.friction_needed == pytest.approx(math.tan(math.radians(48)), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["long-leg", "v3"])
def test_mujoco_holds_stands_on_steps_and_slopes(name: str) -> None:
    """References: MuJoCo's simulation, kinematics and force balance. Steps up and down."""
    robot = load(name)
    for ground in (
        pa.Ground(heights={"FL": 0.02}),
        pa.Ground(slope=0.08, uphill=0.7),
        pa.Ground(heights={"RR": -0.004}),
        pa.Ground(slope=0.06, uphill=-2.0, heights={"FL": -0.003, "RR": 0.005}),
    ):
        stand = pa.solve_stand(robot, pa.StandTask(ground=ground))
        run = pa.verify_stand(robot, stand)
        assert run.passed, (ground, run.failures)
        assert run.mujoco_residual < 1e-9
        for foot, centre in mujoco_feet(robot, stand.qpos).items():
            np.testing.assert_allclose(centre, stand.foot_targets[foot], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3", "v3-long-leg"])
def test_mujoco_holds_three_legs_for_six_seconds_unless_the_servos_are_too_soft(name: str) -> None:
    """Each foot in turn is lifted by 20 mm. The deviation of v3-long-leg doubles every 3 s."""
    robot = load(name)
    for foot in robot.contact_points:
        task = pa.StandTask(swing={foot: 0.02}, com="inside", com_margin=0.01)
        stand = solve_stand_on_soft_ground(robot, task)
        run = pa.verify_stand(robot, stand, duration=6.0, nudged=0)
        assert run.passed is (name != "v3-long-leg"), (foot, run.failures)
        assert run.stability.is_stable_for() is (name != "v3-long-leg")
        assert run.torque_error < 1e-5
        np.testing.assert_array_equal(run.foot_forces[foot], 0.0)
        height = mujoco_feet(robot, stand.qpos)[foot][2]
        assert height == pytest.approx(robot.contact_radius[foot] + 0.02, abs=1e-9)


@pytest.mark.slow
def test_foot_errors_are_minimised_with_loops_that_open_under_load(tmp_path: Path) -> None:
    """Reference: the stand on soft ground reaches the targets, with belts that stretch by 49 mm.

    The nonlinear program closed the belts completely, and returned a foot error of 49 mm.
    """
    soft = 'solref="0.0173 1.936" solimp="0.814 0.986 0.00042 0.47 1"'
    robot = pa.load_robot(*belts(tmp_path, words=soft))
    stand = solve_stand_on_soft_ground(robot)
    opening = compute_loop_opening(robot, stand, stand_statics(robot, stand))
    assert np.abs(opening).max() > 0.04
    targets = replace(compute_targets(robot, stand.task, stand.depths), loop_opening=opening)
    found = minimise_foot_errors(SearchContext(robot), targets, stand.qpos)
    assert found.foot_error < 1e-8
