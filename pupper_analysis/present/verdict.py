"""A verdict in words: the one place that makes them, for terminals and pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Group,
    Quantity,
    Severity,
    Term,
    diagnose,
)
from pupper_analysis.models.transmission import MadeServo
from pupper_analysis.present.document import Block, Document, Name, Text, Words, text
from pupper_analysis.robot.as_published import (
    Cause,
    OwnCommands,
    OwnRun,
    Published,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.simulation.verdict import (
    UNKNOWN_CODES,
    Ending,
    Question,
    Verdict,
    VerdictCode,
)

MAX_NAMED_JOINTS = 3
"""Joints that are named one by one, with what the file has there."""


@dataclass(frozen=True)
class Clause:
    """A part of a verdict.

    Attributes:
        good: Whether it speaks for the stand.
        message: What it says.
    """

    good: bool
    message: Diagnostic

    def __str__(self) -> str:
        return str(self.message)


def verdict_clauses(verdict: Verdict) -> tuple[Clause, ...]:
    """Returns what a verdict says: what decides it first, then what else it rests on."""
    own, fails = (
        tuple(make_keyframe_run_clauses(verdict.own)),
        verdict.code is VerdictCode.OWN_DRIVES_FAIL,
    )
    deciding = [one for one in verdict.remarks if one.code == _DECIDING.get(verdict.code)]
    messages = (
        *(Clause(False, remark) for remark in deciding),
        *(own if fails else ()),
        *_replaced(verdict.servos.replaced),
        *_computed(verdict),
        *(Clause(remark.severity is not Severity.ERROR, remark) for remark in verdict.remarks),
        *_creep(verdict),
        *(Clause(True, note) for note in verdict.notes),
        *make_published_clauses(verdict.published),
        *_beyond(verdict),
        *(() if fails else own),
    )
    once = {str(clause): clause for clause in messages}  # a cause is one, whatever it makes fail
    return tuple(sorted(once.values(), key=lambda clause: clause.good != verdict.passed))


def format_verdict(verdict: Verdict) -> str:
    """Returns a verdict in one line."""
    return "; ".join(map(str, verdict_clauses(verdict)))


_DECIDING = {
    VerdictCode.LIMITS_UNKNOWN: "torque-limits-unknown",
    VerdictCode.MASSES_UNKNOWN: "link-masses-unknown",
}
"""Codes of the remarks that decide the verdicts ``UNKNOWN_CODES``."""

_WORDS = {
    Question.STANDS: ("HOLDS", "FAILS"),
    Question.CARRIES: ("carries", "FAILS"),
    Question.TRACKED: ("tracked", "FAILED"),
    Question.LASTS: ("lasts", "FAILS"),
}
"""What it does, and what it does else, by what is asked."""


def get_verdict_key(verdict: Verdict) -> str:
    """Returns a verdict in a word or two, for tables."""
    if verdict.code in UNKNOWN_CODES:
        return "UNKNOWN"
    if _disagrees(verdict):
        return "DISAGREES"
    alone = verdict.commands_alone in (None, Ending.HOLDS)
    if verdict.passed and not alone:
        return "HOLDS with feed-forward"
    return _WORDS[verdict.asked][0 if verdict.passed else 1]


def _disagrees(verdict: Verdict) -> bool:
    """Return True if the robot stands in MuJoCo, and not as predicted: prepared or as published."""
    if verdict.code is VerdictCode.DIFFERS_AS_PUBLISHED:
        run = None if verdict.published is None else verdict.published.worst
        return run is not None and not run.collapses
    return verdict.code is VerdictCode.DISAGREES


def clause_text(clause: Clause) -> Text:
    """Returns a clause in both languages."""
    message = clause.message
    return Text(str(message), lambda: message.text("zh"), "good" if clause.good else "bad")


def verdict_lines(verdict: Verdict) -> tuple[Text, ...]:
    """Returns what a verdict says, a line each; against one that has passed, warnings."""
    lines = map(clause_text, verdict_clauses(verdict))
    if not verdict.passed:
        return tuple(lines)
    return tuple(line.with_mark("warn") if line.mark == "bad" else line for line in lines)


def split_verdict_lines(verdict: Verdict) -> tuple[tuple[Text, ...], tuple[Text, ...]]:
    """Returns a verdict's lines: what is against it, assumed or asked for, and the others.

    What the file does by itself is among the first, good or not: no verdict goes without it.
    """
    clauses, lines = verdict_clauses(verdict), verdict_lines(verdict)
    quiet = [
        one.good
        and one.message.severity is not Severity.WARNING
        and one.message.group is not Group.ASSUMED
        and one.message.code not in _ALWAYS_SAID
        for one in clauses
    ]
    first = tuple(line for line, less in zip(lines, quiet, strict=True) if not less)
    return first, tuple(line for line, less in zip(lines, quiet, strict=True) if less)


_LEAST_DROP = 1e-3
"""Clearance at reset (m) above which the line of a file's own run states it."""

