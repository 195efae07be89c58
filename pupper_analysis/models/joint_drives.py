"""What moves a joint in an MJCF: a servo that holds it, a motor, or one that cannot hold it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Drive(StrEnum):
    """What moves a joint in the MJCF as it was published."""

    SERVO = "position servo"
    MOTOR = "torque motor"
    NONE = "no actuator"
    WRONG_SIGN = "a servo whose stiffness is negative"
    NO_STIFFNESS = "a servo without stiffness"
    SEVERAL = "several actuators"
    OTHER = "an actuator that holds no position"

    @property
    def bad(self) -> bool:
        """Whether it is meant to hold a joint, and does not."""
        return self in (Drive.WRONG_SIGN, Drive.NO_STIFFNESS)


@dataclass(frozen=True)
class MadeServo:
    """A servo that the MJCF does not have.

    Attributes:
        joint: Its joint.
        kp: Its stiffness (N m/rad).
        kd: Its damping (N m s/rad).
        instead_of: What the MJCF has there.
    """

    joint: str
    kp: float
    kd: float
    instead_of: Drive
