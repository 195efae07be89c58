"""How the robot can stand: a whole-body configuration with planted feet, solved by PlaCo."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
import pinocchio as pin
import placo
import shapely
from numpy.typing import NDArray

from pupper_analysis.collision import Clearance, Shapes, shapes_of
from pupper_analysis.configuration import UP, Configuration
from pupper_analysis.demands import DEMANDS, differ, in_words, shrunk
from pupper_analysis.errors import ConfigurationError, StanceUnreachableError
from pupper_analysis.goal import Goal, goal_of
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.statics import (
    GravityCompensation,
    LoadSharing,
    gravity_compensation,
)
from pupper_analysis.task import StandTask

Array = NDArray[np.float64]

TASK_TOLERANCE = 1e-9
"""Error up to which a task counts as satisfied (m, rad)."""

TOUCHING = 1e-6
"""How much nearer than allowed parts may come (m): rounding."""

_STEP_TOLERANCE = 1e-13
_MAX_ITERATIONS = 200
_TRIGGER = 0.02  # m: links that are further than this from their least distance are left alone
_APART_WEIGHT = 1e3  # of links staying apart, against feet
_TRUST_RADIUS = 0.5  # rad per joint and iteration


@dataclass(frozen=True, eq=False)
class Stand(Result):
    """A solved stand. Its errors are Pinocchio's, computed anew from ``qpos``.

    Attributes:
        task: The task, with its height filled in.
        qpos: (nq,) the configuration.
        foot_targets: {foot: (3,)} where the centre of each foot's sphere shall be (m).
        depths: {foot that carries: how deep it has sunk into the ground (m)}; 0 on rigid ground.
        carrying: The feet that carry.
        normals: {foot that carries: (3,) direction out of the ground}.
        contact_points: {foot that carries: (3,) where it touches the ground (m)}.
        foot_error: The largest distance of a foot from its target (m).
        orientation_error: Angle between the base's orientation and the task's (rad).
        height_error: Of the base frame (m).
        com_error: Horizontal distance of the com from where it shall be (m); with an offset, of the
            base frame.
        ground_clearance: How high the lowest part other than the feet is above the ground, by the
            URDF's shapes; None if it has none.
        self_clearance: The least distance between links that are not neighbours; None if it was
            not asked for.
        iterations: Quadratic programmes solved.
    """

    task: StandTask
    qpos: Array
    foot_targets: dict[str, Array]
    depths: dict[str, float]
    carrying: tuple[str, ...]
    normals: dict[str, Array]
    contact_points: dict[str, Array]
    foot_error: float
    orientation_error: float
    height_error: float
    com_error: float
    ground_clearance: Clearance | None
    self_clearance: Clearance | None
    iterations: int

    @property
    def blocked(self) -> tuple[str, ...]:
        """What comes nearer to the ground, or to another link, than the task allows."""
        found = []
        near, least = self.ground_clearance, self.task.ground_clearance
        if near is not None and near.distance < least - TOUCHING:
            found.append(f"{near.links[0]} is {_distance(near, 'above', 'in')} the ground")
        near, least = self.self_clearance, self.task.self_clearance or 0.0
        if near is not None and near.distance < least - TOUCHING:
            found.append(f"{near.links[0]} is {_distance(near, 'from', 'in')} {near.links[1]}")
        return tuple(found)

    @property
    def solved(self) -> bool:
        """Whether the feet are where they shall be, and nothing is in the way."""
        return self.foot_error < TASK_TOLERANCE and not self.blocked

    def joint_positions(self, robot: Robot) -> Array:
        """Returns the joints' part (nu,) of ``qpos`` (rad)."""
        return self.qpos[robot.nq - robot.nu :]


def _distance(near: Clearance, apart: str, inside: str) -> str:
    return f"{1e3 * abs(near.distance):.1f} mm {apart if near.distance >= 0 else inside}"


