"""Through which gear an actuator of an MJCF acts on which joint."""

from __future__ import annotations

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
