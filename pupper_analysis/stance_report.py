"""One stance of one robot: all that is found out about it, and how it is printed."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from pupper_analysis.best import BestStance, Objective, best_stance
from pupper_analysis.configuration import Configuration
from pupper_analysis.envelope import PoseEnvelope, pose_envelope
from pupper_analysis.errors import (
    NoEquilibriumError,
    NoStiffnessError,
    StanceUnreachableError,
)
from pupper_analysis.path import StancePath, stance_path
from pupper_analysis.payload import PayloadLimit, payload_limit
from pupper_analysis.payload_simulation import PayloadTrial, payload_trial
from pupper_analysis.push import PushRecovery, push_recovery
from pupper_analysis.push_report import print_pushes
from pupper_analysis.report import print_loads, titled_table
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.settle import RELEASE_MARGIN, SettledPose, least_kp, settled_pose
from pupper_analysis.simulation import StandVerification, verify_stand
from pupper_analysis.sink import sunk_stand
from pupper_analysis.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics import GravityCompensation, LoadSharing
from pupper_analysis.task import StandTask
from pupper_analysis.tracking import PathTracking, track_path

Array = NDArray[np.float64]

TRIED = 0.95
"""The part of the payload's limit with which the loaded robot is simulated: below it, as no servo,
floor or hand is exact to a percent."""

DISAGREEMENT = 1e-4
"""What a stand may leave of the balance in MuJoCo's terms before it is remarked upon (N, N m)."""


@dataclass(frozen=True, eq=False)
class Stance(Result):
    """A stance, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        joint_positions: (nu,) of ``sunk``, or else of ``stand``, in actuator order (rad).
        limits: (nu,) of the motors' torques (N m).
        stand: The solved stand.
        statics: Torques and contact forces of ``sunk``, or else of ``stand``: those that last.
        least_peak: The same of least peak motor utilisation.
        point: Where the payload is, in the base's frame (m).
        payload: The greatest mass there.
        trial: The simulation with ``TRIED`` of that mass on the robot; None if there is no such.
        sunk: The stance with its feet sunk into MuJoCo's ground; None where that is out of reach.
        verification: The simulation, with feed-forward, of ``sunk``, or else of ``stand``.
        settled: Where it settles without feed-forward; None where that is not predicted.
        unsettled: Why ``settled`` is None.
        best: How it was found, if the best stance was asked for.
        least_kp: The softest servos that carry it without feed-forward (N m/rad), if asked for;
            None also if none do.
        envelope: How far the base can go, if asked for.
        path: From the nominal stand to it, if asked for.
        tracking: The simulation of ``path``.
        push: The largest pushes it survives, if asked for.
    """

    name: str
    joint_positions: Array
    limits: Array
    stand: Stand
    statics: GravityCompensation
    least_peak: GravityCompensation
    point: tuple[float, float, float]
    payload: PayloadLimit
    trial: PayloadTrial | None
    sunk: Stand | None
    verification: StandVerification
    settled: SettledPose | None
    unsettled: str
    best: BestStance | None
    least_kp: float | None
    envelope: PoseEnvelope | None
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
    envelope: bool = False,
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
        envelope: Also find how far the base can go from there (a second or two).
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
        settled = settled_pose(robot, stand, kp=kp)
    except NoEquilibriumError as error:
        unsettled = str(error)
    with contextlib.suppress(NoStiffnessError):
        softness = least_kp(robot, stand) if softest else None
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
        least_peak=stand_statics(robot, held, sharing=LoadSharing.LEAST_PEAK),
        point=point,
        payload=payload,
        trial=trial,
        sunk=sunk,
        verification=verify_stand(robot, held, kp=kp, kd=kd),
        settled=settled,
        unsettled=unsettled,
        best=best,
        least_kp=softness,
        envelope=pose_envelope(robot, stand.task) if envelope else None,
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
        feet=task.feet, foot_offsets=task.foot_offsets, ground=task.ground, posture=task.posture
    )
    return [nominal, *([replace(over, lifted={})] if task.lifted else []), over]


def print_stance(out: Console, stance: Stance) -> None:
    """Prints a stance."""
    stand, verification = stance.stand, stance.verification
    out.print(f"[bold]{escape(stance.name)}[/]: {escape(str(stand.task))}", soft_wrap=True)
    if stance.best is not None:
        _print_best(out, stance.best)
    more = {"position (rad)": stance.joint_positions}
    print_loads(out, stance.statics, stance.least_peak, verification, stance.limits.tolist(), more)
    if stance.overloaded:
        how = "with the contact forces that last"
        if stance.least_peak.motor_utilisation.max() > 1:
            how = "however the feet share the load"
        out.print(
            f"[bold red]OVERLOADED[/]: the motors cannot hold it {how}: "
            f"{', '.join(stance.overloaded)}",
            soft_wrap=True,
        )
    _print_payload(out, stance)
    _print_clearance(out, stand)
    _print_settled(out, stance)
    if stance.least_kp is not None:
        out.print(f"softest servos that carry it: {stance.least_kp:.2f} N m/rad", soft_wrap=True)
    if stance.envelope is not None:
        _print_envelope(out, stance.envelope)
    if stance.push is not None:
        print_pushes(out, {stance.name: stance.push})
    if stance.path is not None and stance.tracking is not None:
        print_tracking(out, stance.path, stance.tracking)
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
    if verification.mujoco_residual > DISAGREEMENT:
        out.print(
            "[yellow]note:[/] the two models disagree: by the MJCF "
            f"{verification.mujoco_residual:.1e} N (or N m) of the balance are left; "
            "pupper-analysis crosscheck says why",
            soft_wrap=True,
        )
    if verification.passed:
        out.print(
            f"[bold green]HOLDS[/] in MuJoCo, without payload: "
            f"torques within {verification.torque_error:.2%}, "
            f"forces within {verification.force_error:.2%} of the prediction"
        )
    else:
        out.print(f"[bold red]FAILS[/] in MuJoCo: {escape('; '.join(verification.failures))}")


