"""Stands on MuJoCo's soft ground: the feet sink by what they carry, and the base stays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import NotSettlingError, StanceUnreachableError
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.tool import Place, with_payload
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.problem import make_goal
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import (
    Stand,
    solve_goal,
    solve_stand,
    stand_statics,
)
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]


DEPTH_TOLERANCE = 1e-9
"""Change of the feet's depths between iterations that counts as none (m)."""


_MAX_ITERATIONS = 50

_STALLED = 8
"""Iterations in a row that change depths by no less than one before: a sole that is pressed at its
edge tilts ever further."""


@check_arguments
def solve_stand_on_soft_ground(
    robot: Robot, task: StandTask | Stand | None = None, *, explain: bool = True
) -> Stand:
    """Finds the stand that satisfies a task on ground as soft as MuJoCo's.

    On rigid ground only the feet's places count. MuJoCo's ground gives way by millimetres, in
    proportion to what a foot carries: a robot that is commanded the joints of ``solve_stand`` sinks
    and, where its feet bear unequal loads, tilts, by which the loads change too. Here the legs are
    longer by what their feet sink in, so that base and com are where the task has them, and the
    forces are the minimum-tangential ones. The depths and forces determine each other; repeated
    substitution finds them in 1 to 3 rounds.

    Args:
        robot: A robot with a floating base and a ground.
        task: How to stand; the nominal stand by default. Or a stand that satisfies a task on rigid
            ground, which is then not solved again.
        explain: Where the stance is out of reach, find out why.

    Returns:
        The stand; its ``depths`` are those of MuJoCo's contacts under its forces.

    Raises:
        ConfigurationError: As ``solve_stand``; or if the stand is another robot's.
        StanceUnreachableError: If it is out of reach, at least with its feet sunk.
        StaticsInfeasibleError: If no contact forces balance it.
        NotSettlingError: If the depths do not settle.
    """
    if isinstance(task, Stand):
        robot = task.check(robot)
        stand, task = task, task.task
    else:
        task = task or StandTask()
        robot = touching(robot, task.contacts)
        stand = solve_stand(robot, task, explain=explain)
    asked = stand.task
    if asked.com == "inside":
        x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
        task = replace(task, com=(float(x), float(y)), com_margin=0.0)
    laws = {foot: GroundLaw.of(robot, foot) for foot in stand.stance_feet}
    give = np.zeros(0 if robot.closure is None else 1)
    least, stalled = math.inf, 0
    for _ in range(_MAX_ITERATIONS):
        held = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
        depths = {
            foot: law.depth(max(0.0, float(held.contact_forces[foot] @ stand.normals[foot])))
            for foot, law in laws.items()
        }
        depths |= _as_soles(robot, stand, depths)
        change = max([abs(depths[foot] - stand.depths[foot]) for foot in depths], default=0.0)
        if robot.closure is not None:
            before, give = give, open_loops(robot, stand, held)
            change = max(change, float(np.abs(give - before).max(initial=0.0)))
            # They are the softer the less they are open: by turns too much and too little.
            give = (give + before) / 2 if any(stand.depths.values()) else give
        if change < DEPTH_TOLERANCE:
            return stand.for_task(asked)
        least, stalled = min(least, change), stalled + 1 if change >= least else 0
        if stalled == _STALLED:
            break
        ik_seed = tuple(stand.joint_positions(robot).tolist())
        goal = make_goal(robot, replace(task, ik_seed=ik_seed), depths)
        goal = goal if robot.closure is None else replace(goal, give=give)
        with lend(robot, SearchContext) as context:
            stand = solve_goal(context, goal, explain=explain)
    left = diagnose("depths-do-not-settle", change=Quantity(change, "m"))
    raise NotSettlingError(change, left)


@check_arguments
def solve_stand_as_simulated(robot: Robot, task: StandTask | Stand | None = None) -> Stand:
    """Finds the stand that a task means wherever it is shown, pushed, loaded or simulated.

    That is ``solve_stand_on_soft_ground``'s, which MuJoCo holds as predicted; or, where the legs do
    not reach down so far, or the ground does not settle under soft loops, the one on rigid ground,
    without ``depths``. Of a posture (``held_stand``) the loops give way.

    Args:
        robot: A robot with a floating base and a ground.
        task: How to stand; the nominal stand by default. Or a stand that satisfies a task on rigid
            ground.

    Raises:
        ConfigurationError: As ``solve_stand``.
        StanceUnreachableError: If it is out of reach on rigid ground; not explained.
        StaticsInfeasibleError: If no contact forces balance it.
        NotSettlingError: If the depths do not settle, of a robot without loops.
    """
    stand = task if isinstance(task, Stand) else solve_stand(robot, task, explain=False)
    if not stand.check(robot).floating:  # a posture
        return replace(stand, qpos=_with_give(robot, stand.qpos))
    try:
        return solve_stand_on_soft_ground(robot, stand, explain=False)
    except StanceUnreachableError:
        return stand
    except NotSettlingError:
        if robot.closure is None:
            raise
        return stand  # loops that are very soft open further and further: a simulation says so


