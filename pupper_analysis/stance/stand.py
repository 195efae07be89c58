"""How the robot can stand: a whole-body configuration with planted feet, solved by PlaCo."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.errors import ConfigurationError, StanceUnreachableError, UnknownNameError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.problem import Goal, has_spare_joints, make_goal
from pupper_analysis.stance.relaxation import explain_refusal
from pupper_analysis.stance.search import continue_stand, find_nearest, search_stand
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import Contacts, make_contacts
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation, balance_load

Array = NDArray[np.float64]

__all__ = ["Stand", "solve_stand", "stand_statics"]

_UP = [0.0, 0.0, 1.0]


@check_arguments
def solve_stand(
    robot: Robot,
    task: StandTask | None = None,
    *,
    explain: bool = True,
) -> Stand:
    """Finds the configuration that satisfies a stand task, within the joint limits.

    PlaCo solves a sequence of quadratic programmes on the floating base, from the task's ik_seed,
    from home, and, where these do not lead there, from every way to bend the legs that may
    (``branches``). With ``com="inside"``, or with joints to spare, all that a stand must fulfil is
    then met at once (``programme``): the com moves to where the feet are in reach.

    Args:
        robot: A robot with a floating base.
        task: How to stand; the nominal stand by default.
        explain: Where the stance is out of reach, find out how near the feet can come, which
            demands are in the way, as few as possible, and how far they would have to give (a
            second, or some where the com may be anywhere inside).
            Otherwise the shortfall is PlaCo's, which may be a little too large.

    Returns:
        The stand; every error is under 1e-9 m or rad.

    Raises:
        ConfigurationError: If the robot's base is fixed, or it has no feet; or if the margins leave
            nothing.
        UnknownNameError: If the task names a foot that the robot does not have.
        StanceUnreachableError: If it is out of reach; names the feet and how far they miss, and the
            demands of which one would have to give.
    """
    robot = touching(robot, task.contacts) if task is not None else robot
    with lend(robot, SearchContext) as context:
        return solve_goal(context, make_goal(robot, task, {}), explain=explain)


def solve_goal(context: SearchContext, goal: Goal, *, explain: bool) -> Stand:
    """Finds the stand of a goal; see ``solve_stand``.

    Raises:
        StanceUnreachableError: If it is out of reach.
    """
    stand = search_stand(context, goal)
    if stand.solved:
        return stand
    if explain and stand.foot_error >= TASK_TOLERANCE:
        closest = find_nearest(context, goal, stand.qpos)
        stand = min(stand, closest, key=lambda found: found.foot_error)
    raise explain_refusal(context, goal, stand, explain=explain)


@check_arguments
def stand_statics(
    robot: Robot,
    stand: Stand,
    *,
    distribution: ForceDistribution | str = ForceDistribution.MIN_TANGENTIAL,
) -> GravityCompensation:
    """Computes what the motors hold in a stand, on the feet that carry and on its ground.

    Args:
        robot: The robot.
        stand: The stand.
        distribution: Which of the feasible contact forces: by default those that last.

    Raises:
        ConfigurationError: If the stand is another robot's, or ``distribution`` is unknown.
        StaticsInfeasibleError: If the stance is reached but cannot be held: it slides or tips.
    """
    robot = stand.check(robot)

    def compute() -> GravityCompensation:
        config, carrying = Configuration(robot, stand.qpos), stand_contacts(robot, stand)
        return balance_load(config, config.load(), carrying, distribution=distribution)

    return stand.cached_statics(robot, distribution, compute)


def stand_contacts(robot: Robot, stand: Stand) -> Contacts:
    """Returns the contacts that carry in a stand, on its ground, as deep as they are in it."""
    # Of contacts on level, rigid ground all is known that depends on the robot alone.
    level = all(normal.tolist() == _UP for normal in stand.normals.values())
    normals, depths = None if level else stand.normals, stand.depths
    sunk = depths if any(depths.values()) else None
    return make_contacts(robot, stand.stance_feet, None, normals, sunk)


_SAME_BEND = 0.5
"""rad: joints that are further from those of the stand before may be bent another way than a search
from home would bend them. A sample of a path never goes so far."""


_WEIGHTS = {1: (1.0,), 2: (2.0, -1.0), 3: (3.0, -3.0, 1.0), 4: (4.0, -6.0, 4.0, -1.0)}
"""Of so many stands, the latest first, in the value there that their polynomial has next. Of a
thousand in a smooth sequence a parabola is 3e-7 rad off, from where PlaCo takes two steps, for its
regularisation leaves a millionth of a step undone; a cubic 4e-9, from where it takes one."""


@check_arguments
def solve_stands(
    robot: Robot,
    tasks: Sequence[StandTask],
    *,
    explain: bool = False,
) -> tuple[Stand, ...]:
    """Solves a sequence of stand tasks: quicker than one by one where neighbours are alike.

    Each search begins where the stands before it, four at most, lead to. If that comes to a stand
    near the one before, it is the task's; if not, the task is solved as ``solve_stand`` does, from
    its own starts. So it is for tasks that choose where to begin (``ik_seed``), or that leave open
    where a stand ends: with the com anywhere ``"inside"``, on redundant legs, with links to keep
    apart.

    The stands are those of ``solve_stand``, to rounding. Only where a leg can be bent in several
    ways may they differ: a sequence keeps to the way in which it began, as long as that leads on.

    Args:
        robot: A robot with a floating base.
        tasks: How to stand, one after the other.
        explain: As in ``solve_stand``, for a task that is out of reach (a second).

    Returns:
        The stands, in the order of the tasks.

    Raises:
        ConfigurationError: As ``solve_stand``; before any is solved, and naming the task.
        UnknownNameError: Likewise.
        StanceUnreachableError: For the first task that is out of reach; ``where`` tells which.
    """
    goals: list[Goal] = []
    solved: list[Stand] = []
    robot = touching(robot, tasks[0].contacts) if tasks else robot
    for number, task in enumerate(tasks):
        try:  # where feet and ground stay the same, so do the feet's places
            goals.append(make_goal(robot, task, {}, goals[-1] if goals else None))
        except (ConfigurationError, UnknownNameError) as error:
            raise error.at(f"tasks[{number}]") from None
    with lend(robot, SearchContext) as context:
        for number, goal in enumerate(goals):
            stand = _continued(context, goal, [one.qpos for one in solved[:-5:-1]])
            try:
                solved.append(stand or solve_goal(context, goal, explain=explain))
            except StanceUnreachableError as error:
                raise error.at(f"tasks[{number}]") from None
    return tuple(solved)


def _continued(context: SearchContext, goal: Goal, before: Sequence[Array]) -> Stand | None:
    """Returns the stand that those before lead to; None if they lead to none nearby.

    Args:
        context: The robot's.
        goal: The goal.
        before: (nq,) of the last four stands, the latest first: a polynomial goes through them.
    """
    if not before or has_spare_joints(context.robot) or _is_open(goal):
        return None
    weights, last = _WEIGHTS[len(before)], before[0]
    ahead = weights[0] * last
    for weight, qpos in zip(weights[1:], before[1:], strict=True):
        ahead += weight * qpos
    for start in (ahead, last) if _apart(ahead, last) < _SAME_BEND else (last,):
        stand = continue_stand(context, goal, start)
        if stand is not None and _apart(stand.qpos, last) < _SAME_BEND:
            return stand
    return None


def _is_open(goal: Goal) -> bool:
    """Whether a task leaves more open than how legs are bent, or says itself where to begin."""
    task = goal.task
    return task.ik_seed is not None or task.self_clearance is not None or goal.com_is_free


def _apart(one: Array, other: Array) -> float:
    """Returns how far the joints of two configurations are from each other, all in all (rad)."""
    between = (one - other)[7:]
    return math.sqrt(between.dot(between))
