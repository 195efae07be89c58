"""Whole-body inverse kinematics: a posture that satisfies tasks, by PlaCo's kinematics solver.

`solve_posture` finds joint positions, and the pose of a free base, for targets of links, CoM and
joints (`stance.posture_tasks`) [m, rad]. Each iteration linearises all tasks and solves a quadratic
program within the joint limits (Gauss-Newton). Feet that carry load keep their positions. The
result contains the residual of each task by Pinocchio's kinematics of the URDF and by MuJoCo's of
the MJCF.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import mujoco
import numpy as np
import placo
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    PostureUnreachableError,
    UnknownNameError,
)
from pupper_analysis.base.results import Pictured, Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import find_tool
from pupper_analysis.stance.clearance import ClearanceShapes
from pupper_analysis.stance.posture_tasks import (
    JointsTask,
    PlacoTask,
    PositionTask,
    PostureTask,
    SelfClearanceTask,
)
from pupper_analysis.stance.solver import PooledPlacoRobot

Array = NDArray[np.float64]

POSTURE_TOLERANCE = 1e-6
"""Largest residual [m, rad] with which a task counts as satisfied. Chosen, not tuned: 1 um is below
the tolerance of any robot. Residuals of tasks without conflict are about 1e-12."""

_MAX_ITERATIONS = 200
"""Upper bound of the trust-region iterations from one initial guess, per stage of the solver (with
and without preferred tasks). Chosen, not tuned."""

_MAX_FULL_STEPS = 30
"""Upper bound of the number of full Gauss-Newton steps before the trust-region iteration. Measured
on four postures: 4 to 10; steps of `_MAX_STEP` cross the range of a joint in 20."""

_MAX_STEP = 0.3
"""Largest displacement of a joint in an iteration [rad, m]. Chosen, not tuned."""

_NUM_NEAREST_PAIRS = 12
"""Number of nearest pairs of collision shapes that `SelfClearanceTask` keeps apart in an iteration.
The shapes are on links that are not neighbours. Chosen, not tuned: Pupper v3 has 32 such pairs, of
which fewer are close to each other at once."""

_MAX_MEASURED_DISTANCE = 1e3
"""Upper bound of the distances that MuJoCo measures [m]: larger than any robot. Chosen, not tuned.
"""

_CONTACT_WEIGHT = 1e4
"""Weight of the squared residuals of contacts that a posture must keep, relative to required tasks:
in a conflict, the tasks miss their targets. Chosen, not tuned."""

_PREFERENCE_WEIGHT = 1e-4
"""Weight of the squared residuals of preferred joint positions, relative to required tasks. Chosen:
small against required tasks, large against `_REGULARIZATION`. A second iteration without
preferences removes the remaining residuals of required tasks."""

_RADIUS_REDUCTION = 4
"""Factor by which the trust radius shrinks after a step that increases the error. Chosen, not
tuned."""

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
"""Number of random initial guesses after a failure, within the joint limits. Chosen, not tuned."""

_REGULARIZATION = 1e-9
"""Weight of the squared step of the joints, relative to a task's weight of 1. Chosen small: it
selects a step of redundant joints, and does not bias the solution."""

_UNLIMITED_POSITION = 1e3
"""Finite limit [rad, m] that replaces an infinite joint limit, since PlaCo requires finite limits.
Chosen, not tuned: beyond the positions of any posture."""

_AT_LIMIT = 1e-6
"""Distance from a joint limit [rad, m] up to which a joint counts as being at the limit, in the
error of an unreachable posture. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class SolvedPosture(Pictured, Tabular):
    """Posture that satisfies tasks.

    Attributes:
        qpos: Configuration, shape (nq,).
        tasks: Description of each task, with the kept contacts last.
        residuals: Residual of each task by Pinocchio's kinematics.
        mujoco_residuals: Residual of each task by MuJoCo's kinematics of the MJCF; different from
            ``residuals`` if the kinematics of the two files differ.
        units: Unit of the residual of each task.
        contacts: Contact points that kept their positions.
        iterations: Number of solved quadratic programs.
    """

    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    tasks: tuple[str, ...]
    residuals: Array = field(metadata={"unit": "m or rad"})
    mujoco_residuals: Array = field(metadata={"unit": "m or rad"})
    units: tuple[str, ...]
    contacts: tuple[str, ...]
    iterations: int

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_robot"}

    @property
    def robot(self) -> Robot | None:
        """Robot of the posture; None for a posture from another process."""
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
    start: ArrayLike | None = None,
    contacts: Iterable[str] | None = None,
) -> SolvedPosture:
    """Solve for a configuration that satisfies tasks within the joint limits.

    PlaCo minimises the weighted squared residuals. The iteration starts at ``start``; after a
    failure, at up to eight random postures. Links may collide without a ``SelfClearanceTask``. See
    ``examples/first_look.ipynb`` for pictures of the result (``posture.show()``).

    Statics of the result: ``pa.gravity_compensation(pa.Configuration(robot, posture.qpos))``.

    Args:
        robot: Robot without closed loops, couplings and welds.
        tasks: Tasks, for example ``pa.stance.PositionTask("hand", (0.3, 0, 0.4))``.
        start: Initial configuration (nq,). Default: ``robot.home``.
        contacts: Contact points that keep their positions of ``start``, for a free base. Default:
            ``robot.bearing_points``; with none, the base moves freely. A robot with a fixed base
            has none.

    Raises:
        PostureUnreachableError: If a residual exceeds `POSTURE_TOLERANCE`. The error states the
            task with the largest residual, and the joints at their limits.
        ConfigurationError: If there is no task, ``start`` is not valid, a task is not valid,
            ``contacts`` are given for a fixed base, or the robot has closed loops, couplings or
            welds; with a ``SelfClearanceTask`` also if the robot has a continuous joint, which
            PlaCo's half-spaces do not support.
        UnknownNameError: If a link, joint or contact point is unknown.
    """
    robot.check_tree("a whole-body posture")
    requested = tuple(tasks) if isinstance(tasks, Iterable) else (tasks,)
    for task in requested:
        check_type("tasks", task, PostureTask)
    if not requested:
        raise ConfigurationError("tasks", diagnose("no-posture-task"))
    _check_names(robot, requested)
    apart = any(isinstance(task, SelfClearanceTask) for task in requested)
    if apart and robot.pin_convention.unbounded.any():
        names = [robot.joint_names[i] for i in np.flatnonzero(robot.pin_convention.unbounded)]
        raise ConfigurationError("tasks", diagnose("clearance-of-continuous", joints=names))
    initial = Configuration(robot, robot.home if start is None else start)
    kept = tuple(robot.bearing_points if contacts is None else contacts)
    if kept and not robot.floating:
        problem = diagnose("fixed-base-carries", robot=robot.name)
        raise ConfigurationError("contacts", problem)
    positions = initial.foot_positions()
    footholds = [
        PositionTask(robot.contact_frames[robot.check_foot(point)], positions[point])
        for point in kept
    ]
    every = (*requested, *footholds)
    required = np.array([task.required for task in every])
    collision = _LazyShapes(robot)
    solver = _PostureSolver(robot, every, len(kept), collision)
    best: tuple[float, Array] | None = None
    for guess in _list_guesses(robot, initial.qpos):
        qpos = solver.solve(guess)
        residuals = _compute_residuals(every, _PinocchioBody(robot, qpos, collision))
        largest = float(residuals[required].max(initial=0.0))
        if best is None or largest < best[0]:
            best = largest, qpos
        if largest <= POSTURE_TOLERANCE:
            break
    assert best is not None
    largest, qpos = best
    residuals = _compute_residuals(every, _PinocchioBody(robot, qpos, collision))
    if largest > POSTURE_TOLERANCE:
        raise _explain_failure(robot, every, kept, residuals, qpos)
    posture = SolvedPosture(
        qpos=qpos,
        tasks=_describe_tasks(every, kept),
        residuals=residuals,
        mujoco_residuals=_compute_residuals(every, _MujocoBody(robot, qpos, collision)),
        units=tuple(task.unit for task in every),
        contacts=kept,
        iterations=solver.iterations,
    )
    vars(posture)["_robot"] = robot
    return posture


