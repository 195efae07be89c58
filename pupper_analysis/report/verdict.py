"""A verdict in words: the one place that makes them, for terminals and pages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from rich.console import Console

from pupper_analysis.report.console import escape
from pupper_analysis.robot.as_published import Cause, ServosUsed
from pupper_analysis.simulation.verdict import Ending, Verdict

_TOLD = 3  # names that a clause lists


class Clause(NamedTuple):
    """A part of a verdict: a sentence of the catalogue of pages, with what stands in its braces."""

    good: bool
    sentence: str
    values: dict[str, str]

    def __str__(self) -> str:
        return self.sentence.format(**self.values)


def clauses(verdict: Verdict) -> tuple[Clause, ...]:
    """Returns what a verdict says: what decides it first, then what else it rests on."""
    said = (*_file_itself(verdict), *_computed(verdict), *_published(verdict), *_beyond(verdict))
    return tuple(sorted(said, key=lambda clause: clause.good != verdict.passed))


def in_words(verdict: Verdict) -> str:
    """Returns a verdict in one line."""
    return "; ".join(map(str, clauses(verdict)))


def word(verdict: Verdict) -> str:
    """Returns a verdict in a word or two, for tables."""
    if verdict.passed:
        alone = verdict.commands_alone in (None, Ending.HOLDS)
        return "HOLDS" if alone else "HOLDS with feed-forward"
    return "FAILS"


def print_verdict(out: Console, verdict: Verdict, name: str = "") -> None:
    """Prints a verdict in one line: what is good in it green, what decides against it red."""
    against = "yellow" if verdict.passed else "red"
    parts = []
    for clause in clauses(verdict):
        first, space, rest = escape(str(clause)).partition(" ")
        if first.isupper():
            first = f"[bold {'green' if clause.good else against}]{first}[/]"
        parts.append(first + space + rest)
    out.print((f"{escape(name)}: " if name else "") + "; ".join(parts), soft_wrap=True)


def _file_itself(verdict: Verdict) -> Iterator[Clause]:
    """Says what the file's own servos and keyframe do, if they do not hold it."""
    own, replaced = verdict.own, verdict.servos.replaced
    if own is not None and own.collapses:
        yield Clause(
            False,
            "COLLAPSES as published from its own keyframe {keyframe}, with its own ctrl: "
            "{height} m high, after {seconds} s {end} m"
            if own.own_ctrl
            else "COLLAPSES as published from its own keyframe {keyframe}, on its own servos: "
            "{height} m high, after {seconds} s {end} m",
            {
                "keyframe": own.keyframe,
                "height": f"{own.height:.3f}",
                "seconds": f"{own.duration:g}",
                "end": f"{own.end_height:.3f}",
            },
        )
    if replaced:
        yield Clause(
            False,
            "FAILS on the file's own servos, which cannot hold {joints} ({kinds})",
            {
                "joints": _listed(tuple(servo.joint for servo in replaced)),
                "kinds": ", ".join(dict.fromkeys(str(s.instead_of.value) for s in replaced)),
            },
        )


_COMPUTED = {
    Ending.FAILS: "FAILS in MuJoCo: {failures}",
    Ending.COLLAPSES: "COLLAPSES in MuJoCo: {failures}",
}
_ALONE = {
    Ending.FAILS: "FAILS on position commands alone: {failures}",
    Ending.COLLAPSES: "COLLAPSES on position commands alone: {failures}",
}


def _computed(verdict: Verdict) -> Iterator[Clause]:
    """Says how the simulations of the computed robot ended, and on which servos."""
    fed, alone = verdict.with_feedforward, verdict.commands_alone
    if fed is not Ending.HOLDS:
        yield Clause(False, _COMPUTED[fed], {"failures": "; ".join(verdict.failures)})
    else:
        numbers = {
            "seconds": f"{verdict.seconds:g}",
            "torque": f"{verdict.torque_error:.1e}",
            "force": f"{verdict.force_error:.1e}",
        }
        both = alone in (None, Ending.HOLDS)
        yield Clause(
            True,
            "HOLDS in MuJoCo for {seconds} s: torques within {torque}, forces within {force} of "
            "the prediction (relative to the largest)"
            if both
            else "HOLDS with gravity feed-forward in MuJoCo for {seconds} s: torques within "
            "{torque}, forces within {force} of the prediction (relative to the largest)",
            numbers,
        )
    if verdict.servos.made:
        yield on_servos(verdict.servos, good=fed is Ending.HOLDS)
    if fed is Ending.HOLDS and alone is not None and alone is not Ending.HOLDS:
        yield Clause(False, _ALONE[alone], {"failures": "; ".join(verdict.failures_alone)})


def _published(verdict: Verdict) -> Iterator[Clause]:
    """Says how far the robot as published is from the computed one."""
    published = verdict.published
    run = published.worst if published is not None else None
    if published is None or run is None or not published.differs:
        return
    yield Clause(
        False,
        "COLLAPSES as published, from the computed stand: torques are off by {torque} %, the "
        "height by {height} mm"
        if run.collapses
        else "as published, torques are off by {torque} %, the height by {height} mm",
        {"torque": f"{100 * run.torque_error:.2g}", "height": f"{1e3 * run.height_error:+.2f}"},
    )
    for cause in published.causes:
        yield Clause(False, "the cause is {cause}", {"cause": cause_in_words(cause)})


def _beyond(verdict: Verdict) -> Iterator[Clause]:
    """Says which motors are beyond their limits, and what grows."""
    if verdict.overloaded:
        yield Clause(
            False,
            "OVERLOADED: with the contact forces that last the motors cannot hold it: {joints}",
            {"joints": ", ".join(verdict.overloaded)},
        )
    if verdict.doubling_time is not None and math.isfinite(verdict.doubling_time):
        yield Clause(
            False, "what deviates doubles every {time} s", {"time": f"{verdict.doubling_time:.3g}"}
        )


def on_servos(servos: ServosUsed, *, good: bool) -> Clause:
    """Says that a result rests on servos that were made up, and on which."""
    return Clause(
        good,
        "on servos that were made up at {count} joints (kp {kp} N m/rad, kd {kd} N m s/rad)",
        {"count": str(len(servos.made)), "kp": _span(servos.kp), "kd": _span(servos.kd)},
    )


def cause_in_words(cause: Cause) -> str:
    """Says what makes a file do other than predicted, and where it stands."""
    where = "" if cause.line is None else f", line {cause.line}"
    return f"{cause.code}: {_listed(cause.elements)}{where}"


def _listed(names: tuple[str, ...]) -> str:
    more = len(names) - _TOLD
    return ", ".join(names[:_TOLD]) + (f" and {more} more" if more > 0 else "")


def _span(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
