"""Contacts that a task specifies (feet on planes, hands, grips), against MuJoCo and cone programs
of the tests.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import clarabel
import mujoco
import numpy as np
import pytest
from scipy import sparse

import pupper_analysis as pa
from pupper_analysis.base.results import to_json
from pupper_analysis.cli.stance_fields import parse_contact
from pupper_analysis.present.scene import describe_scene
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.problem import ground_normals
from pupper_analysis.stance.sag.equilibrium import ground_points
from pupper_analysis.tools.stand.stance import largest_presses
from pupper_analysis.tools.study.design import apply_stance_values
from pupper_analysis.tools.study.study import Study
from tests.stance.test_slopes import edges_of, search_region
from tests.support.legged import biped, quadruped, with_arm
from tests.support.variants import load

TABLE, HAND = 0.5, "hand"


@pytest.fixture(scope="module")
def armed(tmp_path_factory: pytest.TempPathFactory) -> pa.Robot:
    """Return a quadruped with an arm of three joints, whose hand is a sphere of 25 mm."""
    pair = with_arm(quadruped(tmp_path_factory.mktemp("armed"), floor=True, actuators="position"))
    return pa.load_robot(*pair)


def roof(degrees: float, friction: float | None = None) -> dict[str, pa.Contact]:
    """Return contacts of v3's feet on a roof whose ridge is above the x axis."""
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    left, right = (pa.Plane((0, 0, 0.045), (0, side * s, c), friction) for side in (1, -1))
    return {f: pa.Contact(left if f[1] == "L" else right) for f in ("FL", "FR", "RL", "RR")}


def table(friction: float | None = None, **more: object) -> dict[str, pa.Contact]:
    return {HAND: pa.Contact(pa.Plane((0, 0, TABLE), (0, 0, 1), friction), **more)}  # type: ignore[arg-type]


def grip_bar(of: pa.Robot, grip: float = 30.0, beyond: float = -0.02) -> pa.StandTask:
    """Return the task of a quadruped whose hand grips a bar across, in front of and above it.

    The CoM is `beyond` [m] behind the hind feet, which are moved forward.
    """
    bar = pa.Bar((0.4, 0, 0.45), (0, 1, 0), 0.01)
    hand = pa.Contact(bar, place=(0.35, 0, 0.45), grip=grip)
    forward = dict.fromkeys(("RL_calf", "RR_calf"), (0.12, 0.0))
    feet = pa.solve_stand(
        of, pa.StandTask(foot_offsets=forward, height=0.27)
    ).contact_points.values()
    com = (min(float(place[0]) for place in feet) - beyond, 0.0)
    return pa.StandTask(contacts={"hand": hand}, com=com, foot_offsets=forward, height=0.27)


@pytest.mark.parametrize("grip", [1.0, 500.0])
def test_a_robot_on_a_single_grip_is_refused(armed: pa.Robot, grip: float) -> None:
    """Neither too weak a grip, which was a LinAlgError, nor a strong one has a support area."""
    contacts = grip_bar(armed, grip).contacts
    task = pa.StandTask(contacts=contacts, swing=dict.fromkeys(armed.feet, 0.02), com="inside")
    with pytest.raises(pa.ConfigurationError, match="no contacts except grips"):
        pa.solve_stand(armed, task)


def test_mujoco_holds_a_stand_on_a_roof() -> None:
    """Reference: simulation on two planes of 30 deg."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=roof(30, 0.9)))
    for foot, point in stand.contact_points.items():
        plane = stand.task.contacts[foot].plane
        assert plane.signed_distance(point) == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(stand.normals[foot], plane.normal, atol=1e-15)
    found = pa.verify_stand(robot, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < 1e-6
    assert found.force_error < 1e-6


def test_foot_force_error_is_measured_along_the_normal_of_its_plane() -> None:
    """Simulated without feed-forward, where the forces differ from the prediction."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=roof(30, 0.9)))
    found = pa.verify_stand(robot, stand, feedforward=False)
    forces, predicted = found.foot_forces, found.predicted_forces
    light = 0.05 * sum(force[2] for force in predicted.values())

    def worst(out: dict[str, np.ndarray]) -> float:
        return max(
            abs((forces[foot] - force) @ out[foot]) / max(force @ out[foot], light)
            for foot, force in predicted.items()
        )

    assert found.force_error == pytest.approx(worst(stand.normals), rel=1e-12)
    up = dict.fromkeys(predicted, np.array([0.0, 0.0, 1.0]))
    assert found.force_error != pytest.approx(worst(up), rel=1e-2)
    assert stand.lift_directions(robot)["FL"] @ stand.normals["FL"] == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("com", [None, (0.05, 0.02)])
