"""MuJoCo's soft constraints: their impedance, and by how much they open under a force, at rest."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DISTANCES = {
    mujoco.mjtEq.mjEQ_CONNECT.value: 3,
    mujoco.mjtEq.mjEQ_WELD.value: 6,
}
"""Equations of a constraint whose impedance is that at their common length; others have one."""

_DEFAULT_REFERENCE = (0.02, 1.0)
"""Time constant (s) and damping ratio: MuJoCo's mj_defaultSolRefImp."""

_HALVINGS = 60
"""Of the bounds of an opening: to rounding."""

_MAX_ITERATIONS = 1000
"""Of repeated substitution, which rises to the least opening."""

_EXACT = 1e-14
"""Of an opening."""


def clip_solimp(solimp: Iterable[float]) -> tuple[float, ...]:
    """Returns dmin, dmax, width, midpoint and power within the bounds that MuJoCo sets them."""
    dmin, dmax, width, midpoint, power = (float(value) for value in solimp)
    dmin, dmax, midpoint = (
        min(max(value, mujoco.mjMINIMP), mujoco.mjMAXIMP) for value in (dmin, dmax, midpoint)
    )
    return dmin, dmax, width, midpoint, max(power, 1.0)


def effective_solref(solref: Iterable[float]) -> tuple[float, float]:
    """Returns solref as MuJoCo takes it: one number above zero and one not are its default.

    Two above zero are a time constant and a damping ratio; else they are stiffness and damping.

    Source: MuJoCo's getsolparam in engine_core_constraint.c; it warns.
    """
    first, second = (float(value) for value in solref)
    return (first, second) if (first > 0) == (second > 0) else _DEFAULT_REFERENCE


def solimp_impedance(solimp: tuple[float, ...], opened: float) -> tuple[float, float]:
    """Returns a constraint's impedance d, and its derivative (1/m), where it is open (m or rad).

    Args:
        solimp: As ``clip_solimp`` returns it.
        opened: From the constraint's margin; d is dmin at none, and dmax at ``width``.

    Source: MuJoCo documentation, "Computation: Solver parameters"; engine_core_constraint.c.
    """
    dmin, dmax, width, midpoint, power = solimp
    if dmin == dmax or width <= mujoco.mjMINVAL:
        return (dmin + dmax) / 2, 0.0
    x, rise = min(abs(opened) / width, 1.0), dmax - dmin
    if x <= midpoint:
        share = x / midpoint
        y = midpoint * share**power
    else:
        share = (1 - x) / (1 - midpoint)
        y = 1 - (1 - midpoint) * share**power
    steeper = power * share ** (power - 1) * rise / width if x < 1 else 0.0
    return dmin + y * rise, steeper


class Softness:
    """How soft a model's equality constraints are, at a configuration, however far they are open.

    At rest a constraint that is open by x pushes with k d^2 x / ((1 - d) A), with the impedance d
    at the length of x; A and k do not depend on it.

    Args:
        model: The model.
        data: Its data, with its constraints' rows; they are read at once.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        impedance = data.efc_KBIP[:, 2]
        self._here: Array = 1 / (data.efc_D * data.efc_KBIP[:, 0] * impedance)
        self._per_law: Array = self._here * impedance**2 / (1 - impedance)
        self._groups: list[tuple[slice, tuple[float, ...]]] = []
        row = 0
        while row < data.nefc:
            number = int(data.efc_id[row])
            count = _DISTANCES.get(int(model.eq_type[number]), 1)
            self._groups.append((slice(row, row + count), clip_solimp(model.eq_solimp[number])))
            row += count

    def here(self) -> Array:
        """Returns by how much each equation opens per force (m,), where it is as open as it is."""
        return self._here.copy()

    def most(self) -> Array:
        """Returns the same, where constraints are the softest that they ever are."""
        soft = self._per_law.copy()
        for rows, solimp in self._groups:
            soft[rows] *= max(_law(solimp, 0.0), _law(solimp, solimp[2]))
        return soft

    def opened(self, forces: Array) -> Array:
        """Returns by how much the equations open (m,) under forces (m,), at rest."""
        found = self._per_law * forces
        for rows, solimp in self._groups:
            found[rows] *= _law(solimp, _length(solimp, float(np.linalg.norm(found[rows]))))
        return found


def _length(solimp: tuple[float, ...], force: float) -> float:
    """Returns by how much a constraint is open under a force: x = force law(x)."""
    low, high = (force * _law(solimp, at) for at in (0.0, solimp[2]))
    if low < high:  # the softer the more it is open: as far as it goes when it begins closed
        for _ in range(_MAX_ITERATIONS):
            last, low = low, force * _law(solimp, low)
            if low - last <= _EXACT * low:
                break
        return low
    if high >= solimp[2]:
        return high
    low, high = high, low
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        beyond = middle > force * _law(solimp, middle)
        low, high = (low, middle) if beyond else (middle, high)
    return (low + high) / 2


def _law(solimp: tuple[float, ...], opened: float) -> float:
    """Returns (1 - d) / d^2: how soft a constraint is for its impedance."""
    d, _ = solimp_impedance(solimp, opened)
    return (1 - d) / d**2
