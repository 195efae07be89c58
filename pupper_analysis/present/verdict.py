"""Express a verdict as sentences in English and Chinese, for terminals and pages.

Input is a ``Verdict``. Outputs are its statements (`Clause`), sorted by importance, and the
document of a result whose answer is the verdict.
"""

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
from pupper_analysis.present.document import (
    Block,
    Document,
    Name,
    NextStep,
    Text,
    Words,
    diagnostic_text,
    text,
)
from pupper_analysis.robot.as_published import (
    Cause,
    OwnCommands,
    OwnRun,
    Published,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.simulation.verdict import (
    IMPOSSIBLE_CODES,
    TIE_MESSAGE_CODES,
    TWO_ROBOTS_CODE,
    UNKNOWN_CODES,
    Ending,
    Question,
    Verdict,
    VerdictCode,
)

MAX_NAMED_JOINTS = 3
"""Largest number of added servos for which a message lists the names of the joints. Chosen, not
tuned.
"""


@dataclass(frozen=True)
class Clause:
    """Statement of a verdict: a reason for or against the stand.

    Attributes:
        good: True if the statement supports the stand.
        message: Statement.
    """

    good: bool
    message: Diagnostic

    def __str__(self) -> str:
        return str(self.message)


def verdict_clauses(verdict: Verdict) -> tuple[Clause, ...]:
    """List the statements of a verdict in the order of display, without repetitions.

    Statements that agree with the verdict come first. In a bad verdict, causes (`_CAUSES`) follow
    directly after the first statement, overloaded motors first.
    """
    run_clauses = tuple(make_keyframe_run_clauses(verdict.keyframe_run))
    published_clauses = tuple(make_published_clauses(verdict.published))
    stands_otherwise = (
        verdict.code is VerdictCode.FAILS
        and verdict.with_feedforward is Ending.DISAGREES
        and not verdict.overloaded_motors
    )
    fails = verdict.code is VerdictCode.OWN_DRIVES_FAIL or stands_otherwise
    # No simulation of a file with an impossible mass or inertia has a meaning.
    deciding = [
        remark
        for remark in verdict.remarks
        if remark.code == _DECIDING_REMARKS.get(verdict.code)
        or (not verdict.passed and remark.code in IMPOSSIBLE_CODES)
    ]
    messages = (
        *(Clause(False, remark) for remark in deciding),
        *(run_clauses if fails else ()),
        *(published_clauses if stands_otherwise else ()),
        *make_replaced_clauses(verdict.servos.replacement_servos),
        *_make_simulation_clauses(verdict),
        *(
            Clause(remark.severity is not Severity.ERROR, remark)
            for remark in verdict.remarks
            if remark not in deciding
        ),
        *_make_creep_clauses(verdict),
        *(Clause(True, note) for note in verdict.notes),
        *(() if stands_otherwise else published_clauses),
        *_make_limit_clauses(verdict),
        *(() if fails else run_clauses),
    )
    once = {str(clause): clause for clause in messages}  # a cause may be stated for two failures
    ordered = sorted(once.values(), key=lambda clause: clause.good != verdict.passed)
    if not verdict.passed:
        ordered[1:] = sorted(ordered[1:], key=_rank_cause)
    return tuple(ordered)


OVERLOAD_CODE = "motors-overloaded"
"""Code of the statement that motors exceed their effort limits."""


def _rank_cause(clause: Clause) -> int:
    """Return the rank of a statement in a bad verdict: overloaded motors, other causes, the rest.

    Overloaded motors precede a range that limits motors, which names all motors with this range.
    """
    if clause.message.code == OVERLOAD_CODE:
        return 0
    return 1 if clause.message.code in _CAUSES else 2


def format_verdict(verdict: Verdict) -> str:
    """Join the English statements of a verdict to a single line, with semicolons."""
    return "; ".join(map(str, verdict_clauses(verdict)))


_DECIDING_REMARKS = {
    VerdictCode.LIMITS_UNKNOWN: "torque-limits-unknown",
    VerdictCode.MASSES_UNKNOWN: "link-masses-unknown",
}
"""{code of a verdict: code of the remark that is the reason for the verdict}. This remark precedes
the statements on simulations.
"""

_VERDICT_WORDS = {
    Question.STANDS: ("HOLDS", "FAILS"),
    Question.CARRIES: ("carries", "FAILS"),
    Question.TRACKED: ("tracked", "FAILED"),
    Question.LASTS: ("lasts", "FAILS"),
}
"""{question of a verdict: (word of a good verdict, word of a bad verdict)}, as keys of the text
catalogue."""


def get_verdict_key(verdict: Verdict) -> str:
    """Return the word of a verdict, such as "HOLDS" or "FAILS", as a key of the text catalogue."""
    if verdict.code in UNKNOWN_CODES:
        return "UNKNOWN"
    if _leaves_predicted_equilibrium(verdict):
        return "DISAGREES"
    alone = verdict.commands_alone in (None, Ending.HOLDS)
    if verdict.passed and not alone:
        return _QUALIFIED_KEY
    return _VERDICT_WORDS[verdict.question][0 if verdict.passed else 1]


_QUALIFIED_KEY = "HOLDS with feed-forward"
"""Key of the verdict that the stand holds only with feed-forward torques."""


def split_ties(ties: Iterable[Diagnostic]) -> tuple[str, tuple[Text, ...], tuple[Text, ...]]:
    """Split messages about ties to the world (`describe_ties`) into failures and conditions.

    Returns:
        Word of the verdict of a stand with these failures, as a key of the text catalogue, empty
        without a failure; texts of the failures; texts of the other messages.
    """
    errors = [tie for tie in ties if tie.severity is Severity.ERROR]
    other_ties = [tie for tie in ties if tie.severity is not Severity.ERROR]
    held = not TIE_MESSAGE_CODES.isdisjoint(tie.code for tie in errors)
    word = ("FAILS" if held else "DISAGREES") if errors else ""
    return (
        word,
        tuple(map(diagnostic_text, errors)),
        tuple(diagnostic_text(tie, "good") for tie in other_ties),
    )


def _leaves_predicted_equilibrium(verdict: Verdict) -> bool:
    """Return True if the verdict is that the robot stands, but not in the predicted equilibrium."""
    if verdict.code is VerdictCode.DIFFERS_AS_PUBLISHED:
        run = None if verdict.published is None else verdict.published.worst
        return run is not None and not run.collapses
    return verdict.code is VerdictCode.DISAGREES


def clause_text(clause: Clause) -> Text:
    """Convert a statement of a verdict to a text in English and Chinese, marked good or bad."""
    message = clause.message
    return diagnostic_text(message, "good" if clause.good else "bad")


def verdict_lines(verdict: Verdict) -> tuple[Text, ...]:
    """Return the statements of a verdict as texts with an emphasis (``Text.mark``).

    If the verdict is good, statements against the stand have the mark ``warn`` instead of ``bad``.
    """
    lines = map(clause_text, verdict_clauses(verdict))
    if not verdict.passed:
        return tuple(lines)
    return tuple(line.with_mark("warn") if line.mark == "bad" else line for line in lines)


def split_verdict_lines(
    verdict: Verdict, *, reason_first: bool = False
) -> tuple[tuple[Text, ...], tuple[Text, ...]]:
    """Divide the statements of a verdict: statements of the short answer, and further statements.

    The short answer contains statements against the stand, warnings and assumptions, for example.

    Args:
        verdict: Verdict.
        reason_first: Whether the reason for HOLDS only with gravity compensation precedes other
            statements.

    Returns:
        Lines of the short answer; further lines.
    """
    clauses, lines = verdict_clauses(verdict), verdict_lines(verdict)
    quiet = [
        clause.good
        and (
            clause.message.code == _DETAIL_CODE
            or (
                clause.message.severity is not Severity.WARNING
                and clause.message.group is not Group.ASSUMED
                and clause.message.code not in _LEADING_CODES
            )
        )
        for clause in clauses
    ]
    shown = [place for place, less in enumerate(quiet) if not less]
    if verdict.passed and reason_first:
        shown.sort(key=lambda place: clauses[place].message.code != _QUALIFYING_CODE)
    first = tuple(lines[place] for place in shown)
    return first, tuple(line for line, less in zip(lines, quiet, strict=True) if less)


def report_refused_file(verdict: Verdict) -> tuple[Text, ...]:
    """Return a warning that MuJoCo refuses the published file because files are missing, or ()."""
    run = verdict.keyframe_run
    if run is None or not run.missing:
        return ()
    names = [name.replace("\\", "/").rpartition("/")[2] for name in run.missing]
    return (diagnostic_text(diagnose("file-refused-by-mujoco", missing=names), "warn"),)


_MIN_STATED_CLEARANCE = 1e-3
"""Lower bound of the robot's height above the ground at reset [m], above which the message about
the simulation of the published file (`OwnRun`) states the height. Chosen, not tuned.
"""

_QUALIFYING_CODE = "fails-alone"
"""Code of the statement that explains the verdict HOLDS only with gravity compensation."""

_DETAIL_CODE = "own-run"
"""Code of the statement about the simulation of the published file (`OwnRun`). The short answer
omits the statement if it is favourable.
"""

_LEADING_CODES = ("servos-given",)
"""Codes of the statements that the short answer contains even if the statements support the stand.
"""


class JudgedResult(Protocol):
    """Result with a verdict."""

    @property
    def name(self) -> str:
        """Name of the robot."""

    @property
    def passed(self) -> bool:
        """True if the verdict is good."""

    @property
    def verdict(self) -> Verdict:
        """Verdict of the stand or motion, with its reasons."""


def judged_document(
    kind: Words,
    judged: JudgedResult,
    blocks: Iterable[Block],
    answer: Iterable[Words],
    *,
    details: Iterable[Words] = (),
    failures: Iterable[Words] = (),
    word: Words | None = None,
    limit: Words | None = None,
    limits: Iterable[Words] = (),
    causes: Iterable[Words] = (),
    leading: Iterable[Words] = (),
    number_first: bool = False,
    notes: Iterable[Words] = (),
    next_step: NextStep | None = None,
) -> Document:
    """Create the document of a result whose answer is a verdict, such as a stance.

    Args:
        kind: Kind of result, such as "stance" or "payload limit".
        judged: Result.
        blocks: Tables and plots.
        answer: At least one text: first the number that the user requested, such as the largest
            payload, then further numbers.
        details: Further statements.
        failures: Reasons against the result, in addition to the reasons of the verdict. Ignored if
            the verdict is good.
        word: Verdict in one or two words. Default: the word of ``judged.verdict``.
        limit: Cause that limits the first number of ``answer``, or a second number that belongs to
            the first, such as the base height.
        limits: Texts like ``limit``, if there are several. Ignored if ``limit`` is not None.
        causes: Causes of a bad verdict. Ignored if the verdict is good.
        leading: Reasons that precede all other reasons and the number. Ignored if the verdict is
            good.
        number_first: True if the number precedes the reasons even in a bad verdict. An example is a
            number that answers the question: "the largest payload is 0".
        notes: Assumptions, findings and omissions.
        next_step: Command to run next.
    """
    number, *others = answer
    limits = tuple(limits) if limit is None else (limit,)
    first, more = split_verdict_lines(judged.verdict, reason_first=not limits)
    reasons = () if judged.passed else (*first[:1], *causes, *first[1:], *failures)
    if number_first and reasons:
        reasons, findings = (*leading, number, *reasons), (*limits, *others)
    else:
        reasons = (*leading, *reasons) if reasons else ()
        # A tie of a link is a condition of all numbers, and precedes a second number.
        ties = [
            diagnostic_text(remark, "good")
            for remark in judged.verdict.remarks
            if remark.code == "link-tied"
        ]
        untied = (line for line in first if line not in ties)
        warnings = (*ties, *limits, *untied) if judged.passed else limits
        findings = (number, *report_refused_file(judged.verdict), *warnings, *others)
    return Document(
        kind,
        Name(judged.name),
        tuple(blocks),
        passed=judged.passed,
        verdict=word or verdict_word(judged.verdict),
        failures=reasons,
        findings=findings,
        details=(*details, *more),
        brief=True,
        notes=tuple(notes),
        next_step=next_step,
    )


def verdict_word(verdict: Verdict, *, ideal_servos: bool = False) -> Text:
    """Return the word that displays a verdict (HOLDS, FAILS ...), in English and Chinese.

    Restrictions are added to the word of a good verdict (`qualify_verdict_word`): a single model
    file, effort limits that look like placeholders, and with ``ideal_servos`` also that the
    simulated servos are ideal.
    """
    return qualify_verdict_word(
        get_verdict_key(verdict),
        verdict.converted,
        ideal_servos=ideal_servos,
        placeholder_limits=any(
            remark.code == "rests-on-placeholder-efforts" for remark in verdict.remarks
        ),
    )


def qualify_verdict_word(
    key: str, converted: str, *, ideal_servos: bool = False, placeholder_limits: bool = False
) -> Text:
    """Add restrictions to the word of a good verdict: a single model file, and ideal servos.

    The agreement of two models proves nothing if one was converted from the other.

    Args:
        key: Key of the word in the catalogue of texts, for example "HOLDS".
        converted: Model that was converted from the other model, ``urdf`` or ``mjcf``; empty if
            none was converted.
        ideal_servos: Whether the simulated servos would be unstable as an explicit PD controller,
            because of their damping. MuJoCo integrates them implicitly.
        placeholder_limits: Whether effort limits look like placeholders, such as 1000 N m. A load
            relative to them has no meaning.
    """
    word = text(key)
    restricted = converted or ideal_servos or placeholder_limits
    if key in ("FAILS", "FAILED", "DISAGREES", "UNKNOWN") or not restricted:
        return word
    if key == _QUALIFIED_KEY:  # the restriction leaves no room for the long form
        word = word.with_short_form(text("HOLDS with feed-forward, in short"))
    return text(
        "qualified-verdict",
        word=word,
        file=name_only_format(converted),
        single=bool(converted),
        ideal=ideal_servos,
        both=bool(converted) and ideal_servos,
        assumed=placeholder_limits,
        separated=placeholder_limits and (bool(converted) or ideal_servos),
    )


def name_only_format(converted: str) -> str:
    """Return the format of the only model file, "URDF" or "MJCF"; empty if there are both files.

    ``converted`` is the model that was converted from this file, ``urdf`` or ``mjcf``, or empty.
    """
    return {"urdf": "MJCF", "mjcf": "URDF"}.get(converted, "")


def make_keyframe_run_clauses(keyframe_run: OwnRun | None) -> Iterator[Clause]:
    """Yield the statements of a verdict about the simulation of the published file (`OwnRun`)."""
    for run in (
        ()
        if keyframe_run is None
        else (keyframe_run, *((keyframe_run.held,) if keyframe_run.held else ()))
    ):
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
        joint = run.unheld or run.lifted_leg or run.worst
        if joint is not None:
            how |= {"off": Quantity(abs(joint.off), joint.unit), "drive": Term(joint.drive.value)}
        leg = None if run.collapses or run.lifted_leg is None else run.lifted_leg.joint
        moved = run.has_left_stance and not run.collapses and leg is None
        message = diagnose(
            "own-run",
            collapses=run.collapses and not run.is_lifted,
            lifted=run.is_lifted,
            gives=(run.has_left_posture or run.unheld is not None) and not run.collapses,
            place=run.has_left_place or moved,
            leg=leg,
            moved=moved and not run.is_tilted,
            keeps=run.standing and leg is None and (run.is_tilted or not moved),
            duration=Quantity(run.duration, "s"),
            height=Quantity(run.height, "m"),
            drop=Quantity(run.clearance, "m") if run.clearance > _MIN_STATED_CLEARANCE else None,
            end=Quantity(run.end_height, "m"),
            lean=Quantity(run.lean, "rad"),
            away=Quantity(run.away, "m"),
            joint=None if joint is None else joint.joint,
            hung=joint is not None and not run.standing,
            commanded=joint is not None and joint.commanded_away,
            **how,
        )
        yield Clause(run.keeps_stance and not run.missing, message)
    for cause in () if keyframe_run is None else keyframe_run.causes:
        yield Clause(False, describe_cause(cause))


def make_replaced_clauses(replaced: tuple[MadeServo, ...]) -> Iterator[Clause]:
    """Yield the statement that the replaced servos of the file cannot hold the joints, if any."""
    if replaced:
        joints = [servo.joint for servo in replaced]
        kinds = dict.fromkeys(Term(servo.instead_of.value) for servo in replaced)
        yield Clause(False, diagnose("own-servos-fail", joints=joints, kinds=kinds))


def _make_simulation_clauses(verdict: Verdict) -> Iterator[Clause]:
    """Yield statements on how the simulations of the computed stand ended, and on the servos."""
    fed, alone = verdict.with_feedforward, verdict.commands_alone
    if fed is Ending.HOLDS and verdict.question is not Question.STANDS:
        pass  # the number of the result states this
    elif fed is Ending.UNTRIED:
        message = diagnose("in-balance", within=not verdict.overloaded_motors)
        # If the message decides, it is bad like the verdict, and precedes other statements.
        yield Clause(verdict.code is not VerdictCode.IN_BALANCE, message)
    elif fed is not Ending.HOLDS:
        message = diagnose(
            "fails-in-mujoco",
            collapses=fed is Ending.COLLAPSES,
            lifted=fed is Ending.LIFTED,
            disagrees=fed is Ending.DISAGREES,
            fails=fed is Ending.FAILS,
            failures=_select_stated_failures(verdict),
        )
        yield Clause(False, message)
    else:
        message = diagnose(
            "holds-in-mujoco",
            file=name_only_format(verdict.converted),
            both=alone in (None, Ending.HOLDS),
            duration=Quantity(verdict.seconds, "s"),
            torque=_make_error_quantity(verdict.torque_error),
            force=_make_error_quantity(verdict.force_error),
        )
        yield Clause(True, message)
    if verdict.servos.made:
        yield make_servo_clause(verdict.servos, good=fed is Ending.HOLDS)
    elif verdict.servos.source is ServoSource.GIVEN and fed is not Ending.UNTRIED:
        yield make_given_clause(verdict.servos, good=fed is Ending.HOLDS)
    if fed is Ending.HOLDS and alone is not None and alone is not Ending.HOLDS:
        collapses = alone is Ending.COLLAPSES
        failures = join_ground_touches(verdict.failures_alone)
        lifted = alone is Ending.LIFTED
        message = diagnose(
            "fails-alone",
            collapses=collapses,
            lifted=lifted,
            fails=not (collapses or lifted),
            failures=failures,
        )
        yield Clause(False, message)


def _select_stated_failures(verdict: Verdict) -> tuple[Diagnostic, ...]:
    """Select the failures of the simulation with feed-forward that the verdict reports.

    If URDF and MJCF describe different robots, this difference explains other deviations.
    """
    failures = join_ground_touches(verdict.failures)
    if verdict.with_feedforward is Ending.LIFTED:
        idle = tuple(failure for failure in failures if failure.code == "foot-idle")
        return idle or failures
    causes = tuple(failure for failure in failures if failure.code == TWO_ROBOTS_CODE)
    return causes if causes and verdict.with_feedforward is Ending.DISAGREES else failures


TOUCH_CODE = "body-touches-ground"
"""Code of a simulation's failure: a body other than a foot touches the ground."""


def join_ground_touches(failures: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Replace several failures "body touches the ground" by one failure with the earliest time."""
    failures = tuple(failures)
    touches = [
        failure
        for failure in failures
        if failure.code == TOUCH_CODE and not failure.values.get("surface")
    ]
    names = [failure.subject.name for failure in touches if failure.subject is not None]
    if len(names) < 2:
        return failures
    times = [time for failure in touches if isinstance(time := failure.values["time"], Quantity)]
    joined = diagnose(
        "bodies-touch-ground",
        names=names,
        time=min(times, key=lambda time: time.value, default=None),
    )
    place = failures.index(touches[0])
    other_failures = [failure for failure in failures if failure not in touches]
    return (*other_failures[:place], joined, *other_failures[place:])


def make_published_clauses(published: Published | None) -> Iterator[Clause]:
    """Yield statements on simulations of the published file that deviate from the stand."""
    if published is None:
        return
    run = published.worst
    if run is not None and run.collapses:
        code = "lifted-as-published" if run.is_lifted else "collapses-as-published"
        yield Clause(False, diagnose(code))
    elif run is not None:
        height = None if run.height_error is None else Quantity(run.height_error, "m")
        torque = Quantity(run.torque_error, "1")
        joint = Quantity(run.joint_error, run.joint_error_unit)
        message = diagnose("off-as-published", torque=torque, joint=joint, height=height)
        yield Clause(False, message)
    for cause in published.causes:
        yield Clause(False, describe_cause(cause))


def describe_cause(cause: Cause) -> Diagnostic:
    """Create the message that explains why the simulated unmodified file deviates from a stand.

    Raises:
        KeyError: If the code of the cause is unknown.
    """
    if cause.code == "pair":
        return diagnose(_FILES_DIFFER_CODE, difference=cause.difference)
    return diagnose(_CAUSE_MESSAGES[cause.code], names=cause.elements, line=cause.line)


_FILES_DIFFER_CODE = "files-differ"
"""Code of the statement that a robot's URDF and MJCF differ, with the first difference."""

_CAUSES = (
    _FILES_DIFFER_CODE,
    "support-disabled",
    "contacts-overridden",
    "actuators-disabled",
    "ctrlrange-cuts-off",
    "forcerange-cuts-off",
    "actuatorfrcrange-cuts-off",
    OVERLOAD_CODE,
    "weld-holds-it",
    "connect-holds-it",
    "tendon-holds-it",
    "base-tied",
    "link-tied",
    "keyframe-violates-constraints",
)
"""Codes of statements that explain a bad verdict, and follow directly after its first statement.
"""

_CAUSE_MESSAGES = {
    "flag": "support-disabled",
    "exclude": "excluded-from-touching",
    "override": "contacts-overridden",
    "actuatorgroupdisable": "actuators-disabled",
    "weld": "weld-holds-it",
    "connect": "connect-holds-it",
    "tendon": "tendon-holds-it",
    "ctrlrange": "ctrlrange-cuts-off",
    "forcerange": "forcerange-cuts-off",
    "actuatorfrcrange": "actuatorfrcrange-cuts-off",
    "motors-elsewhere": "motors-elsewhere-push",
    "timeconst": "timeconst-too-long",
    "loose-joints": "loose-joints-move",
    "ball-joints": "ball-joints-move",
    "shapes-beside-feet": "shapes-kept-from-ground",
    "obstacles": "obstacles-touch",
    "overlaps": "overlapping-bodies-touch",
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
    "keyframe-tilted": "keyframe-not-upright",
    "ctrl-elsewhere": "keyframe-commands-another-pose",
    "angles-to-motors": "motors-commanded-angles",
    "soft-servos": "servos-too-soft",
    "joint-unheld": "joint-held-by-nothing",
    "gives-way": "cause-not-found",
    "diverges": "simulation-diverges",
    "base-held": "base-held-as-published",
    "ground": "ground-not-level-as-published",
}
"""{code of a cause: code of the message}. The values of these messages are the names of the
elements and the line in the file."""


def _make_error_quantity(error: float | None) -> Quantity | None:
    """Convert a relative error [1] to a quantity of at least 1e-6; None stays None."""
    return None if error is None else Quantity(max(error, 1e-6), "1")


def _make_limit_clauses(verdict: Verdict) -> Iterator[Clause]:
    """Yield statements on overloaded motors, and on the time [s] in which a deviation doubles."""
    if verdict.overloaded_motors:
        yield Clause(
            False,
            diagnose(
                OVERLOAD_CODE,
                joints=verdict.overloaded_motors,
                standing=verdict.force_error is not None,
            ),
        )
    if math.isfinite(verdict.doubling_time) and verdict.with_feedforward is Ending.UNTRIED:
        time = Quantity(verdict.doubling_time, "s")
        yield Clause(False, diagnose("deviation-doubles", doubling_time=time))


def _make_creep_clauses(verdict: Verdict) -> Iterator[Clause]:
    """Yield a statement on creep: slow motion of a standing robot at the end of the simulation."""
    creep = verdict.creep
    if creep is None or verdict.with_feedforward in (Ending.COLLAPSES, Ending.LIFTED):
        return
    message = diagnose(
        "stand-creeps",
        severity=Severity.WARNING if creep.is_notable else Severity.NOTE,
        duration=Quantity(creep.duration, "s"),
        speed=Quantity(creep.speed, "m/s"),
        rate=Quantity(creep.rate, "rad/s"),
    )
    yield Clause(True, message)


def select_step_after_failure(verdict: Verdict, otherwise: NextStep) -> NextStep:
    """Select the command to propose after a failure: a check of the files, or ``otherwise``.

    The files are checked if they may explain the failure.
    """
    differs = verdict.code in (VerdictCode.DIFFERS_AS_PUBLISHED, VerdictCode.DISAGREES)
    two_robots = any(failure.code == TWO_ROBOTS_CODE for failure in verdict.failures)
    causes = () if verdict.published is None else verdict.published.causes
    if is_support_disabled(verdict):
        return NextStep("audit", of_mjcf=True)
    if not (differs or two_robots or any(cause.code == "pair" for cause in causes)):
        return otherwise
    return NextStep("audit" if verdict.converted else "crosscheck")


def is_support_disabled(verdict: Verdict) -> bool:
    """Return True if a flag of the MJCF that disables contacts or motors explains the failure."""
    published = verdict.published
    return published is not None and any(cause.code == "flag" for cause in published.causes)


def make_servo_clause(servos: ServosUsed, *, good: bool) -> Clause:
    """Create the statement that a result depends on added servos, with the range of the gains.

    ``good`` is True if the statement supports the stand.
    """
    few = servos.made if len(servos.made) <= MAX_NAMED_JOINTS else ()
    message = diagnose(
        "on-servos-made-up",
        count=len(servos.made),
        names=[servo.joint for servo in few],
        kinds=dict.fromkeys(Term(servo.instead_of.value) for servo in few),
        hangs=servos.hangs,
        **_describe_gains(servos),
    )
    return Clause(good, message)


def make_given_clause(servos: ServosUsed, *, good: bool) -> Clause:
    """Create the statement that a result depends on servo gains that the caller passed.

    ``good`` is True if the statement supports the stand.
    """
    return Clause(good, diagnose("servos-given", **_describe_gains(servos)))


def _describe_gains(servos: ServosUsed) -> dict[str, Any]:
    """Return the values of a message about servo gains: lowest and highest gains, and units.

    A highest gain (``kp_most``, ``kd_most``) is None if it equals the lowest gain.
    """
    (kp, kp_most), (kd, kd_most) = servos.kp, servos.kd
    return {
        "kp": kp,
        "kp_most": kp_most if kp_most != kp else None,
        "kd": kd,
        "kd_most": kd_most if kd_most != kd else None,
        "stiffness_unit": servos.stiffness_unit,
        "damping_unit": servos.damping_unit,
    }