def solve_stand(
    robot: Robot,
    task: StandTask | None = None,
    *,
    depths: Mapping[str, float] | None = None,
    explain: bool = True,
) -> Stand:
    """Finds the configuration that satisfies a stand task, within the joint limits.

    PlaCo solves a sequence of quadratic programmes on the floating base: the base's orientation
    and height and the com's place are hard constraints, which the free base can always satisfy;
    the feet are the objective, which vanishes if the stance is in reach. Where links shall stay
    apart, PlaCo's avoidance of self-collisions weighs more than the feet.

    Args:
        robot: A robot with a floating base.
        task: How to stand; the nominal stand by default.
        depths: {foot that carries: how deep it sinks into the ground (m)}; 0 where not given. The
            base stays where the task has it. ``sunk_stand`` finds MuJoCo's.
        explain: Where the stance is out of reach, find out how near the feet can come, which
            demands are in the way, as few as possible, and how far they would have to give (some
            tenths of a second).
            Otherwise the shortfall is PlaCo's, which may be a little too large.

    Returns:
        The stand; every error is under 1e-9 m or rad.

    Raises:
        ConfigurationError: If the robot's base is fixed, or it has no feet; or if the margins leave
            nothing.
        UnknownNameError: If the task, or depths, name a foot that the robot does not have.
        StanceUnreachableError: If it is out of reach; names the feet and how far they miss, and the
            demands of which one would have to give.
    """
    goal = goal_of(robot, task or StandTask(), depths or {})
    # Distances between links remember where they were found last: they begin anew.
    shapes = shapes_of(robot) if goal.task.self_clearance is None else Shapes(robot)
    outcome = _attempt(shapes, goal)
    if outcome.solved:
        return outcome
    inside, nearest = goal.task.com == "inside", outcome
    if goal.task.self_clearance is not None:  # is that what is in the way?
        closer = replace(goal, task=replace(goal.task, self_clearance=None))
        outcome = _measure(shapes, goal, _attempt(shapes, closer).qpos, outcome.iterations)
        nearest = outcome
    if outcome.foot_error >= TASK_TOLERANCE and (explain or inside):
        nearest = _nearest(shapes, goal, outcome.qpos)
    for solved, closest in _elsewhere(shapes, goal, outcome) if inside else ():
        if solved.solved:
            return solved
        nearest = min(nearest, closest, solved, key=lambda stand: stand.foot_error)
    raise _unreachable(shapes, goal, nearest, explain)


def stand_statics(
    robot: Robot, stand: Stand, *, sharing: LoadSharing | str = LoadSharing.EVEN
) -> GravityCompensation:
    """Computes what the motors hold in a stand, on the feet that carry and on its ground.

    Args:
        robot: The robot.
        stand: The stand.
        sharing: Which of the feasible contact forces: by default ``EVEN``, those that last.

    Raises:
        StaticsInfeasibleError: If the stance is reached but cannot be held: it slides or tips.
    """
    return gravity_compensation(
        Configuration(robot, stand.qpos),
        stand.carrying,
        normals=stand.normals,
        depths=stand.depths,
        sharing=sharing,
    )


def _elsewhere(shapes: Shapes, goal: Goal, outcome: Stand) -> Iterator[tuple[Stand, Stand]]:
    """Tries other places of a com that may lie anywhere inside; yields stands and what led to them.

    The com goes to where it comes to lie as the feet get as near to their places as they can: there
    they may be in reach. That depends on the start; and where a joint is then at its limit, the
    place is not exact enough. Where parts are in the way, once more without them in the ground.
    """
    robot, blocked = shapes.robot, False
    for clear in (False, True):
        for start in (outcome.joint_positions(robot), *_starts(robot, goal)):
            qpos = outcome.qpos.copy()
            qpos[7:] = start
            closest = _nearest(shapes, goal, qpos, clear=clear)
            place = Configuration(robot, closest.qpos).center_of_mass()[:2]
            moved = replace(goal, place=place)
            solved = _solve_from(shapes, moved, closest.joint_positions(robot))
            blocked |= solved.foot_error < TASK_TOLERANCE
            yield solved, closest
        if not blocked:
            return


def _attempt(shapes: Shapes, goal: Goal) -> Stand:
    """Tries all starts; returns the first success, or else the best failure."""
    best: Stand | None = None
    for start in _starts(shapes.robot, goal):
        stand = _solve_from(shapes, goal, start)
        if best is None or stand.solved or stand.foot_error < best.foot_error:
            best = stand
        if stand.solved:
            break
    assert best is not None
    return best


