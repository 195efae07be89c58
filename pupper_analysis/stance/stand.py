"""Solve stand tasks (configurations with planted feet), and compute the statics of stands.

Inputs are a robot and stand tasks. Outputs are stands with errors below 1e-9 m or rad, or 0.05 mm
for soles on legs with fewer than six joints. If no stand is found, an error states the reason, if
possible with requirements to relax. `solve_stand` solves a task by inverse kinematics from several
initial guesses (`stance.search`). `solve_stands` solves a sequence of similar tasks, if possible
from extrapolations of previous stands. `stand_statics` computes joint torques [N m] and contact
forces [N].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.errors import ConfigurationError, StanceUnreachableError, UnknownNameError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.constraints import TASK_TOLERANCE
from pupper_analysis.stance.judge import Posed, Stand, attach_robot
from pupper_analysis.stance.problem import StandTargets, compute_targets, has_redundant_joints
from pupper_analysis.stance.relaxation import explain_refusal
from pupper_analysis.stance.search import (
    minimise_foot_errors,
    search_from_configuration,
    search_stand,
)
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import Contacts, make_contacts
from pupper_analysis.statics.equilibrium import (
    ForceDistribution,
    GravityCompensation,
    balance_load,
    to_distribution,
)

__all__ = ["Stand", "solve_stand", "stand_statics"]

_UP = [0.0, 0.0, 1.0]
"""Normal of level ground, as a list for fast comparison."""


@check_arguments
def solve_stand(
    robot: Robot,
    task: StandTask | None = None,
    *,
    start: Posed | ArrayLike | None = None,
    explain: bool = True,
) -> Stand:
    """Solve a stand task: find a configuration with planted feet within the joint limits.

    PlaCo solves a sequence of QPs on the floating base, from several initial guesses, for example
    in the IK branches of the legs (`stance.branches`). If these fail, a nonlinear program of all
    constraints (`stance.programme`) may find a stand with a free CoM or redundant joints.

    Args:
        robot: Robot with a floating base.
        task: Stand task. Default: the nominal stand, ``StandTask()``.
        start: Initial guess: a stand, a ``SolvedPosture``, or a configuration, shape (nq,). Its
            joint positions select the IK branch. Default: ``ik_seed`` of the task.
        explain: Whether the error about an unreachable stance contains the smallest foot error, and
            the smallest change of requirements that makes the stance reachable. Takes about a
            second, longer with a free CoM. If False, the reported foot errors may be larger.

    Returns:
        The stand; each error is below 1e-9 m or rad. A sole on a leg with fewer than six joints may
        miss the task by up to 0.05 mm; ``foot_targets`` are then the reached positions.

    Raises:
        ConfigurationError: If no stand can satisfy the task: for example, the base is fixed, the
            robot has no feet, or the margins are too large. Also if ``start`` is not a valid
            configuration of the robot.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
        StanceUnreachableError: If the stance is unreachable. The error contains the foot errors [m]
            and the requirements to relax.
    """
    if start is not None:
        config = Configuration(robot, start.qpos if isinstance(start, Posed) else start)
        seed = config.qpos[robot.nq - robot.nu :]
        task = replace(task or StandTask(), ik_seed=tuple(seed.tolist()))
    owner, robot = robot, _select_robot(robot, task)
    with borrow(robot, SearchContext) as context:
        stand = solve_targets(context, compute_targets(robot, task, {}), explain=explain)
    return attach_robot(stand, owner)


def resolve_stance(robot: Robot, stance: StandTask | Stand) -> tuple[Robot, Stand]:
    """Solve a stance if it is a task, and return the stand with the robot that has its contacts.

    Returns:
        Robot with the contacts of the stance; stand of this robot.

    Raises:
        ConfigurationError: If a stand belongs to another robot, or no stand can satisfy a task.
        UnknownNameError: If a task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
        StanceUnreachableError: If a task is unreachable.
    """
    stand = stance if isinstance(stance, Stand) else solve_stand(robot, stance)
    return stand.check(robot), stand


def _select_robot(robot: Robot, task: StandTask | None) -> Robot:
    """Return the robot for the search of a stand, with the contacts of the task.

    Without contacts `Robot.before_servos`, since stands do not depend on servos.
    """
    if task is not None and task.contacts:
        return with_contacts(robot, task.contacts)
    return robot.before_servos


def solve_targets(context: SearchContext, targets: StandTargets, *, explain: bool) -> Stand:
    """Search for a stand that meets the targets; if none is found, raise an error with the reason.

    Args:
        context: Search context of the robot.
        targets: Targets and limits of the stand (`StandTargets`).
        explain: Whether the error about unreachable targets contains the smallest foot error, and
            the smallest change of requirements that makes the stance reachable.

    Raises:
        StanceUnreachableError: If no stand meets the targets.
        ConfigurationError: If the task requires a clearance that does not exist, for example
            because the model has no ground.
    """
    stand = search_stand(context, targets)
    if stand.solved:
        return stand
    if explain and stand.foot_error >= TASK_TOLERANCE:
        closest = minimise_foot_errors(context, targets, stand.qpos, stand.iterations)
        stand = min(stand, closest, key=lambda failure: failure.foot_error)
    raise explain_refusal(context, targets, stand, explain=explain)


@check_arguments
def stand_statics(
    robot: Robot,
    stand: Stand,
    *,
    distribution: ForceDistribution | str = ForceDistribution.MIN_TANGENTIAL,
) -> GravityCompensation:
    """Compute joint torques [N m] and contact forces [N] that balance gravity in a stand.

    Args:
        robot: Robot.
        stand: Stand.
        distribution: Criterion that selects the contact forces among the feasible forces. Default:
            minimum tangential forces.

    Raises:
        ConfigurationError: If the stand belongs to another robot, or the friction of the ground is
            unknown, for example.
        UnknownNameError: If the robot lacks the foot or frame of a contact of the task.
        ModelError: If the model with the contacts of the task cannot be built.
        StaticsInfeasibleError: If no contact forces balance the stand: for example, the robot
            slides or tips.
    """
    robot, distribution = stand.check(robot), to_distribution(distribution)

    def compute() -> GravityCompensation:
        """Compute the statics of the stand, without its cache."""
        config, carrying = Configuration(robot, stand.qpos), stand_contacts(robot, stand)
        return balance_load(config, config.static_load(), carrying, distribution=distribution)

    return stand.cached_statics(robot, distribution, compute)


def stand_contacts(robot: Robot, stand: Stand) -> Contacts:
    """Return the contacts of a stand's stance feet, with ground normals and penetrations [m]."""
    level = all(normal.tolist() == _UP for normal in stand.normals.values())
    normals, depths = None if level else stand.normals, stand.depths
    sunk = depths if any(depths.values()) else None
    return make_contacts(robot, stand.stance_feet, None, normals, sunk)


