"""What a robot's MJCF does by itself, as it was published, and what was made up beside it.

Facts, with names and numbers; ``prepare`` finds them, ``simulation/verdict.py`` weighs them, and
``present/verdict.py`` puts them into words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from pupper_analysis.base.diagnostics import Diagnostic
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
    kp: tuple[float, float] = field(metadata={"unit": "N m/rad"})
    kd: tuple[float, float] = field(metadata={"unit": "N m s/rad"})
    made: tuple[MadeServo, ...] = ()

    @property
    def replaced(self) -> tuple[MadeServo, ...]:
        """Those in the place of one in the MJCF that is meant to hold the joint, and does not."""
        return tuple(servo for servo in self.made if servo.instead_of.bad)


GIVES_WAY = 0.05
"""rad, m: a joint among servos that has none, and is so far off, was held by nothing: what has no
stiffness does not sag, it goes until something stops it."""


CLOSE = 0.05
"""Share of the largest torque within which the published robot is as the computed one, but for
what was altered on loading (Solo 12's balls for mesh feet: 0.016). Paths are tracked as well."""

CLOSE_IMPORTED = 0.1
"""The same of a URDF as MuJoCo imports it, on its own shapes and on servos that were added: where
those are of meshes, feet touch millimetres elsewhere (Go2's: 0.065)."""

CLOSE_JOINT = 0.02
"""rad, m: the same of a joint that is told its torque ahead; v3's is off by 5e-5."""

LEFT = 0.5
"""rad, m: a joint that ends further from the posture in which it was held has left it."""


class OwnCommands(StrEnum):
    """What a file's actuators are given in its own run."""

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
        commanded: Where its servo is commanded to be less where it was (rad, m); None where it has
            none.
    """

    joint: str
    off: float = field(metadata={"unit": "rad or m"})
    drive: Drive
    commanded: float | None = field(default=None, metadata={"unit": "rad or m"})

    @property
    def commanded_away(self) -> bool:
        """Whether its own servo was commanded to go there: what is commanded is another pose."""
        if self.commanded is None or abs(self.off) <= GIVES_WAY:
            return False
        return abs(self.commanded) > abs(self.off) / 2


@dataclass(frozen=True)
class Cause:
    """An element of the MJCF, or a change of it on loading, that makes it do other than predicted.

    Attributes:
        code: What it is; see ``present.verdict.cause_text``.
        elements: Its name, or the names of all that are alike.
        line: Where the first stands in the file; None where that is not known.
        remaining: The largest deviation of a torque / the largest predicted torque that is left
            with all causes switched off; None where it cannot be switched off.
        difference: The first in which the two files differ, if that is the cause.
    """

    code: str
    elements: tuple[str, ...]
    line: int | None = None
    remaining: float | None = field(default=None, metadata={"unit": "1"})
    difference: Diagnostic | None = None


OF_PREPARATION = {"shapes-beside-feet", "balls", "other-drive"}
"""Codes of causes that are changes made on loading. A verdict is about the published robot: if it
stands, such a difference is reported, and never fails it."""


@dataclass(frozen=True)
class OwnRun(BodyMotion):
    """What MuJoCo makes of a file from its keyframe, nudged, exactly as a reset leaves it.

    Attributes:
        imported: Whether it is MuJoCo's own import of a URDF, given what the robot was: a free
            base, a floor, servos ... but for its shapes.
        timestep: Of such an import (s), if it is finer than the robot's, as its shapes need.
        keyframe: Its name; empty where the file has none: from the nominal stand.
        commands: What its actuators are given.
        limp: Whether most joints have motors, or nothing, which nobody commands.
        worst: The joint that is furthest from where it began; None where it diverged.
        unheld: The same of the joints without a servo, among others that have one, if that is more
            than ``GIVES_WAY``.
        held: Where the keyframe states no ctrl, the same with its servos told its angles.
        standing: Whether it stands on the ground; else its base is held in a posture, which a joint
            leaves that ends ``LEFT`` away from it, and what stands above means nothing.
        causes: What makes it fail, where that is found.
    """

    imported: bool = False
    timestep: float | None = field(default=None, metadata={"unit": "s"})
    keyframe: str = ""
    commands: OwnCommands = OwnCommands.STATED
    limp: bool = False
    worst: JointOff | None = None
    unheld: JointOff | None = None
    held: OwnRun | None = None
    standing: bool = True
    causes: tuple[Cause, ...] = ()

    @property
    def left(self) -> bool:
        """Whether a joint of what is held has left its posture, and was not told to."""
        worst = None if self.standing else self.worst
        return worst is not None and abs(worst.off) > LEFT and not worst.commanded_away

    @property
    def falls(self) -> bool:
        """Whether it does not stay where it was to: by collapse, or by a joint that gives way."""
        return self.collapses or self.left or self.unheld is not None

    @property
    def fails(self) -> bool:
        """Whether no verdict may be a good one.

        What a keyframe states is the file's word, zeros included. Where it states no ctrl, a reset
        fills in zeros that nobody wrote; then the file is taken to mean that its servos hold the
        angles. Where no keyframe says how it stands, ``Published`` decides whether servos carry it,
        and this whether all joints have one.
        """
        run = self.held or self
        if run.limp or run.commands is OwnCommands.ABSENT:
            return False
        return run.falls if run.keyframe else run.unheld is not None


@dataclass(frozen=True)
class PublishedRun:
    """What the MJCF does from a predicted state, with nothing in it edited, against the prediction.

    Attributes:
        feedforward: Whether its servos were told to hold the prediction; else the pose alone.
        duration: s; it is nudged after the first.
        torque_error: Largest deviation of a joint's torque / largest predicted torque, at any time
            of the last second.
        height_error: Height of the centre of mass less the predicted one (m); None where the base
            is held.
        joint_error: Largest deviation of a joint (rad).
        collapses: Whether it has fallen, sunk by ``robot.fall.SUNKEN`` of its height, travelled
            by its height, or diverged; of what is held, whether a joint has left the posture.
        differs: Whether it does, or is off by more than a verified stand may be.
        imported: Whether it is MuJoCo's own import of a URDF.
    """

    feedforward: bool
    duration: float = field(metadata={"unit": "s"})
    torque_error: float = field(metadata={"unit": "1"})
    height_error: float | None = field(metadata={"unit": "m"})
    joint_error: float = field(metadata={"unit": "rad"})
    collapses: bool
    differs: bool
    imported: bool = False

    @property
    def close(self) -> bool:
        """Whether it is as computed, but for what was altered on loading."""
        near = not self.feedforward or self.joint_error <= CLOSE_JOINT
        most = CLOSE_IMPORTED if self.imported else CLOSE
        return not self.collapses and self.torque_error <= most and near


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
    def is_altered_only(self) -> bool:
        """Whether the published robot stands, and only our own preparation makes it differ."""
        codes = {cause.code for cause in self.causes}
        run = self.worst
        return run is not None and not run.collapses and bool(codes) and codes <= OF_PREPARATION

    @property
    def worst(self) -> PublishedRun | None:
        """The run that differs: one that collapses, else with feed-forward first."""
        off = (run for run in self.runs if run.differs)
        return max(off, key=lambda run: (run.collapses, run.feedforward), default=None)
