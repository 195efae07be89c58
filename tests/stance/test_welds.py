"""Links welded to the world, and contacts with a specified force: MuJoCo and cone programs are the
references.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import clarabel
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy import sparse

import pupper_analysis as pa
from pupper_analysis.base.results import to_json
from pupper_analysis.cli.stance_fields import parse_contact
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.markdown import write_markdown
from pupper_analysis.present.scene import describe_scene
from pupper_analysis.robot.tool import find_tool
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.simulation.rollout import make_stand_start, simulate_commands
from pupper_analysis.statics.contacts import prescribed_forces
from pupper_analysis.statics.support_polygon import margin_of_position, support_corners
from pupper_analysis.tools.stand.stance import study_stance
from tests.stance.test_contacts import contact_rows, grip_bar
from tests.support.legged import quadruped, with_arm
from tests.support.variants import load

BOLTED = {"base": pa.Weld()}
HAND = {"hand": pa.Contact(pa.Plane((0, 0, 0.5), (0, 0, 1), 0.6))}
ARM = """<robot name="arm"><link name="plinth">{box}</link>
  <link name="upper">{rod}</link><link name="lower">{rod}</link><link name="wrist">{ball}</link>
  <joint name="turn" type="revolute"><parent link="plinth"/><child link="upper"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>{limit}</joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}</joint>
  <joint name="nod" type="revolute"><parent link="lower"/><child link="wrist"/>
    <origin xyz="0 0 0.3"/><axis xyz="1 0 0"/>{limit}</joint></robot>"""


def inertial(mass: float, at: str, shape: str) -> str:
    return (
        f'<inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="0.01" ixy="0" ixz="0" '
        f'iyy="0.01" iyz="0" izz="0.01"/></inertial><collision><origin xyz="{at}"/>'
        f"<geometry>{shape}</geometry></collision>"
    )


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """Load an arm of three joints with a fixed base."""
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    text = ARM.format(
        box=inertial(2.0, "0 0 0.05", '<box size="0.2 0.2 0.1"/>'),
        rod=inertial(1.0, "0 0 0.15", '<cylinder radius="0.03" length="0.2"/>'),
        ball=inertial(0.5, "0 0 0.05", '<sphere radius="0.04"/>'),
        limit='<limit lower="-2.5" upper="2.5" effort="40" velocity="5"/>',
    )
    file.write_text(text, encoding="utf-8")
    return pa.load_robot(file)


@pytest.fixture(scope="module")
def armed(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """Return a quadruped with an arm of three joints, whose hand is a sphere of 25 mm."""
    pair = with_arm(quadruped(tmp_path_factory.mktemp("armed"), floor=True, actuators="position"))
    return pa.load_robot(*pair)


def on_table(of: pa.Robot, height: float = 0.25, **more: float) -> pa.StandTask:
    """Return the task of an arm with its wrist on a table, at the height that the wrist has with
    bent joints.
    """
    table = pa.Plane((0, 0, height), (0, 0, 1), 0.5)
    place = (0.45, 0.0, height)
    wrist = pa.Contact(table, place, (0.0, 0.0, 0.05), **more)
    return pa.StandTask(contacts={**BOLTED, "wrist": wrist}, ik_seed=(0.8, 1.4, 0.0))


def press_under_ceiling(of: pa.Robot) -> pa.StandTask:
    """Return the task of an arm whose wrist touches a ceiling.

    The ceiling can only press the arm down: the best contact force is zero.
    """
    wrist = pa.Contact(pa.Plane((0, 0, 0.4), (0, 0, -1), 0.5), (0.45, 0, 0.4), (0.0, 0.0, 0.05))
    return replace(on_table(of), contacts={**BOLTED, "wrist": wrist})


def verify_in_mujoco(robot: pa.Robot, stand: pa.Stand) -> pa.StandVerification:
    """Assert that MuJoCo holds a stand, with relative torque and force errors below 1e-6."""
    found = pa.verify_stand(robot, stand, integrator="implicitfast")
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < 1e-6
    assert found.force_error < 1e-6
    assert found.mujoco_residual < 1e-9
    return found


def compute_least_torque(
    robot: pa.Robot, stand: pa.Stand, *, pressing: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces, shape (n, 3) [N], and torques [N m] of least squared torque, by Clarabel on
    MuJoCo's Jacobians. Forces are inside the friction cones, or normal if `pressing`; a weld
    carries the remaining load.
    """
    model, points = robot.mj_model, list(stand.stance_feet)
    (data, rows), order = contact_rows(robot, stand), robot.mj_convention.qvel_index
    for point in robot.fixed_parts.values():
        body = model.body(robot.mj_base).id if point is None else robot.contact_places[point][0]
        both = np.zeros((2, 3, model.nv))
        mujoco.mj_jacBody(model, data, both[0], both[1], body)
        rows.extend(both)
    pushed = np.vstack(rows)[:, order].T
    load, size, count = data.qfrc_bias[order], len(rows) * 3, len(points)
    cones = np.zeros((4 * count, size))
    for number, point in enumerate(points):
        out, own = stand.normals[point], slice(3 * number, 3 * number + 3)
        friction = 0.0 if pressing else robot.contacts[point].sliding_friction
        cones[4 * number, own] = friction * out
        cones[4 * number + 1 : 4 * number + 4, own] = np.eye(3) - np.outer(out, out)
    normals = np.zeros((count, size))
    for number, point in enumerate(points):
        normals[number, 3 * number : 3 * number + 3] = stand.normals[point]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.tol_gap_abs, settings.tol_gap_rel = False, 1e-13, 1e-13
    solved = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(pushed[6:].T @ pushed[6:] + 1e-12 * np.eye(size))),
        -pushed[6:].T @ load[6:],
        sparse.csc_matrix(np.vstack([pushed[:6], -normals, -cones])),
        np.concatenate([load[:6], np.zeros(5 * count)]),
        [
            clarabel.ZeroConeT(6),
            clarabel.NonnegativeConeT(count),
            *[clarabel.SecondOrderConeT(4)] * count,
        ],
        settings,
    ).solve()
    forces = np.array(solved.x)
    return forces[: 3 * count].reshape(-1, 3), load[6:] - pushed[6:] @ forces


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        pa.StandTask(contacts=BOLTED),
        pa.StandTask(contacts=BOLTED, offset=(0.03, 0.0), roll=0.1, pitch=0.1, yaw=0.2),
        pa.StandTask(contacts={"FL": pa.Weld()}),
        pa.StandTask(contacts={"FL": pa.Weld()}, swing={"RR": 0.02}, com="inside"),
    ],
)
def test_welded_links_beside_pressing_feet_hold_in_simulation(task: pa.StandTask) -> None:
    """References: simulation with feed-forward (base height within 10 nm), and Newton and Euler:
    contact forces and weld wrench balance the weight [N] and its moment [N m] about the origin.
    """
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot, task)
    found = verify_in_mujoco(robot, stand)
    assert found.base_height == pytest.approx(stand.qpos[2], abs=1e-8)  # rigid
    assert stand.com_margin == np.inf
    statics = pa.stance.stand_statics(robot, stand)
    assert statics.com_margin == np.inf
    assert statics.residual_force < 1e-9
    borne = (
        sum(statics.contact_forces.values()) + statics.weld_wrenches[next(iter(task.contacts))][:3]
    )
    np.testing.assert_allclose(borne, (0, 0, robot.total_mass * 9.81), atol=1e-9)
    wrench = statics.weld_wrenches[next(iter(task.contacts))]
    at = stand.qpos[:3] if "base" in task.contacts else stand.foot_targets["FL"]
    moment = np.cross(at, wrench[:3]) + wrench[3:]
    for foot, force in statics.contact_forces.items():
        moment = moment + np.cross(statics.contact_points[foot], force)
    weight = np.array([0.0, 0.0, 9.81 * robot.total_mass])
    np.testing.assert_allclose(moment, np.cross(statics.center_of_mass, weight), atol=1e-9)
    for foot, force in statics.contact_forces.items():  # nothing creeps
        np.testing.assert_allclose(force, force[2] * stand.normals[foot], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("place", [None, (0.42, 0.05, 0.5)])
def test_welded_hand_is_at_its_place_or_its_home_position(
    armed: pa.Robot, place: tuple[float, float, float] | None
) -> None:
    """References: hand position of the home configuration; weld force of `stand_statics`."""
    stand = pa.solve_stand_as_simulated(armed, pa.StandTask(contacts={"hand": pa.Weld(place)}))
    found = verify_in_mujoco(armed, stand)
    robot = stand.check(armed)
    home = armed.make_qpos(armed.home[7:])
    home[2] = armed.stand_height
    there = pa.Configuration(robot, home).foot_positions()["hand"]
    at = pa.Configuration(robot, stand.qpos).foot_positions()["hand"]
    np.testing.assert_allclose(at, there if place is None else place, atol=1e-9)
    wrench = pa.stance.stand_statics(robot, stand).weld_wrenches["hand"]
    np.testing.assert_allclose(found.foot_forces["hand"], wrench[:3], atol=1e-4)


def test_welded_stand_falls_in_mujoco_without_the_weld() -> None:
    """With the same commands the base of v3 keeps its height within 1 nm; it sinks by more than 1
    mm in 500 steps if the equality constraint is inactive.
    """
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=BOLTED))
    held = make_stand_start(robot, stand)
    model = held.drive.model
    assert model.eq_active0.tolist() == [1]
    assert held.robot.mj_model.eq_active0.tolist() == [0]  # the robot itself has none
    ctrl = np.tile(held.ctrl, (500, 1))
    height = 1 + robot.mj_convention.qpos_index[2]
    kept = simulate_commands(model, held.start, ctrl)[-1, height]
    model.eq_active0[:] = 0
    assert kept == pytest.approx(stand.qpos[2], abs=1e-9)
    assert simulate_commands(model, held.start, ctrl)[-1, height] < stand.qpos[2] - 1e-3


