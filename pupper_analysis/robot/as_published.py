"""What a robot's MJCF does by itself, as it was published, and what was made up beside it.

Facts, with names and numbers; ``prepare`` finds them, ``simulation/verdict.py`` weighs them, and
``report/verdict.py`` puts them into words.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pupper_analysis.models.transmission import MadeServo
from pupper_analysis.robot.fall import has_collapsed


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


ANOTHER_POSE = 0.5
"""rad, m: by more than that no servo gives way that holds a robot; it was commanded elsewhere."""


@dataclass(frozen=True)
class OwnRun:
    """What the MJCF does from its own keyframe, with its own actuators and ``ctrl``.

    Attributes:
        keyframe: Its name.
        own_ctrl: Whether ``ctrl`` is the keyframe's; else its servos are told to hold its joints.
        duration: s.
        height: Of the base above the ground in the keyframe, or where the robot first touches the
            ground from there (m).
        end_height: At the end (m).
        lean: Of the base against the keyframe at the end (rad).
        away: How far the base has travelled from the keyframe's place, as seen from above (m).
        diverged: Whether MuJoCo began anew, as numbers were no longer any.
        collapses: Whether it has, or has fallen, sunk by ``robot.fall.SUNKEN`` of its height, or
            travelled by its height.
        joint_error: By how much a joint ends off the keyframe, at most (rad, m).
    """

    keyframe: str
    own_ctrl: bool
    duration: float
    height: float
    end_height: float
    lean: float
    away: float
    diverged: bool
    collapses: bool
    joint_error: float = 0.0

    @property
    def gone(self) -> bool:
        """Whether the base has left the place where it stood, and that is all."""
        stands = not has_collapsed(self.lean, self.height, self.end_height, 0.0)
        return self.collapses and not self.diverged and stands

    @property
    def leaves(self) -> bool:
        """Whether its own ctrl takes it to another pose, in which it stays."""
        return self.own_ctrl and not self.collapses and self.joint_error > ANOTHER_POSE


@dataclass(frozen=True)
class PublishedRun:
    """What the MJCF does from a predicted state, with nothing in it edited, against the prediction.

    Attributes:
        feedforward: Whether its servos were told to hold the prediction; else the pose alone.
        duration: s.
        torque_error: Largest deviation of a joint's torque / largest predicted torque.
        height_error: Base's height less the predicted one (m).
        joint_error: Largest deviation of a joint (rad).
        collapses: Whether it has fallen, sunk by ``robot.fall.SUNKEN`` of its height, travelled
            by its height, or diverged.
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
