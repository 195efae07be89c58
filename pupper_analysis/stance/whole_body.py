"""Whole-body inverse kinematics: find a posture that satisfies tasks, with PlaCo's solver.

`solve_posture` finds joint positions, and the pose of a free base, for targets of links, CoM and
joints (`stance.posture_tasks`) [m, rad]. Each iteration linearises all tasks and solves a quadratic
program within the joint limits (Gauss-Newton). Feet that carry load keep their positions. The
result contains two residuals per task: one by Pinocchio's kinematics of the URDF, one by MuJoCo's
kinematics of the MJCF. If the posture keeps the contacts of a stand, or the base is fixed, the
result also contains a `Stand` for statics and simulations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import mujoco
import numpy as np
import placo
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments, check_type, suggest_degrees
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    PostureUnreachableError,
    UnknownNameError,
)
from pupper_analysis.base.results import Pictured, Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_ranges, joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import MAX_DISTANCE_RATIO, find_tool, measure_size
from pupper_analysis.stance.clearance import NUM_NEAREST_PAIRS, ClearanceShapes
from pupper_analysis.stance.judge import Stand, attach_robot
from pupper_analysis.stance.posture_conflict import find_conflict
from pupper_analysis.stance.posture_contacts import (
    KeptContact,
    keep_contacts,
    keep_points,
    make_posture_stand,
)
from pupper_analysis.stance.posture_tasks import (
    CLEARANCE_WEIGHT,
    JointsTask,
    OrientationTask,
    PlacoTask,
    PositionTask,
    PostureTask,
    SelfClearanceTask,
)
from pupper_analysis.stance.solver import RADIUS_REDUCTION, UNLIMITED_POSITION, PooledPlacoRobot
from pupper_analysis.stance.task import StandTask

POSTURE_TOLERANCE = 1e-6
"""Largest residual [m, rad] with which a task counts as satisfied. Chosen, not tuned: 1 um is below
the tolerances of usual robots."""

_MAX_ITERATIONS = 200
"""Upper bound of the number of trust-region iterations from one initial guess, in each of the two
stages of the solver (with and without preferred tasks). Chosen, not tuned."""

_MAX_FULL_STEPS = 30
"""Upper bound of the number of full Gauss-Newton steps before the trust-region iteration. Measured
on four postures: 4 to 10 steps."""

_MAX_STEP = 0.3
"""Largest displacement of a joint in an iteration [rad, m]. Chosen, not tuned."""

_MAX_MEASURED_DISTANCE = 1e3
"""Upper bound of the distances [m] between links that MuJoCo measures for the second residual.
Larger than any robot. Chosen, not tuned."""

_CONTACT_WEIGHT = 1e4
"""Weight of the squared residuals of contacts that a posture must keep, relative to required tasks.
Chosen, not tuned: in a conflict, tasks rather than contacts miss their targets."""

_PREFERENCE_WEIGHT = 1e-4
"""Weight of the squared residuals of preferred joint positions, relative to required tasks. Chosen
much smaller than the weight of required tasks, and much larger than `_REGULARIZATION`."""

_NEAR_BASE_WEIGHT = 1e-2
"""Weight of the squared displacement of the base [m^2, rad^2] from the stand at which a posture
starts, relative to required tasks. Chosen, not tuned: small against required tasks."""

_NEAR_JOINTS_WEIGHT = 1e-6
"""Weight of the squared displacement of the joints [rad^2, m^2] from the stand at which a posture
starts, relative to required tasks. Chosen so that 1 rad of a joint costs as much as 1 cm of the
base. Measured with equal weights: Go2 with an arm lowered its base by 12 cm to bend the arm
less."""

_ROUNDING_ERROR = 1e-24
"""Weighted sum of squared residuals [m^2 and rad^2 mixed] below which the iteration ends. Chosen as
the size of rounding errors: a residual of 1e-12 of one task."""

_ROUNDING_STEP = 1e-7
"""Norm of a step [rad and m mixed] below which an increase of the error is rounding, so that the
iteration ends. Chosen, not tuned."""

_NEGLIGIBLE_STEP = 1e-10
"""Norm of a step [rad and m mixed], or trust radius, below which the iteration ends. Chosen, not
tuned."""

_NUM_RESTARTS = 8
"""Upper bound of the random initial guesses after a failure, within the joint limits and within
+-pi of the first guess. Chosen, not tuned."""

_REGULARIZATION = 1e-9
"""Weight of the squared step of the joints, relative to a task's weight of 1. Chosen so small that
the regularization selects a step of redundant joints, but does not bias the solution."""


@dataclass(frozen=True, eq=False)
class SolvedPosture(Pictured, Tabular):
    """Posture that satisfies the tasks of `solve_posture`, with residuals by both engines.

    Attributes:
        qpos: Configuration, shape (nq,).
        tasks: Description of each task, with the kept contacts last.
        residuals: Residual of each task by Pinocchio's kinematics.
        mujoco_residuals: Residual of each task by MuJoCo's kinematics of the MJCF.
        units: Unit of the residual of each task.
        contacts: Contact points, and welded and gripping parts, that kept their positions.
        iterations: Number of solved or attempted quadratic programs.
        stand: Stand of the posture, for ``stand_statics``, ``verify_stand`` and other functions for
            stands. None if the base is free, and the start was neither a stand nor a posture with a
            stand. With a free base, ``stand.blocked`` lists the CoM margin and clearances that the
            posture violates.
    """

    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    tasks: tuple[str, ...]
    residuals: Array = field(metadata={"unit": "m or rad"})
    mujoco_residuals: Array = field(metadata={"unit": "m or rad"})
    units: tuple[str, ...]
    contacts: tuple[str, ...]
    iterations: int
    stand: Stand | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_robot"}

    @property
    def robot(self) -> Robot | None:
        """Robot of the posture; None, for example, for a posture from another process."""
        robot: Robot | None = vars(self).get("_robot")
        return robot

    def _columns(self) -> dict[str, Any]:
        """Return {column: values} of a table with one row per task: residuals with units."""
        return {
            "task": self.tasks,
            "residual": self.residuals,
            "mujoco_residual": self.mujoco_residuals,
            "unit": self.units,
        }


@check_arguments
def solve_posture(
    robot: Robot,
    tasks: Iterable[PostureTask],
    *,
    start: Stand | SolvedPosture | ArrayLike | None = None,
    contacts: Iterable[str] | None = None,
) -> SolvedPosture:
    """Find a configuration that satisfies posture tasks within the joint limits (whole-body IK).

    PlaCo minimises the weighted squared residuals, from ``start`` and then from a few random
    postures. Without a ``SelfClearanceTask``, links of the result may collide. ``posture.show()``
    shows the result.

    If ``start`` is a stand, its contacts and welds stay in place. Base and joints stay near the
    stand if the tasks permit. ``posture.stand`` is then the stand of the posture:
    ``pa.stand_statics(robot, posture.stand)``. Otherwise the statics on level ground are
    ``pa.gravity_compensation(pa.Configuration(robot, posture.qpos))``.

    Args:
        robot: Robot without closed loops and couplings.
        tasks: Tasks, for example ``pa.stance.PositionTask("hand", (0.3, 0, 0.4))``.
        start: Initial configuration (nq,), or a stand. The contacts of a stand are kept, and its
            joint margin applies. A solved posture with a stand and a free base counts as this
            stand. Of other solved postures, ``qpos`` is used. Default: ``robot.home``.
        contacts: Contact points that keep their positions in ``start``, for a robot with a free
            base. Default: the contact points of the stand, or ``robot.bearing_points``. If the list
            is empty, the base moves freely.

    Raises:
        PostureUnreachableError: If the residual of a required task exceeds `POSTURE_TOLERANCE`. The
            error states the required task with the largest residual, and the tasks and joint limits
            that oppose this task.
        ConfigurationError: If there is no task, ``start`` or a task is not valid, or the robot has
            closed loops, for example.
        UnknownNameError: If a link, joint or contact point is unknown.
        ModelError: If the contacts of a stand cannot be added to the model, for example.
    """
    robot.check_tree("a whole-body posture")
    requested = tuple(tasks) if isinstance(tasks, Iterable) else (tasks,)
    for task in requested:
        check_type("tasks", task, PostureTask)
    if not requested:
        raise ConfigurationError("tasks", diagnose("no-posture-task"))
    if isinstance(start, SolvedPosture):
        start = start.stand if start.stand and robot.floating else start.qpos
    stand = start if isinstance(start, Stand) else None
    if stand is not None and contacts is not None:
        raise ConfigurationError("contacts", diagnose("stand-has-contacts"))
    owner, robot = robot, robot if stand is None else stand.check(robot)
    _check_task_names(robot, requested)
    apart = any(isinstance(task, SelfClearanceTask) for task in requested)
    if apart and robot.pin_convention.unbounded.any():
        joints = [robot.joint_names[i] for i in np.flatnonzero(robot.pin_convention.unbounded)]
        raise ConfigurationError("tasks", diagnose("clearance-of-continuous", joints=joints))
    if isinstance(start, Stand):
        initial, kept = Configuration(robot, start.qpos), keep_contacts(robot, start)
    else:
        initial = Configuration(robot, robot.home if start is None else start)
        kept = _keep_points_of(initial, contacts)
    limits = _Limits.of(robot, stand.task.joint_margin if stand else 0.0)
    problem = _Problem(robot, requested, kept, limits, near=_stay_near(initial) if stand else ())
    solution = problem.solve(initial.qpos)
    if not robot.floating:
        stand = Stand(task=StandTask(), qpos=solution.qpos, robot=robot.fingerprint)
    elif stand is not None:
        stand = make_posture_stand(robot, stand, solution.qpos, solution.iterations)
    posture = replace(solution, stand=stand and attach_robot(stand, owner))
    vars(posture)["_robot"] = robot
    return posture


def _keep_points_of(
    initial: Configuration, contacts: Iterable[str] | None
) -> tuple[KeptContact, ...]:
    """Create the IK tasks that keep contact points (default: all that can bear forces) in place."""
    robot = initial.robot
    points = tuple(robot.bearing_points if contacts is None else contacts)
    if points and not robot.floating:
        problem = diagnose("fixed-base-carries", robot=robot.name)
        raise ConfigurationError("contacts", problem)
    positions = initial.foot_positions()
    return keep_points(robot, {robot.check_foot(point): positions[point] for point in points})


def _stay_near(initial: Configuration) -> tuple[tuple[float, PostureTask], ...]:
    """Create weak IK tasks that keep base and joints near a configuration; pairs (weight, task).

    Weights are those of the squared error, relative to required tasks.
    """
    robot = initial.robot
    joints = initial.qpos[robot.nq - robot.nu :].tolist()
    near = JointsTask(dict(zip(robot.joint_names, joints, strict=True)))
    if not robot.floating:
        return ((_NEAR_JOINTS_WEIGHT, near),)
    position, rotation = initial.frame_position(robot.base), initial.frame_rotation(robot.base)
    return (
        (_NEAR_JOINTS_WEIGHT, near),
        (_NEAR_BASE_WEIGHT, PositionTask(robot.base, position)),
        (_NEAR_BASE_WEIGHT, OrientationTask(robot.base, rotation)),
    )


class _Limits(NamedTuple):
    """Joint limits of a posture, narrowed by a margin.

    Attributes:
        lower: Lower limits plus margin, shape (nu,) [rad, m].
        upper: Upper limits minus margin, shape (nu,) [rad, m].
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, robot: Robot, margin: float) -> _Limits:
        """Return the joint limits of a robot, narrowed by a margin [rad, m]."""
        return cls(robot.lower_limits + margin, robot.upper_limits - margin)