@pytest.mark.parametrize("pressing", [True, False])
def test_forces_beside_welds_equal_an_independent_cone_program(
    arm: pa.Robot, armed: pa.Robot, *, pressing: bool
) -> None:
    """Reference: Clarabel's optimum on MuJoCo's Jacobians, for joint torques [N m] and, if forces
    only press, contact forces [N].
    """
    for robot, task in (
        (load("v3"), pa.StandTask(contacts=BOLTED)),
        (load("v3"), pa.StandTask(contacts={"FL": pa.Weld()}, roll=0.1)),
        (load("v3"), pa.StandTask(contacts=BOLTED, roll=0.1, pitch=0.15, yaw=0.2)),
        (arm, on_table(arm)),
        (arm, press_under_ceiling(arm)),
        (armed, pa.StandTask(contacts={**BOLTED, **HAND})),
    ):
        stand = pa.solve_stand_as_simulated(robot, task)
        robot = stand.check(robot)
        which = "minimum tangential" if pressing else "minimum torque"
        ours = pa.stance.stand_statics(robot, stand, distribution=which)
        forces, torques = compute_least_torque(robot, stand, pressing=pressing)
        np.testing.assert_allclose(ours.joint_torques, torques, atol=2e-5)
        if pressing:
            for point, force in zip(stand.stance_feet, forces, strict=True):
                np.testing.assert_allclose(ours.contact_forces[point], force, atol=2e-3)


