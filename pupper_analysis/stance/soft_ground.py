"""Stands on MuJoCo's soft ground: feet penetrate under load, base and CoM keep their positions.

`solve_stand_on_soft_ground` extends the legs by the penetration depths [m]. Depths and contact
forces depend on each other. Therefore the function computes both in turn until the depths converge.
A sole stays a rigid body (`_fit_soles`). MuJoCo's soft closed loops also open under load
(`compute_loop_opening`). `solve_stand_as_simulated` returns the stand at which simulations of a
task start: on soft ground, or else on rigid ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pupper_analysis.base import lapack
from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import NotSettlingError, StanceUnreachableError
from pupper_analysis.base.minpack import find_root
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.tool import FramePoint, with_payload
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.judge import attach_robot
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import (
    Stand,
    solve_stand,
    solve_targets,
    stand_statics,
)
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

DEPTH_TOLERANCE = 1e-9
"""Largest change of a penetration depth or loop opening [m, rad] in an iteration, below which the
fixed-point iteration has converged. Chosen, not tuned."""


_MAX_ITERATIONS = 50
"""Upper bound of the fixed-point iterations between contact forces and penetration depths of the
feet. Chosen, not tuned."""

_MAX_STALLED_ITERATIONS = 8
"""Number of successive iterations without a new smallest change of depths and loop openings, after
which the fixed-point iteration fails. Example: a sole that is loaded at its edge tilts
further in each iteration. Chosen, not tuned."""

_MAX_PLAIN_RATIO = 0.5
"""Ratio [1] of the change in an iteration of the fixed point to the previous change of depths,
above which steps are scaled by a relaxation factor. Chosen, not tuned: with this ratio, the
iteration without relaxation needs 20 rounds from 1 mm to `DEPTH_TOLERANCE`."""

_RELAXATION_RANGE = 0.05, 1.0
"""Lower and upper bound of the factor [1] on a step of the fixed-point iteration for the feet's
penetration depths. Chosen, not tuned."""


@check_arguments
def solve_stand_on_soft_ground(
    robot: Robot, task: StandTask | Stand | None = None, *, explain: bool = True
) -> Stand:
    """Solve a stand task on MuJoCo's soft ground, with base and CoM at the required positions.

    MuJoCo's ground yields under the load of a foot, by 4 mm for Pupper v3. If a robot is commanded
    to the joint positions of `solve_stand`, it sinks. With unequal loads it also tilts. This
    function extends the legs by the penetration of the feet, so that base and CoM are at the
    positions of the task. The contact forces are those with minimum tangential components. Depths
    and forces depend on each other, and are computed by a fixed-point iteration.

    Args:
        robot: Robot with a floating base and a ground.
        task: Stand task, or a stand that satisfies a task on rigid ground. Default: the nominal
            stand, ``StandTask()``.
        explain: Whether the error about an unreachable stance contains the smallest foot error and
            the requirements to relax; takes about a second.

    Returns:
        The stand; ``depths`` are the penetrations [m] by MuJoCo's contact model under the computed
        forces.

    Raises:
        ConfigurationError: If no stand can satisfy the task: for example, the robot has no feet, or
            the margins are too large; or if the stand belongs to another robot.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
        StanceUnreachableError: If the stance is unreachable on rigid ground, or with the feet in
            the soft ground.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NotSettlingError: If the depths, or the openings of closed loops, do not converge; or if the
            contacts with the ground exert no force, because their ``solref`` is zero.
    """
    owner = robot
    if isinstance(task, Stand):
        robot = task.check(robot)
        stand, task = task, task.task
    else:
        task = task or StandTask()
        robot = with_contacts(robot, task.contacts)
        stand = solve_stand(robot, task, explain=explain)
    requested_task = stand.task
    if requested_task.com == "inside":
        x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
        task = replace(task, com=(float(x), float(y)), com_margin=0.0)
    laws = {foot: GroundLaw.of_contact(robot, foot) for foot in stand.stance_feet}
    loop_opening = np.zeros(0 if robot.closure is None else 1)
    least, stalled = math.inf, 0
    relaxation, last_residual = 1.0, np.zeros(0)
    for _ in range(_MAX_ITERATIONS):
        held = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
        depths = {
            foot: law.depth(max(0.0, float(held.contact_forces[foot] @ stand.normals[foot])))
            for foot, law in laws.items()
        }
        sinking = [foot for foot, depth in depths.items() if depth == math.inf]
        if sinking:
            raise NotSettlingError(math.inf, diagnose("ground-without-force", feet=sinking))
        depths |= _fit_soles(robot, stand, depths)
        residual = np.array([depths[foot] - stand.depths[foot] for foot in depths])
        change = float(np.abs(residual).max(initial=0.0))
        if robot.closure is not None:
            before, loop_opening = loop_opening, compute_loop_opening(robot, stand, held)
            change = max(change, float(np.abs(loop_opening - before).max(initial=0.0)))
            # The stiffness of loops increases with their opening, so steps would alternate.
            loop_opening = (
                (loop_opening + before) / 2 if any(stand.depths.values()) else loop_opening
            )
        if change < DEPTH_TOLERANCE:
            return attach_robot(stand.for_task(requested_task), owner)
        least, stalled = min(least, change), stalled + 1 if change >= least else 0
        if stalled == _MAX_STALLED_ITERATIONS:
            break
        slow = change > _MAX_PLAIN_RATIO * np.abs(last_residual).max(initial=0.0)
        if len(last_residual) and (slow or relaxation < 1):
            relaxation = _update_relaxation(relaxation, last_residual, residual)
        last_residual, steps = residual, (relaxation * residual).tolist()
        if relaxation < 1:
            depths = {
                foot: stand.depths[foot] + step for foot, step in zip(depths, steps, strict=True)
            }
        ik_seed = tuple(stand.joint_positions(robot).tolist())
        targets = compute_targets(robot, replace(task, ik_seed=ik_seed), depths)
        targets = targets if robot.closure is None else replace(targets, loop_opening=loop_opening)
        with borrow(robot, SearchContext) as context:
            stand = solve_targets(context, targets, explain=explain)
    left = diagnose("depths-do-not-settle", change=Quantity(change, "m"))
    raise NotSettlingError(change, left)


def _update_relaxation(relaxation: float, before: Array, residual: Array) -> float:
    """Compute the factor on the next step of the fixed-point iteration, by Aitken's method.

    The new factor is w' = -w r_before (r - r_before) / |r - r_before|^2, within
    `_RELAXATION_RANGE`. r (n,) [m] are the residuals (required changes of the depths), and w is the
    factor of the last step.

    Source: Kuettler and Wall, Fixed-point fluid-structure interaction solvers with dynamic
    relaxation, Computational Mechanics 43 (2008).
    """
    difference = residual - before
    squared = float(difference @ difference)
    if squared == 0:
        return relaxation
    return float(np.clip(-relaxation * (before @ difference) / squared, *_RELAXATION_RANGE))


@check_arguments
def solve_stand_as_simulated(robot: Robot, task: StandTask | Stand | None = None) -> Stand:
    """Solve a stand task as simulations use it: on soft ground if possible, else on rigid ground.

    The result is usually the stand of `solve_stand_on_soft_ground`. If the stance on soft ground is
    out of reach, for example, the result is the stand on rigid ground, with ``depths`` of 0. A
    posture of a robot with a fixed base (`held_stand`) has no ground: its closed loops and joint
    couplings are deflected as under the static load in MuJoCo.

    Args:
        robot: Robot with a floating base and a ground; for a posture, a robot with a fixed base.
        task: Stand task, or a stand that satisfies a task on rigid ground, or a posture. Default:
            the nominal stand, ``StandTask()``.

    Raises:
        ConfigurationError: If no stand can satisfy the task: for example, the robot has no feet, or
            the margins are too large; or if the stand belongs to another robot.
        UnknownNameError: If the task contains an unknown foot, joint or contact.
        ModelError: If the mass or inertia of a body is invalid, for example.
        StanceUnreachableError: If the stance is unreachable on rigid ground. The error does not
            contain the requirements to relax.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NotSettlingError: If the penetration depths of a robot without closed loops and joint
            couplings do not converge.
    """
    stand = task if isinstance(task, Stand) else solve_stand(robot, task, explain=False)
    if not stand.check(robot).floating:  # a posture
        return attach_robot(replace(stand, qpos=_deflect_couplings(robot, stand.qpos)), robot)
    try:
        return solve_stand_on_soft_ground(robot, stand, explain=False)
    except StanceUnreachableError:
        return stand
    except NotSettlingError:
        if robot.closure is None:
            raise
        return stand  # very soft loops; the simulation decides


def _deflect_couplings(robot: Robot, qpos: Array) -> Array:
    """Deflect loops of a posture (nu,) [rad, m] as MuJoCo does under static load, if possible."""
    closure = robot.closure
    if closure is None or not len(closure.dependent_joints):
        return qpos
    loop_opening = closure.static_deflection(qpos, Configuration(robot, qpos).static_load())
    moving = np.isin(np.arange(robot.nu), closure.dependent_joints).astype(float)
    opened = closure.close_loops(qpos, moving, loop_opening)
    return qpos if opened is None else opened


def solve_loaded_stand(
    robot: Robot, stance: StandTask | Stand, mass: float, point: FramePoint
) -> tuple[Robot, Stand]:
    """Add a payload to a robot, and solve a stand of the loaded robot.

    In the default task, the CoM of the loaded robot is above the centre of the feet, if the legs
    permit: the base is shifted.

    Args:
        robot: Robot.
        stance: Stand task, or a stand whose task is used.
        mass: Payload mass [kg].
        point: Position of the payload, shape (3,) [m] in the base frame. A position in the frame of
            a link, site, body or geom begins with its name: ``("right_hand", 0.0, 0.0, 0.05)``. A
            ``Tool`` is also accepted.

    Returns:
        The loaded robot, and its stand from `solve_stand_as_simulated`.

    Raises:
        ConfigurationError: If an argument is invalid for the robot.
        UnknownNameError: If the robot lacks the frame of the payload, or a foot, joint or contact
            of the task.
        ModelError: If the loaded model cannot be built, for example.
        StanceUnreachableError: If the stance is unreachable with that load. The error does not
            contain the requirements to relax.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NotSettlingError: If the penetration depths of a robot without closed loops and joint
            couplings do not converge.
    """
    loaded = with_payload(robot, mass, point)
    task = stance.task if isinstance(stance, Stand) else stance
    return loaded, solve_stand_as_simulated(loaded, task)


def compute_loop_opening(robot: Robot, stand: Stand, held: GravityCompensation) -> Array:
    """Compute how far MuJoCo's soft loop and coupling constraints open under the load of a stand.

    Args:
        robot: Robot with closed loops or joint couplings (``closure``).
        stand: Stand.
        held: Static contact forces and torques of the stand.

    Returns:
        Deflection in each equation of the loops and couplings, shape (m,) [m, rad].
    """
    assert robot.closure is not None
    config = Configuration(robot, stand.qpos)
    carrying = make_contacts(robot, stand.stance_feet, None, stand.normals, stand.depths)
    forces = (held.contact_forces[foot] for foot in stand.stance_feet)
    wrenches = [*held.weld_wrenches.values()]
    num_welds = len(wrenches) - len(robot.grips)  # grips come last, and bear no moment
    pushed = np.concatenate(
        [*forces, *wrenches[:num_welds], *(wrench[:3] for wrench in wrenches[num_welds:])]
    )
    left = config.static_load() - carrying.transposed_jacobian(config) @ pushed
    return robot.closure.static_deflection(stand.qpos, left[robot.nv - robot.nu :])


def _fit_soles(robot: Robot, stand: Stand, depths: Mapping[str, float]) -> dict[str, float]:
    """Compute {contact point: penetration [m]} of rigid soles from depths of independent points.

    Resultant force and moment of a sole are unchanged. The penetration of a lifted corner is
    negative.
    """
    sole_depths: dict[str, float] = {}
    for foot in robot.feet_with(depths):
        points = robot.feet[foot]
        if len(points) > 1:
            places = np.array([stand.contact_points[point] for point in points])
            normal = stand.normals[points[0]]
            across = places - places.mean(axis=0)
            across -= np.outer(across @ normal, normal)
            table = np.column_stack([np.ones(len(points)), across / np.abs(across).max()])
            laws = [GroundLaw.of_contact(robot, point) for point in points]
            given = [depths[point] for point in points]
            sole_depths |= dict(zip(points, _fit_plane(table, laws, given).tolist(), strict=True))
    return sole_depths


def _fit_plane(table: Array, laws: Sequence[GroundLaw], given: Sequence[float]) -> Array:
    """Compute the penetrations (n,) [m] of a rigid sole with the resultant of given penetrations.

    The resultant is the force and the moments of the contact forces. The potential of the forces is
    convex, so that all solutions give equal forces.

    Args:
        table: Row per contact point: 1 and the position in the sole's plane, normalised, shape (n,
            k). Penetrations of a rigid sole are linear combinations of the columns.
        laws: Force-penetration law of each contact point.
        given: Penetrations of independent contact points, shape (n,) [m].
    """

    def compute_forces(depths: Array) -> Array:
        """Return the normal forces (n,) [N] of the contact points at penetrations (n,) [m]."""
        return np.array(
            [
                law.force(max(-law.margin, depth))
                for law, depth in zip(laws, depths.tolist(), strict=True)
            ]
        )

    basis = lapack.orth(table)  # collinear points have a smaller basis
    wanted, start = basis.T @ compute_forces(np.array(given)), basis.T @ np.array(given)

    def residual(coefficients: Array) -> Array:
        """Return the error of force and moments on the sole, shape (k,) [N].

        ``coefficients`` (k,) [m] are the factors of the columns of ``basis``.
        """
        return np.asarray(basis.T @ compute_forces(basis @ coefficients) - wanted)

    def derivative(coefficients: Array) -> Array:
        """Return the Jacobian of ``residual`` by ``coefficients``, shape (k, k) [N/m]."""
        depths = (basis @ coefficients).tolist()
        stiff = np.array([law.normal_stiffness(d) for law, d in zip(laws, depths, strict=True)])
        return np.asarray(basis.T @ (stiff[:, None] * basis))

    depths: Array = basis @ find_root(residual, start, derivative, xtol=1e-14)
    return depths
