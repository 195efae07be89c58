"""Prints how hard robots can be pushed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from rich.console import Console

from pupper_analysis.analysis.push import PushedStance
from pupper_analysis.report.console import escape, titled_table
from pupper_analysis.report.verdict import made_up, print_verdict


def print_pushes(out: Console, stances: Mapping[str, PushedStance]) -> None:
    """Prints the largest push of each direction, and how each robot fails at its weakest.

    Args:
        out: Where to.
        stances: Per robot; all with the same directions.
    """
    results = {name: stance.recovery for name, stance in stances.items()}
    for name, task in {name: str(stance.stand.task) for name, stance in stances.items()}.items():
        out.print(f"[bold]{escape(name)}[/]: {escape(task)}", soft_wrap=True)
    columns = (f"{escape(name)}\n(N s)" for name in results)
    table = titled_table(out, "Largest push that the stand survives", "direction", *columns)
    for index, angle in enumerate(next(iter(results.values())).directions):
        impulses = (f"{result.impulses[index]:.2f}" for result in results.values())
        table.add_row(_direction(float(angle)), *impulses)
    out.print(table)
    out.print("directions about the vertical, of the base: forward 0, left 90", style="dim")
    for name, result in results.items():
        verdict = stances[name].verdict
        if not verdict.passed:
            print_verdict(out, verdict, name)
        if result.unpushed:
            out.print(
                f"[bold]{escape(name)}[/] ({result.mass:.2f} kg): it does not stand, so it "
                "withstands no push",
                soft_wrap=True,
            )
            continue
        tipping = float(np.min(result.tipping_estimate))
        out.print(
            f"[bold]{escape(name)}[/] ({result.mass:.2f} kg): weakest at "
            f"{_direction(result.weakest_direction)}, {result.weakest_impulse:.2f} N s = "
            f"{result.weakest_impulse / result.mass:.2f} m/s; then "
            f"{escape(result.weakest_failure)} (a rigid robot tips at {tipping:.2f} N s)"
            + (escape(made_up(verdict.servos)) if verdict.passed else ""),
            soft_wrap=True,
        )
    stands = {name: stance.stand for name, stance in stances.items()}
    rigid = [name for name, stand in stands.items() if not any(stand.depths.values())]
    if len(rigid) < len(stands):
        depths = (depth for stand in stands.values() for depth in stand.depths.values())
        out.print(sunk_note(depths), soft_wrap=True)
    if rigid:
        out.print(rigid_note(*rigid), soft_wrap=True)


def sunk_note(depths: Iterable[float]) -> str:
    """Says that a robot was simulated as its feet sink in, by ``depths`` (m)."""
    return (
        "all this is on MuJoCo's soft ground, with legs longer by what the feet sink in "
        f"(at most {1e3 * max(depths):.2f} mm)"
    )


def rigid_note(*names: str) -> str:
    """Says that the robots of these names were simulated as they would stand on rigid ground."""
    return (
        f"[yellow]note:[/] the feet of {escape(', '.join(names))}, sunk into MuJoCo's soft ground, "
        "would be out of reach; simulated with joints for rigid ground"
    )


def _direction(angle: float) -> str:
    return f"{math.degrees(angle):.0f} deg"