_MAX_JOINT_DISTANCE = 0.5
"""Upper bound of the norm of the joint displacement [rad and m mixed] between successive stands of
a sequence, with which both count as one IK branch. Chosen, not tuned; samples of a path are much
closer."""


_EXTRAPOLATION_WEIGHTS = {1: (1.0,), 2: (2.0, -1.0), 3: (3.0, -3.0, 1.0), 4: (4.0, -6.0, 4.0, -1.0)}
"""{number of previous stands of a sequence: weights of their configurations, latest first}. The sum
of the weighted configurations extrapolates a polynomial to the initial guess of the next stand.
Measured on a thousand stands of a smooth sequence: a parabola (3 stands) deviates by 3e-7 rad, and
PlaCo takes two steps; a cubic (4 stands) deviates by 4e-9 rad, and PlaCo takes one step."""


@check_arguments
def solve_stands(
    robot: Robot,
    tasks: Sequence[StandTask],
    *,
    explain: bool = False,
) -> tuple[Stand, ...]:
    """Solve a sequence of stand tasks, faster than one by one if successive tasks are similar.

    A search starts at an extrapolation of up to four previous stands, then at the previous stand.
    If neither leads to a stand near the previous stand, the task is solved as by `solve_stand`.
    Tasks whose result depends on the initial guess, for example with a free CoM or redundant
    joints, are always solved as by `solve_stand`.

    Args:
        robot: Robot with a floating base.
        tasks: Stand tasks. The ``contacts`` must be at the same parts, and have the same friction
            and forces, as in the first task; surfaces and positions may differ.
        explain: Whether the error about an unreachable task contains the smallest foot error, and
            the smallest change of requirements that makes the task reachable; takes about a second.

    Returns:
        The stands, in the order of the tasks.

    Raises:
        ConfigurationError: If no stand can satisfy a task: for example, the base is fixed, the
            robot has no feet, or the margins are too large; usually with the index of the task.
        UnknownNameError: If a task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
        StanceUnreachableError: For the first unreachable task, with the task index.
    """
    all_targets: list[StandTargets] = []
    solved: list[Stand] = []
    owner, robot = robot, _select_robot(robot, tasks[0] if tasks else None)
    for number, task in enumerate(tasks):
        try:  # equal foot targets are reused from the previous stand
            all_targets.append(
                compute_targets(robot, task, {}, all_targets[-1] if all_targets else None)
            )
        except (ConfigurationError, UnknownNameError) as error:
            raise error.with_location(f"tasks[{number}]") from None
    with borrow(robot, SearchContext) as context:
        for number, targets in enumerate(all_targets):
            next_stand = _continue_sequence(
                context, targets, [stand.qpos for stand in solved[:-5:-1]]
            )
            try:
                solved.append(next_stand or solve_targets(context, targets, explain=explain))
            except StanceUnreachableError as error:
                raise error.with_location(f"tasks[{number}]") from None
    return tuple(attach_robot(stand, owner) for stand in solved)


def _continue_sequence(
    context: SearchContext, targets: StandTargets, before: Sequence[Array]
) -> Stand | None:
    """Search for the next stand of a sequence near the previous stands; None if not found.

    None also if the stand may depend on the initial guess. ``before`` contains configurations (nq,)
    of up to four previous stands, the latest first.
    """
    if not before or has_redundant_joints(context.robot) or _depends_on_start(targets):
        return None
    weights, last = _EXTRAPOLATION_WEIGHTS[len(before)], before[0]
    ahead = weights[0] * last
    for weight, qpos in zip(weights[1:], before[1:], strict=True):
        ahead += weight * qpos
    for start in (
        (ahead, last) if _measure_joint_distance(ahead, last) < _MAX_JOINT_DISTANCE else (last,)
    ):
        stand = search_from_configuration(context, targets, start)
        if stand is not None and _measure_joint_distance(stand.qpos, last) < _MAX_JOINT_DISTANCE:
            return stand
    return None


def _depends_on_start(targets: StandTargets) -> bool:
    """Return True if different initial guesses may give different stands in one IK branch."""
    task = targets.task
    return task.ik_seed is not None or task.self_clearance is not None or targets.com_is_free


def _measure_joint_distance(first: Array, second: Array) -> float:
    """Return the norm of the joint displacement between two configurations, (nq,) each [rad, m]."""
    between = (first - second)[7:]
    return math.sqrt(between.dot(between))
