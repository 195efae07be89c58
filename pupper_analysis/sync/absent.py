"""What a file does not state: nothing that could be taken, unless one asks for it."""

from __future__ import annotations

import math
from typing import Final

from pupper_analysis.checks.differences import LIMITS, OF_INERTIALS
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.sync.frames import Key, Sides

_VALUE: Final = {"lower limit": "lower", "upper limit": "upper", "effort": "effort"}

_ATTRIBUTE: Final = {"damping": "damping", "friction": "frictionloss"}
"""What an MJCF's joint calls what a URDF's <dynamics> has under the name of the kind."""


def is_absent(key: Key, whose: str, both: Sides, urdf: UrdfFile, mjcf: MjcfFile) -> bool:
    """Says whether the file whose value shall be taken states none.

    A limit that is not there is infinite, a damping or a friction 0, and so is the mass of a body
    without an <inertial>: that is how the engines read it, and not what anybody has written. A
    URDF must state an effort, and 0 is what exporters write where they know none.

    Args:
        key: The kind and the element of a difference.
        whose: ``"urdf"`` or ``"mjcf"``.
        both: Both robots.
        urdf: The URDF.
        mjcf: The MJCF.
    """
    kind, name = key
    side = both.urdf if whose == "urdf" else both.mjcf
    if kind == "effort" and whose == "urdf" and name in side.joints:
        return not 0 < side.joints[name].effort < math.inf
    if kind in LIMITS:
        return name in side.joints and math.isinf(getattr(side.joints[name], _VALUE[kind]))
    if kind in OF_INERTIALS:
        return name in side.bodies and not side.bodies[name].mass > 0
    if kind not in _ATTRIBUTE or name not in side.joints or getattr(side.joints[name], kind):
        return False
    if whose == "mjcf":
        return mjcf.stated("joint", name, {_ATTRIBUTE[kind]}) is None
    joint = both.matched.urdf_joint[name]
    dynamics = urdf.tree.joints[joint].element.find("dynamics")
    return dynamics is None or dynamics.get(kind) is None