@pytest.mark.slow
def test_gripping_hand_pulls_if_the_com_is_beyond_the_feet(armed: pa.Robot) -> None:
    """Reference: the force of MuJoCo's equality constraint.

    The CoM is outside the support polygon of the feet.
    """
    stand = pa.solve_stand_as_simulated(armed, grip_bar(armed, beyond=0.02))
    found = verify_in_mujoco(armed, stand)
    assert found.joint_error < 1e-6
    robot = stand.check(armed)
    statics = pa.stance.stand_statics(robot, stand)
    pull = statics.weld_wrenches["hand"]
    assert pull[2] < -1.0  # downwards
    assert not pull[3:].any()
    assert statics.com_margin == pytest.approx(stand.com_margin, abs=1e-3)
    for force in statics.contact_forces.values():
        assert force[2] > 0
        np.testing.assert_allclose(force[:2], 0.0, atol=1e-12)
    held = make_stand_start(armed, stand)
    model, data = held.drive.model, mujoco.MjData(held.drive.model)
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    rest = simulate_commands(model, held.start, np.tile(held.ctrl, (2000, 1)))[-1]
    mujoco.mj_setState(model, data, rest, spec)
    data.ctrl[:] = held.ctrl
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
    assert rows.sum() == 3
    np.testing.assert_allclose(data.efc_force[rows], pull[:3], atol=1e-6 * np.linalg.norm(pull))
    np.testing.assert_allclose(found.foot_forces["hand"], data.efc_force[rows], atol=1e-6)
    np.testing.assert_array_equal(found.predicted_forces["hand"], pull[:3])
    drawn = {contact.foot: contact for contact in describe_scene(armed, stand, statics).contacts}
    np.testing.assert_array_equal(drawn["hand"].force, pull[:3])
    place = pa.Configuration(robot, stand.qpos).foot_positions()["hand"]
    np.testing.assert_allclose(drawn["hand"].point, place, atol=1e-9)
    borne = sum(found.foot_forces.values())
    np.testing.assert_allclose(borne, (0, 0, robot.weight), atol=1e-5 * robot.weight)
    alone = pa.verify_stand(armed, stand, integrator="implicitfast", feedforward=False)
    sag = pa.steady_state(armed, stand, seconds=4.5)
    most = 0.02 * np.abs(sag.joint_torques).max()
    np.testing.assert_allclose(sag.joint_torques, alone.joint_torques, atol=most)


