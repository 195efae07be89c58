"""Gravity compensation of many states of one robot at once: of a path, or of a sweep."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, real_array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, StaticsInfeasibleError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE, minimum_tangential_forces
from pupper_analysis.statics.contacts import Contacts, make_contacts
from pupper_analysis.statics.equilibrium import (
    ForceDistribution,
    check_loops,
    gravity_compensation,
    sliding_share,
    to_distribution,
    utilise,
)
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GravityCompensations(Result):
    """The static equilibria of a robot in k states; not a number where there is none.

    Attributes:
        joint_names: Names of the joints, in actuator order.
        feet: The n feet that carry.
        joint_torques: (k, nu) what the motors hold (N m).
        motor_utilisation: (k, nu) torque / effort limit, absolute.
        contact_forces: (k, n, 3) force of the ground on each foot, in world axes (N).
        contact_points: (k, n, 3) where it acts, in the world (m).
        friction_utilisation: (k, n) tangential force / (friction coefficient x normal force).
        base_wrench: (k, 6) what holds the base from outside, as in ``GravityCompensation``.
        center_of_mass: (k, 3) in the world (m).
        com_margin: (k,) of its projection from the edge of the support polygon (m), also where the
            robot is not in balance; not a number without contacts.
        residual_force: (k,) norm of what is left of the balance of forces (N).
        residual_torque: (k,) of moments and joint torques (N m).
        infeasible: {state: why no forces do}, numbered from 0.
    """

    joint_names: tuple[str, ...]
    feet: tuple[str, ...]
    joint_torques: Array
    motor_utilisation: Array
    contact_forces: Array
    contact_points: Array
    friction_utilisation: Array
    base_wrench: Array
    center_of_mass: Array
    com_margin: Array
    residual_force: Array
    residual_torque: Array
    infeasible: dict[int, Diagnostic]


@check_arguments
def gravity_compensations(
    robot: Robot,
    qpos: ArrayLike,
    contacts: Iterable[str] | None = None,
    *,
    friction: float | Mapping[str, float] | None = None,
    normals: Mapping[str, ArrayLike] | None = None,
    depths: Mapping[str, float] | None = None,
    distribution: ForceDistribution | str = ForceDistribution.MIN_TANGENTIAL,
    keep_going: bool = False,
) -> GravityCompensations:
    """Computes motor torques and contact forces that hold a robot still, in many states.

    They are those of ``gravity_compensation``, to rounding, in arrays: on level ground with minimum
    tangential forces inside all friction cones in one go, otherwise one by one.

    Args:
        robot: The robot.
        qpos: (k, nq) the states, such as a path's ``qpos``.
        contacts: The feet that carry, in all states; as in ``gravity_compensation``, like the next
            four.
        friction: Likewise.
        normals: Likewise.
        depths: Likewise.
        distribution: Likewise.
        keep_going: Where no forces do, say so in ``infeasible``, and go on; otherwise it is raised.

    Raises:
        UnknownNameError: As ``gravity_compensation``.
        ConfigurationError: Likewise; or if a state is none, naming it.
        StaticsInfeasibleError: Without ``keep_going``, for the first state that no forces hold;
            ``where`` tells which.
    """
    wanted = to_distribution(distribution)
    carrying = make_contacts(robot, contacts, friction, normals, depths)
    states = _States.of(robot, carrying, _rows(robot, qpos))
    count, base_rows = len(states.qpos), robot.nv - robot.nu
    size = 3 * len(carrying.feet)
    forces, found = np.zeros((count, size)), np.full(count, not size)
    # Alone it is checked whether a robot's loops are closed.
    at_once = carrying.level and robot.closure is None
    if count and size and wanted is ForceDistribution.MIN_TANGENTIAL and at_once:
        forces, found = minimum_tangential_forces(
            states.transposed[:, :base_rows],
            states.loads[:, :base_rows],
            carrying.normals,
            carrying.friction,
        )
    infeasible: dict[int, Diagnostic] = {}
    for state in np.flatnonzero(~found).tolist():
        try:
            alone = gravity_compensation(
                Configuration(robot, states.qpos[state]),
                carrying.feet,
                friction=friction,
                normals=normals,
                depths=depths,
                distribution=wanted,
            )
        except StaticsInfeasibleError as error:
            if not keep_going:
                raise error.at(diagnose("state-number", state=state)) from None
            infeasible[state] = error.diagnostic
            forces[state] = np.nan
        else:
            forces[state] = np.concatenate([alone.contact_forces[foot] for foot in carrying.feet])
    return _results(robot, carrying, states, forces, infeasible)


def _rows(robot: Robot, qpos: ArrayLike) -> Array:
    rows = real_array("qpos", qpos)
    if rows.ndim != 2 or rows.shape[1] != robot.nq:
        wanted = f"(k, {robot.nq})"
        problem = diagnose("shape-not-valid", wanted=wanted, given=str(rows.shape))
        raise ConfigurationError("qpos", problem)
    return rows


@dataclass(frozen=True, eq=False)
class _States:
    """What balance needs to know of k states: all that is kept of a configuration.

    Attributes:
        qpos: (k, nq) the states.
        loads: (k, nv) what motors and contacts hold.
        transposed: (k, nv, 3 n) the contacts' J^T.
        points: (k, n, 3) where the contacts are (m).
        coms: (k, 3) centres of mass (m).
    """

    qpos: Array
    loads: Array
    transposed: Array
    points: Array
    coms: Array

    @staticmethod
    def of(robot: Robot, carrying: Contacts, rows: Array) -> _States:
        """Works it out.

        Raises:
            ConfigurationError: If one of the rows (k, nq) is no state; it says which.
        """
        count, feet = len(rows), len(carrying.feet)
        states = _States(
            qpos=rows,
            loads=np.empty((count, robot.nv)),
            transposed=np.empty((count, robot.nv, 3 * feet)),
            points=np.empty((count, feet, 3)),
            coms=np.empty((count, 3)),
        )
        for state, row in enumerate(rows):
            try:
                config = Configuration(robot, row)
            except ConfigurationError as error:
                raise error.at(diagnose("state-number", state=state)) from None
            if not feet:
                check_loops(config, config.load())
            states.loads[state] = config.by_motors(config.load())
            states.coms[state] = config.center_of_mass()
            if feet:
                states.transposed[state] = config.by_motors(carrying.jacobian(config))
                states.points[state] = carrying.points(config)
        return states


def _results(
    robot: Robot,
    carrying: Contacts,
    states: _States,
    forces: Array,
    infeasible: dict[int, Diagnostic],
) -> GravityCompensations:
    """Puts the results together.

    Args:
        robot: The robot.
        carrying: The contacts.
        states: The k states.
        forces: (k, 3 n) of the contacts.
        infeasible: See ``GravityCompensations``.
    """
    feet = carrying.feet
    base_rows = robot.nv - robot.nu
    per_foot = forces.reshape(states.points.shape)
    left = states.loads - (states.transposed @ forces[:, :, None])[..., 0]
    torques = left[:, base_rows:].copy()
    outside = left[:, :base_rows] if not feet else np.zeros_like(left[:, :base_rows])
    unbalanced = left[:, :base_rows] - outside
    utilisation = utilise(robot, torques)
    if robot.closure is not None:
        utilisation[:, robot.closure.following] = 0.0
    tiny = BALANCE_TOLERANCE * np.linalg.norm(states.loads[:, :3], axis=1)
    contacts = list(zip(carrying.normals.tolist(), carrying.friction.tolist(), strict=True))
    sliding = [
        [
            sliding_share(force, normal, friction, least)
            for force, (normal, friction) in zip(state.tolist(), contacts, strict=True)
        ]
        for state, least in zip(per_foot, tiny.tolist(), strict=True)
    ]
    margins = [
        com_margin(com, dict(zip(feet, places, strict=True))) if feet else np.nan
        for com, places in zip(states.coms, states.points, strict=True)
    ]
    return GravityCompensations(
        joint_names=robot.joint_names,
        feet=feet,
        joint_torques=torques,
        motor_utilisation=utilisation,
        contact_forces=per_foot,
        contact_points=states.points,
        friction_utilisation=np.array(sliding).reshape(per_foot.shape[:2]),
        base_wrench=outside,
        center_of_mass=states.coms,
        com_margin=np.array(margins, dtype=float),
        residual_force=np.linalg.norm(unbalanced[:, :3], axis=1),
        residual_torque=np.linalg.norm(unbalanced[:, 3:], axis=1),
        infeasible=infeasible,
    )
