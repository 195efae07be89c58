"""Cached objects give the same results as new ones, and results cannot be changed by callers."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import shapely

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.statics.equilibrium import balance_load
from pupper_analysis.statics.support_polygon import com_margin
from tests.support.variants import NAMES, load, stand_of


def tasks(robot: pa.Robot) -> list[pa.StandTask]:
    """Return tasks that differ in each target of PlaCo's tasks."""
    return [
        pa.StandTask(),
        pa.StandTask(height=0.93 * robot.stand_height, roll=0.05, pitch=-0.04, yaw=0.1),
        pa.StandTask(offset=(0.01, -0.005), joint_margin=0.05),
        pa.StandTask(ground=pa.Ground(slope=0.1, uphill=0.7), com=(0.005, 0.004)),
        pa.StandTask(foot_offsets={robot.contact_points[0]: (0.01, 0.0)}),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_reused_solver_returns_the_same_stands_as_a_new_one(name: str) -> None:
    """Reference: a new solver per stand; equal to the last bit, in any order."""
    robot = load(name)
    all_targets = [compute_targets(robot, task, {}) for task in tasks(robot)]
    start = stand_of(name).joint_positions(robot)
    expected = [
        SearchContext(robot).solver.solve_from_joints(targets, start) for targets in all_targets
    ]
    solver = SearchContext(robot).solver
    for index in np.random.default_rng(0).permutation(3 * len(all_targets)) % len(all_targets):
        found = solver.solve_from_joints(all_targets[index], start)
        np.testing.assert_array_equal(found.qpos, expected[index].qpos)
        assert found.iterations == expected[index].iterations


@pytest.mark.slow
def test_stands_solved_in_threads_equal_those_of_one_thread() -> None:
    """Reference: the same stands, solved one after the other."""
    robot = load("v3")
    wanted = tasks(robot)[:3]
    expected = [pa.solve_stand(robot, task).qpos for task in wanted]

    def work(index: int) -> tuple[int, np.ndarray]:
        return index, pa.solve_stand(robot, wanted[index]).qpos

    with ThreadPoolExecutor(3) as pool:
        for index, qpos in pool.map(work, [0, 1, 2] * 6):
            np.testing.assert_array_equal(qpos, expected[index])


def test_foot_targets_are_read_only() -> None:
    """The next stand is unchanged after the attempt."""
    robot = load("v3")
    stand = pa.solve_stand(robot)
    for target in stand.foot_targets.values():
        with pytest.raises(ValueError, match="read-only"):
            target[:] = 0.0
    np.testing.assert_array_equal(pa.solve_stand(robot).qpos, stand.qpos)


def test_a_variant_loaded_twice_is_independent_of_changes_to_the_first() -> None:
    """The derivation of a variant is cached; a change of the spec of one robot must not change the
    next robot."""
    first = pa.load_variant("v3-long-leg")
    mass = first.mj_model.body_mass.copy()
    for body in first.description.mjcf.bodies[1:]:
        body.pos = 2 * body.pos
    second = pa.load_variant("v3-long-leg")
    assert second.fingerprint == first.fingerprint
    np.testing.assert_array_equal(second.mj_model.body_mass, mass)
    np.testing.assert_array_equal(second.mj_model.body_pos, first.mj_model.body_pos)


def test_com_margin_equals_the_distance_that_shapely_computes() -> None:
    """Random contacts: in general position, on lines, and partly equal."""
    rng = np.random.default_rng(1)
    for _ in range(300):
        places = rng.normal(size=(rng.integers(3, 9), 3))
        if rng.random() < 0.3:
            places = np.round(places)  # some coincide, some are on one line
        com = rng.normal(size=3) * 0.7
        hull, at = shapely.MultiPoint(places[:, :2]).convex_hull, shapely.Point(com[:2])
        inside = hull.geom_type == "Polygon" and hull.contains(at)
        expected = hull.exterior.distance(at) if inside else -hull.distance(at)
        found = com_margin(com, dict(zip(map(str, range(len(places))), places, strict=True)))
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_fields_shared_by_default_stands_are_read_only() -> None:
    """The next stand is unchanged after the attempt."""
    robot = load("v3")
    first, second = pa.solve_stand(robot), pa.solve_stand(robot)
    for point in first.contact_points.values():
        with pytest.raises(ValueError, match="read-only"):
            point[:] = np.nan
    for mapping in (first.depths, first.task.feet, first.task.foot_offsets, first.task.swing):
        with pytest.raises(TypeError, match="cannot be changed"):
            mapping.clear()  # type: ignore[attr-defined]
    for name, point in pa.solve_stand(robot).contact_points.items():
        np.testing.assert_array_equal(point, second.contact_points[name])


def test_contact_depth_is_independent_of_the_initial_guess() -> None:
    """Reference: the depth without an initial guess, for forces from 1 mN to 1 kN."""
    robot = load("v3")
    law = GroundLaw.of_contact(robot, robot.contact_points[0])
    for force in np.geomspace(1e-3, 1e3, 13):
        depth = law.depth(force)
        for near in (0.0, 0.1 * depth, 0.999 * depth, depth, 3 * depth, 1.0, -1.0):
            assert law.depth(force, near) == pytest.approx(depth, rel=1e-14)


@pytest.mark.slow
def test_a_cell_of_a_gain_sweep_equals_the_sweep_of_that_cell_alone() -> None:
    """Equal to the last bit: cells do not share state."""
    robot, stand = load("v3"), stand_of("v3")
    kp, kd = (20.0, 60.0), (0.5, 2.0)
    grid = pa.simulation.sweep_gains(robot, stand, kp=kp, kd=kd, duration=2.0).height_deviation
    alone = [
        [
            float(
                pa.simulation.sweep_gains(
                    robot, stand, kp=[p], kd=[d], duration=2.0
                ).height_deviation[0, 0]
            )
            for d in kd
        ]
        for p in kp
    ]
    np.testing.assert_array_equal(grid, alone)


def test_statics_are_computed_once_per_stand_robot_and_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: the number of calls of the balance."""
    robot, found = load("v3"), []

    def counted(*arguments: object, **named: object) -> pa.statics.GravityCompensation:
        found.append(named["distribution"])
        return balance_load(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("pupper_analysis.stance.stand.balance_load", counted)
    stand = pa.solve_stand(robot, pa.StandTask(height=0.11))
    held = pa.stance.stand_statics(robot, stand)
    assert pa.stance.stand_statics(robot, stand) is held
    pa.steady_state(robot, stand)
    assert len(found) == 1
    loaded = pa.stance.stand_statics(pa.robot.with_payload(robot, 1.0), stand)
    assert loaded.joint_torques.tolist() != held.joint_torques.tolist()
    peak = pa.stance.stand_statics(robot, stand, distribution="min-max torque")
    assert peak.joint_torques.tolist() != held.joint_torques.tolist()
    again = pickle.loads(pickle.dumps(stand))
    np.testing.assert_array_equal(
        pa.stance.stand_statics(robot, again).joint_torques, held.joint_torques
    )
    assert len(found) == 4
