"""Joints that follow others: ``<mimic>`` of a URDF, and joint equalities of an MJCF."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from pupper_analysis.robot.compare.mjcf_only.effect import MjcfOnlyEffect
from pupper_analysis.robot.matching.trees import Reference
from pupper_analysis.robot.matching.urdf import Mimics

EQUALITY = mujoco.mjtEq


def split_mimics(
    found: Sequence[MjcfOnlyEffect], reference: Reference, mimics: Mimics, tolerance: float
) -> tuple[list[MjcfOnlyEffect], list[str]]:
    """Tells which joint equalities say the same as a URDF's ``<mimic>``, and are no effects.

    Both state q = m q_other + c. MuJoCo's polynomial is of the coordinates less their ``qpos0``:
    q - q0 = a0 + a1 (q_other - q0_other), so that m = a1 and c = a0 + q0 - a1 q0_other.

    Args:
        found: The effects of the reference.
        reference: The MJCF.
        mimics: The URDF's, by the reference's names.
        tolerance: How far offsets (rad or m), and multipliers relative to 1, may differ.

    Returns:
        The effects that are the URDF's, too; and the joints whose mimic no equality states.
    """
    model = reference.model
    same: list[MjcfOnlyEffect] = []
    left = dict(mimics)
    for effect in found:
        if effect.kind != "equality":
            continue
        index = int(effect.slots[0][1])  # type: ignore[arg-type]
        data, ids = model.eq_data[index], (model.eq_obj1id[index], model.eq_obj2id[index])
        if model.eq_type[index] != EQUALITY.mjEQ_JOINT.value or min(ids) < 0 or data[2:5].any():
            continue
        one, two = (reference.names.joint(int(joint)).name for joint in ids)
        rest = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in ids]
        slope = float(data[1])
        offset = float(data[0]) + rest[0] - slope * rest[1]
        said = [(one, (two, slope, offset))]
        if slope:
            said.append((two, (one, 1 / slope, -offset / slope)))  # the same, read backwards
        for joint, (other, multiplier, constant) in said:
            leader, wanted, shift = left.get(joint, ("", 0.0, 0.0))
            near = abs(multiplier - wanted) <= tolerance * max(1.0, abs(wanted))
            if leader == other and near and abs(constant - shift) <= tolerance:
                same.append(effect)
                del left[joint]
                break
    return same, list(left)
