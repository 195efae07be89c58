"""Conventions in which two files differ, told as differences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.words import FORMATS, ModelNames
from pupper_analysis.diagnostics import Quantity, diagnose
from pupper_analysis.matching.alignment import with_base
from pupper_analysis.matching.conventions import Conventions, pose_told, with_zero
from pupper_analysis.models.multibody import MultibodyTree


def convention_changes(
    found: Conventions, first: MultibodyTree, sides: ModelNames = FORMATS
) -> Iterator[tuple[Difference, MultibodyTree]]:
    """Yields each convention as a difference, and the first robot without that change.

    Args:
        found: The conventions; of a fixed base that shows it, where its frame is is no difference.
        first: The first robot, in the second's conventions.
        sides: What the two are called.
    """
    if found.base is not None and (first.floating or not found.shown):
        told = diagnose(
            "base-frame-elsewhere",
            subject=("body", first.base),
            pose=pose_told(found.base),
            floating=first.floating,
            shown=found.shown,
            **sides.named,
        )
        pose = np.array(found.base.homogeneous)
        difference = Difference("base frame", first.base, pose, np.eye(4), "m", told, {})
        yield difference, with_base(first, found.base.inverse())
    for name, offset in found.zeros.items():
        unit = "m" if first.joints[name].slides else "rad"
        told = diagnose(
            "joint-zero-elsewhere",
            subject=("joint", name),
            offset=Quantity(offset, unit),
            more=offset > 0,
            magnitude=Quantity(abs(offset), unit),
            turn=None if unit == "m" else Quantity(offset, unit),
            **sides.named,
        )
        difference = Difference("zero", name, offset, 0.0, unit, told, {})
        yield difference, with_zero(first, name, -offset)
