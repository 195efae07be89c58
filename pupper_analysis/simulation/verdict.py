"""Verdict on a stance: result of the simulations, and the assumptions behind the result.

`judge_stance` creates the verdict on a simulated stance, and `predict_verdict` the verdict on a
stance without simulation. Documents, drawings and exit statuses use these verdicts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.results import Result
from pupper_analysis.robot.as_published import (
    OwnRun,
    Published,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.stability import Stability
from pupper_analysis.statics.equilibrium import GravityCompensation


class VerdictCode(StrEnum):
    """Code of a verdict on a stance, from the best to the worst.

    ``LIMITS_UNKNOWN`` and ``MASSES_UNKNOWN`` replace passing verdicts (`PASSING_CODES`) of stances
    whose result depends on torque limits or masses that no file states.
    """

    HOLDS = "holds"
    HOLDS_ON_ADDED_SERVOS = "holds on servos that were added"
    HOLDS_ALTERED = "holds as computed, and is not quite so as published"
    HOLDS_WITH_FEEDFORWARD = "holds with feed-forward alone"
    LIMITS_UNKNOWN = "holds in simulation, on motors whose torque limit no file states"
    MASSES_UNKNOWN = "holds in simulation, with the masses of links that the file does not state"
    IN_BALANCE = "in balance, and not simulated"
    UNSTABLE = "in balance, not stable, and not simulated"
    OVERLOADED = "beyond the motors' limits"
    LIMB_WITHOUT_FOOT = "holds on fewer feet than limbs that are alike"
    TIED = "holds by a constraint that ties the robot to the world"
    DIFFERS_AS_PUBLISHED = "holds as computed, and not as published"
    OWN_DRIVES_FAIL = "fails on the file's own servos or keyframe"
    DISAGREES = "stands in simulation, and not as predicted"
    FAILS = "fails"


PASSING_CODES = (
    VerdictCode.HOLDS,
    VerdictCode.HOLDS_ON_ADDED_SERVOS,
    VerdictCode.HOLDS_ALTERED,
    VerdictCode.HOLDS_WITH_FEEDFORWARD,
)
"""Codes of verdicts that count as a success, with which commands exit with status 0."""


UNKNOWN_CODES = (VerdictCode.LIMITS_UNKNOWN, VerdictCode.MASSES_UNKNOWN)
"""Codes of verdicts on stances that hold in simulation, but depend on values that no file states.
"""


IMPOSSIBLE_CODES = ("mass-beyond-metal", "inertia-beyond-robot")
"""Codes of messages about masses and moments of inertia that no part of a robot can have, for
example a body denser than tungsten."""


class Question(StrEnum):
    """Question about a robot that a verdict answers, as text for reports."""

    STANDS = "whether it holds"
    CARRIES = "whether it carries its payload"
    TRACKED = "whether it follows its path"
    LASTS = "whether it bears pushes"


LOAD_QUESTIONS = (Question.CARRIES, Question.LASTS)
"""Questions about payloads and pushes. If a torque limit is unknown, the verdict on such a question
does not pass."""


TWO_ROBOTS_CODE = "files-of-two-robots"
"""Code of the message that URDF and MJCF describe different robots. All other failures may be
consequences, so this failure is listed first."""


class Ending(StrEnum):
    """End of a simulation of a stance, as text for reports."""

    HOLDS = "holds"
    DISAGREES = "stands, and not as predicted"
    FAILS = "fails"
    COLLAPSES = "collapses"
    LIFTED = "is lifted"
    UNTRIED = "was not simulated"


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """Result of a simulation of a stance: the values from which a verdict is formed.

    Attributes:
        passed: Whether the simulation did what was requested.
        failures: Reasons of the failure.
        duration: Simulated time (s).
        collapses: Whether the robot collapsed.
        torque_error: Largest torque deviation / largest predicted torque (``verify.torque_scale``);
            NaN without a prediction.
        force_error: Largest relative deviation of a foot force; None if no foot carries load, or
            without a prediction.
        stability: Stability of the settled or the initial state; None if not evaluated.
        creep: Mean speeds over at most the last 10 s; None if not measured.
        notes: Observations that do not decide, such as a mode that the simulation refutes.
        stays: Whether the robot stands still on its feet, even if not as predicted.
        is_lifted: Whether the robot ends upright, with its CoM more than 30 % above the stand.
    """

    passed: bool
    failures: tuple[Diagnostic, ...]
    duration: float = field(metadata={"unit": "s"})
    collapses: bool = False
    torque_error: float = field(default=math.nan, metadata={"unit": "1"})
    force_error: float | None = field(default=None, metadata={"unit": "1"})
    stability: Stability | None = None
    creep: Creep | None = None
    notes: tuple[Diagnostic, ...] = ()
    stays: bool = False
    is_lifted: bool = False


@dataclass(frozen=True, eq=False)
class Creep(Result):
    """Mean speeds of a robot that stands, over the last seconds of a simulation.

    Attributes:
        duration: Time over which the motion is measured (s).
        speed: Largest speed of the base frame, of the contact points of the stance feet, and of
            slides (m/s).
        rate: Largest rate of the hinges and of the base's orientation (rad/s).
    """

    duration: float = field(metadata={"unit": "s"})
    speed: float = field(metadata={"unit": "m/s"})
    rate: float = field(metadata={"unit": "rad/s"})

    @property
    def is_notable(self) -> bool:
        """Whether a verdict reports this creep in the first lines.

        This is so if the speed exceeds `NOTABLE_CREEP_SPEED` (1 mm/min) or the rate exceeds
        `NOTABLE_CREEP_RATE` (10 mrad/min).
        """
        return self.speed > NOTABLE_CREEP_SPEED or self.rate > NOTABLE_CREEP_RATE


NOTABLE_CREEP_SPEED, NOTABLE_CREEP_RATE = 1e-3 / 60, 10e-3 / 60
"""Upper bounds of the creep (slow mean motion) of a standing robot: speed [m/s] and rate [rad/s], 1
mm/min and 10 mrad/min. If a bound is exceeded, the first lines of a verdict report the creep.
Chosen, not tuned: the nominal stand of Pupper v3 creeps by less than a tenth of both."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict(Result):
    """Verdict on a stance, or on a payload, path or push in that stance, with assumptions.

    Attributes:
        code: The worst verdict that applies.
        question: Question that the verdict answers.
        passed: Whether ``code`` is a verdict that passes, with which commands exit with status 0.
        seconds: Simulated time (s); 0 if not simulated.
        with_feedforward: End of the simulation with gravity feed-forward, ctrl = q* + tau / kp.
        commands_alone: End of the simulation with position commands only, ctrl = q*; None if not
            simulated.
        torque_error: With feed-forward, largest deviation / largest predicted torque
            (``verify.torque_scale``); NaN without a prediction.
        force_error: With feed-forward, largest relative deviation of a foot force, vertical or
            along the normal of the foot's plane; NaN if not simulated; None if no foot carries
            load.
        failures: Reasons of a failure with feed-forward.
        failures_alone: Reasons of a failure without feed-forward.
        overloaded_motors: Motors above their effort limits.
        servos: Servos of the simulation.
        keyframe_run: Simulation of the published file from the keyframe; None for robots without a
            file.
        published: Differences between the published MJCF and the simulated model; None if not
            compared.
        doubling_time: Smallest doubling time of a deviation (s), with feed-forward, over the modes
            that grow within 12 s; infinite without such a time, or if the evaluated state is not at
            rest.
        creep: Mean speeds over at most the last 10 s of the simulation with feed-forward; None if
            not measured.
        notes: Observations that do not decide, such as a mode that the simulation refutes.
        converted: Model that was converted from the other model, ``"urdf"`` or ``"mjcf"``: both
            engines read one file then; empty if each engine read its own file.
        remarks: Other assumptions, for example balls in place of soles, or limbs without feet.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "code")

    code: VerdictCode
    question: Question
    passed: bool
    seconds: float = field(metadata={"unit": "s"})
    with_feedforward: Ending
    commands_alone: Ending | None = None
    torque_error: float = field(default=math.nan, metadata={"unit": "1"})
    force_error: float | None = field(default=math.nan, metadata={"unit": "1"})
    failures: tuple[Diagnostic, ...] = ()
    failures_alone: tuple[Diagnostic, ...] = ()
    overloaded_motors: tuple[str, ...]
    servos: ServosUsed
    keyframe_run: OwnRun | None = None
    published: Published | None = None
    doubling_time: float = field(metadata={"unit": "s"})
    converted: str = ""
    remarks: tuple[Diagnostic, ...] = ()
    creep: Creep | None = None
    notes: tuple[Diagnostic, ...] = ()


def judge_stance(
    fed: Outcome,
    alone: Outcome | None,
    servos: ServosUsed,
    *,
    question: Question = Question.STANDS,
    overloaded_motors: tuple[str, ...] = (),
    keyframe_run: OwnRun | None = None,
    published: Published | None = None,
    converted: str = "",
    unknown: bool = False,
    masses_unknown: bool = False,
    remarks: tuple[Diagnostic, ...] = (),
) -> Verdict:
    """Create the verdict on simulations of a stance, payload, path or push.

    The worst code that applies is selected. If the answer depends on masses or torque limits that
    no file states, ``MASSES_UNKNOWN`` or ``LIMITS_UNKNOWN`` replaces a passing code.

    Args:
        fed: Result of the simulation with feed-forward torques.
        alone: Result of the simulation with position commands alone; None if there is none.
        servos: Servos of the simulation.
        question: Question that the simulation answers.
        overloaded_motors: Names of joints whose motors exceed the effort limits.
        keyframe_run: Simulation of the published file from a keyframe; None if there is none.
        published: Differences between the published MJCF and the simulated model; None if not
            compared.
        converted: Format of the model that was converted from the other, ``"urdf"`` or ``"mjcf"``;
            empty without a conversion.
        unknown: Whether the answer depends on torque limits that no file states.
        masses_unknown: Whether moving links have masses that no file states.
        remarks: Messages about other assumptions. With a message of severity error, the verdict
            does not pass.
    """
    code = _find_worst_code(fed, alone, servos, overloaded_motors, keyframe_run, published, remarks)
    if masses_unknown and code in PASSING_CODES:
        code = VerdictCode.MASSES_UNKNOWN
    if unknown and code in PASSING_CODES:
        code = VerdictCode.LIMITS_UNKNOWN
    return Verdict(
        code=code,
        question=question,
        passed=code in PASSING_CODES,
        seconds=fed.duration,
        with_feedforward=classify_ending(fed),
        commands_alone=None if alone is None else classify_ending(alone),
        torque_error=fed.torque_error,
        force_error=fed.force_error,
        failures=fed.failures,
        failures_alone=() if alone is None else alone.failures,
        overloaded_motors=overloaded_motors,
        servos=servos,
        keyframe_run=keyframe_run,
        published=published,
        doubling_time=_min_doubling_time(fed.stability),
        converted=converted,
        remarks=remarks,
        creep=fed.creep,
        notes=(*fed.notes, *_select_slip_notes(alone)),
    )


def _min_doubling_time(stability: Stability | None) -> float:
    """Return the smallest doubling time [s] of the modes of `Stability.modes_growing_within`.

    The result is infinite if no time is known, for example because the state is not at rest.
    """
    leaving = (
        stability.modes_growing_within() if stability is not None and stability.at_rest else ()
    )
    return min((mode.doubling_time or math.inf for mode in leaving), default=math.inf)


def predict_verdict(
    statics: GravityCompensation, servos: ServosUsed, stability: Stability | None = None
) -> Verdict:
    """Create the verdict on a balanced stance that was not simulated; ``passed`` is False.

    The code is ``OVERLOADED`` if a motor exceeds the effort limit, else ``UNSTABLE`` if a mode
    grows (`Stability.is_stable_for`), else ``IN_BALANCE``.

    Args:
        statics: Statics of the stance.
        servos: Servos of the robot.
        stability: Stability with feed-forward; None if not evaluated.
    """
    overloaded_motors = find_overloaded_motors(statics)
    leaves = stability is not None and not stability.is_stable_for()
    code = VerdictCode.UNSTABLE if leaves else VerdictCode.IN_BALANCE
    doubling_time = _min_doubling_time(stability)
    return Verdict(
        code=VerdictCode.OVERLOADED if overloaded_motors else code,
        question=Question.STANDS,
        passed=False,
        seconds=0.0,
        with_feedforward=Ending.UNTRIED,
        overloaded_motors=overloaded_motors,
        servos=servos,
        doubling_time=doubling_time,
    )


def find_overloaded_motors(statics: GravityCompensation) -> tuple[str, ...]:
    """Return the names of the joints whose motors are overloaded: torque / effort limit above 1."""
    utilisations = zip(statics.joint_names, statics.motor_utilisation, strict=True)
    return tuple(name for name, utilisation in utilisations if utilisation > 1)


def _select_slip_notes(alone: Outcome | None) -> tuple[Diagnostic, ...]:
    """Return the note about a foot that slid in the simulation without feed-forward, if any."""
    notes = () if alone is None else alone.notes
    return tuple(note for note in notes if note.code == "foot-slid")


def classify_ending(run: Outcome) -> Ending:
    """Classify how a simulation ended, for example: the robot holds, collapses, is lifted."""
    if run.passed:
        return Ending.HOLDS
    if run.stays:
        return Ending.DISAGREES
    if run.is_lifted:
        return Ending.LIFTED
    return Ending.COLLAPSES if run.collapses else Ending.FAILS


TIE_MESSAGE_CODES = {"base-tied", "link-tied"}
"""Codes of messages about constraints that tie the robot to the world. With severity error, the
robot holds only by such a constraint."""


def _find_worst_code(
    fed: Outcome,
    alone: Outcome | None,
    servos: ServosUsed,
    overloaded_motors: tuple[str, ...],
    keyframe_run: OwnRun | None,
    published: Published | None,
    remarks: tuple[Diagnostic, ...],
) -> VerdictCode:
    """Return the worst verdict code that applies to the simulations of a stance.

    Codes of `UNKNOWN_CODES` are not considered.
    """
    user_gains = servos.source is ServoSource.GIVEN  # the servos of the file are not used then
    own_run_fails = keyframe_run is not None and keyframe_run.fails and not user_gains
    differs = published is not None and published.differs
    deviation = published.worst if published is not None and differs else None
    if not fed.passed:
        collapses = deviation is not None and deviation.collapses
        stands = fed.stays and not (overloaded_motors or own_run_fails or collapses)
        return VerdictCode.DISAGREES if stands else VerdictCode.FAILS
    if own_run_fails or servos.replacement_servos:
        return VerdictCode.OWN_DRIVES_FAIL
    if (
        deviation is not None
        and published is not None
        and not (deviation.agrees_with_equilibrium or published.is_altered_only)
    ):
        return VerdictCode.DIFFERS_AS_PUBLISHED
    errors = [remark.code for remark in remarks if remark.severity is Severity.ERROR]
    if errors:
        tied = not TIE_MESSAGE_CODES.isdisjoint(errors)
        return VerdictCode.TIED if tied else VerdictCode.LIMB_WITHOUT_FOOT
    if overloaded_motors:
        return VerdictCode.OVERLOADED
    if alone is not None and not alone.passed:
        return VerdictCode.HOLDS_WITH_FEEDFORWARD
    if differs:
        return VerdictCode.HOLDS_ALTERED
    return VerdictCode.HOLDS_ON_ADDED_SERVOS if servos.made else VerdictCode.HOLDS
