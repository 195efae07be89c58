"""Where joints are at zero angles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models import multibody

Array = NDArray[np.float64]


def poses_at_zero(tree: multibody.MultibodyTree) -> dict[str, pin.SE3]:
    """Returns where each body's frame is at zero angles, in the base's."""
    poses = {tree.base: pin.SE3.Identity()}
    for name in tree.parents_first():
        joint = tree.joints[name]
        poses[name] = poses[joint.parent] * joint.placement
    return poses


def at_zero(tree: multibody.MultibodyTree) -> dict[str, tuple[Array, Array]]:
    """Returns where each joint is at zero, and its axis, both in the base's frame."""
    poses = poses_at_zero(tree)
    return {
        name: (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
        for name, joint in tree.joints.items()
    }