def test_grip_balances_the_horizontal_force_of_a_foot_on_a_slope(armed: pa.Robot) -> None:
    """Reference: force balance; the foot on the slope is the only other contact with a horizontal
    force, larger in x than in y."""
    task = grip_bar(armed)
    slope = {"RL_calf": pa.Contact(pa.Slope(0.3, 0.5))}
    stand = pa.solve_stand(armed, replace(task, contacts={**task.contacts, **slope}))
    robot = stand.check(armed)
    statics = pa.stance.stand_statics(robot, stand)
    pull = statics.weld_wrenches["hand"][:3]
    aside = sum(statics.contact_forces.values())[:2]
    np.testing.assert_allclose(pull[:2], -aside, atol=1e-7 * robot.weight)
    assert abs(pull[0]) > 1.5 * abs(pull[1]) > 0.1
    assert not statics.weld_wrenches["hand"][3:].any()


@pytest.mark.parametrize("strength", [30.0, 4.0])
def test_grip_force_equals_an_independent_cone_program(armed: pa.Robot, strength: float) -> None:
    """Reference: smallest sum of squared forces, by Clarabel on MuJoCo's Jacobians. Feet only
    press, and the grip force is limited; with 4 N, the grip is at its limit.
    """
    beyond = 0.02 if strength > 10 else -0.01
    stand = pa.solve_stand_as_simulated(armed, grip_bar(armed, strength, beyond))
    robot = stand.check(armed)
    (data, rows), order = contact_rows(robot, stand), robot.mj_convention.qvel_index
    body, place = robot.contact_places["hand"]
    jacobian = np.zeros((3, robot.mj_model.nv))
    there = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
    mujoco.mj_jac(robot.mj_model, data, jacobian, None, there, body)
    pushed, load = np.vstack([*rows, jacobian])[:, order].T, data.qfrc_bias[order]
    count, size = len(rows), 3 * len(rows) + 3
    across = np.zeros((2 * count, size))
    across[np.arange(2 * count), [i for i in range(3 * count) if i % 3 < 2]] = 1.0
    up = np.zeros((count, size))
    up[np.arange(count), 3 * np.arange(count) + 2] = 1.0
    ball = np.vstack([np.zeros((1, size)), np.eye(3, size, k=3 * count)])
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.tol_gap_abs, settings.tol_gap_rel = False, 1e-13, 1e-13
    solved = clarabel.DefaultSolver(
        sparse.csc_matrix(np.eye(size)),
        np.zeros(size),
        sparse.csc_matrix(np.vstack([pushed[:6], across, -up, -ball])),
        np.concatenate([load[:6], np.zeros(3 * count), [strength, 0, 0, 0]]),
        [
            clarabel.ZeroConeT(6 + 2 * count),
            clarabel.NonnegativeConeT(count),
            clarabel.SecondOrderConeT(4),
        ],
        settings,
    ).solve()
    forces = np.array(solved.x).reshape(-1, 3)
    ours = pa.stance.stand_statics(robot, stand)
    np.testing.assert_allclose(ours.weld_wrenches["hand"][:3], forces[-1], atol=1e-4)
    for point, force in zip(stand.stance_feet, forces, strict=False):
        np.testing.assert_allclose(ours.contact_forces[point], force, atol=1e-4)
    used = float(np.linalg.norm(forces[-1]))
    assert used == pytest.approx(strength, rel=1e-3) if strength < 10 else used < 0.9 * strength


