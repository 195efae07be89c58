"""A verdict in words: the one place that makes them, for terminals and pages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from pupper_analysis.models.joint_drives import MadeServo
from pupper_analysis.report.document import Said, Text
from pupper_analysis.report.html.words import text
from pupper_analysis.robot.as_published import OwnRun, Published, ServoSource, ServosUsed
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import Ending, Verdict, VerdictCode

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
    said = (
        *_file_itself(verdict.own, verdict.servos.replaced),
        *_computed(verdict),
        *_published(verdict.published),
        *_beyond(verdict),
    )
    return tuple(sorted(said, key=lambda clause: clause.good != verdict.passed))


def of_the_file(robot: Robot) -> tuple[Clause, ...]:
    """Returns what is to be said of a robot's MJCF as it was published, if anything is."""
    bad = tuple(servo for servo in robot.description.made_servos if servo.instead_of.bad)
    return (*_file_itself(robot.own_run, bad), *_published(robot.published))


def in_words(verdict: Verdict) -> str:
    """Returns a verdict in one line."""
    return "; ".join(map(str, clauses(verdict)))


def word(verdict: Verdict) -> str:
    """Returns a verdict in a word or two, for tables."""
    if verdict.passed:
        alone = verdict.commands_alone in (None, Ending.HOLDS)
        return "HOLDS" if alone else "HOLDS with feed-forward"
    return "FAILS"


def clause_text(clause: Clause) -> Text:
    """Returns a clause in both languages."""
    values = {name: Said(value) for name, value in clause.values.items()}
    return text(clause.sentence, **values).marked("good" if clause.good else "bad")


def verdict_lines(verdict: Verdict) -> tuple[Text, ...]:
    """Returns what a verdict says, a line each; against one that has passed, warnings."""
    lines = map(clause_text, clauses(verdict))
    if not verdict.passed:
        return tuple(lines)
    return tuple(line.marked("warn") if line.mark == "bad" else line for line in lines)


def verdict_word(verdict: Verdict) -> Text:
    """Returns a verdict in a word or two."""
    return text(word(verdict))


_OWN = {
    (True, False): "COLLAPSES as published from its own keyframe {keyframe}, with its own ctrl: "
    "{height} m high, after {seconds} s {end} m",
    (False, False): "COLLAPSES as published from its own keyframe {keyframe}, on its own servos: "
    "{height} m high, after {seconds} s {end} m",
    (True, True): "DIVERGES as published from its own keyframe {keyframe}, with its own ctrl",
    (False, True): "DIVERGES as published from its own keyframe {keyframe}, on its own servos",
}

_GONE = (
    "COLLAPSES as published from its own keyframe {keyframe}: it leaves its place; {height} m "
    "high, after {seconds} s {end} m, and {away} m away"
)


def _file_itself(own: OwnRun | None, replaced: tuple[MadeServo, ...]) -> Iterator[Clause]:
    """Says what the file's own servos and keyframe do, if they do not hold it."""
    if own is not None and own.collapses:
        numbers = {"keyframe": own.keyframe, "height": f"{own.height:.3f}"}
        numbers |= {"seconds": f"{own.duration:g}", "end": f"{own.end_height:.3f}"}
        text = _OWN[own.own_ctrl, own.diverged]
        if own.diverged:
            numbers = {"keyframe": own.keyframe}
        elif own.gone:
            numbers |= {"away": f"{own.away:.3f}"}
            text = _GONE
        yield Clause(False, text, numbers)
    if own is not None and own.leaves:
        yield Clause(
            False,
            "as published, from its own keyframe {keyframe} its own ctrl takes a joint {angle} rad "
            "away: it is that of another pose",
            {"keyframe": own.keyframe, "angle": f"{own.joint_error:.2g}"},
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
    if fed is Ending.UNTRIED:
        within = not verdict.overloaded
        yield Clause(
            verdict.code is not VerdictCode.IN_BALANCE,  # what decides stands first
            "in balance, within the motors' limits; not simulated yet"
            if within
            else "in balance; not simulated yet",
            {},
        )
    elif fed is not Ending.HOLDS:
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
    elif verdict.servos.source is ServoSource.GIVEN and fed is not Ending.UNTRIED:
        gains = {"kp": _span(verdict.servos.kp), "kd": _span(verdict.servos.kd)}
        given = "on servos as given (kp {kp} N m/rad, kd {kd} N m s/rad)"
        yield Clause(fed is Ending.HOLDS, given, gains)
    if fed is Ending.HOLDS and alone is not None and alone is not Ending.HOLDS:
        yield Clause(False, _ALONE[alone], {"failures": "; ".join(verdict.failures_alone)})


def _published(published: Published | None) -> Iterator[Clause]:
    """Says how far the robot as published is from the computed one."""
    if published is None or not published.differs:
        return
    run = published.worst
    if run is not None and run.collapses:
        yield Clause(False, "COLLAPSES as published, from the computed stand", {})
    elif run is not None:
        height = f"{1e3 * run.height_error:+.2g}"
        yield Clause(
            False,
            "as published, torques are off by {torque} %, the height by {height} mm",
            {"torque": f"{100 * run.torque_error:.2g}", "height": height},
        )
    for cause in published.causes:
        where = "" if cause.line is None else f" (line {cause.line})"
        yield Clause(False, CAUSES[cause.code], {"names": _listed(cause.elements) + where})


CAUSES = {
    "exclude": "an <exclude> keeps from touching: {names}",
    "override": "its contacts are overridden by {names}",
    "actuatorgroupdisable": "actuators are switched off by {names}",
    "solver": "MuJoCo's sparse solver leaves forces out: {names}",
    "weld": "a <weld> holds it: {names}",
    "connect": "a <connect> holds it: {names}",
    "ctrlrange": "the ctrlrange cuts commands off: {names}",
    "forcerange": "the forcerange cuts torques off: {names}",
    "actuatorfrcrange": "the actuatorfrcrange cuts torques off: {names}",
    "motors-elsewhere": "motors that are not commanded push: {names}",
    "pair-friction": "the friction of a <pair> is not alike along its axes: {names}",
    "timeconst": "the timeconst of servos is longer than any stand lasts: {names}",
    "loose-joints": "joints that only the MJCF has move: {names}",
    "flex": "flexible bodies touch: {names}",
    "shapes-beside-feet": "shapes were kept from touching the ground: {names}",
    "obstacles": "what stands in the world touches: {names}",
    "balls": "balls took the place of the meshes of {names}",
    "other-drive": "servos took the place of actuators that are none: {names}",
    "pair": "URDF and MJCF are not of one robot, crosscheck says where{names}",
    "base-held": "as published, its base is held in the world, or part of it: {names}",
    "ground": "as published, its ground is not level{names}",
}
"""What makes a file differ from what is computed, by ``Cause.code``."""


def _beyond(verdict: Verdict) -> Iterator[Clause]:
    """Says which motors are beyond their limits, and what grows."""
    if verdict.overloaded:
        yield Clause(
            False,
            "OVERLOADED: with the contact forces that last the motors cannot hold it: {joints}",
            {"joints": ", ".join(verdict.overloaded)},
        )
    if math.isfinite(verdict.doubling_time):
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


def _listed(names: tuple[str, ...]) -> str:
    more = len(names) - _TOLD
    return ", ".join(names[:_TOLD]) + (f" and {more} more" if more > 0 else "")


def _span(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