def test_mujoco_holds_a_stand_with_a_hand_on_a_table(
    armed: pa.Robot, com: tuple[float, float] | None
) -> None:
    """Reference: simulations with and without feed-forward."""
    stand = pa.solve_stand_as_simulated(armed, pa.StandTask(contacts=table(0.6), com=com))
    found = pa.verify_stand(armed, stand, integrator="implicitfast")
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < 1e-6
    assert found.force_error < 1e-6
    assert found.predicted_forces[HAND][2] > 5.0  # N
    assert found.mujoco_residual < 1e-9
    alone = pa.verify_stand(armed, stand, integrator="implicitfast", feedforward=False)
    sag = pa.steady_state(armed, stand, seconds=4.5)  # the middle of the measured interval
    assert sag.height_loss == pytest.approx(alone.height_loss, rel=1e-3)
    assert sag.contact_sag == pytest.approx(alone.contact_sag, rel=1e-3)
    for foot, force in alone.foot_forces.items():
        np.testing.assert_allclose(sag.contact_forces[foot], force, atol=5e-3)


def contact_rows(robot: pa.Robot, stand: pa.Stand) -> tuple[mujoco.MjData, list[np.ndarray]]:
    """Return MuJoCo's data at a stand, and its Jacobians of the contact points, shape (3, nv)."""
    model = robot.mj_model
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    rows = []
    for point in stand.stance_feet:
        body, place = robot.contact_places[point]
        centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        deep = robot.contact_radius[point] - stand.depths[point] / 2
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, centre - deep * stand.normals[point], body)
        rows.append(jacobian)
    return data, rows


def in_mujoco(robot: pa.Robot, stand: pa.Stand) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return J^T of the contact points, the generalised load of motors and contacts, and the rows
    of the friction cones, by MuJoCo.
    """
    (data, rows), points = contact_rows(robot, stand), list(stand.stance_feet)
    pushed = np.vstack(rows)[:, robot.mj_convention.qvel_index].T
    load = data.qfrc_bias[robot.mj_convention.qvel_index]
    size = 3 * len(points)
    cones = np.zeros((4 * len(points), size))
    for number, point in enumerate(points):
        out, own = stand.normals[point], slice(3 * number, 3 * number + 3)
        cones[4 * number, own] = robot.contacts[point].sliding_friction * out
        cones[4 * number + 1 : 4 * number + 4, own] = np.eye(3) - np.outer(out, out)
    return pushed, load, cones


def least_torque(robot: pa.Robot, stand: pa.Stand) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the forces of smallest squared torque, by Clarabel on MuJoCo's Jacobians, and the
    torques.
    """
    (pushed, load, cones), points = in_mujoco(robot, stand), list(stand.stance_feet)
    size = 3 * len(points)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.tol_gap_abs, settings.tol_gap_rel = False, 1e-13, 1e-13
    solved = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(pushed[6:].T @ pushed[6:] + 1e-12 * np.eye(size))),
        -pushed[6:].T @ load[6:],
        sparse.csc_matrix(np.vstack([pushed[:6], -cones])),
        np.concatenate([load[:6], np.zeros(len(cones))]),
        [clarabel.ZeroConeT(6), *[clarabel.SecondOrderConeT(4)] * len(points)],
        settings,
    ).solve()
    forces = np.array(solved.x)
    return dict(zip(points, forces.reshape(-1, 3), strict=True)), load[6:] - pushed[6:] @ forces