@pytest.mark.slow
def test_com_region_with_a_grip_equals_a_search_by_cone_programs(armed: pa.Robot) -> None:
    """Reference: for each of 1,000 CoM positions, a cone program (Clarabel)."""
    stand = pa.solve_stand(armed, grip_bar(armed, 10.0))
    robot = stand.check(armed)
    corners = tuple(map(tuple, stand.corners(robot).tolist()))
    points = np.vstack([*stand.contact_points.values(), stand.foot_targets["hand"]])
    mu = np.array([robot.contacts[foot].sliding_friction for foot in stand.stance_feet])
    ends, weight = np.array(corners), robot.weight
    low, high = ends.min(axis=0), ends.max(axis=0)
    tried = {True: 0, False: 0}
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    count = len(points)
    cones = np.zeros((4 * count, 3 * count))
    for number in range(count):
        cones[4 * number + 1 : 4 * number + 4, 3 * number : 3 * number + 3] = np.eye(3)
    for number, friction in enumerate(mu):
        cones[4 * number, 3 * number + 2] = friction
        cones[4 * number + 3] = 0.0
    most = np.zeros(4 * count)
    most[4 * len(mu)] = 10.0 / weight
    rows = np.vstack([np.tile(np.eye(3), count), np.hstack([pin.skew(point) for point in points])])
    for x, y in np.random.default_rng(0).uniform(low - 0.05, high + 0.05, (1000, 2)):
        margin = margin_of_position((float(x), float(y)), corners)
        if abs(margin) < 0.01 * float((high - low).max()):
            continue
        solved = clarabel.DefaultSolver(
            sparse.csc_matrix((3 * count, 3 * count)),
            np.zeros(3 * count),
            sparse.csc_matrix(np.vstack([rows, -cones])),
            np.concatenate([[0, 0, 1, y, -x, 0], most]),
            [clarabel.ZeroConeT(6), *[clarabel.SecondOrderConeT(4)] * count],
            settings,
        ).solve()
        assert (str(solved.status) == "Solved") is (margin > 0), (x, y, margin, solved.status)
        tried[margin > 0] += 1
    assert min(tried.values()) > 100


def test_arm_with_a_fixed_base_leans_on_a_table(arm: pa.Robot) -> None:
    """References: MuJoCo holds the stand, and the table reduces the torques of the arm alone.

    Without the table, torques and weld force equal those of the file with a fixed base.
    """
    stand = pa.solve_stand_as_simulated(arm, on_table(arm))
    assert not arm.floating
    np.testing.assert_allclose(stand.qpos[:7], (0, 0, 0, 1, 0, 0, 0), atol=1e-9)
    verify_in_mujoco(arm, stand)
    statics = pa.stance.stand_statics(arm, stand)
    assert statics.contact_forces["wrist"][2] > 1.0
    bare = pa.StandTask(contacts=BOLTED, ik_seed=tuple(stand.qpos[7:]))
    held = pa.load_robot(arm.description.urdf_source, fixed_base=True)
    lone = pa.gravity_compensation(pa.Configuration(held, stand.qpos[7:]), contacts=[])
    assert np.linalg.norm(statics.joint_torques) < np.linalg.norm(lone.joint_torques)
    free = pa.solve_stand(arm, bare)
    found = pa.stance.stand_statics(arm, free)
    same = pa.gravity_compensation(pa.Configuration(held, free.qpos[7:]), contacts=[])
    np.testing.assert_allclose(found.joint_torques, same.joint_torques, atol=1e-12)
    np.testing.assert_allclose(found.weld_wrenches["base"][2], arm.total_mass * 9.81, rtol=1e-12)