def _solve_from(shapes: Shapes, goal: Goal, joints: Array) -> Stand:
    robot, wrapper = shapes.robot, shapes.wrapper
    convention = robot.pin_convention
    qpos = robot.neutral()
    qpos[:3] = (*goal.place, goal.height)
    x, y, z, w = pin.Quaternion(goal.task.rotation()).coeffs()
    qpos[3:7] = w, x, y, z
    qpos[7:] = np.clip(joints, goal.lower, goal.upper)
    wrapper.state.q = convention.q(qpos)
    wrapper.update_kinematics()

    solver = placo.KinematicsSolver(wrapper)
    for name, low, high in zip(robot.joint_names, goal.lower, goal.upper, strict=True):
        if np.isfinite(low) and np.isfinite(high):
            wrapper.set_joint_limits(name, low, high)
    solver.enable_joint_limits(True)
    wrapper.set_velocity_limits(1.0)
    solver.enable_velocity_limits(True)
    feet = []
    for foot, target in goal.targets.items():
        feet.append(solver.add_position_task(robot.foot_frames[foot], target))
        feet[-1].configure(foot, "soft", 1.0)
    orientation = solver.add_orientation_task(robot.base, goal.task.rotation())
    orientation.configure("orientation", "hard")
    height = solver.add_position_task(robot.base, goal.height * UP)
    height.mask.set_axises("z")
    height.configure("height", "hard")
    where = np.array([*goal.place, 0.0])
    if goal.by_base:
        place = solver.add_position_task(robot.base, where)
    else:
        place = solver.add_com_task(where)
    place.mask.set_axises("xy")
    place.configure("place", "hard")
    if goal.task.self_clearance is not None:
        shapes.pair()
        apart = solver.add_avoid_self_collisions_constraint()
        apart.self_collisions_margin = goal.task.self_clearance
        apart.self_collisions_trigger = goal.task.self_clearance + _TRIGGER
        apart.configure("apart", "soft", _APART_WEIGHT)
    # Decides between configurations that place the feet equally well; too small to move a foot.
    solver.add_regularization_task(1e-9)

    # A trust region: where a step makes things worse it is undone, and the next one is shorter.
    radius, iterations = _TRUST_RADIUS, 0
    q = np.array(wrapper.state.q)
    error = math.inf
    while iterations < _MAX_ITERATIONS and radius > _STEP_TOLERANCE:
        iterations += 1
        solver.dt = radius
        step = solver.solve(True)
        wrapper.update_kinematics()
        new_error = sum(foot.error_norm() ** 2 for foot in feet) + place.error_norm() ** 2
        if new_error > error and new_error > TASK_TOLERANCE**2:
            radius /= 4
            wrapper.state.q = q
            wrapper.update_kinematics()
            continue
        error, q = new_error, np.array(wrapper.state.q)
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    return _measure(shapes, goal, convention.qpos(np.array(wrapper.state.q)), iterations)


def _measure(shapes: Shapes, goal: Goal, qpos: Array, iterations: int) -> Stand:
    config = Configuration(shapes.robot, qpos)
    feet = config.foot_positions()
    turn = goal.task.rotation().T @ config.base_rotation()
    at = config.qpos[:2] if goal.by_base else config.center_of_mass()[:2]
    errors = [float(np.linalg.norm(feet[foot] - target)) for foot, target in goal.targets.items()]
    normal = goal.task.ground.normal()
    return Stand(
        task=goal.task,
        qpos=config.qpos.copy(),
        foot_targets=goal.targets,
        depths=goal.depths,
        carrying=goal.carrying,
        normals=dict.fromkeys(goal.carrying, normal),
        contact_points=dict(zip(goal.carrying, goal.contacts, strict=True)),
        foot_error=max(errors),
        orientation_error=float(np.linalg.norm(pin.log3(turn))),
        height_error=abs(float(config.qpos[2]) - goal.height),
        com_error=float(np.linalg.norm(at - goal.place)),
        ground_clearance=shapes.above_ground(
            config.qpos, goal.task.ground, goal.targets, goal.depths
        ),
        self_clearance=(
            None if goal.task.self_clearance is None else shapes.between_links(config.qpos)
        ),
        iterations=iterations,
    )


def _nearest(shapes: Shapes, goal: Goal, start: Array, *, clear: bool = False) -> Stand:
    """Finds how near the feet can come to targets that are out of reach.

    The sum of the squared distances is minimised over the base's place and the joints, inside their
    limits, with the base's orientation and height and the com's place as the task has them. PlaCo's
    Gauss-Newton steps, made for errors that vanish, stop short of that minimum. If ``clear``, no
    part but the feet may be lower than the task allows.
    """
    from scipy import optimize  # slow to import

    robot = shapes.robot
    free = [0, 1, *range(7, robot.nq)]
    columns = [0, 1, *range(6, robot.nv)]

    def at(values: Array) -> Configuration:
        qpos = start.copy()
        qpos[free] = values
        return Configuration(robot, qpos)

    def distances(values: Array) -> tuple[float, Array]:
        config = at(values)
        positions, jacobians = config.foot_positions(), config.foot_jacobians()
        total, gradient = 0.0, np.zeros(len(free))
        for foot, target in goal.targets.items():
            error = positions[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot][:, columns]
        return total, gradient

    constraint: dict[str, object]
    if goal.task.com == "inside":
        sides = _sides(goal.contacts)
        constraint = {
            "type": "ineq",
            "fun": lambda values: (
                sides[:, :2] @ at(values).center_of_mass()[:2] + sides[:, 2] - goal.task.com_margin
            ),
            "jac": lambda values: sides[:, :2] @ at(values).com_jacobian()[:2, columns],
        }
    elif goal.by_base:
        constraint = {
            "type": "eq",
            "fun": lambda values: values[:2] - goal.place,
            "jac": lambda values: np.eye(2, len(values)),
        }
    else:
        constraint = {
            "type": "eq",
            "fun": lambda values: at(values).center_of_mass()[:2] - goal.place,
            "jac": lambda values: at(values).com_jacobian()[:2, columns],
        }
    constraints = [constraint]
    if clear:

        def room(values: Array) -> Array:
            heights = shapes.heights(at(values).qpos, goal.task.ground, goal.targets, goal.depths)
            finite: Array = heights[np.isfinite(heights)]
            return finite - (goal.task.ground_clearance + TOUCHING)

        constraints.append({"type": "ineq", "fun": room})
    outcome = optimize.minimize(
        distances,
        start[free],
        jac=True,
        method="SLSQP",
        bounds=[(None, None), (None, None), *zip(goal.lower, goal.upper, strict=True)],
        constraints=constraints,
        options={"ftol": 1e-14, "maxiter": 200},
    )
    return _measure(shapes, goal, at(outcome.x).qpos, 0)


