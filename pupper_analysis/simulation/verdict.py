"""The verdict of a stance: what a simulation makes of it, and what that rests on.

One function makes it, ``judge_stance``; whatever prints, draws or exits by it has it from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

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
    """A verdict in one word, from the best to the worst."""

    HOLDS = "holds"
    HOLDS_ON_ADDED_SERVOS = "holds on servos that were added"
    HOLDS_ALTERED = "holds as computed, and is not quite so as published"
    HOLDS_WITH_FEEDFORWARD = "holds with feed-forward alone"
    IN_BALANCE = "in balance, and not simulated"
    UNSTABLE = "in balance, not stable, and not simulated"
    OVERLOADED = "beyond the motors' limits"
    LIMITS_UNKNOWN = "holds in simulation, on motors whose torque limit no file states"
    MASSES_UNKNOWN = "holds in simulation, with the masses of links that the file does not state"
    LIMB_WITHOUT_FOOT = "holds on fewer feet than limbs that are alike"
    DIFFERS_AS_PUBLISHED = "holds as computed, and not as published"
    OWN_DRIVES_FAIL = "fails on the file's own servos or keyframe"
    DISAGREES = "stands in simulation, and not as predicted"
    FAILS = "fails"


HOLDING = (
    VerdictCode.HOLDS,
    VerdictCode.HOLDS_ON_ADDED_SERVOS,
    VerdictCode.HOLDS_ALTERED,
    VerdictCode.HOLDS_WITH_FEEDFORWARD,
)
"""The verdicts that let pass; exit status 0."""


UNKNOWN = (VerdictCode.LIMITS_UNKNOWN, VerdictCode.MASSES_UNKNOWN)
"""The verdicts of stances that hold in simulation, with values that no file states."""


class Asked(StrEnum):
    """What a verdict answers."""

    STANDS = "whether it holds"
    CARRIES = "whether it carries its payload"
    TRACKED = "whether it follows its path"
    LASTS = "whether it bears pushes"


ABOUT_LOAD = (Asked.CARRIES, Asked.LASTS)
"""Questions that no simulation with motors of unknown torque answers."""


class Ending(StrEnum):
    """How a simulation ended."""

    HOLDS = "holds"
    DISAGREES = "stands, and not as predicted"
    FAILS = "fails"
    COLLAPSES = "collapses"
    UNTRIED = "was not simulated"


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a verdict needs to know of a simulation; of a payload or a path no more is known.

    Attributes:
        passed: Whether it did what was asked.
        failures: If not, why.
        duration: What was simulated (s).
        collapses: Whether it fell.
        torque_error: Largest deviation / largest predicted torque; not a number where none is
            predicted.
        force_error: Of a foot's force, likewise; None where no foot carries.
        stability: Of where it settled; None where that was not asked.
        creep: Motion over the last 10 s; None if it was not measured.
        notes: Observations that do not decide, such as a mode that the simulation refutes.
        stays: Whether the robot stands still on its feet, even if not as predicted.
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


@dataclass(frozen=True, eq=False)
class Creep(Result):
    """Mean speeds of a robot that stands, over the last seconds of a simulation.

    Attributes:
        duration: Time over which the motion is measured (s).
        speed: Speed of the base's CoM-fixed point, or of the foot that moves most (m/s).
        rate: Rate of the joint or of the base's orientation that turns most (rad/s).
    """

    duration: float = field(metadata={"unit": "s"})
    speed: float = field(metadata={"unit": "m/s"})
    rate: float = field(metadata={"unit": "rad/s"})

    @property
    def matters(self) -> bool:
        """Whether the robot creeps by more than ``NOTABLE_SPEED`` or ``NOTABLE_RATE``."""
        return self.speed > NOTABLE_SPEED or self.rate > NOTABLE_RATE


NOTABLE_SPEED, NOTABLE_RATE = 1e-3 / 60, 10e-3 / 60
"""Creep above which the verdict states it in its first lines: 1 mm/min, 10 mrad/min. Chosen, not
tuned: v3's nominal stand creeps by less than a tenth of both."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict(Result):
    """Whether a stance holds, or does what is asked of it, and what that rests on.

    Attributes:
        code: The verdict: of all that applies, the worst.
        asked: What it answers.
        passed: Whether it holds; the exit status of commands.
        seconds: The simulated time (s).
        with_feedforward: How it ends with gravity feed-forward, ctrl = q* + tau / kp.
        commands_alone: How it ends on position commands alone, ctrl = q*; None if it was not asked.
        torque_error: With feed-forward, largest deviation / largest predicted torque.
        force_error: With feed-forward, largest deviation of a vertical foot force / its prediction;
            None where no foot carries.
        failures: Why it fails with feed-forward, if it does.
        failures_alone: Why it fails without, if it does.
        overloaded: Motors above their limits.
        servos: The servos that it rests on.
        own: What the file does by itself, from its keyframe as a reset leaves it; None of robots
            that have no file.
        published: How the MJCF as it was published differs; None where it was not looked at.
        doubling_time: Doubling time of a deviation (s), with feed-forward, if that makes the stand
            fail; infinite otherwise. It is measured in a nudged simulation.
        creep: Motion over the last 10 s of the simulation with feed-forward; None if that was not
            simulated.
        notes: Observations that do not decide, such as a mode that the simulation refutes.
        converted: Which of the robot's models was made of the other one, ``"urdf"`` or ``"mjcf"``:
            both engines read one file then; empty if each read its own.
        remarks: What else it rests on: balls in the place of soles, limbs without feet.
    """

    code: VerdictCode
    asked: Asked
    passed: bool
    seconds: float = field(metadata={"unit": "s"})
    with_feedforward: Ending
    commands_alone: Ending | None = None
    torque_error: float = field(default=math.nan, metadata={"unit": "1"})
    force_error: float | None = field(default=math.nan, metadata={"unit": "1"})
    failures: tuple[Diagnostic, ...] = ()
    failures_alone: tuple[Diagnostic, ...] = ()
    overloaded: tuple[str, ...]
    servos: ServosUsed
    own: OwnRun | None = None
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
    asked: Asked = Asked.STANDS,
    overloaded: tuple[str, ...] = (),
    own: OwnRun | None = None,
    published: Published | None = None,
    converted: str = "",
    unknown: bool = False,
    masses_unknown: bool = False,
    remarks: tuple[Diagnostic, ...] = (),
) -> Verdict:
    """Weighs what was simulated of a stance, of a posture, or of what is asked of them.

    Args:
        fed: The simulation with feed-forward.
        alone: The simulation without; None if there is none.
        servos: Those that were simulated.
        asked: What the simulation is of.
        overloaded: Motors above their limits.
        own: What the file does by itself, from its keyframe.
        published: How the MJCF as it was published differs from what was simulated.
        converted: Which of the robot's models was made of the other one, if one was.
        unknown: Whether the answer depends on torque limits that no file states.
        masses_unknown: Whether moving links have masses that no file states.
        remarks: What else of the robot it rests on; an error lets it not pass.
    """
    code = _code(fed, alone, servos, overloaded, own, published, remarks)
    if unknown and code in HOLDING:
        code = VerdictCode.LIMITS_UNKNOWN
    if masses_unknown and code in HOLDING:
        code = VerdictCode.MASSES_UNKNOWN
    return Verdict(
        code=code,
        asked=asked,
        passed=code in HOLDING,
        seconds=fed.duration,
        with_feedforward=describe_ending(fed),
        commands_alone=None if alone is None else describe_ending(alone),
        torque_error=fed.torque_error,
        force_error=fed.force_error,
        failures=fed.failures,
        failures_alone=() if alone is None else alone.failures,
        overloaded=overloaded,
        servos=servos,
        own=own,
        published=published,
        doubling_time=_leaving_time(fed.stability),
        converted=converted,
        remarks=remarks,
        creep=fed.creep,
        notes=fed.notes,
    )


