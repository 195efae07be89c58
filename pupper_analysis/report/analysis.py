"""Prints analyses as tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.bar import Bar
from rich.console import Console

from pupper_analysis.analysis.robot import Analysis
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.report.console import escape, titled_table
from pupper_analysis.report.verdict import print_verdict
from pupper_analysis.robot.efforts import origins_in_words
from pupper_analysis.simulation.gain_sweep import GainSweep
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]


def print_analysis(out: Console, analysis: Analysis) -> None:
    """Prints one robot's analysis."""
    out.rule(f"[bold]{analysis.name}[/]", align="left")
    _print_structure(out, analysis)
    _print_stand(out, analysis)
    _print_jacobians(out, analysis)
    _print_statics(out, analysis)
    _print_verification(out, analysis)
    _print_sweep(out, analysis)
    _print_check(out, analysis)
    word = "[bold green]VERIFIED[/]" if analysis.verified else "[bold red]FAILED[/]"
    print_verdict(out, analysis.verdict)
    failed = "".join(f": {escape(text)}" for text in ["; ".join(analysis.failures)] if text)
    out.print(f"{word} {escape(analysis.name)}{failed}\n", soft_wrap=True)


def _vector(values: Iterable[float], digits: int = 4) -> str:
    return " ".join(_number(value, digits) for value in values)


def _number(value: float, digits: int = 4, sign: str = "+") -> str:
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"  # + 0.0: no minus before a zero


def _print_structure(out: Console, analysis: Analysis) -> None:
    out.print(
        f"nq = {analysis.nq}, nv = {analysis.nv}, nu = {analysis.nu}; "
        f"mass {analysis.total_mass:.3f} kg; com at zero angles, from the base "
        f"({_vector(analysis.center_of_mass)}) m"
    )
    out.print(
        f"thigh {_millimetres(analysis.thigh_length)}, calf {_millimetres(analysis.calf_length)}; "
        f"bodies: {_masses(analysis.link_masses)}"
    )
    table = titled_table(
        out,
        "Joints, in actuator order (axes at zero angles, base frame)",
        "joint",
        "motion",
        "axis",
        "limits\n(rad)",
        "effort\n(N m)",
        "velocity\n(rad/s)",
        "armature\n(kg m²)",
        "damping\n(N m s/rad)",
        "friction\n(N m)",
        left=2,
    )
    for joint in analysis.joints:
        table.add_row(
            joint.name,
            joint.motion,
            _vector(joint.axis, 2 if joint.motion.startswith("oblique") else 0),
            f"{joint.lower:+.2f} … {joint.upper:+.2f}",
            f"{joint.effort:g}",
            f"{joint.velocity:g}",
            f"{joint.armature:g}",
            f"{joint.damping:g}",
            f"{joint.friction:g}",
        )
    out.print(table)
    origins = origins_in_words(joint.effort_origin for joint in analysis.joints)
    out.print(f"effort: {origins}", style="dim")
    for note in analysis.notes:
        out.print(f"note: {escape(str(note))}", style="yellow")


def _millimetres(length: float | None) -> str:
    return "-" if length is None else f"{1e3 * length:.1f} mm"


def _masses(masses: Mapping[str, float]) -> str:
    """Lists equal masses once."""
    groups: dict[str, list[str]] = {}
    for name, mass in masses.items():
        groups.setdefault(f"{mass:.3f} kg", []).append(name)
    return ", ".join(
        f"{names[0]} {mass}" if len(names) == 1 else f"{len(names)} x {mass} ({names[0]} …)"
        for mass, names in groups.items()
    )


def _print_stand(out: Console, analysis: Analysis) -> None:
    stand = analysis.stand
    out.print(f"\n[bold]Stand[/] (PlaCo, {stand.iterations} iterations): {escape(str(stand.task))}")
    out.print(
        f"errors: feet {stand.foot_error:.1e} m (by MuJoCo "
        f"{analysis.verification.mujoco_foot_error:.1e} m), orientation "
        f"{stand.orientation_error:.1e} rad, height {stand.height_error:.1e} m, "
        f"com {stand.com_error:.1e} m"
    )


