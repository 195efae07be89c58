"""Joints of a URDF that follow others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pupper_analysis.models.urdf_tree import UrdfTree

Mimics = Mapping[str, tuple[str, float, float]]
"""{joint: (the joint that it follows, multiplier, offset)}: q = multiplier q_other + offset."""


def urdf_mimics(root: Any) -> dict[str, tuple[str, float, float]]:
    """Returns the joints of a parsed URDF that follow others: their ``<mimic>``."""
    found = {}
    for name, joint in UrdfTree(root).joints.items():
        mimic = joint.mimic
        if mimic is not None and not joint.is_fixed:
            numbers = (float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            found[name] = (str(mimic.get("joint")), *numbers)
    return found
