"""What a robot's MJCF does by itself, as it was published, and what was made up beside it.

Facts, with names and numbers; ``prepare`` finds them, ``simulation/verdict.py`` weighs them, and
``report/verdict.py`` puts them into words.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pupper_analysis.models.transmission import Drive, MadeServo
from pupper_analysis.robot.fall import BodyMotion


class ServoSource(StrEnum):
    """Where the gains of a robot's servos are from."""

    FILE = "the MJCF's"
    ADDED = "added"
    GIVEN = "given"


@dataclass(frozen=True)
class ServosUsed:
    """The servos on which a result rests.

    Attributes:
        source: Where their gains are from: the MJCF; made up on loading, at one joint or more, as
            the MJCF has none there, or bad ones; or given by the caller.
        kp: The least and the greatest stiffness (N m/rad) of those that were made up, or else all.
        kd: The least and the greatest damping (N m s/rad), likewise.
        made: Those that were made up on loading, and are used.
    """

    source: ServoSource
    kp: tuple[float, float]
    kd: tuple[float, float]
    made: tuple[MadeServo, ...] = ()

    @property
    def replaced(self) -> tuple[MadeServo, ...]:
        """Those in the place of one in the MJCF that is meant to hold the joint, and does not."""
        return tuple(servo for servo in self.made if servo.instead_of.bad)


GIVES_WAY = 0.1
"""rad, m: a joint among servos that has none, and is so far off, was held by nothing: what has no
stiffness does not sag, it goes until something stops it."""


class OwnCommands(StrEnum):
    """What a file's actuators are told in its own run."""

    STATED = "the keyframe's ctrl"
    ABSENT = "the zeros of a keyframe without ctrl"
    ANGLES = "its joints' angles"


@dataclass(frozen=True)
class JointOff:
    """A joint that is not where it began.

    Attributes:
        joint: Its name.
        off: Where it is less where it was (rad, m).
        drive: What drives it in the file.
        commanded: Where its servo is told to be less where it was (rad, m); None where it has none.
        added: Whether a servo was added there, on which the run rests.
    """

    joint: str
    off: float
    drive: Drive
    commanded: float | None = None
    added: bool = False

    @property
    def told_away(self) -> bool:
        """Whether its own servo was told to go there: what is commanded is another pose."""
        return self.commanded is not None and abs(self.commanded) > abs(self.off) / 2


@dataclass(frozen=True)
class OwnRun(BodyMotion):
    """What MuJoCo makes of a file from its keyframe, nudged, exactly as a reset leaves it.

    Attributes:
        imported: Whether it is MuJoCo's own import of a URDF, given a free base, a floor and the
            servos that were added.
        keyframe: Its name; empty where the file has none: from the nominal stand.
        commands: What its actuators are told.
        limp: Whether most joints have motors, or nothing, which nobody commands.
        worst: The joint that is furthest from where it began; None where it diverged.
        unheld: The same of the joints without a servo, among others that have one, if that is more
            than ``GIVES_WAY``.
        held: Where the keyframe states no ctrl, the same with its servos told its angles.
    """

    imported: bool = False
    keyframe: str = ""
    commands: OwnCommands = OwnCommands.STATED
    limp: bool = False
    worst: JointOff | None = None
    unheld: JointOff | None = None
    held: OwnRun | None = None

    @property
    def falls(self) -> bool:
        """Whether it does not stay where it was to: by collapse, or by a joint that gives way."""
        return self.collapses or self.unheld is not None

    @property
    def fails(self) -> bool:
        """Whether no verdict may be a good one.

        What a keyframe states is the file's word, zeros included. Where it states no ctrl, a reset
        fills in zeros that nobody wrote; then the file is taken to mean that its servos hold the
        angles. From the nominal stand, ``Published`` decides.
        """
        run = self.held or self
        if run.limp or not run.keyframe or run.commands is OwnCommands.ABSENT:
            return False
        return run.falls


@dataclass(frozen=True)
class PublishedRun:
    """What the MJCF does from a predicted state, with nothing in it edited, against the prediction.

    Attributes:
        feedforward: Whether its servos were told to hold the prediction; else the pose alone.
        duration: s; it is nudged after the first.
        torque_error: Largest deviation of a joint's torque / largest predicted torque, at any time
            of the last second.
        height_error: Base's height less the predicted one (m).
        joint_error: Largest deviation of a joint (rad).
        collapses: Whether it has fallen, sunk by ``robot.fall.SUNKEN`` of its height, travelled
            by its height, or diverged; of what is held, whether a joint has left the posture.
        differs: Whether it does, or is off by more than a verified stand may be.
    """

    feedforward: bool
    duration: float
    torque_error: float
    height_error: float
    joint_error: float
    collapses: bool
    differs: bool


@dataclass(frozen=True)
class Cause:
    """An element of the MJCF, or a change of it on loading, that makes it do other than predicted.

    Attributes:
        code: What it is; see ``report.verdict.told_cause``.
        elements: Its name, or the names of all that are alike.
        line: Where the first stands in the file; None where that is not known.
        remaining: The largest deviation of a torque / the largest predicted torque that is left
            with it switched off; None where it cannot be switched off.
    """

    code: str
    elements: tuple[str, ...]
    line: int | None = None
    remaining: float | None = None


@dataclass(frozen=True)
class Published:
    """How the MJCF as it was published differs from what is computed.

    Attributes:
        runs: What was simulated of it.
        causes: What makes it differ; empty if it does not, or nothing is found that does.
        differs: Whether it is not as predicted, or cannot be simulated as it is.
    """

    runs: tuple[PublishedRun, ...]
    causes: tuple[Cause, ...]
    differs: bool

    @property
    def worst(self) -> PublishedRun | None:
        """The run that differs: one that collapses, else with feed-forward first."""
        off = (run for run in self.runs if run.differs)
        return max(off, key=lambda run: (run.collapses, run.feedforward), default=None)
