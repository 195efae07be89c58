"""The IK solver: error and configuration of a result belong together."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance import solver
from pupper_analysis.stance.problem import StandTargets, compute_targets
from pupper_analysis.stance.solver import SearchContext, SolverResult, StanceSolver
from tests.support.bound import four_bars
from tests.support.variants import load


def foot_error(robot: pa.Robot, targets: StandTargets, result: SolverResult) -> float:
    """Return the largest distance [m] between contact point and target, by Pinocchio."""
    positions = Configuration(robot, result.qpos).foot_positions()
    return max(
        float(np.linalg.norm(positions[foot] - targets.foot_targets[foot])) for foot in positions
    )


@pytest.mark.slow
def test_a_result_has_closed_loops_if_the_first_step_opens_them(tmp_path: Path) -> None:
    """Reference: the loop residual of MuJoCo's constraint, by ``Closure.largest_violation``.

    After the first step for these targets Newton's method does not close the loops. The step was
    kept, and the result had loops open by 2.6 mm.
    """
    pair = four_bars(tmp_path, 0.04)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    task = pa.StandTask(
        height=0.5525012854090647,
        roll=0.06446372553820813,
        pitch=-0.37288812214878087,
        yaw=1.4357836689067494,
    )
    targets = compute_targets(robot, task, {})
    result = SearchContext(robot).solver.solve_from_joints(targets, robot.home[7:])
    assert robot.closure is not None
    assert robot.closure.largest_violation(result.qpos) < 1e-6
    assert result.foot_error == pytest.approx(foot_error(robot, targets, result), abs=1e-9)


@pytest.mark.parametrize("iterations", [1, 3])
def test_the_error_is_that_of_the_configuration_if_all_steps_are_rejected(
    monkeypatch: pytest.MonkeyPatch, iterations: int
) -> None:
    """Reference: Pinocchio's foot positions at the initial guess, 1 um from the targets.

    A full step from there reaches the targets within 4e-12 m.
    """
    robot = load("v3")
    joints = pa.solve_stand(robot).qpos[7:]
    targets = compute_targets(robot, pa.StandTask(height=robot.stand_height + 1e-6), {})
    stance_solver = SearchContext(robot).solver
    monkeypatch.setattr(solver, "_MAX_ITERATIONS", iterations)
    monkeypatch.setattr(StanceSolver, "_take_full_steps", lambda _: (None, 0))
    monkeypatch.setattr(StanceSolver, "_close_loops", lambda *_: False)
    result = stance_solver.solve_from_joints(targets, joints)
    expected = foot_error(robot, targets, result)
    assert 5e-7 < expected < math.inf
    assert result.foot_error == pytest.approx(expected, abs=1e-10)
    assert not result.converged


class CountingSolver:
    """QP solver of PlaCo that counts the calls of ``solve``."""

    def __init__(self, solver: Any) -> None:
        self.__dict__.update(solver=solver, count=0)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.solver, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.solver, name, value)

    def solve(self, apply: bool) -> Any:
        self.__dict__["count"] += 1
        return self.solver.solve(apply)


@pytest.mark.parametrize("height", [1.0, 1.4, 3.0])
def test_iterations_include_full_steps_that_fail(height: float) -> None:
    """Reference: number of calls of PlaCo's ``solve``. The legs reach the lowest height only."""
    robot = load("v3")
    stance_solver = SearchContext(robot).solver
    targets = compute_targets(robot, pa.StandTask(height=height * robot.stand_height), {})
    stance_solver.solve_from_joints(targets, robot.home[7:])
    counting = CountingSolver(stance_solver.tasks.solver)
    stance_solver.tasks.solver = counting
    result = stance_solver.solve_from_joints(targets, robot.home[7:])
    assert result.iterations == counting.count


def test_cached_initial_guess_equals_that_of_a_new_solver() -> None:
    """Reference: a new solver; equal to the last bit, in any order of targets and joints."""
    robot = load("v3")
    reused, home = SearchContext(robot).solver, robot.home[7:]
    tasks = [
        pa.StandTask(),
        pa.StandTask(height=0.11),
        pa.StandTask(roll=0.1),
        pa.StandTask(joint_margin=0.3),
        pa.StandTask(offset=(0.01, 0.0)),
        pa.StandTask(com=(0.01, 0.002)),
    ]
    for shift in (0.0, 0.1):
        for index in np.random.default_rng(0).integers(0, len(tasks), 15):
            targets = compute_targets(robot, tasks[index], {})
            found = reused.set_initial_guess(targets, home + shift)
            expected = SearchContext(robot).solver.set_initial_guess(targets, home + shift)
            np.testing.assert_array_equal(found, expected)


def test_full_steps_lead_to_the_configuration_of_the_trust_region() -> None:
    """Reference: the trust-region iteration from the same initial guess, with as many steps."""
    robot, full_steps = load("v3"), 0
    stance_solver, home = SearchContext(robot).solver, robot.home[7:]
    random = np.random.default_rng(2)
    for _ in range(20):
        height, roll, pitch, yaw = random.uniform((0.08, -0.3, -0.3, -0.3), (0.2, 0.3, 0.3, 0.3))
        targets = compute_targets(robot, pa.StandTask(height, roll, pitch, yaw), {})
        result = stance_solver.solve_from_joints(targets, home)
        q = stance_solver.set_initial_guess(targets, home)
        expected = stance_solver._iterate_trust_region(q)
        stance_solver.set_initial_guess(targets, home)
        if stance_solver._take_full_steps()[0] is None:
            np.testing.assert_array_equal(result.qpos, expected.qpos)
        else:
            full_steps += 1
            np.testing.assert_allclose(result.qpos, expected.qpos, atol=1e-13)
    assert 0 < full_steps < 20