_ALWAYS_SAID = ("servos-given", "own-run", "own-run-diverges")
"""Codes of lines that are read first, whatever they say."""


class JudgedResult(Protocol):
    """A result that has a verdict."""

    @property
    def name(self) -> str:
        """The robot's name."""

    @property
    def passed(self) -> bool:
        """Whether the verdict is good."""

    @property
    def verdict(self) -> Verdict:
        """Whether it does what is asked, and what that rests on."""


def judged_document(
    kind: Words,
    judged: JudgedResult,
    blocks: Iterable[Block],
    answer: Iterable[Words],
    *,
    details: Iterable[Words] = (),
    failures: Iterable[Words] = (),
    word: Words | None = None,
    notes: Iterable[Words] = (),
) -> Document:
    """Returns the document of a result that is judged, whose head is its answer.

    The one rule of short answers: the verdict and what is against it, the key figures, and what was
    assumed for it. What else the verdict rests on, and all tables, a terminal has with -v.

    Args:
        kind: What is shown.
        judged: The result.
        blocks: Its tables and plots.
        answer: Its key figures: some three lines.
        details: What else is shown of it.
        failures: What is against it besides the verdict.
        word: The verdict in a word or two, if it is another than the judge's.
        notes: What was assumed, found or left out on the way.
    """
    first, more = split_verdict_lines(judged.verdict)
    return Document(
        kind,
        Name(judged.name),
        tuple(blocks),
        passed=judged.passed,
        verdict=word or verdict_word(judged.verdict),
        failures=(*(() if judged.passed else first), *failures),
        findings=(*answer, *(first if judged.passed else ())),
        details=(*details, *more),
        brief=True,
        notes=tuple(notes),
    )


def verdict_word(verdict: Verdict) -> Text:
    """Returns a verdict in a word or two."""
    return qualify_verdict_word(get_verdict_key(verdict), verdict.converted)


def qualify_verdict_word(key: str, converted: str) -> Text:
    """Returns the word of a verdict; of a good one it tells if both models are of one file.

    Args:
        key: The word's, of the catalogue.
        converted: Which of the robot's models was made of the other one, if one was.
    """
    word = text(key)
    good = converted and key not in ("FAILS", "FAILED", "DISAGREES", "UNKNOWN")
    return text("verdict-from-one-file", word=word) if good else word