def test_least_torque_equals_a_cone_programme_on_mujocos_jacobians(armed: pa.Robot) -> None:
    """Reference: a cone programme of the test, with MuJoCo's Jacobians and bias forces."""
    for robot, task in (
        (load("v3"), pa.StandTask(contacts=roof(30, 0.9))),
        (load("v3"), pa.StandTask(contacts=roof(20, 0.25))),  # at the edge of some cones
        (armed, pa.StandTask(contacts=table(0.2))),
    ):
        stand = pa.solve_stand_as_simulated(robot, task)
        robot = stand.check(robot)
        ours = pa.stance.stand_statics(robot, stand, distribution="minimum torque")
        forces, torques = least_torque(robot, stand)
        np.testing.assert_allclose(ours.joint_torques, torques, atol=1e-5)
        for point, force in forces.items():
            np.testing.assert_allclose(ours.contact_forces[point], force, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("effort", [600.0, 60.0])
def test_maximum_hand_force_equals_an_independent_cone_program(
    armed: pa.Robot, effort: float
) -> None:
    """Reference: a cone program (Clarabel) with MuJoCo's Jacobians, limited by friction or by a
    motor. A required force slightly below the maximum has an equilibrium, slightly above it has
    none."""
    robot = pa.robot.with_efforts(armed, dict.fromkeys(armed.joint_names, effort))
    wall = pa.Contact(pa.Plane((0.45, 0, 0), (-1, 0, 0), 0.6), place=(0.45, 0.0, 0.45))
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts={HAND: wall}))
    (press,) = largest_presses(robot, stand)
    view = stand.check(robot)
    pushed, load, cones = in_mujoco(view, stand)
    size, points = pushed.shape[1], list(stand.stance_feet)
    own, out = 3 * points.index(HAND), stand.normals[HAND]
    linear = np.zeros(size)
    linear[own : own + 3] = -out
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solved = clarabel.DefaultSolver(
        sparse.csc_matrix((size, size)),
        linear,
        sparse.csc_matrix(np.vstack([pushed[:6], pushed[6:], -pushed[6:], -cones])),
        np.concatenate([load[:6], load[6:] + effort, effort - load[6:], np.zeros(len(cones))]),
        [
            clarabel.ZeroConeT(6),
            clarabel.NonnegativeConeT(2 * view.nu),
            *[clarabel.SecondOrderConeT(4)] * len(points),
        ],
        settings,
    ).solve()
    assert press.force == pytest.approx(-solved.obj_val, rel=1e-5)
    torques = np.abs(load[6:] - pushed[6:] @ np.array(solved.x))
    limited = bool((torques > 0.9999 * effort).any())
    assert limited is (effort < 600)

    def peak(force: float) -> float:
        stated = pa.Contact(wall.plane, wall.place, force=force)
        pressed = pa.solve_stand(robot, pa.StandTask(contacts={HAND: stated}))
        return float(
            pa.stance.stand_statics(
                robot, pressed, distribution="min-max torque"
            ).motor_utilisation.max()
        )

    assert peak(0.99 * press.force) <= 1.0
    if limited:
        assert peak(1.01 * press.force) > 1.0
    else:
        with pytest.raises(pa.StaticsInfeasibleError):
            peak(1.01 * press.force)


def test_friction_of_a_plane_applies_to_its_contact_only() -> None:
    """Reference: MuJoCo's contacts.

    The contact of FL has the plane's friction, 0.7; all other parameters, and the other feet, are
    unchanged.
    """
    robot, contacts = load("v3"), roof(20)
    own = pa.Contact(pa.Plane(contacts["FL"].plane.point, contacts["FL"].plane.normal, 0.7))
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=contacts | {"FL": own}))
    grounded = build_on_ground(stand.check(robot), stand.task.ground, stand.rigid_targets)
    data = mujoco.MjData(grounded.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(grounded.mj_model, data)
    seen = {}
    for touch in data.contact:
        foot = next(grounded.foot_geoms[geom] for geom in touch.geom if geom in grounded.foot_geoms)
        seen[foot] = touch
    assert seen.keys() == set(robot.feet)
    for foot, touch in seen.items():
        parameters = robot.contacts[foot]
        assert touch.friction[0] == (0.7 if foot == "FL" else parameters.sliding_friction)
        np.testing.assert_allclose(touch.friction[2:], parameters.friction[2:], atol=1e-15)
        np.testing.assert_allclose(touch.solref, parameters.solref, atol=1e-15)
        np.testing.assert_allclose(touch.solimp, parameters.solimp, atol=1e-15)
    assert grounded.contacts["FL"].sliding_friction == 0.7
    assert grounded.contacts["FR"] == robot.contacts["FR"]


def test_hand_is_a_massless_ball_that_touches_only_its_plane(armed: pa.Robot) -> None:
    """References: positions in both engines, and the contact masks of the compiled model."""
    task = pa.StandTask(contacts=table())
    robot = with_contacts(armed, task.contacts)
    assert robot.hands == (HAND,)
    assert robot.contact_points == (*armed.contact_points, HAND)
    assert robot.contact_radius[HAND] == pytest.approx(0.025, abs=1e-9)  # radius of the hand
    assert robot.notes[-1].code == "hand-touches-by-ball"
    assert "ball of 25 mm" in str(robot.notes[-1])
    assert robot.total_mass == armed.total_mass
    assert robot.mj_model.body_mass.sum() == armed.mj_model.body_mass.sum()
    random = np.random.default_rng(0)
    qpos = robot.make_qpos(random.uniform(-1, 1, robot.nu))
    config = pa.Configuration(robot, qpos)
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(robot.mj_model, data)
    np.testing.assert_allclose(
        config.foot_positions()[HAND], data.geom(HAND).xpos, atol=1e-12
    )  # both engines' place
    stand = pa.solve_stand(armed, task)
    model = build_on_ground(robot, stand.task.ground, stand.rigid_targets).mj_model
    top = model.geom(f"step_{HAND}").id
    meets = [
        model.geom(geom).name
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom]
        and (
            model.geom_contype[geom] & model.geom_conaffinity[top]
            or model.geom_contype[top] & model.geom_conaffinity[geom]
        )
    ]
    assert meets == [f"{HAND} (contact)"]


