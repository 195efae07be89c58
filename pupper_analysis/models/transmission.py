"""Through which gear an actuator of an MJCF acts on which joint."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.joint_kinds import scalar_joints

Array = NDArray[np.float64]


def is_at_one_joint(model: mujoco.MjModel, actuator: int) -> bool:
    """Says whether an actuator's armature and damping are those of one hinge or slide."""
    kinds = (mujoco.mjtTrn.mjTRN_JOINT.value, mujoco.mjtTrn.mjTRN_JOINTINPARENT.value)
    if model.actuator_trntype[actuator] not in kinds:
        return False
    joint = int(model.actuator_trnid[actuator, 0])
    return joint in scalar_joints(model)


def actuator_gear(model: mujoco.MjModel, actuator: int) -> Array:
    """Returns the gear of an actuator's first output: (1,) at one joint, else (6,)."""
    gear = np.array(model.actuator_gear[int(model.actuator_outadr[actuator])])
    return gear[:1] if is_at_one_joint(model, actuator) else gear


def drives_of(model: mujoco.MjModel, joint: int) -> list[int]:
    """Returns the actuators at a hinge or slide.

    Of one, ``jointinparent`` is the same as ``joint``. An actuator may have several controls, so
    that there are fewer of them than ``model.nu``.
    """
    return [
        actuator
        for actuator in range(model.nactuator)
        if is_at_one_joint(model, actuator) and model.actuator_trnid[actuator, 0] == joint
    ]


_ALIKE = 1e-5
"""Share within which a servo's gain is its stiffness, as ``robot.servos`` has it."""


class Drive(StrEnum):
    """What moves a joint in the MJCF as it was published."""

    SERVO = "position servo"
    MOTOR = "torque motor"
    NONE = "no actuator"
    WRONG_SIGN = "a servo whose stiffness is negative"
    NO_STIFFNESS = "a servo without stiffness"
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


def drive_of(model: mujoco.MjModel, joint: int) -> Drive:
    """Tells what moves a hinge or slide.

    Several actuators are taken by what they are together: their stiffnesses add up.

    Args:
        model: The MJCF's, as it is.
        joint: The joint's id.
    """
    motors = drives_of(model, joint)
    if not motors:
        return Drive.NONE
    kinds = [_kind(model, motor) for motor in motors]
    if len(motors) == 1:
        return kinds[0]
    if Drive.WRONG_SIGN in kinds:
        stiffness = sum(_stiffness(model, motor)[0] for motor in motors)
        return Drive.SERVO if stiffness > 0 else Drive.WRONG_SIGN
    return next((kind for kind in _ORDER if kind in kinds), Drive.OTHER)


_ORDER = (Drive.SERVO, Drive.MOTOR, Drive.OTHER, Drive.NO_STIFFNESS)


def _stiffness(model: mujoco.MjModel, motor: int) -> tuple[float, float]:
    """Returns -dF/dq at the joint, and dF/dctrl times the gear, which is as much in a servo."""
    gear = float(actuator_gear(model, motor)[0])
    gain = float(model.actuator_gainprm[motor, 0]) * gear**2
    affine = model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE.value
    return (-float(model.actuator_biasprm[motor, 1]) * gear**2 if affine else 0.0), gain


def _kind(model: mujoco.MjModel, motor: int) -> Drive:
    if model.actuator_gaintype[motor] != mujoco.mjtGain.mjGAIN_FIXED.value:
        return Drive.OTHER
    if model.actuator_biastype[motor] not in (
        mujoco.mjtBias.mjBIAS_NONE.value,
        mujoco.mjtBias.mjBIAS_AFFINE.value,
    ):
        return Drive.OTHER
    stiffness, gain = _stiffness(model, motor)
    if stiffness < 0 or (stiffness > 0 and gain < 0):
        return Drive.WRONG_SIGN
    if stiffness > 0:
        return Drive.SERVO if abs(gain - stiffness) <= _ALIKE * stiffness else Drive.OTHER
    if gain == 0:
        return Drive.NO_STIFFNESS
    # An affine bias is a servo's, even if its numbers are all zero.
    affine = model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE.value
    return Drive.OTHER if affine or model.actuator_biasprm[motor, :3].any() else Drive.MOTOR