def _print_jacobians(out: Console, analysis: Analysis) -> None:
    table = titled_table(
        out,
        "Foot Jacobians (m/rad, world axes, by the joints of the leg)",
        "foot",
        "vx",
        "vy",
        "vz",
        "singular values",
        "condition",
    )
    for foot, jacobian in analysis.foot_jacobians.items():
        rows = [_vector(row) for row in jacobian.matrix]
        values = " ".join(f"{value:.4f}" for value in jacobian.singular_values)
        table.add_row(foot, *rows, values, f"{jacobian.condition:.2f}")
    out.print(table)


def _print_statics(out: Console, analysis: Analysis) -> None:
    print_loads(
        out,
        analysis.statics,
        analysis.minimum_peak,
        analysis.verification,
        [joint.effort for joint in analysis.joints],
        [joint.effort_origin for joint in analysis.joints],
        {"hanging": analysis.hanging_torques},
        "; hanging: the same pose, base held",
    )


def print_loads(
    out: Console,
    statics: GravityCompensation,
    minimum_peak: GravityCompensation,
    verification: StandVerification,
    limits: Sequence[float],
    origins: Sequence[EffortStatement | None],
    more: Mapping[str, Array],
    explanation: str = "",
) -> None:
    """Prints what motors and feet hold, predicted and simulated.

    Args:
        out: Where to.
        statics: Of the forces that last.
        minimum_peak: Of least peak utilisation.
        verification: The simulation.
        limits: (nu,) of the motors (N m).
        origins: (nu,) where these are from.
        more: Further columns, {title: (nu,)}.
        explanation: Of them.
    """
    table = titled_table(
        out,
        "Motor torques (N m)",
        "joint",
        "torque",
        "limit",
        "utilisation",
        "",
        "simulated",
        "minimum peak",
        *more,
    )
    for index, name in enumerate(statics.joint_names):
        utilisation = float(statics.motor_utilisation[index])
        colour = "green" if utilisation < 0.5 else "yellow" if utilisation < 0.9 else "red"
        table.add_row(
            name,
            _number(statics.joint_torques[index]),
            f"{limits[index]:g}",
            f"{utilisation:.1%}",
            Bar(1.0, 0.0, min(utilisation, 1.0), width=16, color=colour),
            _number(verification.joint_torques[index]),
            _number(minimum_peak.joint_torques[index]),
            *(_number(values[index]) for values in more.values()),
        )
    out.print(table)
    out.print(
        "torque: with the least tangential forces at the feet, which last; minimum peak: with the "
        "contact forces of\nleast peak utilisation, "
        f"{minimum_peak.motor_utilisation.max():.1%}{explanation}\n"
        f"limit: {origins_in_words(origins)}",
        style="dim",
    )
    flat = len(statics.foot_loads) < len(statics.contact_forces)
    table = titled_table(
        out,
        "Contact forces on the feet (N, world axes)",
        "foot",
        "force",
        "friction used",
        "simulated",
        "minimum peak",
    )
    for foot, load in statics.foot_loads.items():
        table.add_row(
            foot,
            _vector(load.force, 3),
            f"{load.friction_utilisation:.1%}",
            _vector(verification.foot_forces[foot], 3),
            _vector(minimum_peak.foot_loads[foot].force, 3),
        )
    out.print(table)
    for foot, load in statics.foot_loads.items() if flat else ():
        out.print(f"centre of pressure of {escape(foot)}: {_vector(load.centre_of_pressure, 4)} m")
    margin = "-" if statics.com_margin is None else f"{1e3 * statics.com_margin:.1f} mm"
    out.print(
        f"balance residual {statics.residual_force:.1e} N, {statics.residual_torque:.1e} N m "
        f"(in MuJoCo's terms {verification.mujoco_residual:.1e}); "
        f"com {margin} inside the support polygon"
    )


