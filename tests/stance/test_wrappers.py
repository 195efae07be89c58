"""Pooled PlaCo robots: results equal those of new ones, and memory is freed."""

from __future__ import annotations

import ctypes
import gc
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance import solver
from pupper_analysis.stance.solver import PooledPlacoRobot, SearchContext
from tests.support.variants import load

TASKS = (
    pa.StandTask(),
    pa.StandTask(pitch=0.1, com="inside"),
    pa.StandTask(self_clearance=0.002),
    pa.StandTask(joint_margin=0.05),
)


def designs() -> list[pa.Robot]:
    heavy = pa.robot.with_payload(load("v3"), 1.0, (0.03, 0.0, 0.05))
    return [
        load("v3"),
        pa.load_variant(pa.pupper.VariantSpec("v3", 1.1)),
        heavy,
        load("v3-long-leg"),
    ]


def stands(robot: pa.Robot) -> list[list[float]]:
    return [pa.solve_stand(robot, task).qpos.tolist() for task in TASKS]


def test_reused_wrapper_gives_the_results_of_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference: stands from new wrappers, bit by bit, after use for other masses, link lengths and
    limits."""
    monkeypatch.setattr(solver, "_wrapper_pool", {})
    monkeypatch.setattr("pupper_analysis.robot.robot._MAX_POOL_SIZE", 0)
    expected = []
    for robot in designs():
        solver._wrapper_pool.clear()
        expected.append(stands(robot))
    assert len(solver._wrapper_pool) == 1  # all robots have one structure, also with payload
    found = [stands(robot) for robot in reversed(designs())]
    assert found[::-1] == expected


def test_wrapper_is_loaded_once_per_structure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight variants of one kinematic structure load a single PlaCo robot, with empty pools
    before.
    """
    read: list[str] = []
    load_once = solver._load_wrapper

    def counted(robot: pa.Robot) -> object:
        read.append(robot.name)
        return load_once(robot)

    monkeypatch.setattr(solver, "_wrapper_pool", {})
    monkeypatch.setattr(solver, "_load_wrapper", counted)
    monkeypatch.setattr(
        "pupper_analysis.robot.robot._MAX_POOL_SIZE", 0
    )  # the pool keeps no unused object
    for scale in np.linspace(0.9, 1.1, 8):
        robot = pa.load_variant(pa.pupper.VariantSpec("v3", float(scale)))
        SearchContext(robot)
        pa.solve_stand(robot, pa.StandTask(self_clearance=0.0))
    assert len(read) == 1


def measure_resident_memory() -> int:
    """Return the resident memory of this process [bytes], after the allocator has freed pages."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="not Linux with glibc")
def test_memory_of_solved_robots_is_freed() -> None:
    """Less than 50 kB per robot, measured after 40 robots that fill the caches; a new PlaCo wrapper
    per robot would leak 375 kB."""

    def solved(count: int, at: int) -> None:
        for number in range(count):
            robot = pa.load_variant(pa.pupper.VariantSpec("v3", 1 + 1e-4 * (at + number)))
            pa.solve_stand(robot)
            pa.solve_stand(robot, pa.StandTask(self_clearance=0.001))
        gc.collect()

    solved(40, 0)
    before = measure_resident_memory()
    solved(20, 40)
    assert (measure_resident_memory() - before) / 20 < 50e3


def test_finite_limit_is_kept_if_the_opposite_limit_is_infinite() -> None:
    """PlaCo's model, a Pinocchio model, holds the limits of the targets."""
    robot = load("v3")
    placo = SearchContext(robot).solver
    shapes, index = placo.placo_robot.wrapper.model, 3
    name = robot.joint_names[index]
    q = int(shapes.joints[shapes.getJointId(name)].idx_q)
    lower, upper = robot.lower_limits.copy(), robot.upper_limits.copy()
    upper[index] = np.inf
    for low, high in ((robot.lower_limits, robot.upper_limits), (lower, upper)):
        placo._set_joint_limits(low, high)
    assert shapes.lowerPositionLimit[q] == pytest.approx(robot.lower_limits[index], abs=1e-12)
    assert shapes.upperPositionLimit[q] > 100


def test_limits_of_a_pooled_wrapper_are_those_of_the_robot() -> None:
    """A robot with unlimited joints takes the wrapper of a robot with limits, and vice versa."""
    bound = load("v3")
    model = bound.pin_model.copy()
    low, high = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    low[7:], high[7:] = -np.inf, np.inf
    model.lowerPositionLimit, model.upperPositionLimit = low, high
    for robot, limited in ((bound, True), (replace(bound, pin_model=model), False)) * 2:
        lent = PooledPlacoRobot(robot).wrapper.model
        assert np.isfinite(lent.lowerPositionLimit[7:]).all() == limited


def test_a_wrapper_in_use_is_not_given_to_another_user() -> None:
    robot = load("v3")
    held = [PooledPlacoRobot(robot) for _ in range(3)]
    held.clear()  # the pool is not empty
    held = [PooledPlacoRobot(robot) for _ in range(3)]
    assert len({id(placo_robot.wrapper) for placo_robot in held}) == 3
    context = SearchContext(robot)
    assert all(
        context.solver.placo_robot.wrapper is not placo_robot.wrapper for placo_robot in held
    )
    first = held[0].wrapper
    del held[0]
    assert PooledPlacoRobot(robot).wrapper is first


@pytest.mark.slow
def test_threads_with_robots_of_one_structure_solve_their_own_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: the stands of each robot in one thread, bit by bit.

    Six threads take all wrappers from one pool, and switch every 10 us, more often than by default.
    """
    monkeypatch.setattr("pupper_analysis.robot.robot._MAX_POOL_SIZE", 0)
    robots = [pa.load_variant(pa.pupper.VariantSpec("v3", scale)) for scale in (0.95, 1.0, 1.05)]
    expected, interval = [stands(robot) for robot in robots], sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(6) as pool:
            assert list(pool.map(stands, 2 * robots)) == 2 * expected
    finally:
        sys.setswitchinterval(interval)
