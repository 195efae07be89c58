"""Where joints are at zero angles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models import parameters

Array = NDArray[np.float64]


def at_zero(tree: parameters.Parameters) -> dict[str, tuple[Array, Array]]:
    """Returns where each joint is at zero, and its axis, both in the base's frame."""
    poses = {tree.base: pin.SE3.Identity()}
    places = {}
    for name, joint in tree.joints.items():
        poses[name] = poses[joint.parent] * pin.SE3(joint.rotation, joint.position)
        places[name] = (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
    return places
