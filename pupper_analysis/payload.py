"""How much a standing robot can carry, and what gives way first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pupper_analysis.configuration import Configuration
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.stand import Stand, stand_statics

Array = NDArray[np.float64]

UNLIMITED = 1e4
"""A payload above this many times the robot's mass is as good as unlimited."""


class Failure(StrEnum):
    """What gives way first when the payload grows."""

    MOTOR = "a motor saturates"
    SLIDING = "a foot slides"
    TIPPING = "the robot tips"
    NOTHING = "nothing, up to 10 000 times the robot's mass"


@dataclass(frozen=True, eq=False)
class PayloadLimit(Result):
    """The greatest mass that a stand can carry at a point of its base.

    Attributes:
        mass: kg.
        point: (3,) where it is attached, in the base's frame (m).
        failure: What gives way first.
        where: The motor that saturates, or the feet that slide or lift off.
        by: {failure: the greatest mass if nothing else could give way (kg; infinite if none)}.
        joint_torques: (nu,) at the limit (N m).
        contact_forces: {foot: (3,)} at the limit, in world axes (N).
    """

    mass: float
    point: Array
    failure: Failure
    where: tuple[str, ...]
    by: dict[str, float]
    joint_torques: Array
    contact_forces: dict[str, Array]


def payload_limit(
    robot: Robot, stand: Stand, point: Sequence[float] = (0.0, 0.0, 0.0)
) -> PayloadLimit:
    """Finds the greatest point mass that a robot can carry in a stand.

    With the mass m at a point whose Jacobian is J_p, balance means
    g + m |g| J_p^T e_z = J^T f + S^T tau. The greatest m for which some contact forces inside the
    friction cones and some torques inside the effort limits give it is a second-order cone
    programme in (f, m). What gives way first is the kind of limit without which m could be greater:
    motors, friction, or, if neither, that no foot can pull.

    Args:
        robot: The robot.
        stand: How it stands.
        point: Where the mass is, in the base's frame (m).

    Returns:
        The limit.

    Raises:
        ConfigurationError: If the point is none.
        StaticsInfeasibleError: If the stand cannot be held without payload.
    """
    try:
        place = np.array(point, dtype=float)
    except (TypeError, ValueError):
        place = np.zeros(0)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ConfigurationError("point", f"{point!r} is not a point (3,)")
    held = stand_statics(robot, stand)
    problem = _problem(robot, stand, place)
    best = problem.solve(motors=True, friction=True)
    if not best.held:  # the motors are too weak without any payload
        forces = np.concatenate([held.contact_forces[foot] for foot in stand.carrying])
        best = _Outcome(0.0, held.joint_torques, forces, held=False)
    by = {
        Failure.MOTOR: problem.solve(motors=True, friction=False, unilateral=False).mass,
        Failure.SLIDING: problem.solve(motors=False, friction=True).mass,
        Failure.TIPPING: problem.solve(motors=False, friction=False).mass,
    }
    ceiling = UNLIMITED * robot.total_mass
    failure, where = Failure.NOTHING, tuple[str, ...]()
    if best.mass < 0.999 * ceiling:
        failure = _first(problem, best.mass)
        where = _where(robot, stand, best, failure)
    return PayloadLimit(
        mass=best.mass,
        point=place,
        failure=failure,
        where=where,
        by={kind.value: mass if mass < 0.999 * ceiling else np.inf for kind, mass in by.items()},
        joint_torques=best.torques,
        contact_forces=dict(zip(stand.carrying, best.forces.reshape(-1, 3), strict=True)),
    )


@dataclass(frozen=True, eq=False)
class _Outcome:
    mass: float
    torques: Array
    forces: Array
    held: bool = True