class _Problem:
    """IK problem of a posture: requested tasks, kept contacts and joint limits.

    Args:
        robot: Robot, with the contacts of the stand.
        requested: Tasks of the caller.
        kept: Contacts that the posture keeps.
        limits: Joint limits.
        near: Pairs (weight, task) that select one of the postures that satisfy the other tasks.
    """

    def __init__(
        self,
        robot: Robot,
        requested: Sequence[PostureTask],
        kept: Sequence[KeptContact],
        limits: _Limits,
        near: Sequence[tuple[float, PostureTask]],
    ) -> None:
        self._near = near
        self._robot, self._kept, self._limits = robot, kept, limits
        self._tasks = (*requested, *(contact.task for contact in kept))
        names = (_describe_task(task) for task in requested)
        self._names = (*names, *(contact.description for contact in kept))

    def solve(self, qpos: Array) -> SolvedPosture:
        """Solve for a posture that satisfies the tasks, from an initial configuration (nq,).

        Raises:
            PostureUnreachableError: If no initial guess leads to such a posture.
        """
        robot, tasks = self._robot, self._tasks
        required = np.array([task.required for task in tasks])
        collision = _LazyShapes(robot)
        solver = _PostureSolver(
            robot, tasks, len(self._kept), collision, self._limits, near=self._near
        )
        best: tuple[float, Array, Array] | None = None
        for guess in _list_guesses(robot, qpos, self._limits):
            solved = solver.solve(guess)
            residuals = _compute_residuals(tasks, _PinocchioBody(robot, solved, collision))
            largest = float(residuals[required].max(initial=0.0))
            if best is None or largest < best[0]:
                best = largest, solved, residuals
            if largest <= POSTURE_TOLERANCE:
                break
        assert best is not None
        largest, solved, residuals = best
        if largest > POSTURE_TOLERANCE:
            raise self._explain_failure(residuals, solved, collision)
        return SolvedPosture(
            qpos=solved,
            tasks=self._names,
            residuals=residuals,
            mujoco_residuals=_compute_residuals(tasks, _MujocoBody(robot, solved, collision)),
            units=tuple(task.unit for task in tasks),
            contacts=tuple(dict.fromkeys(contact.name for contact in self._kept)),
            iterations=solver.iterations,
        )

    def _explain_failure(
        self, residuals: Array, qpos: Array, collision: _LazyShapes
    ) -> PostureUnreachableError:
        """Create the error about an unreachable posture, with opposing tasks and limits."""
        robot, tasks, names = self._robot, self._tasks, self._names
        weights = np.array([float(task.required) for task in tasks])
        weights[[isinstance(task, SelfClearanceTask) for task in tasks]] *= CLEARANCE_WEIGHT
        weights[len(tasks) - len(self._kept) :] *= _CONTACT_WEIGHT
        worst = int(np.where(weights > 0, residuals, -1.0).argmax())
        conflict = find_conflict(
            robot,
            qpos,
            self._limits,
            lambda at: _compute_residuals(tasks, _PinocchioBody(robot, at, collision)),
            weights.tolist(),
            worst,
        )
        task, unit, written = tasks[worst], tasks[worst].unit, None
        if isinstance(task, JointsTask):
            joints = qpos[robot.nq - robot.nu :].tolist()
            positions = dict(zip(robot.joint_names, joints, strict=True))
            gaps = {name: abs(positions[name] - at) for name, at in task.positions.items()}
            joint = max(gaps, key=gaps.__getitem__)
            unit = joint_unit(robot, joint)
            if unit == "rad":
                low, high = joint_ranges(robot)[robot.joint_names.index(joint)].tolist()
                written = suggest_degrees(task.positions[joint], low, high)
        max_distance = MAX_DISTANCE_RATIO * measure_size(robot)
        return PostureUnreachableError(
            names[worst],
            float(residuals[worst]),
            unit,
            dict(zip(names, residuals.tolist(), strict=True)),
            conflicting=tuple(names[index] for index in conflict.tasks),
            at_limit=conflict.at_limit,
            blocking=conflict.blocking,
            out_of_reach=conflict.out_of_reach,
            units={name: joint_unit(robot, name) for name in conflict.at_limit},
            qpos=qpos,
            written=written,
            far=unit == "m" and 0 < max_distance < residuals[worst],
        )


