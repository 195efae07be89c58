"""What a stance can carry, and whether it does in the simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import ArrayLike

from pupper_analysis.results import Result
from pupper_analysis.robot.as_published import ServosUsed
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos_used
from pupper_analysis.robot.tool import Place, find_tool
from pupper_analysis.simulation.payload import (
    Buckling,
    PayloadTrial,
    payload_buckling,
    simulate_payload,
)
from pupper_analysis.stance.payload.limit import PayloadLimit, payload_limit
from pupper_analysis.stance.payload.servo_limit import Failure
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask

TRIED = 0.95
"""The part of the payload's limit with which the loaded robot is simulated: below it, as no servo,
floor or hand is exact to a percent."""


FINE = 0.02
"""To what part a mass is found that bears nudges, where that of the equilibrium does not."""

NEAR = (0.8, 0.95, 1.0, 1.05, 1.2)
"""Parts of the servos' limit for which it is told how fast the stand buckles: friction that creeps
leaves no sharp edge there."""


@dataclass(frozen=True, eq=False)
class LoadedStance(Result):
    """The greatest payload of a stance, and the simulation of almost that.

    Attributes:
        name: The robot's name.
        stand: The solved stand, without payload.
        payload: The greatest mass in equilibrium.
        mass: The greatest that bears nudges, too: that of ``payload``, or less where ``TRIED`` of
            that falls (kg).
        trial: The simulation with ``TRIED`` of ``mass`` on the robot; None where that is nothing,
            or without limit.
        fell: The simulation with ``TRIED`` of the ``payload`` where a nudge made it fall; None
            where it did not.
        buckling: How fast it buckles with ``NEAR`` of what the servos' stiffness holds; empty where
            something else gives way there.
        servos: The servos that all are of.
        converted: Which of the robot's models was made of the other one, if one was.
    """

    name: str
    stand: Stand
    payload: PayloadLimit
    mass: float
    trial: PayloadTrial | None
    fell: PayloadTrial | None
    buckling: tuple[Buckling, ...]
    servos: ServosUsed
    converted: str = ""

    @property
    def passed(self) -> bool:
        """Whether it carries anything, and stays up with it."""
        return self.mass > 0 and (self.trial is None or self.trial.held)


def study_payload(
    robot: Robot,
    task: StandTask,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> LoadedStance:
    """Solves a stance, and finds out what it can carry.

    Args:
        robot: The robot.
        task: The stance.
        point: Where the payload is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        StanceUnreachableError: If it is out of reach.
        StaticsInfeasibleError: If it is reached, but slides or tips without payload.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    stand = solve_stand(robot, task)
    return try_payload(robot, stand, payload_limit(robot, stand, point, kp=kp, kd=kd), kp=kp, kd=kd)


def try_payload(
    robot: Robot,
    stand: Stand,
    payload: PayloadLimit,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> LoadedStance:
    """Simulates a stand with almost the greatest payload; see ``study_payload``."""
    mass, trial, fell = payload.mass, None, None
    point = find_tool(robot, payload.link).moved(payload.point)
    if 0 < mass < math.inf:

        def tried(mass: float) -> PayloadTrial:
            return simulate_payload(robot, stand, TRIED * mass, point, kp=kp, kd=kd)

        trial = tried(mass)
        if not trial.held:
            fell, (mass, trial) = trial, _bisected(tried, trial, mass)
    buckling: tuple[Buckling, ...] = ()
    if payload.servos.failure is Failure.BUCKLING and payload.servos.mass > 0:
        masses = (share * payload.servos.mass for share in NEAR)
        buckling = tuple(
            payload_buckling(robot, stand, mass, point, kp=kp, kd=kd) for mass in masses
        )
    used = servos_used(robot, kp, kd)
    made = robot.description.converted
    return LoadedStance(robot.name, stand, payload, mass, trial, fell, buckling, used, made)


def _bisected(
    tried: Callable[[float], PayloadTrial], trial: PayloadTrial, high: float
) -> tuple[float, PayloadTrial]:
    """Returns the greatest mass (kg) whose trial holds, to ``FINE``, and that trial.

    What equilibria say is exact for a stand that is let alone; how far a nudge takes feet that
    lift, soles that pivot and motors that saturate, simulation alone tells.

    Args:
        tried: Makes a mass's trial.
        trial: That of ``high``, which falls.
        high: A mass.
    """
    low, least = 0.0, FINE * high
    while high - low > least:
        middle = (low + high) / 2
        found = tried(middle)
        if found.held:
            low, trial = middle, found
        else:
            high, trial = middle, trial if low else found
    return low, trial
