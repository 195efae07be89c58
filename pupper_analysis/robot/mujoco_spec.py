"""MuJoCo spec from which a robot's model is compiled."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.robot.floor import disable_ground, find_floor


def make_mujoco_spec(
    description: Description, *, fixed_base: bool
) -> tuple[mujoco.MjSpec, Array, list[Diagnostic]]:
    """Copy the MJCF of a description, and prepare the copy for a free or a fixed base.

    Args:
        description: Contents of the URDF and the MJCF.
        fixed_base: Whether free joints and keyframes are removed. If a free joint was removed, the
            ground no longer collides. If False, a missing floor of a robot with a free joint is
            added.

    Returns:
        Spec; qpos of the keyframe ``home`` or of the first keyframe; notes on the changes. qpos is
        in MuJoCo's order, includes the coordinates of a removed free joint, and is empty if the
        MJCF states none.
    """
    notes = []
    spec = description.mjcf.copy()
    keys = sorted(spec.keys, key=lambda key: key.name != "home")
    keyframe = np.array(keys[0].qpos) if keys else np.zeros(0)
    free = [joint for joint in spec.joints if joint.type == JointKind.FREE]
    if fixed_base:
        for element in (*free, *spec.keys):
            spec.delete(element)
        notes += disable_ground(spec) if free else []  # a fixed robot may intersect the ground
    elif free and not find_floor(spec):
        SpecTree(spec).add_floor()
        notes.append(diagnose("ground-added"))
    return spec, keyframe, notes
