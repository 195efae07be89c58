"""What is left of a rigid body, and whether two are the same."""

from __future__ import annotations

import functools
import operator
from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

Part = TypeVar("Part", bound=Hashable)

_TRIANGLE = 1e-6
"""By how much of itself a principal moment may exceed the sum of the others, for rounding."""


def without_parts(whole: pin.Inertia, parts: Sequence[pin.Inertia]) -> pin.Inertia | None:
    """Returns what is left of a body without some parts of it; None if no mass is left."""
    if not whole.mass > sum(part.mass for part in parts):
        return None if parts else whole
    return functools.reduce(operator.sub, parts, whole)


def spread_alike(
    parts: Mapping[Part, pin.Inertia], wanted: pin.Inertia
) -> dict[Part, pin.Inertia] | None:
    """Returns parts of a body that all are as much heavier, and moved by one step.

    Their sum is a body of the same density pattern: its inertia about the com is in proportion to
    its mass.

    Args:
        parts: The parts, in one frame.
        wanted: Their sum, as it shall be.

    Returns:
        {part: as it shall be}; None if the wanted body is of another pattern, or has no mass.
    """
    now = functools.reduce(operator.add, parts.values(), pin.Inertia.Zero())
    if not (now.mass > 0 and wanted.mass > 0):
        return None
    factor, step = wanted.mass / now.mass, wanted.lever - now.lever
    alike = pin.Inertia(wanted.mass, wanted.lever, factor * np.array(now.inertia))
    if not is_same_body(alike, wanted, 1e-10):
        return None
    return {
        name: pin.Inertia(factor * part.mass, part.lever + step, factor * np.array(part.inertia))
        for name, part in parts.items()
    }


def is_physical(body: pin.Inertia) -> bool:
    """Says whether a rigid body can be so."""
    if not body.mass > 0:
        return False
    least, middle, greatest = np.linalg.eigvalsh(np.array(body.inertia))
    return bool(least > 0 and least + middle >= (1 - _TRIANGLE) * greatest)


def is_same_body(one: pin.Inertia, two: pin.Inertia, tolerance: float = 1e-11) -> bool:
    """Says whether two bodies are the same but for rounding."""
    size = max(float(np.abs(one.inertia).max()), float(np.abs(two.inertia).max()), 1e-300)
    return bool(
        abs(one.mass - two.mass) <= tolerance * max(one.mass, two.mass)
        and float(np.abs(one.lever - two.lever).max()) <= tolerance
        and float(np.abs(one.inertia - two.inertia).max()) <= tolerance * size
    )


def turned_like(wanted: Array, own: Array, near: Array) -> Array | None:
    """Returns the rotation that makes one tensor of another: wanted = R own R^T.

    Args:
        wanted: The tensor.
        own: The same in other axes.
        near: Of the rotations that do, the nearest to this one is returned, or none at all.

    Returns:
        It; None if the principal moments differ.
    """
    moments, axes = np.linalg.eigh(wanted)
    others, own_axes = np.linalg.eigh(own)
    if float(np.abs(moments - others).max()) > 1e-10 * float(np.abs(moments).max()):
        return None
    candidates = [np.eye(3), near]
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        turn = axes @ np.diag(signs).astype(float) @ own_axes.T
        candidates.append(turn if np.linalg.det(turn) > 0 else -turn)
    size = float(np.abs(wanted).max())
    right = [
        turn
        for turn in candidates
        if float(np.abs(turn @ own @ turn.T - wanted).max()) <= 1e-11 * size
    ]
    straight = [turn for turn in right if np.allclose(turn, np.eye(3), atol=1e-12)]
    if straight:
        return straight[0]
    return max(right, key=lambda turn: float(np.trace(near.T @ turn)), default=None)
