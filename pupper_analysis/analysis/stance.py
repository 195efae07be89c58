"""All that is found out about one stance."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import (
    NoEquilibriumError,
    NoStiffnessError,
    StanceUnreachableError,
)
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.payload import PayloadTrial, payload_trial
from pupper_analysis.simulation.push import PushRecovery, push_recovery
from pupper_analysis.simulation.tracking import PathTracking, track_path
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.optimize.best import BestStance, best_stance
from pupper_analysis.stance.optimize.search import Objective
from pupper_analysis.stance.path.stance_path import StancePath, stance_path
from pupper_analysis.stance.payload.limit import PayloadLimit, payload_limit
from pupper_analysis.stance.sag.steady_state import (
    SteadyState,
    minimum_stiffness,
    steady_state,
)
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.sunk import sunk_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.workspace import BaseWorkspace, base_workspace
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]

TRIED = 0.95
"""The part of the payload's limit with which the loaded robot is simulated: below it, as no servo,
floor or hand is exact to a percent."""


@dataclass(frozen=True, eq=False)
class Stance(Result):
    """A stance, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        joint_positions: (nu,) of ``sunk``, or else of ``stand``, in actuator order (rad).
        limits: (nu,) of the motors' torques (N m).
        stand: The solved stand.
        statics: Torques and contact forces of ``sunk``, or else of ``stand``: those that last.
        minimum_peak: The same of least peak motor utilisation.
        point: Where the payload is, in the base's frame (m).
        payload: The greatest mass there.
        trial: The simulation with ``TRIED`` of that mass on the robot; None if there is no such.
        sunk: The stance with its feet sunk into MuJoCo's ground; None where that is out of reach.
        verification: The simulation, with feed-forward, of ``sunk``, or else of ``stand``.
        settled: Where it settles without feed-forward; None where that is not predicted.
        unsettled: Why ``settled`` is None.
        best: How it was found, if the best stance was asked for.
        minimum_stiffness: Of the servos that carry it without feed-forward (N m/rad), if asked
            for; None also if none do.
        workspace: How far the base can go, if asked for.
        path: From the nominal stand to it, if asked for.
        tracking: The simulation of ``path``.
        push: The largest pushes it survives, if asked for.
    """

    name: str
    joint_positions: Array
    limits: Array
    stand: Stand
    statics: GravityCompensation
    minimum_peak: GravityCompensation
    point: tuple[float, float, float]
    payload: PayloadLimit
    trial: PayloadTrial | None
    sunk: Stand | None
    verification: StandVerification
    settled: SteadyState | None
    unsettled: str
    best: BestStance | None
    minimum_stiffness: float | None
    workspace: BaseWorkspace | None
    path: StancePath | None
    tracking: PathTracking | None
    push: PushRecovery | None

    @property
    def overloaded(self) -> tuple[str, ...]:
        """Motors above their limits with the contact forces that last, without any payload."""
        used = zip(self.statics.joint_names, self.statics.motor_utilisation, strict=True)
        return tuple(name for name, share in used if share > 1)

    @property
    def passed(self) -> bool:
        """Whether it holds, and the path to it is tracked."""
        return self.verification.passed and (self.tracking is None or self.tracking.passed)


def study(
    robot: Robot,
    task: StandTask,
    *,
    kp: float | None = None,
    kd: float | None = None,
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    objective: Objective | None = None,
    softest: bool = False,
    workspace: bool = False,
    seconds: float | None = None,
    push: bool = False,
) -> Stance:
    """Solves a stance, and finds out what it costs and whether it holds.

    Args:
        robot: The robot.
        task: The stance.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        point: Where a payload is, in the base's frame (m).
        objective: Search for the best stance in this, from the task on (some seconds).
        softest: Also find the softest servos that carry it without feed-forward.
        workspace: Also find how far the base can go from there (a second or two).
        seconds: Also move there from the nominal stand, in this time (s).
        push: Also push it (some seconds).

    Raises:
        StanceUnreachableError: If it is out of reach.
        StaticsInfeasibleError: If it is reached, but slides or tips.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    best = None
    if objective is not None:
        best = best_stance(robot, objective, task=task, point=point, kp=kp)
    stand = solve_stand(robot, task) if best is None else best.stand
    payload = None if best is None else best.payload
    payload = payload or payload_limit(robot, stand, point, kp=kp)
    trial = None
    if 0 < payload.mass < math.inf:
        trial = payload_trial(robot, stand, TRIED * payload.mass, point, kp=kp, kd=kd)
    settled, unsettled, sunk, softness = None, "", None, None
    try:
        settled = steady_state(robot, stand, kp=kp)
    except NoEquilibriumError as error:
        unsettled = str(error)
    with contextlib.suppress(NoStiffnessError):
        softness = minimum_stiffness(robot, stand) if softest else None
    with contextlib.suppress(StanceUnreachableError):
        sunk = sunk_stand(robot, stand.task, explain=False)
    held = sunk or stand
    path = None if seconds is None else stance_path(robot, way_to(robot, stand), seconds)
    return Stance(
        name=robot.name,
        joint_positions=held.joint_positions(robot),
        limits=robot.effort_limits,
        stand=stand,
        statics=stand_statics(robot, held),
        minimum_peak=stand_statics(robot, held, distribution=ForceDistribution.MIN_PEAK),
        point=point,
        payload=payload,
        trial=trial,
        sunk=sunk,
        verification=verify_stand(robot, held, kp=kp, kd=kd),
        settled=settled,
        unsettled=unsettled,
        best=best,
        minimum_stiffness=softness,
        workspace=base_workspace(robot, stand.task) if workspace else None,
        path=path,
        tracking=None if path is None else track_path(robot, path, kp=kp, kd=kd),
        push=push_recovery(robot, held, kp=kp, kd=kd) if push else None,
    )


def way_to(robot: Robot, stand: Stand) -> list[StandTask]:
    """Returns the stances that lead to a stand: the nominal one, with its feet where they are.

    Where a foot is lifted, the weight is first shifted on to the others.
    """
    task = stand.task
    x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
    over = replace(task, com=(float(x), float(y)), com_margin=0.0, offset=None)
    nominal = StandTask(
        feet=task.feet, foot_offsets=task.foot_offsets, ground=task.ground, ik_seed=task.ik_seed
    )
    return [nominal, *([replace(over, swing={})] if task.swing else []), over]
