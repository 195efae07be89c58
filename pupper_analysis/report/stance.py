"""Prints what was found out about a stance: one function per result."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pupper_analysis.analysis.best import BestStudy
from pupper_analysis.analysis.path import PathThere
from pupper_analysis.analysis.payload import LoadedStance
from pupper_analysis.analysis.stance import Stance
from pupper_analysis.report.analysis import print_loads
from pupper_analysis.report.console import escape, titled_table
from pupper_analysis.report.push import rigid_note, sunk_note
from pupper_analysis.report.verdict import made_up, print_verdict
from pupper_analysis.simulation.tracking import PathTracking
from pupper_analysis.stance.optimize.best import BestStance
from pupper_analysis.stance.optimize.search import Objective
from pupper_analysis.stance.path.stance_path import StancePath
from pupper_analysis.stance.sag.steady_state import RELEASE_MARGIN
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.workspace import BaseWorkspace

Array = NDArray[np.float64]

DISAGREEMENT = 1e-4
"""What a stand may leave of the balance in MuJoCo's terms before it is remarked upon (N, N m)."""


_MORE = 1.001  # times what motors bear: legs that share a load bear more


def print_stance(out: Console, stance: Stance) -> None:
    """Prints a stance, what it costs, and whether it holds."""
    verification = stance.verification
    _print_task(out, stance.name, stance.stand)
    more = {"position (rad)": stance.joint_positions}
    print_loads(
        out,
        stance.statics,
        stance.minimum_peak,
        verification,
        stance.limits.tolist(),
        stance.limit_origins,
        more,
    )
    _print_clearance(out, stance.stand)
    _print_settled(out, stance)
    if stance.minimum_stiffness is not None:
        out.print(
            "minimum stiffness of servos that carry it without feed-forward: "
            f"{stance.minimum_stiffness:.2f} N m/rad",
            soft_wrap=True,
        )
    if stance.sunk is None:
        out.print(rigid_note(stance.name), soft_wrap=True)
    else:
        out.print(sunk_note(stance.sunk.depths.values()), soft_wrap=True)
    if stance.loops_open is not None:
        out.print(
            f"the MJCF's loops and couplings are open in it by up to {stance.loops_open:.2g} m or "
            "rad, as their softness has it",
            soft_wrap=True,
        )
    if verification.mujoco_residual > DISAGREEMENT:
        out.print(
            "[yellow]note:[/] the two models disagree: by the MJCF "
            f"{verification.mujoco_residual:.1e} N (or N m) of the balance are left; "
            "pupper-analysis crosscheck says why",
            soft_wrap=True,
        )
    print_verdict(out, stance.verdict)


def _print_task(out: Console, name: str, stand: Stand) -> None:
    out.print(f"[bold]{escape(name)}[/]: {escape(str(stand.task))}", soft_wrap=True)


def print_best(out: Console, study: BestStudy) -> None:
    """Prints the best stance, how it was found, and what is found out about it."""
    _print_search(out, study.best)
    print_stance(out, study.stance)
    if study.loaded is not None:
        _print_limit(out, study.loaded)


def _print_search(out: Console, best: BestStance) -> None:
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


def print_payload(out: Console, loaded: LoadedStance) -> None:
    """Prints what a stance can carry, and what the simulation makes of it."""
    _print_task(out, loaded.name, loaded.stand)
    _print_limit(out, loaded)


def _print_limit(out: Console, loaded: LoadedStance) -> None:
    payload, trial = loaded.payload, loaded.trial
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
    shared = payload.shared
    if shared is not None and payload.motors.mass * _MORE < shared.mass < math.inf:
        text += f"; motors {kilograms(shared.mass)}, if the legs share it as these can"
    if payload.unlimited:
        count = len(payload.unlimited)
        motors = "1 motor has" if count == 1 else f"{count} motors have"
        text += f"; {motors} no effort limit, and set{'s' if count == 1 else ''} no payload"
    out.print(escape(text), soft_wrap=True)
    rests = "static, at the motors' peak torque as the files state it"
    if loaded.buckling:
        _print_buckling(out, loaded)
    out.print(escape(f"that is {rests}{made_up(loaded.servos)}"), soft_wrap=True)
    if trial is not None:
        text = f"simulated with {kilograms(trial.mass)} on it, {trial.duration:g} s, nudged: "
        text += (
            "it stays up"
            if trial.failure is None
            else f"at {trial.time:.2f} s {trial.failure.value} ({', '.join(trial.where)})"
        )
        out.print(escape(text), soft_wrap=True)