def make_keyframe_run_clauses(own: OwnRun | None) -> Iterator[Clause]:
    """Says what a file does by itself, whatever comes of it: a line for each run."""
    for run in () if own is None else (own, *((own.held,) if own.held else ())):
        how: dict[str, Any] = {
            "imported": run.imported,
            "missing": run.missing,
            "step": None if run.timestep is None else Quantity(run.timestep, "s"),
            "keyframe": run.keyframe or None,
            "absent": run.commands is OwnCommands.ABSENT,
            "angles": run.commands is OwnCommands.ANGLES,
        }
        if run.diverged:
            yield Clause(False, diagnose("own-run-diverges", **how))
            continue
        how["standing"] = run.standing
        joint = run.unheld or run.worst
        if joint is not None:
            how |= {"off": Quantity(abs(joint.off), "rad"), "drive": Term(joint.drive.value)}
        message = diagnose(
            "own-run",
            collapses=run.collapses and not run.lifted,
            lifted=run.lifted,
            gives=(run.left or run.unheld is not None) and not run.collapses,
            place=run.gone,
            duration=Quantity(run.duration, "s"),
            height=Quantity(run.height, "m"),
            drop=Quantity(run.clearance, "m") if run.clearance > _LEAST_DROP else None,
            end=Quantity(run.end_height, "m"),
            lean=Quantity(run.lean, "rad"),
            away=Quantity(run.away, "m"),
            joint=None if joint is None else joint.joint,
            commanded=joint is not None and joint.commanded_away,
            **how,
        )
        yield Clause(not (run.falls or run.tilted), message)
    for cause in () if own is None else own.causes:
        yield Clause(False, cause_text(cause))


def _replaced(replaced: tuple[MadeServo, ...]) -> Iterator[Clause]:
    """Says which of the file's own servos do not hold what they are meant to."""
    if replaced:
        joints = [servo.joint for servo in replaced]
        kinds = dict.fromkeys(Term(servo.instead_of.value) for servo in replaced)
        yield Clause(False, diagnose("own-servos-fail", joints=joints, kinds=kinds))


def _computed(verdict: Verdict) -> Iterator[Clause]:
    """Says how the simulations of the computed robot ended, and on which servos."""
    fed, alone = verdict.with_feedforward, verdict.commands_alone
    if fed is Ending.HOLDS and verdict.asked is not Question.STANDS:
        pass  # what it carries, and how it follows, is told beside it
    elif fed is Ending.UNTRIED:
        message = diagnose("in-balance", within=not verdict.overloaded)
        yield Clause(
            verdict.code is not VerdictCode.IN_BALANCE, message
        )  # what decides stands first
    elif fed is not Ending.HOLDS:
        message = diagnose(
            "fails-in-mujoco",
            collapses=fed is Ending.COLLAPSES,
            disagrees=fed is Ending.DISAGREES,
            fails=fed is Ending.FAILS,
            failures=verdict.failures,
        )
        yield Clause(False, message)
    else:
        message = diagnose(
            "holds-in-mujoco",
            one=bool(verdict.converted),
            both=alone in (None, Ending.HOLDS),
            duration=Quantity(verdict.seconds, "s"),
            torque=_within(verdict.torque_error),
            force=_within(verdict.force_error),
        )
        yield Clause(True, message)
    if verdict.servos.made:
        yield make_servo_clause(verdict.servos, good=fed is Ending.HOLDS)
    elif verdict.servos.source is ServoSource.GIVEN and fed is not Ending.UNTRIED:
        yield Clause(fed is Ending.HOLDS, diagnose("servos-given", **_gains(verdict.servos)))
    if fed is Ending.HOLDS and alone is not None and alone is not Ending.HOLDS:
        collapses, failures = alone is Ending.COLLAPSES, verdict.failures_alone
        yield Clause(False, diagnose("fails-alone", collapses=collapses, failures=failures))


def make_published_clauses(published: Published | None) -> Iterator[Clause]:
    """Says how far the robot as published is from the computed one."""
    if published is None:
        return
    run = published.worst
    if run is not None and run.collapses:
        yield Clause(False, diagnose("collapses-as-published"))
    elif run is not None:
        height = None if run.height_error is None else Quantity(run.height_error, "m")
        torque = Quantity(run.torque_error, "1")
        joint = Quantity(run.joint_error, "rad")
        message = diagnose("off-as-published", torque=torque, joint=joint, height=height)
        yield Clause(False, message)
    for cause in published.causes:
        yield Clause(False, cause_text(cause))


def cause_text(cause: Cause) -> Diagnostic:
    """Tells what makes a file differ from what is computed.

    Raises:
        KeyError: If its code is unknown.
    """
    if cause.code == "pair":
        return diagnose("files-differ", difference=cause.difference)
    return diagnose(_CAUSES[cause.code], names=cause.elements, line=cause.line)