@pytest.mark.slow
def test_contact_has_the_stated_normal_force_in_mujoco(arm: pa.Robot, armed: pa.Robot) -> None:
    """Reference: MuJoCo's contact force, beside a weld, and of a hand that pushes a table down or a
    roof up."""
    pressed = {"hand": pa.Contact(HAND["hand"].plane, force=4.0)}
    roof = pa.Contact(pa.Plane((0, 0, 0.6), (0, 0, -1), 0.6), force=4.0)
    for robot, task, name in (
        (arm, on_table(arm, force=12.0), "wrist"),
        (armed, pa.StandTask(contacts=pressed), "hand"),
        (armed, pa.StandTask(contacts={"hand": roof}), "hand"),  # which presses it down
    ):
        stand = pa.solve_stand_as_simulated(robot, task)
        found = verify_in_mujoco(robot, stand)
        wanted = task.contacts[name].force  # type: ignore[union-attr]
        assert wanted == pytest.approx(found.foot_forces[name] @ stand.normals[name], rel=1e-6)


def test_stated_hand_force_shifts_the_com_region(armed: pa.Robot) -> None:
    """Closed form: the feet bear m g - F, so that their polygon is contracted towards the hand by
    the share F / (m g).
    """
    force = 5.0
    pressed = {"hand": pa.Contact(HAND["hand"].plane, force=force)}
    stand = pa.solve_stand(armed, pa.StandTask(contacts=pressed))
    touched = stand.check(armed)
    share = force / (armed.total_mass * 9.81)
    feet = [stand.contact_points[foot] for foot in armed.feet]
    hand = stand.contact_points["hand"]
    wanted = np.array([(1 - share) * foot[:2] + share * hand[:2] for foot in feet])
    points = np.array([*stand.contact_points.values()])
    stated = prescribed_forces(touched, stand.stance_feet)
    found = np.array(support_corners(points, np.tile([0, 0, 1.0], (5, 1)), [1e-3] * 5, stated))
    for corner in wanted:
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-3
    assert found[:, 0].max() == pytest.approx(wanted[:, 0].max(), abs=1e-3)
    margin = pa.stance.stand_statics(armed, stand).com_margin
    assert margin == pytest.approx(stand.com_margin, abs=1e-9)


@pytest.mark.slow
def test_sag_of_a_welded_robot_equals_the_simulation(arm: pa.Robot) -> None:
    """Reference: simulation without feed-forward; torques within 2 % of the largest torque, height
    loss within 1 %.
    """
    for robot, task in (
        (arm, on_table(arm)),
        (load("v3"), pa.StandTask(contacts={"FL": pa.Weld()})),
    ):
        stand = pa.solve_stand_as_simulated(robot, task)
        alone = pa.verify_stand(robot, stand, integrator="implicitfast", feedforward=False)
        sag = pa.steady_state(robot, stand, seconds=4.5)  # the middle of the measured interval
        way = np.abs(sag.qpos[7:] - stand.qpos[7:]).max()
        assert way > 1e-3
        np.testing.assert_allclose(
            sag.joint_torques, alone.joint_torques, atol=0.02 * np.abs(sag.joint_torques).max()
        )
        assert sag.height_loss == pytest.approx(alone.height_loss, rel=1e-2, abs=1e-7)
        assert not sag.failures


@pytest.mark.slow
def test_payload_of_a_welded_arm_equals_the_fixed_base_result(arm: pa.Robot) -> None:
    """Closed form: (40 N m - |gravity torque|) / lever arm, the smallest over the two loaded
    joints, with the torques of the file with a fixed base.
    """
    task = pa.StandTask(contacts=BOLTED, posture={"turn": 0.7, "bend": 0.5, "nod": 0.0})
    limit = pytest.importorskip("pupper_analysis.tools.payload.limit")
    most = limit.payload_limit(arm, task, ("wrist", 0.0, 0.0, 0.05), kp=2000.0, kd=20.0)
    held = pa.load_robot(arm.description.urdf_source, fixed_base=True)
    config = pa.Configuration(held, most.stand.qpos[7:])
    empty = pa.gravity_compensation(config, contacts=[]).joint_torques
    lever = np.abs(find_tool(held, "wrist").translated((0, 0, 0.05)).load_per_mass(config))
    own = min((40.0 - abs(empty[row])) / lever[row] for row in range(2))
    assert most.motors.mass == pytest.approx(own, rel=1e-5)
    assert most.passed


