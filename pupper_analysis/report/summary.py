"""Prints an analysis in a few lines."""

from __future__ import annotations

import numpy as np
from rich.console import Console

from pupper_analysis.analysis.robot import Analysis
from pupper_analysis.report.console import escape
from pupper_analysis.report.verdict import print_verdict
from pupper_analysis.simulation.verify import StandVerification


def print_summary(out: Console, analysis: Analysis) -> None:
    """Prints a verdict, and what the analysis says of mass, stand, torques, sag and models."""
    verdict = "[bold green]VERIFIED[/]" if analysis.verified else "[bold red]FAILED[/]"
    name = escape(analysis.name)
    out.print(
        f"{verdict} [bold]{name}[/]: {analysis.total_mass:.3f} kg; {escape(_peak(analysis))}",
        soft_wrap=True,
    )
    held, let_go = analysis.verification, analysis.sagging
    stand = f"   stands {1e3 * analysis.stand.qpos[2]:.1f} mm high, in MuJoCo {_millimetres(held)}"
    sag = f"commanded the same joints without feed-forward {_millimetres(let_go)}"
    if let_go.failures:
        sag += f" ({let_go.failures[0]})"
    check = analysis.check
    worst = next(one for one in check.quantities if one.name == check.worst)
    models = f"URDF and MJCF: worst deviation {worst.relative:.1e} ({worst.name})"
    out.print(escape(f"{stand}, {sag}; {models}"), soft_wrap=True)
    if analysis.notes:
        count = len(analysis.notes)
        out.print(f"   {count} note{'s' if count > 1 else ''} on what was assumed: -v", style="dim")
    print_verdict(out, analysis.verdict)
    for failure in analysis.failures:
        out.print(f"   [red]failed:[/] {escape(failure)}", soft_wrap=True)


def _peak(analysis: Analysis) -> str:
    """Says which motor holds the greatest part of its limit."""
    statics = analysis.statics
    share = statics.motor_utilisation
    limited = bool(share.any())
    index = int(np.argmax(share if limited else np.abs(statics.joint_torques)))
    torque, name = statics.joint_torques[index], statics.joint_names[index]
    text = f"peak torque {torque:+.3f} N m at {name}"
    return f"{text}, {share[index]:.1%} of its limit" if limited else text


def _millimetres(run: StandVerification) -> str:
    return f"{1e3 * run.base_height:.1f} mm" if np.isfinite(run.base_height) else "diverged"