def _print_buckling(out: Console, loaded: LoadedStance) -> None:
    """Prints how fast a stand buckles near what its servos hold."""
    table = titled_table(
        out,
        "How fast it buckles on its servos: in what time a deviation doubles",
        "payload (kg)",
        "of the servos' limit",
        "doubles in (s)",
        "without dry friction (s)",
    )
    limit = loaded.payload.servos.mass
    for one in loaded.buckling:
        times = (one.doubling_time, one.free_doubling_time)
        told = ("-" if math.isinf(time) else f"{time:.3g}" for time in times)
        table.add_row(f"{one.mass:.2f}", f"{one.mass / limit:.2f}", *told)
    out.print(table)


def kilograms(mass: float) -> str:
    """Returns a mass that can be borne (kg) in words, rounded down: what is printed is borne."""
    return "no limit" if math.isinf(mass) else f"{math.floor(100 * mass) / 100:.2f} kg"


def _print_clearance(out: Console, stand: Stand) -> None:
    near, links = stand.ground_clearance, stand.self_clearance
    if near is not None:
        out.print(
            f"lowest part but the feet: {escape(near.links[0])}, {1e3 * near.distance:.1f} mm"
        )
    if links is not None:
        out.print(
            f"nearest links: {' and '.join(links.links)}, {1e3 * links.distance:.1f} mm apart"
        )


def print_path(out: Console, there: PathThere) -> None:
    """Prints a path to a stance, and how well it is followed."""
    _print_task(out, there.name, there.stand)
    if there.binding is not None:
        out.print(
            f"least time {there.path.time[-1]:.3g} s, with {there.reserve:.0%} of every limit in "
            f"reserve: bound by {escape(str(there.binding))}; {there.lower_bound:.3g} s if the "
            "acceleration could jump",
            soft_wrap=True,
        )
    print_tracking(out, there.path, there.tracking, made_up(there.servos))


def print_tracking(
    out: Console, path: StancePath, tracking: PathTracking, servos: str = ""
) -> None:
    """Prints how well a path is followed, and what is said of the servos that follow it."""
    lowest = path.loads.min(axis=0)
    loads = ", ".join(f"{foot} {low:.2f}" for foot, low in zip(path.feet, lowest, strict=True))
    out.print(
        f"path of {path.time[-1]:.4g} s, {len(path.time)} samples: motors in motion at most "
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
        f"{1e3 * max(tracking.foot_slip.values()):.1f} mm of their places{escape(servos)}",
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
        f"commanded these joints alone it settles at {settled.base_height:.5f} m: servos give "
        f"{1e3 * settled.servo_sag:.2f} mm, the ground {1e3 * settled.contact_sag:.2f} mm"
    )
    if settled.release_margin < RELEASE_MARGIN and not settled.failures:
        text += ", if it is let down slowly (let go at once, feet slip in the fall)"
    if settled.failures:
        text += f"; but {'; '.join(settled.failures)}"
    out.print(escape(text), soft_wrap=True)


def print_workspace(out: Console, name: str, workspace: BaseWorkspace) -> None:
    """Prints how far a base can go."""
    _print_task(out, name, workspace.start)
    rows = titled_table(out, "How far the base can go, each alone", "", "from", "to")
    for direction, interval in workspace.intervals.items():
        if direction in ("roll", "pitch", "yaw"):
            low, high = (f"{math.degrees(end):+.1f} deg" for end in (interval.low, interval.high))
        else:
            low, high = (f"{1e3 * end:+.1f} mm" for end in (interval.low, interval.high))
        rows.add_row(direction, low, high)
    out.print(rows)
    out.print(
        "of reach and balance alone, whatever motors and servos hold: stand, with a pose of these, "
        "tells whether it holds",
        style="dim",
    )