def _leaving_time(stability: Stability | None) -> float:
    """Return the least doubling time of the modes that leave a state (s); infinite without any."""
    leaving = (
        stability.modes_growing_within() if stability is not None and stability.at_rest else ()
    )
    return min((mode.doubling_time or math.inf for mode in leaving), default=math.inf)


def predict_verdict(
    statics: GravityCompensation, servos: ServosUsed, stability: Stability | None = None
) -> Verdict:
    """Weighs what is known of a stance that balances before it is simulated; it never passes.

    Args:
        statics: Its balance.
        servos: Those that hold it.
        stability: Whether it is stable with feed-forward; None where that is not known yet.
    """
    overloaded = beyond_limits(statics)
    leaves = stability is not None and not stability.lasts()
    code = VerdictCode.UNSTABLE if leaves else VerdictCode.IN_BALANCE
    doubling = _leaving_time(stability)
    return Verdict(
        code=VerdictCode.OVERLOADED if overloaded else code,
        asked=Asked.STANDS,
        passed=False,
        seconds=0.0,
        with_feedforward=Ending.UNTRIED,
        overloaded=overloaded,
        servos=servos,
        doubling_time=doubling,
    )


def beyond_limits(statics: GravityCompensation) -> tuple[str, ...]:
    """Returns the motors that hold more than their limits."""
    used = zip(statics.joint_names, statics.motor_utilisation, strict=True)
    return tuple(name for name, share in used if share > 1)


def describe_ending(run: Outcome) -> Ending:
    """Tells how a simulation ended."""
    if run.passed:
        return Ending.HOLDS
    if run.stays:
        return Ending.DISAGREES
    return Ending.COLLAPSES if run.collapses else Ending.FAILS


def _code(
    fed: Outcome,
    alone: Outcome | None,
    servos: ServosUsed,
    overloaded: tuple[str, ...],
    own: OwnRun | None,
    published: Published | None,
    remarks: tuple[Diagnostic, ...],
) -> VerdictCode:
    """Returns the worst that applies."""
    if not fed.passed:
        return VerdictCode.DISAGREES if fed.stays and not overloaded else VerdictCode.FAILS
    given = servos.source is ServoSource.GIVEN  # then the file's own are not what holds it
    if (own is not None and own.fails and not given) or servos.replaced:
        return VerdictCode.OWN_DRIVES_FAIL
    differs = published is not None and published.differs
    off = published.worst if published is not None and differs else None
    if off is not None and published is not None and not (off.close or published.is_altered_only):
        return VerdictCode.DIFFERS_AS_PUBLISHED
    if any(remark.severity is Severity.ERROR for remark in remarks):
        return VerdictCode.LIMB_WITHOUT_FOOT
    if overloaded:
        return VerdictCode.OVERLOADED
    if alone is not None and not alone.passed:
        return VerdictCode.HOLDS_WITH_FEEDFORWARD
    if differs:
        return VerdictCode.HOLDS_ALTERED
    return VerdictCode.HOLDS_ON_ADDED_SERVOS if servos.made else VerdictCode.HOLDS