def _check_task_names(robot: Robot, tasks: Sequence[PostureTask]) -> None:
    """Raise UnknownNameError if a task names an unknown link or joint."""
    for task in tasks:
        for frame in task.frames:
            if frame not in robot.structure.links:
                links = tuple(robot.structure.links)
                raise UnknownNameError(robot.name, "link", frame, links, base=robot.base)
        for joint in task.positions if isinstance(task, JointsTask) else ():
            if joint not in robot.joint_names:
                raise UnknownNameError(robot.name, "joint", joint, robot.joint_names)


def _list_guesses(robot: Robot, qpos: Array, limits: _Limits) -> Iterable[Array]:
    """Yield initial guesses (nq,) within the limits: ``qpos``, then random joint positions."""
    first = robot.nq - robot.nu
    lower, upper = limits
    start = qpos.copy()
    start[first:] = np.clip(start[first:], lower, upper)
    yield start
    random = np.random.default_rng(0)
    low, high = np.maximum(lower, start[first:] - np.pi), np.minimum(upper, start[first:] + np.pi)
    for _ in range(_NUM_RESTARTS):
        guess = start.copy()
        guess[first:] = random.uniform(low, high)
        yield guess


class _Stage(NamedTuple):
    """PlaCo solver with weighted tasks; a posture is solved in one or two stages.

    Attributes:
        solver: PlaCo solver.
        tasks: Weight of the squared error, and task.
    """

    solver: placo.KinematicsSolver
    tasks: tuple[tuple[float, PlacoTask], ...]


