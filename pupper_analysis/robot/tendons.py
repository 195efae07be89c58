"""Reports of MuJoCo constraints that the stance solver ignores.

Equality constraints of flexible bodies (``flex``) and ranges of tendons act in MuJoCo's simulation
only. Computed stances ignore such constraints. A URDF cannot express them.
"""

from __future__ import annotations

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose

SUPPORTED_EQUALITIES = frozenset(
    {
        mujoco.mjtEq.mjEQ_CONNECT,
        mujoco.mjtEq.mjEQ_WELD,
        mujoco.mjtEq.mjEQ_JOINT,
        mujoco.mjtEq.mjEQ_TENDON,
    }
)
"""Types of equality constraints that computed stances satisfy, unless a constraint couples a free
base to the world (`find_closure`)."""

_LIMIT_DISABLING_BITS = (
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value | mujoco.mjtDisableBit.mjDSBL_LIMIT.value
)
"""MuJoCo's two disable flags (bit mask), each of which switches off the ranges of tendons."""


def report_ignored_equalities(model: mujoco.MjModel) -> list[Diagnostic]:
    """Report the types of active equality constraints that the stance solver does not support.

    Constraints of flexible bodies (``flex``), for example, act in MuJoCo's simulation only.

    Returns:
        One diagnostic, or an empty list.
    """
    kinds = [mujoco.mjtEq(int(kind)) for kind in model.eq_type[model.eq_active0.astype(bool)]]
    ignored = sorted(
        {
            kind.name.removeprefix("mjEQ_").lower()
            for kind in kinds
            if kind not in SUPPORTED_EQUALITIES
        }
    )
    return [diagnose("equalities-not-kept", kinds=ignored)] if ignored else []


def report_ignored_tendon_ranges(model: mujoco.MjModel) -> list[Diagnostic]:
    """Report the tendons with a limited length, because the stance solver ignores the limits."""
    messages = []
    for tendon in model.tendon_limited.nonzero()[0].tolist():
        lower, upper = model.tendon_range[tendon].tolist()
        subject = ("tendon", str(model.tendon(tendon).name) or f"#{tendon}")
        messages.append(diagnose("tendon-with-range", subject=subject, lower=lower, upper=upper))
    are_enforced = messages and not model.opt.disableflags & _LIMIT_DISABLING_BITS
    return [diagnose("tendon-ranges-not-kept", tendons=messages)] if are_enforced else []