def _print_verification(out: Console, analysis: Analysis) -> None:
    table = titled_table(
        out,
        f"MuJoCo, {analysis.verification.duration:g} s on the floating base "
        f"({analysis.verification.integrator}, {1e3 * analysis.verification.timestep:g} ms; "
        f"kp {_range(analysis.verification.kp)} N m/rad, "
        f"kd {_range(analysis.verification.kd)} N m s/rad)",
        "",
        "with feed-forward",
        "without",
    )
    both = (analysis.verification, analysis.sagging)
    rows: list[tuple[str, list[str]]] = [
        ("base height", [f"{run.base_height:.5f} m" for run in both]),
        ("loss of height", [f"{_number(1e3 * run.height_loss, 3, '-')} mm" for run in both]),
        ("  servo sag", [f"{_number(1e3 * run.servo_sag, 3, '-')} mm" for run in both]),
        ("  contact softness", [f"{_number(1e3 * run.contact_sag, 3, '-')} mm" for run in both]),
        (
            "deviation, last second (< 5 mm = stable)",
            [f"{1e3 * run.height_deviation:.5f} mm" for run in both],
        ),
        (
            "drift, last second",
            [f"{_number(1e3 * run.height_drift, 4)} mm/s" for run in both],
        ),
        ("tilt against the task", [f"{math.degrees(run.tilt):.4f} deg" for run in both]),
        ("foot slip", [f"{1e3 * max(run.foot_slip.values()):.4f} mm" for run in both]),
        ("joint error", [f"{run.joint_error:.1e} rad" for run in both]),
        ("torque off prediction, of the largest", [f"{run.torque_error:.3%}" for run in both]),
        ("vertical foot force off prediction", [f"{run.force_error:.3%}" for run in both]),
        ("verdict", ["stands" if run.passed else "FAILED" for run in both]),
    ]
    for name, values in rows:
        table.add_row(name, *values)
    out.print(table)
    for run, how in zip(both, ("with", "without"), strict=True):
        for failure in run.failures:
            out.print(f"{how} feed-forward: {escape(failure)}", style="red")


def _range(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g} … {high:g}"


def _print_sweep(out: Console, analysis: Analysis) -> None:
    sweep = analysis.sweep
    table = titled_table(
        out,
        f"Height deviation (mm) under {sweep.amplitude:g} N at {sweep.frequency:g} Hz "
        f"({sweep.integrator}, {sweep.duration:g} s, last second); damping ratio of the least "
        "damped mode",
        "Kp (N m/rad) \\ Kd (N m s/rad)",
        *(f"{kd:g}" for kd in sweep.kd),
    )
    for row, kp in enumerate(sweep.kp):
        cells = [_gains_cell(sweep, row, column) for column in range(len(sweep.kd))]
        table.add_row(f"{kp:g}", *cells)
    out.print(table)
    out.print(
        "stiffer servos move less, without end: delay, noise and torque, which end it, are not in "
        "it",
        style="dim",
    )


def _gains_cell(sweep: GainSweep, row: int, column: int) -> str:
    """Returns what comes of a pair of gains."""
    if sweep.fell[row, column]:
        return "fell"
    text = f"{1e3 * sweep.height_deviation[row, column]:.4f}"
    doubling, damping = sweep.doubling_time[row, column], sweep.damping_ratio[row, column]
    if np.isnan(doubling):
        return f"{text} [red]does not rest[/]"
    if not sweep.lasts[row, column]:
        return f"{text} [red]doubles in {doubling:.2g} s[/]"
    return f"{text} {damping:.2f}" if np.isfinite(damping) else f"{text} -"


def _print_check(out: Console, analysis: Analysis) -> None:
    check = analysis.check
    table = titled_table(
        out,
        "Cross-check: URDF and MJCF, each in Pinocchio and in MuJoCo, at "
        f"{check.configurations} random configurations (#); tolerance {check.tolerance:g}",
        "quantity",
        "worst at",
        "deviation of",
        "scale",
        "deviation",
        "relative",
        "",
        left=3,
    )
    for quantity in check.quantities:
        exact = quantity.deviation == 0
        table.add_row(
            quantity.name,
            "" if exact else quantity.where,
            "" if exact else quantity.whose,
            f"{quantity.scale:.3g} {quantity.unit}",
            f"{quantity.deviation:.1e}",
            f"{quantity.relative:.1e}",
            "ok" if quantity.passed else "[red]DIFFERS[/]",
        )
    out.print(table)
    for note in check.notes:
        out.print(f"note: {escape(str(note))}", style="yellow")
