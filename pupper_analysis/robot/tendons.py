"""Ranges of tendons, and which constraints of an MJCF no stand knows of.

What an MJCF lets joints do together a URDF cannot express.

A fixed tendon's length is a sum of joint positions, l = C q, so that its range bounds C q as a
joint's range bounds q. A spatial one's is a way through space: postures are found without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

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


class TendonRanges(NamedTuple):
    """Limited fixed tendons of a robot's joints.

    Attributes:
        names: Theirs.
        coefficients: (n, nu) of the joints, in actuator order.
        lower: (n,) least lengths (rad, m).
        upper: (n,) greatest lengths.
    """

    names: tuple[str, ...]
    coefficients: Array
    lower: Array
    upper: Array

    def room(self, joints: Array) -> Array:
        """Returns how far lengths are from their ends (2 n,) (rad, m), with joints there (nu,)."""
        lengths = self.coefficients @ joints
        return np.concatenate([lengths - self.lower, self.upper - lengths])

    def at_ends(self, joints: Array, within: float) -> Iterator[Diagnostic]:
        """Tells which tendons are no further within their ranges (rad, m), joints there (nu,)."""
        for number in np.flatnonzero(self.room(joints) < within).tolist():
            end = float(np.concatenate([self.lower, self.upper])[number])
            name = self.names[number % len(self.names)]
            yield diagnose("tendon-at-its-end", subject=("tendon", name), end=end)


def tendon_ranges(robot: Robot) -> TendonRanges:
    """Returns the ranges of a robot's tendons that postures are kept in; found once."""
    return robot.once(_found)


def _found(robot: Robot) -> TendonRanges:
    model = robot.mj_model
    kept = [*_kept(model, robot.joint_names)]
    rows = np.zeros((len(kept), robot.nu))
    for row, tendon in zip(rows, kept, strict=True):
        for joint, coefficient in _sum(model, tendon):
            row[robot.joint_names.index(joint)] += coefficient
    names = tuple(_name(model, tendon) for tendon in kept)
    return TendonRanges(names, rows, *model.tendon_range[kept].T.copy())


def _kept(model: mujoco.MjModel, joints: tuple[str, ...]) -> Iterator[int]:
    for tendon in _limited(model):
        wraps = _sum(model, tendon)
        if len(wraps) == model.tendon_num[tendon] and {name for name, _ in wraps} <= {*joints}:
            yield tendon


def _limited(model: mujoco.MjModel) -> list[int]:
    """Returns the tendons that MuJoCo keeps in their range."""
    acts = not model.opt.disableflags & _OFF
    limited: list[int] = np.flatnonzero(model.tendon_limited).tolist()
    return limited if acts else []


def _sum(model: mujoco.MjModel, tendon: int) -> list[tuple[str, float]]:
    """Returns the joints of which a tendon adds up positions, each with its coefficient."""
    first = int(model.tendon_adr[tendon])
    return [
        (model.joint(int(model.wrap_objid[wrap])).name, float(model.wrap_prm[wrap]))
        for wrap in range(first, first + int(model.tendon_num[tendon]))
        if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT.value
    ]


def _name(model: mujoco.MjModel, tendon: int) -> str:
    return str(model.tendon(tendon).name) or f"#{tendon}"


def tell_bonds_not_kept(model: mujoco.MjModel) -> list[Diagnostic]:
    """Tells which equality constraints MuJoCo acts by, and no posture knows of: those of flexes."""
    kinds = [mujoco.mjtEq(int(kind)) for kind in model.eq_type[model.eq_active0.astype(bool)]]
    left = sorted({kind.name.removeprefix("mjEQ_").lower() for kind in kinds if kind not in BONDS})
    return [diagnose("equalities-not-kept", kinds=left)] if left else []


def tell_ranges_not_kept(model: mujoco.MjModel, joints: tuple[str, ...]) -> list[Diagnostic]:
    """Tells which tendons have a range that MuJoCo keeps, and no posture knows of.

    Args:
        model: The robot's.
        joints: In actuator order.
    """
    kept = {*_kept(model, joints)}
    messages = []
    for tendon in _limited(model):
        if tendon not in kept:
            lower, upper = model.tendon_range[tendon].tolist()
            whose = [name for name, _ in _sum(model, tendon)]
            named = ("tendon", _name(model, tendon))
            messages.append(
                diagnose("tendon-with-range", subject=named, lower=lower, upper=upper, joints=whose)
            )
    return [diagnose("tendon-ranges-not-kept", tendons=messages)] if messages else []
