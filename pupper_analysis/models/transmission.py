"""Through which gear an actuator of an MJCF acts on which joint."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.mjcf import JointKind

Array = NDArray[np.float64]


_AT_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT.value, mujoco.mjtTrn.mjTRN_JOINTINPARENT.value)

_ONE_COORDINATE = (int(JointKind.HINGE), int(JointKind.SLIDE))


def is_at_one_joint(model: mujoco.MjModel, actuator: int) -> bool:
    """Says whether an actuator's armature and damping are those of one hinge or slide."""
    if model.actuator_trntype[actuator] not in _AT_JOINTS:
        return False
    return int(model.jnt_type[model.actuator_trnid[actuator, 0]]) in _ONE_COORDINATE


def motor_targets(model: mujoco.MjModel, actuator: int) -> tuple[mujoco.mjtObj, list[int]]:
    """Returns on what an actuator acts: its kind, and the ids of one or two; -1 is none."""
    kind = mujoco.mjtTrn(int(model.actuator_trntype[actuator])).name.removeprefix("mjTRN_")
    word = {"JOINTINPARENT": "JOINT", "SLIDERCRANK": "SITE", "SO3": "SITE"}.get(kind, kind)
    return getattr(mujoco.mjtObj, f"mjOBJ_{word}"), model.actuator_trnid[actuator].tolist()


def actuator_gear(model: mujoco.MjModel, actuator: int) -> Array:
    """Returns the gear of an actuator's first output: (1,) at one joint, else (6,)."""
    gear = np.array(model.actuator_gear[int(model.actuator_outadr[actuator])])
    return gear[:1] if is_at_one_joint(model, actuator) else gear


def drives_of(model: mujoco.MjModel, joint: int) -> list[int]:
    """Returns the actuators at a hinge or slide.

    Of one, ``jointinparent`` is the same as ``joint``. An actuator may have several controls, so
    that there are fewer of them than ``model.nu``.
    """
    there = np.flatnonzero(model.actuator_trnid[:, 0] == joint).tolist()
    return [actuator for actuator in there if is_at_one_joint(model, actuator)]


def drives_by_joint(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Returns {joint: its actuators} of the hinges and slides that have some; see ``drives_of``."""
    found: dict[int, list[int]] = {}
    for actuator, joint in enumerate(model.actuator_trnid[:, 0].tolist()):
        if is_at_one_joint(model, actuator):
            found.setdefault(joint, []).append(actuator)
    return found


@dataclass(frozen=True)
class ActuatorLaw:
    """The force of an actuator at a hinge or slide: gain ctrl - stiffness l - damping dl/dt.

    Its length l is the gear times the joint's position, and so it acts on the joint.

    Attributes:
        gain: Of a servo its kp (N m/rad), of a motor N m per unit of ctrl.
        stiffness: N m/rad; 0 of a motor.
        damping: N m s/rad.
        gear: Ratio.
    """

    gain: float
    stiffness: float
    damping: float
    gear: float

    @property
    def at_joint(self) -> tuple[float, float]:
        """Stiffness and damping at the joint (N m/rad, N m s/rad)."""
        return self.stiffness * self.gear**2, self.damping * self.gear**2


def law_of(model: mujoco.MjModel, actuator: int) -> ActuatorLaw:
    """Returns the law of an actuator; without an affine bias it has neither of the latter two."""
    gain = float(model.actuator_gainprm[actuator, 0])
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE.value
    stiffness, damping = -model.actuator_biasprm[actuator, 1:3] if affine else (0.0, 0.0)
    gear = float(actuator_gear(model, actuator)[0])
    return ActuatorLaw(gain, float(stiffness), float(damping), gear)


_STIFFNESS_TOLERANCE = 1e-5
"""Share within which a servo's gain is its stiffness, as ``robot.servos`` has it."""


class Drive(StrEnum):
    """What moves a joint in the MJCF as it was published."""

    SERVO = "position servo"
    MOTOR = "torque motor"
    NONE = "no actuator"
    WRONG_SIGN = "a servo whose stiffness is negative"
    NO_STIFFNESS = "a servo without stiffness"
    VELOCITY = "velocity servo"
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
    kp: float = field(metadata={"unit": "N m/rad"})
    kd: float = field(metadata={"unit": "N m s/rad"})
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
        stiffness = sum(law_of(model, motor).at_joint[0] for motor in motors)
        return Drive.SERVO if stiffness > 0 else Drive.WRONG_SIGN
    return next((kind for kind in _ORDER if kind in kinds), Drive.OTHER)


_ORDER = (Drive.SERVO, Drive.MOTOR, Drive.VELOCITY, Drive.OTHER, Drive.NO_STIFFNESS)


def _kind(model: mujoco.MjModel, motor: int) -> Drive:
    if model.actuator_gaintype[motor] != mujoco.mjtGain.mjGAIN_FIXED.value:
        return Drive.OTHER
    if model.actuator_biastype[motor] not in (
        mujoco.mjtBias.mjBIAS_NONE.value,
        mujoco.mjtBias.mjBIAS_AFFINE.value,
    ):
        return Drive.OTHER
    law = law_of(model, motor)
    stiffness, gain = law.at_joint[0], law.gain * law.gear**2
    if stiffness < 0 or (stiffness > 0 and gain < 0):
        return Drive.WRONG_SIGN
    if stiffness > 0:
        alike = abs(gain - stiffness) <= _STIFFNESS_TOLERANCE * stiffness
        return Drive.SERVO if alike else Drive.OTHER
    if gain == 0:
        return Drive.NO_STIFFNESS
    if law.damping > 0 and abs(law.gain - law.damping) <= _STIFFNESS_TOLERANCE * law.damping:
        return Drive.VELOCITY
    # An affine bias is a servo's, even if its numbers are all zero.
    affine = model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE.value
    return Drive.OTHER if affine or model.actuator_biasprm[motor, :3].any() else Drive.MOTOR
