"""Prints the check of a repository's models, for people and for machines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich.console import Console

from pupper_analysis.guard.check import RepositoryCheck
from pupper_analysis.guard.remarks import Remark, State
from pupper_analysis.report.audit import LEVELS, STYLES
from pupper_analysis.report.console import escape
from pupper_analysis.report.formats import Annotation, Case
from pupper_analysis.report.sarif import from_root


def print_check(out: Console, check: RepositoryCheck, *, everything: bool = False) -> None:
    """Prints what fails, with its place, and how much is known.

    Args:
        out: Where to.
        check: The check.
        everything: Print what does not fail, too.
    """
    shown = [remark for remark in check.remarks if everything or remark.fails]
    for group in _groups(shown):
        _print_group(out, group)
    for entry in check.stale:
        text = f"stale: {entry}: it does not occur any more"
        out.print(escape(text + _what_of_stale(check)), style="yellow", soft_wrap=True)
    for pair in check.pairs:
        told = "[red]FAILS[/]" if pair.failures else "[green]OK[/]"
        parts = [f"{pair.failures} to mend"] * bool(pair.failures)
        parts += [f"{pair.known} known"] * bool(pair.known)
        parts += {True: ["they agree"], False: ["they differ"], None: []}[pair.agree]
        files = escape(f"{pair.name}: {', '.join(pair.files)}")
        out.print(f"{told} {files}{': ' * bool(parts)}{', '.join(parts)}", soft_wrap=True)
        for rule, reason in pair.disabled.items():
            out.print(escape(f"  {rule} is switched off: {reason}"), style="dim", soft_wrap=True)
    verdict = "[bold green]PASSED[/]" if check.passed else "[bold red]FAILED[/]"
    out.print(f"{verdict}: {escape(summary(check))}", soft_wrap=True)


def _groups(remarks: Iterable[Remark]) -> list[list[Remark]]:
    """Puts together remarks of one kind and file with the same values, old and new."""
    groups: dict[tuple[str, ...], list[Remark]] = {}
    for remark in remarks:
        same = (remark.state, str(remark.values), str(remark.before))
        key = (remark.check, remark.pair, remark.kind, remark.file, *same)
        groups.setdefault(key, []).append(remark)
    return list(groups.values())


def _print_group(out: Console, group: list[Remark]) -> None:
    first, *others = group
    style, place = STYLES[first.severity], _from_root(first.place) or first.file
    out.print(
        f"[{style}]{first.severity}[/] {escape(place)} "
        f"[dim]{escape(f'{first.check} {first.kind}')} ({first.state})[/]",
        soft_wrap=True,
    )
    other = f" [{_from_root(first.other_place)}]" if first.other_place else ""
    names = ", ".join(remark.element for remark in others)
    more = f"; likewise on {len(others)} more: {names}" if others else ""
    out.print(f"  {escape(first.message + other + more)}", soft_wrap=True)
    if first.before is not None:
        out.print(f"  {escape(_before(first))}", style="dim", soft_wrap=True)


def summary(check: RepositoryCheck) -> str:
    """Returns how much was found, in a line."""
    parts = [f"{check.failures} to mend"]
    counts = {state: sum(r.state is state for r in check.remarks) for state in State}
    minor = sum(r.state is not State.KNOWN and not r.fails for r in check.remarks)
    parts += [f"{minor} of less severity than fails"] * bool(minor)
    parts += [f"{counts[State.KNOWN]} known"] * bool(counts[State.KNOWN])
    parts += [f"{len(check.stale)} stale"] * bool(check.stale)
    text = ", ".join(parts)
    return f"{text}; the baseline is written: {check.baseline}" if check.updated else text


def _before(remark: Remark) -> str:
    before = remark.before or {}
    values = (
        f"{value}" if name == "message" else f"{name} {value}" for name, value in before.items()
    )
    return f"the baseline has: {', '.join(values)}"


def _what_of_stale(check: RepositoryCheck) -> str:
    return "; it was taken out" if check.updated else "; --update-baseline takes it out"


def _from_root(place: str | None) -> str:
    """Returns ``file:line`` with the file as CI services find it."""
    file, line = Annotation("", "", "", place).file_and_line
    if not file:
        return ""
    return from_root(file) if line is None else f"{from_root(file)}:{line}"


def remarks(check: RepositoryCheck, *, in_a_change: bool = False) -> list[Annotation]:
    """Returns the remarks as annotations; what fails is an error, whatever its severity.

    Args:
        check: The check.
        in_a_change: For the page of a change, where what is told of the lines that it touches alone
            is seen: a difference is told where its value is another one than the baseline's, or in
            both files.
    """
    found = [
        _annotation(remark, place)
        for remark in check.remarks
        for place in (_places(remark) if in_a_change else [remark.place])
    ]
    found += [
        Annotation(
            "notice",
            "stale baseline",
            f"{entry}: it does not occur any more{_what_of_stale(check)}",
            check.baseline,
            rule="check/stale",
            about="an entry of the baseline does not occur any more",
            known=False,
        )
        for entry in check.stale
    ]
    return found


def _places(remark: Remark) -> list[str | None]:
    """Returns where a change may have brought a remark in."""
    places = [place for place in (remark.place, remark.other_place) if place]
    before, now = remark.before or {}, remark.values
    moved = [side for side in ("urdf", "mjcf") if before and before.get(side) != now.get(side)]
    if len(places) == 2 and len(moved) == 1:
        return [places[0] if moved == ["urdf"] else places[1]]
    return [*places] or [None]


def _annotation(remark: Remark, place: str | None) -> Annotation:
    both = (remark.place, remark.other_place)
    others = [_from_root(one) for one in both if one and one != place]
    other = f" [{others[0]}]" if others else ""
    before = f"; {_before(remark)}" if remark.before is not None else ""
    return Annotation(
        "error" if remark.fails else LEVELS[remark.severity],
        remark.subject,
        f"{remark.message}{other}{before}",
        place,
        rule=f"{remark.check}/{remark.kind}",
        about=remark.about,
        known=remark.state is State.KNOWN,
    )


def unknown(annotations: list[Annotation]) -> list[Annotation]:
    """Leaves out what the baseline has: nobody is reminded of it at every change."""
    return [annotation for annotation in annotations if not annotation.known]


def cases(check: RepositoryCheck) -> Iterator[Case]:
    """Yields a case per pair that was compared, and per file that was audited."""
    for pair in check.pairs:
        if len(pair.files) > 1:
            own = [r for r in check.remarks if r.check == "crosscheck" and r.pair == pair.name]
            yield Case(f"{pair.name}: crosscheck", _failure(own))
    files = [file for pair in check.pairs for file in pair.files]
    files += [remark.file for remark in check.remarks if remark.check == "audit"]
    for file in dict.fromkeys(files):
        own = [r for r in check.remarks if r.check == "audit" and r.file == file]
        yield Case(f"{file}: audit", _failure(own))


def _failure(remarks: list[Remark]) -> str | None:
    lines = [f"{_from_root(r.place)}: {r.message}" for r in remarks if r.fails]
    return "\n".join(lines) or None
