"""Prints what is written to make two files agree, and what is left."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from pupper_analysis.report.console import print_notes
from pupper_analysis.sync.choices import label, line_at
from pupper_analysis.sync.models import Sync
from pupper_analysis.sync.plan import Cause


def question(sync: Sync, place: int) -> str:
    """Returns a difference with its number and with its two lines."""
    difference = sync.differences[place]
    lines = [f"\n{place + 1}. {difference.message}"]
    for said in (difference.urdf_place, difference.mjcf_place):
        if said is not None:
            lines.append(f"   {said}: {line_at(said)}")
    return "\n".join(lines)


def print_choices(out: Console, sync: Sync) -> None:
    """Prints the differences with their numbers, and what to type.

    Args:
        out: Where to.
        sync: What was found; nothing was chosen.
    """
    if not sync.differences:
        _print_verdict(out, sync)
        return
    for number, difference in enumerate(sync.differences, start=1):
        out.print(f"[bold]{number}.[/] {escape(difference.message)}", soft_wrap=True)
        where = f"   {difference.urdf_place}   {difference.mjcf_place}"
        out.print(escape(where), style="dim", soft_wrap=True)
    first = label(sync.differences[0])
    out.print(
        "\nNothing was changed. --take urdf takes the URDF's values and writes them into the MJCF, "
        "--take mjcf the other way; for some alone:\n"
        + escape(f'   --take mjcf:1   --take urdf:"{first}"   --take mjcf:{_kind(sync)}')
        + "\nwith --dry-run it shows what it would change.",
        soft_wrap=True,
    )


def _kind(sync: Sync) -> str:
    kind = sync.differences[0].kind
    return f'"{kind}"' if " " in kind else kind


def print_sync(out: Console, sync: Sync, *, dry_run: bool = False) -> None:
    """Prints what was written, and what is left.

    Args:
        out: Where to.
        sync: What was done.
        dry_run: It was not done: print how the files would change.
    """
    if dry_run:
        out.print(escape(sync.diff), soft_wrap=True, end="")
    elif not sync.withheld:
        for edit in sync.edits:
            old = "(not stated)" if edit.old is None else edit.old
            said = f"{edit.file}:{edit.line}: {edit.element}: {edit.attribute}: {old} -> {edit.new}"
            out.print(escape(said), soft_wrap=True)
    print_notes(out, (f"{name}: {note}" for name, note in sync.notes.items()))
    for backup in sync.backups:
        out.print(escape(f"the old file is kept: {backup}"), style="dim", soft_wrap=True)
    for left in sync.left:
        out.print(f"[red]left:[/] {escape(f'{left.difference}: {left.reason}')}", soft_wrap=True)
    if sync.withheld:
        failed = sum(left.cause == Cause.NOT_MENDED for left in sync.left)
        out.print(
            f"[bold]nothing is written[/]: {failed} of the chosen differences cannot be mended, "
            "and the rest alone would make a robot of two versions; choose what is meant, or add "
            "--partial",
            soft_wrap=True,
        )
    _print_verdict(out, sync, would=dry_run or sync.withheld)


def _print_verdict(out: Console, sync: Sync, *, would: bool = False) -> None:
    count = f"{len(sync.edits)} attribute{'s' if len(sync.edits) != 1 else ''}"
    changed = f"{count} {'would be ' if would else ''}written"
    if sync.agree:
        out.print(f"[bold green]AGREE[/]: {changed}")
    else:
        out.print(f"[bold red]DISAGREE[/]: {changed}, {len(sync.left)} left")