@pytest.mark.slow
def test_soles_and_hand_balance_on_separate_planes(tmp_path: Path) -> None:
    """Reference: MuJoCo's torques and sag. Contact points have a common order, the hand last."""
    robot = pa.load_robot(*with_arm(biped(tmp_path), "", "pelvis"))
    contact = pa.Contact(pa.Plane((0, 0, TABLE), (0, 0, 1), 0.6), place=(0.45, 0.0, TABLE))
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts={HAND: contact}))
    found = pa.verify_stand(robot, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < 1e-6
    assert list(found.predicted_forces) == [*robot.feet, HAND]
    alone = pa.verify_stand(robot, stand, feedforward=False)
    sag = pa.steady_state(robot, stand, seconds=4.5)
    assert sag.height_loss == pytest.approx(alone.height_loss, rel=1e-3)
    named = stand.check(robot)
    assert [*ground_normals(named, stand.task.ground)] == [*named.contact_points]
    points = ground_points(named, stand)
    assert [*points] == [*named.contact_points]
    assert points[HAND][2] == pytest.approx(stand.contact_points[HAND][2], abs=1e-12)


def test_a_sole_neither_grips_nor_stands_on_a_bar(tmp_path: Path) -> None:
    """A foot with several contact points has no single contact with a bar."""
    robot = pa.load_robot(*biped(tmp_path))
    foot = next(iter(robot.feet))
    bar = pa.Bar((0, 0, 0), (0, 1, 0), 0.02)
    for contact in (pa.Contact(bar), pa.Contact(pa.Plane((0, 0, 0), (0, 0, 1)), grip=60.0)):
        with pytest.raises(pa.ConfigurationError, match=f"{foot} touches with several points"):
            pa.solve_stand(robot, pa.StandTask(contacts={foot: contact}))


def test_hand_contact_is_at_its_home_position_or_at_the_given_place(armed: pa.Robot) -> None:
    """Reference: the position of the hand in the home pose, and the given place, on the plane."""
    home = armed.make_qpos(armed.home[7:])
    home[2] = armed.stand_height
    robot = with_contacts(armed, table())
    there = pa.Configuration(robot, home).foot_positions()[HAND]
    stand = pa.solve_stand(armed, pa.StandTask(contacts=table()))
    np.testing.assert_allclose(stand.contact_points[HAND], (*there[:2], TABLE), atol=1e-12)
    wall = pa.Contact(pa.Plane((0.5, 0, 0), (-1, 0, 0)), place=(0.45, 0.05, 0.48), radius=0.01)
    stand = pa.solve_stand(armed, pa.StandTask(contacts={HAND: wall}))
    np.testing.assert_allclose(stand.contact_points[HAND], (0.5, 0.05, 0.48), atol=1e-12)
    feet = [stand.contact_points[foot] for foot in armed.feet]
    assert stand.qpos[2] == pytest.approx(np.mean(feet, axis=0)[2] + armed.stand_height, abs=1e-9)


def test_a_robot_has_the_contacts_of_each_task(armed: pa.Robot) -> None:
    """The same robot for the same contacts, wherever planes are; and back again."""
    one = with_contacts(armed, table(0.5))
    assert with_contacts(armed, {HAND: pa.Contact(pa.Plane((0, 0, 1), (1, 0, 0), 0.5))}) is one
    assert with_contacts(one, table(0.5)) is one
    assert with_contacts(one, {}) is armed
    assert with_contacts(one, table(0.6)) is with_contacts(armed, table(0.6))
    assert with_contacts(armed, {"FL_calf": pa.Contact(pa.Plane((0, 0, 0), (0, 0, 1)))}) is armed
    loaded = pa.robot.with_payload(one, 0.5)
    assert loaded.contacts[HAND].sliding_friction == 0.5
    assert with_contacts(loaded, table(0.5)) is loaded
    with pytest.raises(pa.ConfigurationError, match="contacts"):
        with_contacts(loaded, {})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_com_region_with_a_hand_equals_a_search_by_linear_programs(
    armed: pa.Robot, seed: int
) -> None:
    """Reference: for each of 1,000 CoM positions, a linear program over the edges of the friction
    cones."""
    wall = pa.Contact(pa.Plane((0.5, 0, 0.5), (-0.8, 0, 0.6), 0.5))
    task = pa.StandTask(contacts={HAND: wall})
    stand = pa.solve_stand(armed, task)
    robot = stand.check(armed)
    corners = tuple(map(tuple, stand.corners(robot).tolist()))
    points = np.array([*stand.contact_points.values()])
    cones = [
        edges_of(stand.normals[point], robot.contacts[point].sliding_friction)
        for point in stand.contact_points
    ]
    shares = np.random.default_rng(seed).uniform(size=(1000, 2))
    assert min(search_region(corners, points, cones, shares, 0.01)) > 100


def test_contacts_are_equal_after_json_and_command_line_round_trips() -> None:
    """Reference: the contacts before."""
    contacts = {
        "FL": pa.Contact(pa.Plane((0.4, 0, 0), (-2, 0, 0), 0.6), place=(0.4, 0.1, 0.3)),
        "hand": pa.Contact(pa.Plane((0, 0, 0.7), (0, 0, 1)), offset=(0.1, 0, 0), radius=0.02),
        "head": pa.Contact(pa.Plane((0, 0, 1.2), (0, 0, -1))),
        "RR": pa.Contact(pa.Plane((0.1, 0.2, 0.3), (0.0, 0.6, 0.8), 0.0)),
        "RL": pa.Contact(pa.Slope(0.3, -1.0, 0.7), place=(0.1, 0.2, 0.3)),
        "FR": pa.Contact(pa.Slope(math.pi)),
        "tail": pa.Contact(pa.Bar((0.1, 0, 1.2), (0, 2, 0), 0.01, 0.5), grip=60.0),
    }
    task = pa.StandTask(contacts=contacts, ground=pa.Ground(slope=0.1))
    assert pa.StandTask.from_dict(json.loads(to_json(task))) == task
    for contact in contacts.values():
        assert parse_contact("contact", str(contact), "") == contact
    assert str(contacts["FL"]).startswith("wall:0.4m,mu=0.6")
    assert "FL on wall:400mm" in str(task)
    assert "RL on slope:17.19deg,uphill=-57.3deg,mu=0.7" in str(task)
    assert "FL 接触 wall:400mm" in task.describe("zh")


def test_study_varies_the_position_of_a_plane() -> None:
    """By the number that is typed: x of a wall, z of a table, else along the normal."""
    slanted = pa.Contact(pa.Plane((0.1, 0.2, 0.3), (0.0, 0.6, 0.8)))
    rung = pa.Contact(pa.Bar((0.4, 0, 0.45), (0, 1, 0), 0.01), (0.35, 0, 0.45), grip=30.0)
    wall = pa.Contact(pa.Plane((0.4, 0, 0), (-1, 0, 0), 0.6))
    task = pa.StandTask(contacts={"a": wall, "b": slanted, "c": wall, "d": rung})
    found = apply_stance_values(
        task, {"contacts:a": 0.45, "contacts:b": 0.5, "contacts:d": 0.4}
    ).contacts
    assert found["d"] == pa.Contact(
        pa.Bar((0.4, 0, 0.4), (0, 1, 0), 0.01), (0.35, 0, 0.45), grip=30.0
    )
    assert found["a"] == pa.Contact(pa.Plane((0.45, 0, 0), (-1, 0, 0), 0.6))
    assert found["c"] == wall
    moved = np.array(found["b"].plane.point) - slanted.plane.point
    np.testing.assert_allclose(moved, 0.14 * np.array(slanted.plane.normal), atol=1e-15)
    assert found["b"].plane.parameter == pytest.approx(0.5, abs=1e-15)
    design = {"robot": "v3", "measure": ["stands"], "vary": {"contacts:X": {"values": [1, 2]}}}
    with pytest.raises(pa.UnknownNameError, match="contact 'X'"):
        Study.of(design)


def plane(**more: object) -> pa.Contact:
    return pa.Contact(pa.Plane((0, 0, 0.02), (0, 0, 1)), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: pa.Plane((0, 0, 0), (0, 0, 0)), "not a direction"),
        (lambda: pa.Plane((0, 0, 0), (0, 0, 1), -0.1), "friction: -0.1 is not between"),
        (lambda: pa.Plane((0, 0, math.nan), (0, 0, 1)), r"plane\.point"),
        (lambda: pa.Plane((0, 0), (0, 0, 1)), r"plane\.point"),  # type: ignore[arg-type]
        (lambda: plane(radius=0), "radius"),
        (lambda: pa.StandTask(contacts={"FL": "wall"}), r"contacts\[FL\]"),  # type: ignore[dict-item]
        (lambda: pa.StandTask.from_dict({"contacts": {"FL": {"wall": 1}}}), "is not a contact"),
        (
            lambda: pa.StandTask(contacts={"FL": plane()}, ground=pa.Ground(heights={"FL": 0.01})),
            "FL has both a plane of its own and an entry in heights",
        ),
        (lambda: pa.Slope(0.1, math.inf), r"slope\.uphill"),
        (lambda: pa.Bar((0, 0, 0), (0, 0, 0), 0.1), "not a direction"),
        (lambda: pa.Bar((0, 0, 0), (0, 1, 0), 0.0), r"bar\.radius: 0"),
        (lambda: plane(grip=0), "grip: 0 is not more than 0"),
        (lambda: plane(grip=5.0, force=3.0), "either a grip or a force"),
        (
            lambda: pa.Bar((0, 0, 0), (0, 1, 0), 0.1).contact_plane((0, 3, 0)),
            "on the axis of the bar",
        ),
        (lambda: pa.Slope(0.1, friction=-1), "friction: -1"),
        (
            lambda: pa.StandTask.from_dict({"contacts": {"FL": {"plane": {"angle": 4}}}}),
            r"slope\.angle",
        ),
        (
            lambda: pa.StandTask(
                contacts={"FL": plane(place=(0, 0, 0))}, foot_offsets={"FL": (0, 0)}
            ),
            "has a place",
        ),
        (lambda: plane().with_parameters((1, 2)), r"parameters: shape \(2,\) is wrong"),
        (lambda: plane().with_parameters(()), r"parameters: shape \(0,\) is wrong"),
        (lambda: plane().with_parameters((True,)), "parameters: .* bool"),
        (lambda: pa.Contact(pa.Slope(0.1)).with_parameters(0.2), "parameters: shape"),  # type: ignore[arg-type]
        (lambda: plane().with_plane_parameter("a"), r"plane\.parameter: 'a'"),  # type: ignore[arg-type]
    ],
)
def test_invalid_contact_is_refused_in_one_line(make: object, match: str) -> None:
    """The message names the field or the reason."""
    with pytest.raises(pa.ConfigurationError, match=match) as caught:
        make()  # type: ignore[operator]
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(("radius", "lean"), [(0.01, 0.0), (0.001, 0.0), (0.02, 0.1)])
def test_foot_on_a_bar_touches_its_top_or_the_stated_place(radius: float, lean: float) -> None:
    """Reference: closed form of the contact point and normal.

    Without a place, the contact is at the top; otherwise, the normal points from the axis to the
    place.
    """
    robot = load("v3")
    x, y, _ = pa.solve_stand(robot).contact_points["FL"]
    bar = pa.Bar((x, 0, 0.02), (0, 1, 0), radius)
    place = (x + 0.1 * math.sin(lean), y, 0.02 + 0.1 * math.cos(lean)) if lean else None
    right = pa.Contact(bar, (place[0], -y, place[2])) if place else pa.Contact(bar)
    contacts = {"FL": pa.Contact(bar, place), "FR": right}
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=contacts))
    out = (math.sin(lean), 0.0, math.cos(lean))
    np.testing.assert_allclose(stand.normals["FL"], out, atol=1e-12)
    wanted = (x + radius * out[0], y, 0.02 + radius * out[2])
    np.testing.assert_allclose(stand.contact_points["FL"], wanted, atol=1e-9)
    model = build_on_ground(stand.check(robot), stand.task.ground, stand.rigid_targets).mj_model
    assert model.geom("step_FL").type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER.value
    seen = describe_scene(robot, stand, None)
    for step in seen.steps.values():  # cylinders about the bar
        assert step.round
        np.testing.assert_allclose(np.cross(step.centre - bar.point, bar.direction), 0, atol=1e-9)
        np.testing.assert_allclose(abs(step.rotation[:, 2] @ bar.direction), 1, rtol=1e-9)
        np.testing.assert_allclose(step.half[:2], radius, rtol=1e-9)
    found = pa.verify_stand(robot, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    if not lean:
        assert found.torque_error < 1e-6
        assert found.force_error < 1e-6


def test_contact_of_an_unknown_part_or_a_foot_is_refused(armed: pa.Robot) -> None:
    """The message names the most similar parts, or the reason."""
    with pytest.raises(pa.UnknownNameError, match="arm_elbow_link"):
        pa.solve_stand(armed, pa.StandTask(contacts={"paw": plane()}))
    with pytest.raises(
        pa.UnknownNameError, match="no foot or frame 'LF'; the most similar names are: FR, FL, RL"
    ):
        pa.solve_stand(load("v3"), pa.StandTask(contacts={"LF": plane()}))
    calf = pa.StandTask(contacts={"FL_knee_body": plane()})
    with pytest.raises(pa.UnknownNameError):
        pa.solve_stand(armed, calf)
    v3 = load("v3")
    carrier = v3.contact_frames["FL"]
    with pytest.raises(pa.ConfigurationError, match="specify the contact of FL"):
        pa.solve_stand(v3, pa.StandTask(contacts={carrier: plane()}))
    with pytest.raises(pa.ConfigurationError, match="trunk is fixed to the base"):
        pa.solve_stand(armed, pa.StandTask(contacts={"trunk": plane()}))
    with pytest.raises(pa.ConfigurationError, match="FL is a foot"):
        pa.solve_stand(v3, pa.StandTask(contacts={"FL": plane(radius=0.01)}))


FOOT = pa.Contact(pa.Plane((0, 0, 0.02), (0, 0, 1)))


def solve_balanced_stand(of: pa.Robot, **task: Any) -> pa.Stand:
    """Return a stand; raise an error if it is out of reach or not in balance."""
    stand = pa.solve_stand(of, pa.StandTask(**task))
    pa.stance.stand_statics(of, stand)
    return stand


def hand_on(what: object, **more: Any) -> dict[str, pa.Contact]:
    return {HAND: pa.Contact(what, **more), "RL_calf": FOOT}  # type: ignore[arg-type]


def grip_of(of: pa.Robot, grip: float) -> pa.Stand:
    """Return the stand of a strong grip with another grip force; raise an error without balance."""
    strong = pa.solve_stand(of, grip_bar(of, beyond=0.02))
    contacts = grip_bar(of, grip, beyond=0.02).contacts
    stand = replace(strong, task=replace(strong.task, contacts=contacts))
    pa.stance.stand_statics(with_contacts(of, contacts), stand)
    return stand


def make_slopes(friction: float) -> dict[str, pa.Contact]:
    way = (-math.sin(math.radians(20)), 0.0, math.cos(math.radians(20)))
    return dict.fromkeys(load("v3").feet, pa.Contact(pa.Plane((0, 0, 0), way, friction)))


def read_nearest(name: str) -> Callable[[Any], pa.Contact]:
    """Return a function that reads the nearest reachable contact from an error, and parses its
    printed text.
    """

    def read(error: Any) -> pa.Contact:
        limits = error.limits["contacts"]["contacts"]
        assert limits.get("RL_calf", FOOT) == FOOT  # not relaxed
        text = f"{limits[name]:.7g}"
        assert f"{name}={text}" in str(error).partition("Possible")[2]
        return parse_contact("contact", text, "")  # type: ignore[return-value]

    return read


def get_defect(error: Any) -> Any:
    """Return the diagnostic in a refusal: the defect of a field, or the reason for no balance."""
    return getattr(error, "problem", None) or error.diagnostic.values["detail"]


def needed_on_slope(error: Any) -> float:
    assert error.friction_needed == pytest.approx(math.tan(math.radians(20)), rel=1e-5)
    needed: float = get_defect(error).values["needed"]
    return needed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ask", "requested", "limit", "step", "holds"),
    [
        pytest.param(
            "armed",
            lambda of, x: solve_balanced_stand(
                of, contacts=hand_on(pa.Plane((x, 0, 0), (-1, 0, 0), 0.6))
            ),
            0.9,
            lambda error: read_nearest(HAND)(error).plane.parameter,
            5e-4,
            True,
            id="a wall out of reach",
        ),
        pytest.param(
            "armed",
            lambda of, z: solve_balanced_stand(
                of, contacts=hand_on(pa.Plane((0, 0, z), (0, 0, 1)))
            ),
            0.9,
            lambda error: read_nearest(HAND)(error).plane.parameter,
            5e-4,
            True,
            id="a table out of reach",
        ),
        pytest.param(
            "armed",
            lambda of, d: solve_balanced_stand(
                of, contacts=hand_on(pa.Plane((0.9, 0, 0), (-0.8, 0, 0.6)).with_parameter(d))
            ),
            -0.72,
            lambda error: read_nearest(HAND)(error).plane.parameter,
            5e-4,
            False,
            id="a slanted plane out of reach",
        ),
        pytest.param(
            "armed",
            lambda of, x: solve_balanced_stand(
                of, contacts=hand_on(pa.Bar((x, 0, 0.5), (0, 1, 0), 0.01), grip=30.0)
            ),
            0.9,
            lambda error: read_nearest(HAND)(error).plane.point[0],
            5e-4,
            False,
            id="a rung out of reach",
        ),
        pytest.param(
            "armed",
            lambda of, x: pa.solve_stand(of, pa.StandTask(contacts={HAND: pa.Weld((x, 0.0, 0.5))})),
            1.2,
            lambda error: read_nearest(HAND)(error).place[0],
            5e-4,
            False,
            id="a weld out of reach",
        ),
        pytest.param(
            "v3",
            lambda of, z: solve_balanced_stand(
                of,
                contacts={
                    foot: pa.Contact(pa.Plane((0, 0, at), (0, 0, 1)))
                    for foot, at in zip(("FL", "FR"), z, strict=True)
                },
            ),
            (0.1, -0.1),
            lambda error: [read_nearest(foot)(error).plane.parameter for foot in ("FL", "FR")],
            1e-3,
            True,
            id="tables that contradict",
        ),
        pytest.param(
            "v3",
            lambda of, z: pa.solve_stand(of, pa.StandTask(contacts={"base": pa.Weld()}, height=z)),
            0.4,
            lambda error: error.limits["height"]["height"],
            2e-3,
            False,
            id="a base that is welded too high",
        ),
        pytest.param(
            "v3",
            lambda of, mu: solve_balanced_stand(of, contacts=make_slopes(mu), pitch=-0.2),
            0.2,
            needed_on_slope,
            2e-3,
            True,
            id="friction too low",
        ),
        pytest.param(
            "armed",
            grip_of,
            0.5,
            lambda error: get_defect(error).values["grips"][0].values["force"].value,
            0.01,
            False,
            id="a grip too weak",
        ),
        pytest.param(
            "armed",
            lambda of, force: solve_balanced_stand(of, contacts=table(0.6, force=force)),
            500.0,
            lambda error: get_defect(error).values["most"].value,
            0.2,
            False,
            id="a force that no feet bear",
        ),
        pytest.param(
            "armed",
            lambda of, com: solve_balanced_stand(
                of,
                contacts={HAND: pa.Contact(pa.Plane((0, 0, 0.43), (0, 0, 1)), (0.35, 0, 0.43))},
                com=tuple(com),
                foot_offsets=dict.fromkeys(("RL_calf", "RR_calf"), (0.12, 0.0)),
                height=0.27,
            ),
            (-0.4, 0.0),
            lambda error: get_defect(error).values["nearest"].values,
            5e-4,
            True,
            id="a hand that would pull",
        ),
        pytest.param(
            "armed",
            lambda of, margin: solve_balanced_stand(of, contacts=table(0.6), com_margin=margin),
            0.3,
            lambda error: get_defect(error).values["most"].value,
            5e-4,
            True,
            id="a com too near to tipping",
        ),
    ],
)
def test_limit_stated_by_a_refusal_is_accepted_and_exact(
    armed: pa.Robot, name: str, ask: Any, requested: Any, limit: Any, step: float, *, holds: bool
) -> None:
    """The stated limit is solved; the limit plus ``step`` is refused.

    With ``holds``, MuJoCo holds the stand at the limit; not with a straight limb, or a contact with
    almost no load.
    """
    robot = armed if name == "armed" else load(name)
    with pytest.raises(pa.PupperAnalysisError) as caught:
        ask(robot, requested)
    assert "\n" not in str(caught.value)
    there, wanted = np.array(limit(caught.value)), np.array(requested)
    stand = ask(robot, there.tolist())
    if holds:
        simulated = pa.solve_stand_as_simulated(robot, stand.task)
        assert pa.verify_stand(robot, simulated, integrator="implicitfast").passed
    beyond = there + step * (wanted - there) / np.linalg.norm(wanted - there)
    with pytest.raises(pa.PupperAnalysisError):
        ask(robot, beyond.tolist())