def _check_names(robot: Robot, tasks: Sequence[PostureTask]) -> None:
    """Raise UnknownNameError if a task names an unknown link or joint."""
    for task in tasks:
        for frame in task.frames:
            if frame not in robot.structure.links:
                raise UnknownNameError(robot.name, "link", frame, tuple(robot.structure.links))
        for joint in task.positions if isinstance(task, JointsTask) else ():
            if joint not in robot.joint_names:
                raise UnknownNameError(robot.name, "joint", joint, robot.joint_names)


def _list_guesses(robot: Robot, qpos: Array) -> Iterable[Array]:
    """Yield initial guesses (nq,): ``qpos`` within the limits, then random joint positions."""
    first = robot.nq - robot.nu
    lower, upper = robot.lower_limits, robot.upper_limits
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
    """PlaCo solver with tasks.

    Attributes:
        solver: PlaCo solver.
        tasks: Weight of the squared error, and task.
    """

    solver: placo.KinematicsSolver
    tasks: tuple[tuple[float, PlacoTask], ...]


class _PostureSolver:
    """PlaCo solvers with the tasks of a posture: with preferred tasks, then without.

    Args:
        robot: Robot.
        tasks: Tasks, those of kept contacts last.
        num_contacts: Number of kept contacts.
        collision: Collision shapes.

    Attributes:
        iterations: Number of solved quadratic programs.
    """

    def __init__(
        self,
        robot: Robot,
        tasks: Sequence[PostureTask],
        num_contacts: int,
        collision: _LazyShapes,
    ) -> None:
        self._robot, self._placo_robot = robot, PooledPlacoRobot(robot)
        self._collision = collision
        self.iterations = 0
        wrapper = self._placo_robot.wrapper
        for joint in np.flatnonzero(~robot.pin_convention.unbounded):
            low, high = robot.lower_limits[joint], robot.upper_limits[joint]
            limits = max(low, -_UNLIMITED_POSITION), min(high, _UNLIMITED_POSITION)
            wrapper.set_joint_limits(robot.joint_names[joint], *limits)
        # PlaCo bounds steps by velocity limit x dt.
        wrapper.set_velocity_limits(1.0)
        required = [task for task in tasks if task.required]
        self._stages = [
            self._make_stage(chosen, num_contacts)
            for chosen in (([tasks] if len(required) < len(tasks) else []) + [required])
        ]

    def _make_stage(self, tasks: Sequence[PostureTask], num_contacts: int) -> _Stage:
        """Return a PlaCo solver of some tasks; the last ``num_contacts`` are kept contacts."""
        solver = placo.KinematicsSolver(self._placo_robot.wrapper)
        solver.mask_fbase(not self._robot.floating)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        weighted = []
        for index, task in enumerate(tasks):
            weight = 1.0 if task.required else _PREFERENCE_WEIGHT
            if index >= len(tasks) - num_contacts:
                weight = _CONTACT_WEIGHT
            weighted.append((weight, task.add_to(solver, weight)))
        solver.add_regularization_task(_REGULARIZATION)
        return _Stage(solver, tuple(weighted))

    def solve(self, qpos: Array) -> Array:
        """Minimise the weighted residuals of the tasks from an initial guess qpos (nq,).

        Returns:
            Configuration at which steps are negligible, or the iterations end, shape (nq,).
        """
        wrapper, convention = self._placo_robot.wrapper, self._robot.pin_convention
        base = [] if self._robot.floating else [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        wrapper.state.q = np.concatenate([base, convention.q(qpos)])
        wrapper.update_kinematics()
        for stage in self._stages:
            start = np.array(wrapper.state.q)
            if not self._take_full_steps(stage):
                wrapper.state.q = start
                wrapper.update_kinematics()
                self._iterate_trust_region(stage)
        return self._current_qpos()

    def _take_full_steps(self, stage: _Stage) -> bool:
        """Move PlaCo's robot by full steps; return True if they converge without a larger error.

        The error is compared with the initial error only at the end. Contacts are nonlinear
        constraints with a large weight, so that a trust region would follow a narrow valley.
        """
        initial_error = self._evaluate(stage)
        stage.solver.dt = _MAX_STEP
        for _ in range(_MAX_FULL_STEPS):
            self.iterations += 1
            try:
                step = stage.solver.solve(True)
            except RuntimeError:  # no solution of the quadratic program
                return False
            self._placo_robot.wrapper.update_kinematics()
            error = self._evaluate(stage)
            if error < _ROUNDING_ERROR or float(np.linalg.norm(step)) < _NEGLIGIBLE_STEP:
                return error <= initial_error
        return False

    def _iterate_trust_region(self, stage: _Stage) -> None:
        """Move PlaCo's robot by steps of bounded length that do not increase the error.

        A step that increases the error is taken back, and the trust radius is reduced. Ends if the
        error, a step or the radius is negligible, after `_MAX_ITERATIONS`, or if a quadratic
        program has no solution.
        """
        wrapper, radius = self._placo_robot.wrapper, _MAX_STEP
        error = self._evaluate(stage)
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
            previous, error = error, self._evaluate(stage)
            if error > previous:
                wrapper.state.q = before
                wrapper.update_kinematics()
                error = self._evaluate(stage)
                if float(np.linalg.norm(step)) < _ROUNDING_STEP:
                    return
                radius /= _RADIUS_REDUCTION
            elif float(np.linalg.norm(step)) < _NEGLIGIBLE_STEP:
                return
            else:
                radius = min(_MAX_STEP, 2 * radius)
            if radius < _NEGLIGIBLE_STEP:
                return

    def _evaluate(self, stage: _Stage) -> float:
        """Return the weighted sum of squared residuals [m^2, rad^2] at PlaCo's configuration.

        Targets that depend on the configuration, such as a gaze direction, are updated first.
        """
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
    """Collision shapes of a robot, prepared when a task needs them."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @cached_property
    def shapes(self) -> ClearanceShapes:
        """Collision shapes of the robot, with the pairs of links that are not neighbours."""
        return ClearanceShapes(self._robot)


class _PinocchioBody:
    """Poses of links by Pinocchio's kinematics of the URDF."""

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
        """Return the smallest distances [m] of shapes on links that are no neighbours, sorted."""
        pairs = self._collision.shapes.find_nearest_pairs(self._config.qpos, _NUM_NEAREST_PAIRS)
        return np.array([pair.distance for pair in pairs])

    def linearise_self_clearances(self) -> tuple[Array, Array]:
        """Return the derivatives of `self_clearances` by PlaCo's q, and q.

        The shapes are (n, nq) and (nq,). Derivatives by the pose of the base are zero.
        """
        robot, convention = self._config.robot, self._config.robot.pin_convention
        rates = self._collision.shapes.distance_jacobian(self._config, _NUM_NEAREST_PAIRS)
        # PlaCo's robot has a free base, which a fixed-base robot does not move.
        base = 0 if robot.floating else 7
        derivatives = np.zeros((len(rates), base + convention.nq))
        derivatives[:, base + convention.q_index] = rates[:, robot.nv - robot.nu :]
        return derivatives, np.concatenate([np.zeros(base), convention.q(self._config.qpos)])


class _MujocoBody(_PinocchioBody):
    """Poses of links by MuJoCo's kinematics of the MJCF.

    The constant pose of a link in its body is that of the neutral configuration, because the frames
    of a URDF and an MJCF may differ.
    """

    def __init__(self, robot: Robot, qpos: Array, collision: _LazyShapes) -> None:
        super().__init__(robot, qpos, collision)
        self._robot, self._data = robot, robot.compute_kinematics(qpos)

    def pose(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) [m] of a link in the world."""
        robot, model = self._robot, self._robot.mj_model
        name, offset = find_tool(robot, frame).locate_in_mjcf(robot)
        body = model.body(name).id
        neutral, still = robot.compute_kinematics(), Configuration(robot, robot.neutral())
        relative = neutral.xmat[body].reshape(3, 3).T @ still.frame_rotation(frame)
        rotation = self._data.xmat[body].reshape(3, 3)
        return rotation @ relative, self._data.xpos[body] + rotation @ offset

    def self_clearances(self) -> Array:
        """Return distances between links of the robot, ascending, shape (n,) [m].

        MuJoCo measures the distances, for the n pairs of collision shapes that Pinocchio finds
        nearest.
        """
        shapes, model = self._collision.shapes, self._robot.mj_model
        pairs = shapes.find_nearest_pairs(self._config.qpos, _NUM_NEAREST_PAIRS)
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


def _describe_tasks(tasks: Sequence[PostureTask], kept: Sequence[str]) -> tuple[str, ...]:
    """Return a description of each task; the last len(kept) are contact points."""
    names = []
    for task in tasks[: len(tasks) - len(kept)]:
        subjects = task.positions if isinstance(task, JointsTask) else task.frames
        names.append(" ".join([type(task).__name__, *subjects]))
    return (*names, *(f"contact {point}" for point in kept))


def _explain_failure(
    robot: Robot,
    tasks: Sequence[PostureTask],
    kept: Sequence[str],
    residuals: Array,
    qpos: Array,
) -> PostureUnreachableError:
    """Return the error of an unreachable posture.

    It names the required task with the largest residual, and the joints at their limits. The unit
    of a `JointsTask` is that of the joint with the largest deviation.

    Args:
        robot: Robot.
        tasks: Tasks of the posture.
        kept: Contacts that the posture keeps, for the names of their tasks.
        residuals: Residual of each task [m or rad].
        qpos: Configuration with these residuals, shape (nq,).
    """
    required = np.array([task.required for task in tasks])
    worst, first = int(np.where(required, residuals, -1.0).argmax()), robot.nq - robot.nu
    at_limit = {}
    limits = zip(
        robot.joint_names, qpos[first:], robot.lower_limits, robot.upper_limits, strict=True
    )
    for name, value, low, high in limits:
        if min(value - low, high - value) < _AT_LIMIT:
            at_limit[name] = float(low if value - low < high - value else high)
    names = _describe_tasks(tasks, kept)
    task, unit = tasks[worst], tasks[worst].unit
    if isinstance(task, JointsTask):
        positions = dict(zip(robot.joint_names, qpos[first:].tolist(), strict=True))
        gaps = {name: abs(positions[name] - target) for name, target in task.positions.items()}
        unit = joint_unit(robot, max(gaps, key=gaps.__getitem__))
    units = {name: joint_unit(robot, name) for name in at_limit}
    return PostureUnreachableError(
        names[worst],
        float(residuals[worst]),
        unit,
        dict(zip(names, residuals.tolist(), strict=True)),
        at_limit,
        units,
        qpos,
    )