@pytest.mark.slow
@pytest.mark.parametrize("alone", [True, False])
def test_welded_arm_has_the_verdict_and_document_of_a_stand(arm: pa.Robot, *, alone: bool) -> None:
    """Also if the weld of the base is the only contact."""
    bare = pa.StandTask(contacts=BOLTED, posture={"turn": 0.7, "bend": 0.5})
    found = study_stance(arm, bare if alone else on_table(arm))
    assert found.passed, found.verdict.code
    shown = write_markdown(build_report([("arm", found)]))
    assert "base is fixed in the world" in shown
    assert " inf " not in shown
    wrench = found.statics.weld_wrenches["base"].tolist()
    (row,) = (line for line in shown.splitlines() if line.startswith("| base |"))
    shown_force = [float(cell) for cell in row.split("|")[2:5]]
    assert shown_force == pytest.approx(wrench[:3], abs=6e-4)
    moment = shown.split("an additional moment of ")[1].split(" N m")[0]
    assert [float(component) for component in moment.split()] == pytest.approx(
        wrench[3:], rel=1e-3, abs=1e-3
    )


def test_welds_are_equal_after_text_and_json_round_trips() -> None:
    for text in ("weld", "weld,place=0.1m/0.0m/0.3m,offset=0.0m/0.0m/0.05m"):
        assert str(parse_contact("contact", text, text)) == text
    pressed = "table:0.4m,mu=0.6,force=20.0N"
    assert str(parse_contact("contact", pressed, pressed)) == pressed
    task = pa.StandTask(contacts={"base": pa.Weld(), "hand": parse_contact("contact", pressed, "")})
    assert pa.StandTask.from_dict(json.loads(to_json(task))) == task


@pytest.mark.parametrize(
    ("contacts", "message"),
    [
        ({"base": pa.Weld(), "trunk": pa.Weld()}, "move as one body"),
        ({"base": pa.Weld(offset=(0, 0, 0.1))}, "omit offset"),
        ({"base": pa.Weld(place=(0, 0, 0.1))}, "omit place"),
        ({"FL_calf": pa.Weld(place=(0, 0, 0.1))}, "omit place"),
        (
            {"hand": pa.Weld(), "arm_elbow_link": pa.Contact(pa.Plane((0, 0, 0.5), (0, 0, 1)))},
            "move as one",
        ),
        ({"nothing": pa.Weld()}, "nothing"),
        ({"base": pa.Contact(pa.Plane((0, 0, 0.5), (0, 0, 1)))}, "fixed to the base"),
    ],
)
def test_welds_that_make_no_sense_are_refused(
    armed: pa.Robot, contacts: dict[str, pa.Contact | pa.Weld], message: str
) -> None:
    with pytest.raises(pa.PupperAnalysisError, match=message) as refused:
        pa.solve_stand(armed, pa.StandTask(contacts=contacts))
    assert "\n" not in str(refused.value)


def test_weld_of_a_foot_at_a_place_is_refused_if_the_robot_has_the_weld_already() -> None:
    robot = with_contacts(load("v3"), {"FR": pa.Weld()})
    with pytest.raises(pa.ConfigurationError, match="omit place"):
        with_contacts(robot, {"FR": pa.Weld(place=(0.0, 0.0, 0.1))})


def test_weld_of_a_base_without_body_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "bar.xml"
    file.write_text(
        '<mujoco><worldbody><body name="bar"><joint name="j" axis="0 1 0"/>'
        '<geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/></body></worldbody>'
        '<actuator><position joint="j" kp="50" kv="2"/></actuator></mujoco>',
        encoding="utf-8",
    )
    robot = pa.load_robot(file)
    with pytest.raises(pa.ConfigurationError, match="no body of its own"):
        pa.solve_stand(robot, pa.StandTask(contacts=BOLTED))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("welded", "requests"),
    [
        (("FR",), {"height": 0.3}),
        (("base",), {"height": 0.3}),
        (("FR",), {"roll": 1.0}),
        (("FR", "FL", "RR", "RL"), {"height": 0.3}),
    ],
)
def test_a_welded_stance_out_of_reach_is_refused_with_a_reachable_one(
    welded: tuple[str, ...], requests: dict[str, float]
) -> None:
    """With a weld and the CoM inside, no constraint was left, and the search raised ValueError.

    Reference: the stance that the refusal proposes is solved.
    """
    robot = load("v3")
    task = pa.StandTask(com="inside", contacts=dict.fromkeys(welded, pa.Weld()), **requests)
    with pytest.raises(pa.StanceUnreachableError) as refused:
        pa.solve_stand(robot, task)
    limits = refused.value.limits
    assert limits
    for possible in limits.values():
        pa.solve_stand(robot, replace(task, **possible))


