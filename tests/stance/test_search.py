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
from pupper_analysis.stance.problem import make_goal
from pupper_analysis.stance.search import solve_constraints
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.support_polygon import com_margin
from tests.support import random_legged
from tests.support.engines import evaluate_mujoco
from tests.support.variants import NAMES, load

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
    """The feet's centres by MuJoCo's kinematics of the MJCF."""
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


def test_refusal_names_the_blocking_demand_and_its_limit() -> None:
    """References: stands at the printed limits are solved, and 1 % beyond are refused."""
    robot = load("v3")
    asked = {"height": 0.16, "roll": 0.4}
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(robot, pa.StandTask(**asked))
    error = caught.value
    assert set(error.possible) == {"height", "roll"}
    # What it says is possible is so as it is printed, and 1 % more is not.
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
    assert np.ptp(depths) > 1e-3  # read at the feet's centre it would be elsewhere
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

    def met(search: search_module._Search, program: object, qpos: object) -> object:
        tried.append(qpos)
        assert len(tried) < 100
        return original(search, program, qpos)  # type: ignore[arg-type]

    original = search_module._Search.solve_program
    monkeypatch.setattr(search_module._Search, "solve_program", met)
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
    found = solve_constraints(SearchContext(robot), make_goal(robot, required, {}), stand.qpos)
    assert found is not None
    assert found.ground_clearance is not None
    assert found.ground_clearance.distance >= required.ground_clearance - 1e-6
    for foot, centre in mujoco_feet(robot, found.qpos).items():
        np.testing.assert_allclose(centre, found.foot_targets[foot], atol=1e-9)
    com = pa.Configuration(robot, found.qpos).center_of_mass()
    assert com_margin(com, found.contact_points) > 0.01 - 1e-9
    assert np.abs(found.qpos - stand.qpos).max() > 1e-4