@dataclass(frozen=True, eq=False)
class _Problem:
    """Rows of the balance: gravity + mass * load = contacts f + S^T tau.

    Attributes:
        gravity: (nv,).
        load: (nv,) of one kilogram.
        contacts: (nv, 3 n).
        normals: (n, 3).
        friction: (n,).
        limits: (nu,) effort limits.
        ceiling: Greatest mass looked for (kg).
    """

    gravity: Array
    load: Array
    contacts: Array
    normals: Array
    friction: Array
    limits: Array
    ceiling: float

    def solve(self, *, motors: bool, friction: bool, unilateral: bool = True) -> _Outcome:
        """Maximises the mass; friction=False means that no foot can slide.

        Where not even no mass can be held, the outcome's torques and forces mean nothing.
        """
        n, nu = len(self.normals), len(self.limits)
        base = len(self.gravity) - nu
        weight = float(np.abs(self.gravity).max())
        # Variables: f / weight (3 n), and the mass in kg.
        size = 3 * n + 1
        equal = np.column_stack([self.contacts[:base], -self.load[:base] / weight])
        blocks, bounds, cones = [equal], [self.gravity[:base] / weight], [clarabel.ZeroConeT(base)]
        rows, right = [np.eye(1, size, size - 1)], [np.array([self.ceiling])]
        rows.append(-np.eye(1, size, size - 1))
        right.append(np.zeros(1))
        finite = np.isfinite(self.limits)
        if motors and finite.any():
            # tau = gravity + mass load - contacts f, inside +- limits
            torque = np.column_stack([-self.contacts[base:], self.load[base:] / weight])[finite]
            constant = self.gravity[base:][finite] / weight
            limit = self.limits[finite] / weight
            rows += [torque, -torque]
            right += [limit - constant, limit + constant]
        if unilateral and not friction:
            for index, normal in enumerate(self.normals):
                row = np.zeros((1, size))
                row[0, 3 * index : 3 * index + 3] = -normal
                rows.append(row)
                right.append(np.zeros(1))
        inequality = np.concatenate(rows)
        blocks.append(inequality)
        bounds.append(np.concatenate(right))
        cones.append(clarabel.NonnegativeConeT(len(inequality)))
        if unilateral and friction:
            for index, (normal, mu) in enumerate(zip(self.normals, self.friction, strict=True)):
                cone = np.zeros((4, size))
                cone[0, 3 * index : 3 * index + 3] = -mu * normal
                cone[1:, 3 * index : 3 * index + 3] = -(np.eye(3) - np.outer(normal, normal))
                blocks.append(cone)
                bounds.append(np.zeros(4))
                cones.append(clarabel.SecondOrderConeT(4))
        cost = np.zeros(size)
        cost[-1] = -1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        solution = clarabel.DefaultSolver(
            sparse.csc_matrix((size, size)),
            cost,
            sparse.csc_matrix(np.concatenate(blocks)),
            np.concatenate(bounds),
            cones,
            settings,
        ).solve()
        values = np.array(solution.x)
        infeasible = (
            clarabel.SolverStatus.PrimalInfeasible,
            clarabel.SolverStatus.AlmostPrimalInfeasible,
        )
        held = solution.status not in infeasible
        mass, forces = max(0.0, float(values[-1])) if held else 0.0, values[:-1] * weight
        torques = self.gravity[base:] + mass * self.load[base:] - self.contacts[base:] @ forces
        return _Outcome(mass, torques, forces, held)


def _problem(robot: Robot, stand: Stand, point: Array) -> _Problem:
    config = Configuration(robot, stand.qpos)
    strength = float(np.linalg.norm(robot.gravity))
    up = -robot.gravity / strength
    offset = config.base_rotation() @ point
    load = strength * up @ config.frame_jacobian(robot.base, offset)[:3]
    jacobians = []
    for foot in stand.carrying:
        arm = stand.contact_points[foot] - config.frame_position(robot.foot_frames[foot])
        jacobians.append(config.frame_jacobian(robot.foot_frames[foot], arm)[:3])
    return _Problem(
        gravity=config.gravity(),
        load=load,
        contacts=np.concatenate(jacobians).T,
        normals=np.array([stand.normals[foot] for foot in stand.carrying]),
        friction=np.array([robot.contacts[foot].sliding_friction for foot in stand.carrying]),
        limits=robot.effort_limits,
        ceiling=UNLIMITED * robot.total_mass,
    )


def _first(problem: _Problem, mass: float) -> Failure:
    """Returns the kind of limit without which more could be carried."""
    if problem.solve(motors=False, friction=True).mass > mass * (1 + 1e-4) + 1e-6:
        return Failure.MOTOR
    if problem.solve(motors=False, friction=False).mass > mass * (1 + 1e-4) + 1e-6:
        return Failure.SLIDING
    return Failure.TIPPING


def _where(robot: Robot, stand: Stand, outcome: _Outcome, failure: Failure) -> tuple[str, ...]:
    if failure is Failure.MOTOR:
        use = np.abs(outcome.torques) / robot.effort_limits
        return tuple(robot.joint_names[index] for index in np.flatnonzero(use > 1 - 1e-3))
    forces = dict(zip(stand.carrying, outcome.forces.reshape(-1, 3), strict=True))
    weight = max(float(np.linalg.norm(force)) for force in forces.values())
    feet = []
    for foot, force in forces.items():
        normal = float(force @ stand.normals[foot])
        tangential = float(np.linalg.norm(force - normal * stand.normals[foot]))
        if failure is Failure.TIPPING and normal < 1e-3 * weight:
            feet.append(foot)
        grip = robot.contacts[foot].sliding_friction * normal
        if failure is Failure.SLIDING and normal > 1e-3 * weight and tangential > 0.999 * grip:
            feet.append(foot)
    return tuple(feet)