@pytest.mark.slow
def test_four_welded_feet_hold_the_robot_in_equilibrium() -> None:
    """24 rows of four welds act on 18 coordinates: at most 18 are independent.

    References: Newton's law (the wrenches of the welds carry the weight), and MuJoCo's simulation
    without feed-forward. The four legs are a parallelogram linkage, so the base can still sink.
    """
    robot = load("v3")
    task = pa.StandTask(contacts=dict.fromkeys(("FR", "FL", "RR", "RL"), pa.Weld()))
    stance = study_stance(robot, task)
    assert stance.passed
    carried = sum(wrench[2] for wrench in stance.statics.weld_wrenches.values())
    assert carried == pytest.approx(9.81 * robot.total_mass, rel=1e-9)
    assert stance.settled is not None
    assert stance.settled.servo_sag == pytest.approx(stance.sagging.servo_sag, abs=1e-5)


DROOPING = ARM.replace('<axis xyz="1 0 0"/>{limit}', '<axis xyz="1 0 0"/>{tip}')
"""Arm whose last joint has a range with a middle other than zero."""


@pytest.fixture(scope="module")
def drooping(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    file = tmp_path_factory.mktemp("drooping") / "arm.urdf"
    text = DROOPING.format(
        box=inertial(2.0, "0 0 0.05", '<box size="0.2 0.2 0.1"/>'),
        rod=inertial(1.0, "0 0 0.15", '<cylinder radius="0.03" length="0.2"/>'),
        ball=inertial(0.5, "0 0 0.05", '<sphere radius="0.04"/>'),
        limit='<limit lower="-1" upper="2.5" effort="40" velocity="5"/>',
        tip='<limit lower="0.2" upper="1.4" effort="40" velocity="5"/>',
    )
    file.write_text(text, encoding="utf-8")
    return pa.load_robot(file)


def test_stand_with_a_welded_base_starts_in_the_posture_of_hold(drooping: pa.Robot) -> None:
    """Reference: ``find_posture``, the middle of the joint ranges: 0.75, 0.75 and 0.8 rad."""
    posture = pa.posture.find_posture(drooping)
    np.testing.assert_allclose(posture.qpos, [0.75, 0.75, 0.8])
    stand = pa.solve_stand(drooping, pa.StandTask(contacts=BOLTED))
    np.testing.assert_allclose(stand.qpos[7:], posture.qpos, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("positions", [None, {"turn": 0.6, "bend": 2.45, "nod": 0.5}])
def test_a_posture_of_hold_typed_into_stand_gives_its_torques_and_verdict(
    drooping: pa.Robot, positions: dict[str, float] | None
) -> None:
    """Also with the wrist below the base, since the file has no ground.

    Reference: the torques and the verdict of ``hold_posture``.
    """
    held = pa.hold_posture(drooping, positions)
    typed = dict(zip(drooping.joint_names, held.posture.qpos.tolist(), strict=True))
    stance = study_stance(drooping, pa.StandTask(contacts=BOLTED, posture=typed))
    np.testing.assert_allclose(stance.statics.joint_torques, held.statics.joint_torques, atol=1e-6)
    assert stance.verdict.code == held.verdict.code
    assert stance.passed


@pytest.mark.slow
def test_welded_base_loses_no_height_although_its_feet_sink() -> None:
    """Reference: 3 s of MuJoCo without feed-forward. The legs' weight presses the feet down.

    The deflection of the joints was reported as a height gain of 0.32 mm, compensated by the feet.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(contacts={"base_link": pa.Weld()}))
    rest = pa.steady_state(robot, stand)
    run = pa.verify_stand(robot, stand, feedforward=False, duration=3.0, nudged=0.0)
    for sag in (rest, run):
        assert sag.height_loss == pytest.approx(0.0, abs=1e-6)
        assert sag.servo_sag == pytest.approx(sag.height_loss, abs=1e-12)
        assert sag.contact_sag == 0.0
    deflections = rest.qpos[7:] - stand.qpos[7:]
    assert np.abs(deflections).max() > 0.01
    dry_friction = 0.01 / 5.0  # frictionloss / kp: deadband of a joint [rad]
    np.testing.assert_allclose(run.joint_positions, rest.qpos[7:], atol=dry_friction)
