"""How the robot can stand: a whole-body configuration with planted feet, solved by PlaCo."""

from __future__ import annotations

from collections.abc import Mapping

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.context import Context
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.problem import Goal, make_goal
from pupper_analysis.stance.relaxation import explain_refusal
from pupper_analysis.stance.search import find_nearest, search_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import Contacts, make_contacts
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation, balance_load

__all__ = ["Stand", "solve_stand", "stand_statics"]

_UP = [0.0, 0.0, 1.0]


@check_arguments
def solve_stand(
    robot: Robot,
    task: StandTask | None = None,
    *,
    depths: Mapping[str, float] | None = None,
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
        depths: {foot that carries: how deep it sinks into the ground (m)}; 0 where not given. The
            base stays where the task has it. ``solve_stand_on_soft_ground`` finds MuJoCo's.
        explain: Where the stance is out of reach, find out how near the feet can come, which
            demands are in the way, as few as possible, and how far they would have to give (a
            second, or some where the com may be anywhere inside).
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
    with lend(robot, Context) as context:
        return solve_goal(context, make_goal(robot, task, depths or {}), explain=explain)


def solve_goal(context: Context, goal: Goal, *, explain: bool) -> Stand:
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
    stand.check(robot)

    def find() -> GravityCompensation:
        config, carrying = Configuration(robot, stand.qpos), stand_contacts(robot, stand)
        return balance_load(config, config.load(), carrying, distribution=distribution)

    return stand.statics(robot, distribution, find)


def stand_contacts(robot: Robot, stand: Stand) -> Contacts:
    """Returns the contacts that carry in a stand, on its ground, as deep as they are in it."""
    # Of contacts on level, rigid ground all is known that depends on the robot alone.
    level = all(normal.tolist() == _UP for normal in stand.normals.values())
    normals, depths = None if level else stand.normals, stand.depths
    sunk = depths if any(depths.values()) else None
    return make_contacts(robot, stand.stance_feet, None, normals, sunk)