_CAUSES = {
    "exclude": "excluded-from-touching",
    "override": "contacts-overridden",
    "actuatorgroupdisable": "actuators-disabled",
    "weld": "weld-holds-it",
    "connect": "connect-holds-it",
    "ctrlrange": "ctrlrange-cuts-off",
    "forcerange": "forcerange-cuts-off",
    "actuatorfrcrange": "actuatorfrcrange-cuts-off",
    "motors-elsewhere": "motors-elsewhere-push",
    "timeconst": "timeconst-too-long",
    "loose-joints": "loose-joints-move",
    "shapes-beside-feet": "shapes-kept-from-ground",
    "obstacles": "obstacles-touch",
    "balls": "balls-for-meshes",
    "other-drive": "servos-for-actuators",
    "timestep": "timestep-too-long",
    "iterations": "solver-too-rough",
    "bias": "servos-are-biased",
    "gain": "gain-is-no-stiffness",
    "delay": "servos-are-late",
    "gear": "gear-is-negative",
    "spring": "springs-pull",
    "range": "range-stops",
    "fluid": "fluid-drags",
    "gravity": "gravity-aside",
    "slippery": "contacts-slip",
    "soft": "contacts-give-way",
    "ctrl-absent": "keyframe-states-no-ctrl",
    "ctrl-elsewhere": "keyframe-commands-another-pose",
    "angles-to-motors": "motors-commanded-angles",
    "soft-servos": "servos-too-soft",
    "joint-unheld": "joint-held-by-nothing",
    "gives-way": "cause-not-found",
    "diverges": "simulation-diverges",
    "base-held": "base-held-as-published",
    "ground": "ground-not-level-as-published",
}
"""{code of a cause: what is said of it}, where its elements and its line say all."""


def _within(error: float | None) -> Quantity | None:
    """Returns a share that is said to be within; what is less than a millionth is rounded up."""
    return None if error is None else Quantity(max(error, 1e-6), "1")


def _beyond(verdict: Verdict) -> Iterator[Clause]:
    """Says which motors are beyond their limits, and what grows."""
    if verdict.overloaded:
        yield Clause(
            False,
            diagnose(
                "motors-overloaded",
                joints=verdict.overloaded,
                standing=verdict.force_error is not None,
            ),
        )
    if math.isfinite(verdict.doubling_time) and verdict.with_feedforward is Ending.UNTRIED:
        time = Quantity(verdict.doubling_time, "s")
        yield Clause(False, diagnose("deviation-doubles", doubling_time=time))


def _creep(verdict: Verdict) -> Iterator[Clause]:
    """State how fast the robot creeps; as a warning if that matters."""
    creep = verdict.creep
    if creep is None or verdict.with_feedforward is Ending.COLLAPSES:
        return
    message = diagnose(
        "stand-creeps",
        severity=Severity.WARNING if creep.matters else Severity.NOTE,
        duration=Quantity(creep.duration, "s"),
        speed=Quantity(creep.speed, "m/s"),
        rate=Quantity(creep.rate, "rad/s"),
    )
    yield Clause(True, message)


def make_servo_clause(servos: ServosUsed, *, good: bool) -> Clause:
    """Says that a result rests on servos that were made up, and on which."""
    few = servos.made if len(servos.made) <= MAX_NAMED_JOINTS else ()
    message = diagnose(
        "on-servos-made-up",
        count=len(servos.made),
        names=[servo.joint for servo in few],
        kinds=dict.fromkeys(Term(servo.instead_of.value) for servo in few),
        **_gains(servos),
    )
    return Clause(good, message)


def _gains(servos: ServosUsed) -> dict[str, Any]:
    """Returns the gains of servos, and the greatest where they are not alike."""
    (kp, kp_most), (kd, kd_most) = servos.kp, servos.kd
    return {
        "kp": kp,
        "kp_most": kp_most if kp_most != kp else None,
        "kd": kd,
        "kd_most": kd_most if kd_most != kd else None,
    }
