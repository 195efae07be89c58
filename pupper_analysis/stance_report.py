"""One stance of one robot: all that is found out about it, and how it is printed."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from pupper_analysis.envelope import PoseEnvelope, pose_envelope
from pupper_analysis.errors import NoEquilibriumError, StanceUnreachableError
from pupper_analysis.payload import PayloadLimit, payload_limit
from pupper_analysis.report import print_loads, titled_table
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.settle import SettledPose, settled_pose
from pupper_analysis.simulation import StandVerification, verify_stand
from pupper_analysis.sink import sunk_stand
from pupper_analysis.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics import GravityCompensation
from pupper_analysis.task import StandTask

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stance(Result):
    """A stance, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        joint_positions: (nu,) in actuator order (rad).
        limits: (nu,) of the motors' torques (N m).
        stand: The solved stand.
        statics: Torques and contact forces, of least torque.
        payload: The greatest mass at the base's origin.
        sunk: The stance with its feet sunk into MuJoCo's ground; None where that is out of reach.
        verification: The simulation, with feed-forward, of ``sunk``, or else of ``stand``.
        settled: Where it settles without feed-forward; None where that is not predicted.
        unsettled: Why ``settled`` is None.
        envelope: How far the base can go; None if it was not asked for.
    """

    name: str
    joint_positions: Array
    limits: Array
    stand: Stand
    statics: GravityCompensation
    payload: PayloadLimit
    sunk: Stand | None
    verification: StandVerification
    settled: SettledPose | None
    unsettled: str
    envelope: PoseEnvelope | None


def study(robot: Robot, task: StandTask, *, envelope: bool = False) -> Stance:
    """Solves a stance, and finds out what it costs and whether it holds.

    Args:
        robot: The robot.
        task: The stance.
        envelope: Also find how far the base can go from there (a second or two).

    Raises:
        StanceUnreachableError: If it is out of reach.
        StaticsInfeasibleError: If it is reached, but slides or tips.
        ConfigurationError: If the task makes no sense for the robot.
    """
    stand = solve_stand(robot, task)
    statics = stand_statics(robot, stand)
    settled, unsettled, sunk = None, "", None
    try:
        settled = settled_pose(robot, stand)
    except NoEquilibriumError as error:
        unsettled = str(error)
    with contextlib.suppress(StanceUnreachableError):
        sunk = sunk_stand(robot, task, explain=False)
    return Stance(
        name=robot.name,
        joint_positions=stand.joint_positions(robot),
        limits=robot.effort_limits,
        stand=stand,
        statics=statics,
        payload=payload_limit(robot, stand),
        sunk=sunk,
        verification=verify_stand(robot, sunk or stand),
        settled=settled,
        unsettled=unsettled,
        envelope=pose_envelope(robot, task) if envelope else None,
    )


def print_stance(out: Console, stance: Stance) -> None:
    """Prints a stance."""
    stand, verification = stance.stand, stance.verification
    out.print(f"[bold]{escape(stance.name)}[/]: {escape(str(stand.task))}", soft_wrap=True)
    more = {"position (rad)": stance.joint_positions}
    print_loads(out, stance.statics, verification, stance.limits.tolist(), more)
    where = f" ({', '.join(stance.payload.where)})" if stance.payload.where else ""
    out.print(
        f"payload at the base's origin: {stance.payload.mass:.2f} kg, then "
        f"{stance.payload.failure.value}{where}",
        soft_wrap=True,
    )
    _print_settled(out, stance)
    if stance.envelope is not None:
        _print_envelope(out, stance.envelope)
    if stance.sunk is None:
        out.print(
            "[yellow]note:[/] its feet, sunk into MuJoCo's soft ground, would be out of reach; "
            "simulated with joints for rigid ground",
            soft_wrap=True,
        )
    else:
        deepest = 1e3 * max(stance.sunk.depths.values())
        out.print(
            f"simulated with its legs longer by what the feet sink into MuJoCo's soft ground "
            f"(at most {deepest:.2f} mm)",
            soft_wrap=True,
        )
    if verification.passed:
        out.print(
            f"[bold green]HOLDS[/] in MuJoCo: torques within {verification.torque_error:.2%}, "
            f"vertical forces within {verification.force_error:.2%} of the prediction"
        )
    else:
        out.print(f"[bold red]FAILS[/] in MuJoCo: {escape('; '.join(verification.failures))}")


def _print_settled(out: Console, stance: Stance) -> None:
    settled = stance.settled
    if settled is None:
        out.print(
            f"without feed-forward, no sag is predicted: {escape(stance.unsettled)}", soft_wrap=True
        )
        return
    text = (
        f"without feed-forward it settles at {settled.base_height:.5f} m: servos give "
        f"{1e3 * settled.servo_sag:.2f} mm, the ground {1e3 * settled.contact_sag:.2f} mm"
    )
    if settled.failures:
        text += f"; but {'; '.join(settled.failures)}"
    out.print(escape(text), soft_wrap=True)


def _print_envelope(out: Console, envelope: PoseEnvelope) -> None:
    rows = titled_table(out, "How far the base can go, each alone", "", "from", "to")
    for direction, interval in envelope.intervals.items():
        if direction in ("roll", "pitch", "yaw"):
            low, high = (f"{math.degrees(end):+.1f} deg" for end in (interval.low, interval.high))
        else:
            low, high = (f"{1e3 * end:+.1f} mm" for end in (interval.low, interval.high))
        rows.add_row(direction, low, high)
    out.print(rows)
