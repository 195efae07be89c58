"""Prints what became of a conversion."""

from __future__ import annotations

from rich.console import Console

from pupper_analysis.convert.conversion import Conversion
from pupper_analysis.report.console import escape, print_notes


def print_conversion(out: Console, conversion: Conversion) -> None:
    """Prints what was written, what was added and left out, and the proof.

    Args:
        out: Where to.
        conversion: The conversion.
    """
    for path in conversion.written:
        out.print(escape(f"written: {path}"), soft_wrap=True)
    print_notes(out, conversion.notes)
    for text in conversion.left:
        out.print(f"[red]left:[/] {escape(text)}", soft_wrap=True)
    compared = conversion.comparison
    worst = max(compared.deviations.values())
    verdict = "[bold green]AGREE[/]" if conversion.agree else "[bold red]DISAGREE[/]"
    count = len(compared.differences)
    differences = "1 difference" if count == 1 else f"{count} differences"
    repairs = len(conversion.repairs)
    but = f" but for {repairs} repaired inertials" if repairs else ""
    out.print(
        f"{verdict}{but}: {differences} from {escape(conversion.source)}; the "
        f"dynamics deviate by {worst:.1e}",
        soft_wrap=True,
    )
    stood = conversion.verification
    if stood is not None:
        verdict = "[bold green]STANDS[/]" if stood.passed else "[bold red]DOES NOT STAND[/]"
        out.print(
            f"{verdict} for {stood.duration:g} s in MuJoCo, {stood.base_height:.4f} m high; "
            f"torques as predicted to {stood.torque_error:.1e}",
            soft_wrap=True,
        )
    kept = conversion.kept
    if kept is not None and not kept.failures and (least := kept.stability.least_damped):
        out.print(
            f"[bold green]FORGETS A NUDGE[/] of {kept.nudge.speed:g} m/s and rad/s from its "
            f"keyframe: the least damping ratio is {least.damping_ratio:.2g}, at "
            f"{least.frequency:.2g} Hz",
            soft_wrap=True,
        )
    for failure in conversion.failures:
        out.print(f"[red]failed:[/] {escape(failure)}", soft_wrap=True)