def test_scene_shows_the_plane_of_a_hand_contact(armed: pa.Robot, tmp_path: Path) -> None:
    """Reference: the height of the table."""
    stand = pa.solve_stand_as_simulated(armed, pa.StandTask(contacts=table()))
    scene = describe_scene(armed, stand, pa.stance.stand_statics(armed, stand))
    assert [*scene.steps] == [HAND]
    step = scene.steps[HAND]
    top = step.centre + step.rotation[:, 2] * step.half[2]
    assert top[2] == pytest.approx(TABLE, abs=1e-12)
    assert {contact.foot for contact in scene.contacts} == {*armed.feet, HAND}
    pa.report.write_report(stand, tmp_path / "stand.html", robots=[armed])


@pytest.mark.slow
def test_stand_on_the_planes_of_slopes_equals_the_stand_on_the_slopes() -> None:
    """Reference: the stand between two slopes of 30 deg, described by angles in place of planes."""
    robot, slopes = load("v3"), roof(30)
    one = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=slopes))
    planes = {
        foot: pa.Contact(pa.Plane(tuple(one.contact_points[foot]), tuple(one.normals[foot])))
        for foot in robot.feet
    }
    two = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=planes))
    np.testing.assert_allclose(two.qpos, one.qpos, atol=1e-9)
    assert two.com_margin == pytest.approx(one.com_margin, abs=1e-9)
    sags = [pa.steady_state(robot, stand) for stand in (one, two)]
    np.testing.assert_allclose(sags[1].qpos, sags[0].qpos, atol=1e-9)


def test_refusal_of_a_robot_on_a_grip_alone_names_the_grip(armed: pa.Robot) -> None:
    task = grip_bar(armed)
    contacts = {HAND: task.contacts[HAND]}
    task = pa.StandTask(contacts=contacts, swing=dict.fromkeys(armed.feet, 0.02))
    with pytest.raises(pa.ConfigurationError, match=r"except grips \(hand\)") as caught:
        pa.solve_stand(armed, task)
    assert "ground along a single line" not in str(caught.value)