class _PostureSolver:
    """Solver for the tasks of a posture: with preferred tasks, if any, then without.

    Args:
        robot: Robot.
        tasks: Tasks; tasks of kept contacts are the last.
        num_contacts: Number of kept contacts.
        collision: Collision shapes.
        limits: Joint limits.
        near: Pairs (weight, task) for the first stage, in addition to the preferred tasks in
            ``tasks``.

    Attributes:
        iterations: Number of solved or attempted quadratic programs.
    """

    def __init__(
        self,
        robot: Robot,
        tasks: Sequence[PostureTask],
        num_contacts: int,
        collision: _LazyShapes,
        limits: _Limits,
        near: Sequence[tuple[float, PostureTask]],
    ) -> None:
        self._robot, self._placo_robot = robot, PooledPlacoRobot(robot)
        self._collision = collision
        self.iterations = 0
        wrapper = self._placo_robot.wrapper
        for joint in np.flatnonzero(~robot.pin_convention.unbounded):
            low = max(limits.lower[joint], -UNLIMITED_POSITION)
            high = min(limits.upper[joint], UNLIMITED_POSITION)
            wrapper.set_joint_limits(robot.joint_names[joint], low, high)
        # PlaCo bounds steps by velocity limit x dt.
        wrapper.set_velocity_limits(1.0)
        weights = [1.0 if task.required else _PREFERENCE_WEIGHT for task in tasks]
        for index in range(len(tasks) - num_contacts, len(tasks)):
            weights[index] = _CONTACT_WEIGHT
        every = list(zip(weights, tasks, strict=True))
        required = [(weight, task) for weight, task in every if task.required]
        preferring = [*near, *every]
        self._stages = [self._make_stage(required)]
        if len(preferring) > len(required):
            self._stages.insert(0, self._make_stage(preferring))

    def _make_stage(self, tasks: Sequence[tuple[float, PostureTask]]) -> _Stage:
        """Create a PlaCo solver, and add tasks, each with the weight of its squared error."""
        solver = placo.KinematicsSolver(self._placo_robot.wrapper)
        solver.mask_fbase(not self._robot.floating)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        weighted = tuple((weight, task.add_to(solver, weight)) for weight, task in tasks)
        solver.add_regularization_task(_REGULARIZATION)
        return _Stage(solver, weighted)

    def solve(self, qpos: Array) -> Array:
        """Minimise the weighted squared residuals of the tasks from an initial guess qpos (nq,).

        Returns:
            Configuration at which steps are negligible, or the iterations end, shape (nq,).
        """
        wrapper, convention = self._placo_robot.wrapper, self._robot.pin_convention
        base = [] if self._robot.floating else [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        wrapper.state.q = np.concatenate([base, convention.q(qpos)])
        wrapper.update_kinematics()
        for stage in self._stages:
            start, error = np.array(wrapper.state.q), self._evaluate_stage(stage)
            if not self._take_full_steps(stage):
                # Full steps converge slowly if errors of preferred tasks remain.
                if stage is self._stages[-1] or self._evaluate_stage(stage) > error:
                    wrapper.state.q = start
                    wrapper.update_kinematics()
                self._iterate_trust_region(stage)
        return self._current_qpos()

    def _take_full_steps(self, stage: _Stage) -> bool:
        """Take full Gauss-Newton steps; return True if converged without an increase of the error.

        Contacts are nonlinear constraints with a large weight. A trust-region iteration would
        therefore need many short steps.
        """
        initial_error = self._evaluate_stage(stage)
        stage.solver.dt = _MAX_STEP
        for _ in range(_MAX_FULL_STEPS):
            self.iterations += 1
            try:
                step = stage.solver.solve(True)
            except RuntimeError:  # no solution of the quadratic program
                return False
            self._placo_robot.wrapper.update_kinematics()
            error = self._evaluate_stage(stage)
            if error < _ROUNDING_ERROR or float(np.linalg.norm(step)) < _NEGLIGIBLE_STEP:
                return error <= initial_error
        return False

    def _iterate_trust_region(self, stage: _Stage) -> None:
        """Take Gauss-Newton steps within a trust radius that do not increase the error."""
        wrapper, radius = self._placo_robot.wrapper, _MAX_STEP
        error = self._evaluate_stage(stage)
        for _ in range(_MAX_ITERATIONS):
            if error < _ROUNDING_ERROR:
                return
            stage.solver.dt = radius
            self.iterations += 1
            before = np.array(wrapper.state.q)
            try:
                step = stage.solver.solve(True)
            except RuntimeError:  # no solution of the quadratic program
                return
            wrapper.update_kinematics()
            previous, error = error, self._evaluate_stage(stage)
            if error > previous:
                wrapper.state.q = before
                wrapper.update_kinematics()
                error = self._evaluate_stage(stage)
                if float(np.linalg.norm(step)) < _ROUNDING_STEP:
                    return
                radius /= RADIUS_REDUCTION
            elif float(np.linalg.norm(step)) < _NEGLIGIBLE_STEP:
                return
            else:
                radius = min(_MAX_STEP, 2 * radius)
            if radius < _NEGLIGIBLE_STEP:
                return

    def _evaluate_stage(self, stage: _Stage) -> float:
        """Return the weighted sum of squared residuals [m^2, rad^2] at PlaCo's configuration."""
        if any(task.update_target for _, task in stage.tasks):
            body = _PinocchioBody(self._robot, self._current_qpos(), self._collision)
            for _, task in stage.tasks:
                if task.update_target is not None:
                    task.update_target(body)
        total = 0.0
        for weight, task in stage.tasks:
            task.task.update()
            total += weight * float(task.task.error_norm()) ** 2
        return total

    def _current_qpos(self) -> Array:
        """Return the configuration (nq,) of PlaCo's robot."""
        q = np.array(self._placo_robot.wrapper.state.q)[0 if self._robot.floating else 7 :]
        qpos = self._robot.pin_convention.qpos(q)
        if self._robot.floating:
            qpos[3:7] /= np.linalg.norm(qpos[3:7])
        return qpos


class _LazyShapes:
    """Collision shapes of a robot, prepared at first access."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @cached_property
    def shapes(self) -> ClearanceShapes:
        """Collision shapes of the robot, with the pairs of links that are not neighbours."""
        return ClearanceShapes(self._robot)


class _PinocchioBody:
    """Poses of links at a configuration, by Pinocchio's kinematics of the URDF.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,).
        collision: Collision shapes of the robot, created at first use.
    """

    def __init__(self, robot: Robot, qpos: Array, collision: _LazyShapes) -> None:
        self._config, self._collision = Configuration(robot, qpos), collision

    def pose(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) [m] of a link in the world."""
        return self._config.frame_rotation(frame), self._config.frame_position(frame)

    def com(self) -> Array:
        """Return the position of the CoM, shape (3,) [m], in the world frame."""
        return self._config.center_of_mass()

    def joint(self, name: str) -> float:
        """Return the position of the joint ``name`` [rad, m]."""
        robot = self._config.robot
        index = robot.nq - robot.nu + robot.joint_names.index(name)
        return float(self._config.qpos[index])

    def self_clearances(self) -> Array:
        """Return the smallest distances [m] of shapes on links that are no neighbours, ascending.

        At most `NUM_NEAREST_PAIRS` distances.
        """
        pairs = self._collision.shapes.find_nearest_pairs(self._config.qpos, NUM_NEAREST_PAIRS)
        return np.array([pair.distance for pair in pairs])

    def linearise_self_clearances(self) -> tuple[Array, Array]:
        """Return derivatives (n, nq) of `self_clearances` by PlaCo's configuration q, and q."""
        robot, convention = self._config.robot, self._config.robot.pin_convention
        rates = self._collision.shapes.distance_jacobian(self._config, NUM_NEAREST_PAIRS)
        # PlaCo's robot has a free base, which a fixed-base robot does not move.
        base = 0 if robot.floating else 7
        derivatives = np.zeros((len(rates), base + convention.nq))
        derivatives[:, base + convention.q_index] = rates[:, robot.nv - robot.nu :]
        return derivatives, np.concatenate([np.zeros(base), convention.q(self._config.qpos)])


class _MujocoBody(_PinocchioBody):
    """Poses of links at a configuration, by MuJoCo's kinematics of the MJCF.

    The frames of URDF links and MJCF bodies may differ. The constant offset between both is taken
    from the neutral configuration.

    Args:
        robot: Robot.
        qpos: Configuration, shape (nq,).
        collision: Collision shapes of the robot, created at first use.
    """

    def __init__(self, robot: Robot, qpos: Array, collision: _LazyShapes) -> None:
        super().__init__(robot, qpos, collision)
        self._robot, self._data = robot, robot.compute_kinematics(qpos)

    def pose(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) [m] of a link in the world, by MuJoCo."""
        robot, model = self._robot, self._robot.mj_model
        name, offset = find_tool(robot, frame).locate_in_mjcf(robot)
        body = model.body(name).id
        neutral, still = robot.compute_kinematics(), Configuration(robot, robot.neutral())
        relative = neutral.xmat[body].reshape(3, 3).T @ still.frame_rotation(frame)
        rotation = self._data.xmat[body].reshape(3, 3)
        return rotation @ relative, self._data.xpos[body] + rotation @ offset

    def self_clearances(self) -> Array:
        """Return distances (n,) [m] of links that are no neighbours, by MuJoCo, ascending.

        `ClearanceShapes.find_nearest_pairs` selects the pairs of collision shapes.
        """
        shapes, model = self._collision.shapes, self._robot.mj_model
        pairs = shapes.find_nearest_pairs(self._config.qpos, NUM_NEAREST_PAIRS)
        found = [
            mujoco.mj_geomDistance(
                model,
                self._data,
                shapes.shapes[pair.one].geom,
                shapes.shapes[pair.other].geom,
                _MAX_MEASURED_DISTANCE,
                None,
            )
            for pair in pairs
        ]
        return np.sort(found)

    def com(self) -> Array:
        """Return the position of the CoM, shape (3,) [m], in the world frame."""
        base = self._robot.mj_model.body(self._robot.mj_base).id
        return np.array(self._data.subtree_com[base])


def _compute_residuals(tasks: Sequence[PostureTask], body: _PinocchioBody) -> Array:
    """Return the residual of each task at a configuration, shape (n,) [m, rad]."""
    return np.array([task.residual(body) for task in tasks])


def _describe_task(task: PostureTask) -> str:
    """Return a description of a task: its type, and its links or joints."""
    subjects = task.positions if isinstance(task, JointsTask) else task.frames
    return " ".join([type(task).__name__, *subjects])