def _sides(contacts: Array) -> Array:
    """Returns the support polygon as (n, 3): a x + b y + c is the distance inside each edge (m)."""
    hull = shapely.MultiPoint(contacts[:, :2]).convex_hull
    corners = np.array(shapely.get_coordinates(shapely.geometry.polygon.orient(hull).exterior))
    rows = []
    for one, two in pairwise(corners):
        along = (two - one) / np.linalg.norm(two - one)
        inward = np.array([-along[1], along[0]])  # the corners run counter-clockwise
        rows.append([*inward, -float(inward @ one)])
    return np.array(rows)


def _starts(robot: Robot, goal: Goal) -> Iterator[Array]:
    """Yields joint positions to start from: the posture, then the middle of the limits."""
    yield robot.home[7:] if goal.task.posture is None else np.array(goal.task.posture)
    bounded = np.isfinite(goal.lower) & np.isfinite(goal.upper)
    middle = (np.where(bounded, goal.lower, 0) + np.where(bounded, goal.upper, 0)) / 2
    yield np.where(bounded, middle, 0.0)


# ------------------------------------------------------------------------------------- refusals


def _unreachable(
    shapes: Shapes, goal: Goal, nearest: Stand, explain: bool
) -> StanceUnreachableError:
    robot = shapes.robot
    feet = Configuration(robot, nearest.qpos).foot_positions()
    gaps = {foot: float(np.linalg.norm(feet[foot] - goal.targets[foot])) for foot in feet}
    joints = nearest.joint_positions(robot)
    at_limit: dict[str, float] = {}
    for limits in (goal.lower, goal.upper):
        for index in np.flatnonzero(np.abs(joints - limits) < 1e-6):
            at_limit[robot.joint_names[index]] = float(limits[index])
    missed = {foot: gap for foot, gap in gaps.items() if gap >= TASK_TOLERANCE}
    possible: dict[str, str] = {}
    ends: dict[str, dict[str, object]] = {}
    feasible: Stand | None = None
    if explain:
        differing = [d for d in DEMANDS if differ(robot, goal.task, [d])]
        for size in range(1, len(differing) + 1):
            for demands in combinations(differing, size):
                stand = _furthest(shapes, goal, demands)
                if stand is not None:
                    name = " and ".join(demands)
                    possible[name] = " and ".join(f"{d} {in_words(stand.task, d)}" for d in demands)
                    ends[name] = {demand: getattr(stand.task, demand) for demand in demands}
            if possible:
                break
        feasible = _furthest(shapes, goal, DEMANDS)
    blocked = () if missed else nearest.blocked
    return StanceUnreachableError(
        str(goal.task), missed, at_limit, possible, feasible, blocked, ends
    )


def _furthest(shapes: Shapes, goal: Goal, demands: Sequence[str]) -> Stand | None:
    """Finds how far demands can go from the nominal stand's towards the task's.

    Bisection: between a share that is in reach and one that is not; to 1 part in 1000.

    Returns:
        The stand there; None if the demands do not differ from the nominal stand's, or giving them
        up altogether does not help.
    """
    robot, task = shapes.robot, goal.task
    if not differ(robot, task, demands):
        return None
    best: Stand | None = None
    low, high = 0.0, 1.0
    share = 0.0
    while high - low > 1e-3 or share == 0.0:
        try:
            smaller = goal_of(robot, shrunk(robot, task, demands, share), goal.depths)
            stand = _attempt(shapes, smaller)
        except ConfigurationError:
            return None
        if stand.solved:
            best, low = stand, share
        elif share == 0.0:
            return None
        else:
            high = share
        share = (low + high) / 2
    return best