def _with_give(robot: Robot, qpos: Array) -> Array:
    """Returns where joints that follow others are at rest (nu,): MuJoCo's couplings are soft."""
    closure = robot.closure
    if closure is None or not len(closure.following):
        return qpos
    give = closure.give(qpos, Configuration(robot, qpos).load())
    moving = np.isin(np.arange(robot.nu), closure.following).astype(float)
    opened = closure.closed(qpos, moving, give)
    return qpos if opened is None else opened


def solve_loaded_stand(
    robot: Robot, stance: StandTask | Stand, mass: float, point: Place
) -> tuple[Robot, Stand]:
    """Puts a payload on a robot, and finds how it stands with it.

    This is the one loaded stand: of ``payload_limit`` and its simulations as of ``stand
    --payload``. Whatever the task says is said of the loaded robot: its com, which by default is
    over the centre of the feet, so that the base moves from under the load.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task.
        mass: Of the payload (kg).
        point: Where it is, as in ``with_payload``.

    Returns:
        The loaded robot, and its stand as simulated (``solve_stand_as_simulated``).

    Raises:
        ConfigurationError: If an argument makes no sense for the robot.
        StanceUnreachableError: If it is out of reach with that load; not explained.
        StaticsInfeasibleError: If no contact forces balance it.
        NotSettlingError: If the feet's depths do not settle.
    """
    loaded = with_payload(robot, mass, point)
    task = stance.task if isinstance(stance, Stand) else stance
    return loaded, solve_stand_as_simulated(loaded, task)


def open_loops(robot: Robot, stand: Stand, held: GravityCompensation) -> Array:
    """Returns by how much MuJoCo's loops and couplings of joints open in a stand.

    Args:
        robot: A robot with a ``closure``.
        stand: The stand.
        held: What holds it.

    Returns:
        (m,) for each equation of its constraints (m, rad).
    """
    assert robot.closure is not None
    config = Configuration(robot, stand.qpos)
    carrying = make_contacts(robot, stand.stance_feet, None, stand.normals, stand.depths)
    forces = (held.contact_forces[foot] for foot in stand.stance_feet)
    grips = len(held.weld_wrenches) - len(robot.grips)
    wrenches = [*held.weld_wrenches.values()]
    pushed = np.concatenate([*forces, *wrenches[:grips], *(one[:3] for one in wrenches[grips:])])
    left = config.load() - carrying.jacobian(config) @ pushed
    return robot.closure.give(stand.qpos, left[robot.nv - robot.nu :])


def _as_soles(robot: Robot, stand: Stand, depths: Mapping[str, float]) -> dict[str, float]:
    """Returns the depths of flat feet's contact points (m), which are on one body: a plane's.

    A sole is one body: it lies where the ground pushes against it with the force and the moment
    that it has to bear, however its points share them. A corner may lift: its depth is negative.
    """
    found: dict[str, float] = {}
    for foot in robot.feet_with(depths):
        points = robot.feet[foot]
        if len(points) > 1:
            places = np.array([stand.contact_points[point] for point in points])
            normal = stand.normals[points[0]]
            across = places - places.mean(axis=0)
            across -= np.outer(across @ normal, normal)
            table = np.column_stack([np.ones(len(points)), across / np.abs(across).max()])
            laws = [GroundLaw.of(robot, point) for point in points]
            given = [depths[point] for point in points]
            found |= dict(zip(points, _plane(table, laws, given).tolist(), strict=True))
    return found


def _plane(table: Array, laws: Sequence[GroundLaw], given: Sequence[float]) -> Array:
    """Returns the depths (n,) in a plane whose forces have the resultant of others.

    Their potential is convex: there is one root.

    Args:
        table: (n, 4) what a plane's numbers make of a sole's points: its height, its slopes.
        laws: (n,) of the ground under the points.
        given: (n,) depths in no plane (m).
    """

    def forces(depths: Array) -> Array:
        return np.array(
            [
                law.force(max(-law.margin, depth))
                for law, depth in zip(laws, depths.tolist(), strict=True)
            ]
        )

    from scipy import linalg, optimize  # slow to import

    basis = linalg.orth(table)  # points in a line have fewer than the table
    wanted, start = basis.T @ forces(np.array(given)), basis.T @ np.array(given)

    def left(place: Array) -> Array:
        return np.asarray(basis.T @ forces(basis @ place) - wanted)

    def rates(place: Array) -> Array:
        depths = (basis @ place).tolist()
        stiff = np.array([law.rate(d) for law, d in zip(laws, depths, strict=True)])
        return np.asarray(basis.T @ (stiff[:, None] * basis))

    depths: Array = basis @ optimize.root(left, start, jac=rates, options={"xtol": 1e-14}).x
    return depths
