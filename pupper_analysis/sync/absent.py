"""What a file does not state: nothing that could be taken, unless one asks for it."""

from __future__ import annotations

import math

from pupper_analysis.checks.differences import LIMITS, OF_INERTIALS
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.sync.frames import Key, MatchedRobots


def is_absent(key: Key, whose: str, both: MatchedRobots, urdf: UrdfFile, mjcf: MjcfFile) -> bool:
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
    attribute = BY_KIND.get(kind)
    if kind in LIMITS and attribute is not None:
        return name in side.joints and math.isinf(getattr(side.joints[name], attribute.field))
    if kind in OF_INERTIALS:
        return name in side.bodies and not side.bodies[name].mass > 0
    if attribute is None or attribute.urdf is None or name not in side.joints:
        return False
    if getattr(side.joints[name], attribute.field):
        return False
    if whose == "mjcf":
        return mjcf.stated("joint", name, attribute.mjcf) is None
    return urdf.tree.joints[both.matched.urdf_joint[name]].stated(attribute) is None
