"""Distribution of the time of single calls to the engine and to the code around it.

The parts are the functions that the package calls, in the same order.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

import pupper_analysis as pa
from pupper_analysis.stance.judge import evaluate_stand
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.steady_state import (
    HomotopyPath,
    collect_steady_state,
    release_margin,
)
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.statics.contacts import make_contacts

Parts = dict[str, float]


class Stopwatch:
    """Stopwatch that records the times of parts by name."""

    def __init__(self) -> None:
        self.taken: dict[str, list[float]] = {}
        self._since = time.perf_counter()

    def start(self) -> None:
        """Start the time of the next part."""
        self._since = time.perf_counter()

    def stop(self, name: str) -> None:
        """Record the time of a part [s], and start the next."""
        now = time.perf_counter()
        self.taken.setdefault(name, []).append(now - self._since)
        self._since = time.perf_counter()

    def medians(self) -> Parts:
        """Return {part: median time [s]}."""
        return {name: statistics.median(times) for name, times in self.taken.items()}


def measure_stages(variant: str, calls: int) -> dict[str, Parts]:
    """Return {job: {part: median time [s]}}.

    Args:
        variant: Name of the robot.
        calls: Number of calls of each job; the jobs run alternately.
    """
    robot = pa.load_variant(variant)
    jobs = {
        "solve_stand": _make_stand_job,
        "Configuration": _make_configuration_job,
        "gravity_compensation": _make_forces_job,
        "steady_state": _make_sag_job,
    }
    watches = {name: Stopwatch() for name in jobs}
    runs = {name: job(robot, watches[name]) for name, job in jobs.items()}
    for _ in range(calls):
        for name, run in runs.items():
            watches[name].start()
            run()
    return {name: watch.medians() for name, watch in watches.items()}


def _make_stand_job(robot: pa.Robot, watch: Stopwatch) -> Callable[[], None]:
    """Return a function that solves a stand in parts."""
    context, home = SearchContext(robot), robot.home[robot.nq - robot.nu :]
    shapes, solver = context.shapes, context.solver

    def run() -> None:
        targets = compute_targets(robot, None, {})
        watch.stop("numerical targets of the nominal task")
        point = solver.solve_from_joints(targets, home)
        watch.stop("PlaCo: targets and solver steps")
        stand = evaluate_stand(shapes, targets, point.qpos, point.iterations)
        watch.stop("task errors (Pinocchio), clearance, result")
        pa.solve_stand(robot)
        watch.stop("solve_stand, total")
        # What another task takes, and what some of these are made of.
        compute_targets(robot, pa.StandTask(height=0.95 * robot.stand_height), {})
        watch.stop("another task: checks, numerical targets")
        solver.set_initial_guess(targets, home)
        watch.start()
        for _ in range(point.iterations):
            solver.tasks.solver.solve(True)
            solver.placo_robot.wrapper.update_kinematics()
        watch.stop("part of PlaCo: the same number of solves alone")
        shapes.kinematics.update(point.qpos)
        watch.stop("part of the errors: positions of CoM and feet")
        shapes.find_lowest_part(
            shapes.kinematics, targets.task.ground, targets.foot_targets, targets.depths
        )
        watch.stop("part of the errors: heights of all parts")
        pa.Stand(**vars(stand))
        watch.stop("part of the errors: construction of a Stand")

    return run


def _make_configuration_job(robot: pa.Robot, watch: Stopwatch) -> Callable[[], None]:
    """Return a function that evaluates a configuration in parts."""
    stand = pa.solve_stand(robot)
    model, data = robot.pin_model, robot.pin_model.createData()
    q = robot.pin_convention.q(stand.qpos)
    frames = [model.getFrameId(frame) for frame in robot.contact_frames.values()]

    def run() -> None:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        local = [
            pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames
        ]
        pin.centerOfMass(model, data, q, False)
        pin.crba(model, data, q)
        pin.computeGeneralizedGravity(model, data, q)
        watch.stop("Pinocchio's calls")
        np.array(local)
        watch.stop("one array of four Jacobians")
        config = pa.Configuration(robot, stand.qpos)
        watch.stop("Configuration: checks, Jacobians")
        config.foot_jacobians()
        watch.stop("foot_jacobians")
        config.mass_matrix()
        watch.stop("mass_matrix")
        config.center_of_mass()
        config.gravity()
        watch.stop("center_of_mass, gravity")

    return run


def _make_forces_job(robot: pa.Robot, watch: Stopwatch) -> Callable[[], None]:
    """Return a function that computes contact forces in parts."""
    config = pa.Configuration(robot, pa.solve_stand(robot).qpos)

    def run() -> None:
        load = config.gravity()
        carrying = make_contacts(robot, None, None, None, None)
        transposed = carrying.transposed_jacobian(config)
        problem = carrying.balance(transposed, load)
        watch.stop("Jacobians of the contacts, gravity")
        problem.minimum_tangential(carrying.friction, carrying.metric)
        watch.stop("forces: a least-squares problem of 6 by 12")
        pa.gravity_compensation(config)
        watch.stop("gravity_compensation, total")

    return run


def _make_sag_job(robot: pa.Robot, watch: Stopwatch) -> Callable[[], None]:
    """Return a function that computes an equilibrium in parts."""
    stand = pa.solve_stand(robot)

    def run() -> None:
        system = SagEquilibrium(robot, stand, None, "pinned")
        watch.stop("setup of the equations")
        way = HomotopyPath(system)
        watch.stop("statics, Newton steps to the stand on soft ground")
        way.follow(1.0)
        watch.stop("Newton steps without feed-forward, stiffness")
        collect_steady_state(way, release_margin(way))
        watch.stop("results of the equilibrium")
        derivative = system.derivative(way.solution.qpos, system.stack_forces(way.solution))
        watch.stop("part of a step: derivative")
        lapack.dgesv(derivative, derivative[0])
        watch.stop("part of a step: linear equations")
        pa.steady_state(robot, stand)
        watch.stop("steady_state, total")

    return run
