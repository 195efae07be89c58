"""Prints what has changed between two versions of a model."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console

from pupper_analysis.checks.versions.compare import ModelChange, ModelDiff
from pupper_analysis.report.console import SafeTable, escape, print_notes

_FELT = 1e-3
"""Relative change of a torque or a mass that is shown: less changes no digit that is printed."""


def print_diff(out: Console, diff: ModelDiff) -> None:
    """Prints the verdict, every change with its effect, and what they do to the torques."""
    verdict = "[bold green]SAME[/]" if diff.same else "[bold red]DIFFERENT[/]"
    count = len(diff.changes)
    said = "no change" if diff.same else f"{count} change{'s' if count != 1 else ''}"
    out.print(f"{verdict}: {escape(f'{diff.old} and {diff.new}: {said}')}", soft_wrap=True)
    for number, change in enumerate(diff.changes, start=1):
        out.print(f"\n[bold]{number}.[/] {escape(change.message)}", soft_wrap=True)
        out.print(
            escape(f"   {change.old_place}   {change.new_place}"), style="dim", soft_wrap=True
        )
        out.print(f"   {_effects(change)}", style="" if change.effects else "dim", soft_wrap=True)
    if not diff.same:
        old, new = diff.mass
        out.print(f"\nmass: {old:.6g} kg, now {new:.6g} kg{_percent(old, new)}")
        _print_torques(out, diff)
    if not diff.complete:
        name = max(diff.left, key=lambda quantity: diff.left[quantity])
        text = f"{diff.left[name]:.1e} of {name} is left that no change explains"
        out.print(f"[red]{text}[/]", soft_wrap=True)
    print_notes(out, diff.notes)


def _effects(change: ModelChange) -> str:
    if not change.effects:
        return "no effect on the dynamics of the tree of joints"
    effects = sorted(change.effects.items(), key=lambda item: -item[1].relative)
    return "alone it changes " + ", ".join(f"{name} by {e.relative:.1e}" for name, e in effects)


def _percent(old: float, new: float) -> str:
    return f" ({100 * (new / old - 1):+.3g} %)" if old and old != new else ""


def _print_torques(out: Console, diff: ModelDiff) -> None:
    """Prints the torques against gravity that have changed."""
    shown = {
        name: pair
        for name, pair in diff.torques.items()
        if abs(pair[1] - pair[0]) > _FELT * max(pair)
    }
    if not shown:
        out.print("the torques that hold its links in the air are what they were")
        return
    out.print(
        "\nGreatest torque that holds the links in the air, base level and held", style="bold"
    )
    table = SafeTable(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="dim")
    table.add_column("joint", overflow="fold")
    for title in ("old (N m)", "new (N m)", "change"):
        table.add_column(title, justify="right", no_wrap=True)
    for name, (old, new) in shown.items():
        change = _percent(old, new).strip(" ()")
        table.add_row(escape(name), f"{old:.4g}", f"{new:.4g}", change)
    out.print(table)