def _print_best(out: Console, best: BestStance) -> None:
    unit = " m" if best.objective is Objective.MARGIN else ""
    what = {
        Objective.UTILISATION: "peak motor utilisation",
        Objective.MARGIN: "distance of the com from the support polygon's edge",
        Objective.PAYLOAD: "payload",
    }[best.objective]
    coordinates = ", ".join(
        f"{name} {math.degrees(value):+.1f} deg"
        if name in ("roll", "pitch", "yaw")
        else f"{name} {1e3 * value:.1f} mm"
        for name, value in best.coordinates.items()
    )
    values = [f"{value:.4g}{unit}" for value in (best.value, best.nominal_value)]
    if best.objective is Objective.PAYLOAD:
        values = [kilograms(value) for value in (best.value, best.nominal_value)]
    out.print(
        f"best of {best.evaluations} stances: {what} {values[0]}, "
        f"against {values[1]} as asked; {coordinates}"
        + (f"; at its limit: {', '.join(best.active)}" if best.active else ""),
        soft_wrap=True,
    )


def _print_payload(out: Console, stance: Stance) -> None:
    payload, trial = stance.payload, stance.trial
    place = ", ".join(f"{1e3 * value:.0f}" for value in payload.point)
    where = f" ({', '.join(payload.where)})" if payload.where else ""
    bounds = (
        ("motors", payload.motors),
        ("servos' stiffness", payload.servos),
        ("contacts", payload.contacts),
    )
    each = ", ".join(f"{name} {kilograms(bound.mass)}" for name, bound in bounds)
    text = (
        f"payload at ({place}) mm of the base: {kilograms(payload.mass)}, then "
        f"{payload.failure.value}{where}; {each}"
    )
    if payload.unlimited:
        text += f"; {len(payload.unlimited)} motors have no effort limit, and set no payload"
    if trial is not None:
        text += f"\nsimulated with {kilograms(trial.mass)} on it, {trial.duration:g} s, nudged: "
        text += (
            "it stays up"
            if trial.failure is None
            else f"at {trial.time:.2f} s {trial.failure.value} ({', '.join(trial.where)})"
        )
    out.print(escape(text), soft_wrap=True)


def kilograms(mass: float) -> str:
    """Returns a mass that can be borne (kg) in words, rounded down: what is printed is borne."""
    return "no limit" if math.isinf(mass) else f"{math.floor(100 * mass) / 100:.2f} kg"


def _print_clearance(out: Console, stand: Stand) -> None:
    near, links = stand.ground_clearance, stand.self_clearance
    if near is not None:
        out.print(f"lowest part but the feet: {near.links[0]}, {1e3 * near.distance:.1f} mm")
    if links is not None:
        out.print(
            f"nearest links: {' and '.join(links.links)}, {1e3 * links.distance:.1f} mm apart"
        )


def print_tracking(out: Console, path: StancePath, tracking: PathTracking) -> None:
    """Prints how well a path is followed."""
    lowest = path.loads.min(axis=0)
    loads = ", ".join(f"{foot} {low:.2f}" for foot, low in zip(path.feet, lowest, strict=True))
    out.print(
        f"path of {path.time[-1]:g} s, {len(path.time)} samples: motors in motion at most "
        f"{path.peak_utilisation:.1%} of their torque limit ({path.peak_joint} at "
        f"{path.peak_time:.2f} s), {path.peak_speed_utilisation:.1%} of their velocity limit; com "
        f"at least {1e3 * path.com_margin.min():.1f} mm inside the support polygon, zero-moment "
        f"point {1e3 * path.zmp_margin.min():.1f} mm",
        soft_wrap=True,
    )
    out.print(f"least load of the feet (N): {loads}", soft_wrap=True)
    out.print(
        f"in MuJoCo: torques within {tracking.torque_error:.1%} of the largest, joints within "
        f"{tracking.joint_error:.3f} rad ({tracking.joint_error_rms:.3f} rms), base height within "
        f"{1e3 * tracking.height_error:.1f} mm, orientation within "
        f"{tracking.orientation_error:.3f} rad, feet within "
        f"{1e3 * max(tracking.foot_slip.values()):.1f} mm of their places",
        soft_wrap=True,
    )
    if tracking.passed:
        out.print("[bold green]TRACKED[/]")
    else:
        out.print(f"[bold red]FAILED[/]: {escape('; '.join(tracking.failures))}", soft_wrap=True)


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
    if settled.release_margin < RELEASE_MARGIN and not settled.failures:
        text += ", if it is let down slowly (let go at once, feet slip in the fall)"
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
