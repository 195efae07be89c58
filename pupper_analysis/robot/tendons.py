"""Which constraints of an MJCF no stand knows of: it is said on loading.

What an MJCF lets joints do together a URDF cannot express. Ranges of tendons, and constraints that
bind no joints, act in MuJoCo's simulation alone: postures are found without them.
"""

from __future__ import annotations

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose

BONDS = frozenset(
    {
        mujoco.mjtEq.mjEQ_CONNECT,
        mujoco.mjtEq.mjEQ_WELD,
        mujoco.mjtEq.mjEQ_JOINT,
        mujoco.mjtEq.mjEQ_TENDON,
    }
)
"""Equality constraints that bind joints: stands keep them (``closure``)."""

_OFF = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value | mujoco.mjtDisableBit.mjDSBL_LIMIT.value


def tell_bonds_not_kept(model: mujoco.MjModel) -> list[Diagnostic]:
    """Tells which equality constraints MuJoCo acts by, and no posture knows of: those of flexes."""
    kinds = [mujoco.mjtEq(int(kind)) for kind in model.eq_type[model.eq_active0.astype(bool)]]
    left = sorted({kind.name.removeprefix("mjEQ_").lower() for kind in kinds if kind not in BONDS})
    return [diagnose("equalities-not-kept", kinds=left)] if left else []


def tell_ranges_not_kept(model: mujoco.MjModel) -> list[Diagnostic]:
    """Tells which tendons have a range: MuJoCo keeps it, and no posture knows of it."""
    messages = []
    for tendon in model.tendon_limited.nonzero()[0].tolist():
        lower, upper = model.tendon_range[tendon].tolist()
        named = ("tendon", str(model.tendon(tendon).name) or f"#{tendon}")
        messages.append(diagnose("tendon-with-range", subject=named, lower=lower, upper=upper))
    kept = messages and not model.opt.disableflags & _OFF
    return [diagnose("tendon-ranges-not-kept", tendons=messages)] if kept else []
