"""MuJoCo's soft constraints: impedance, and static deflection under a force.

Input: ``solimp`` and ``solref`` of constraints, or MuJoCo data with constraint rows. Output: the
impedance at a constraint violation, the compliance of equality constraints at rest, and the
violations under given constraint forces. The compliance depends on the violation: the violation
under a force is solved by fixed-point iteration or bisection.

Sources: MuJoCo documentation, "Computation: Solver parameters"; ``engine_core_constraint.c``.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array

_NUM_EQUATIONS = {
    mujoco.mjtEq.mjEQ_CONNECT.value: 3,
    mujoco.mjtEq.mjEQ_WELD.value: 6,
}
"""{type of an equality constraint: number of scalar equations}. Only types with a common impedance
of all equations, a function of the norm of the violations."""

_DEFAULT_REFERENCE = (0.02, 1.0)
"""Time constant [s] and damping ratio of MuJoCo's mj_defaultSolRefImp."""

_NUM_BISECTIONS = 60
"""Number of bisections that solve the violation of a soft constraint under a force. Bisection is
used if the stiffness rises with the violation. Derived: 60 halvings divide an interval by 1e18."""

_MAX_ITERATIONS = 1000
"""Maximum number of fixed-point iterations that solve the violation of a soft constraint under a
force. The iteration is used if the stiffness falls with the violation. Chosen, not tuned."""

_VIOLATION_RTOL = 1e-14
"""Tolerance of the fixed-point iteration for the violation of a soft constraint [1]. The iteration
ends if the relative change of the violation is at most this value. The value is near the rounding
error of double precision. Chosen, not tuned."""


def clip_solimp(solimp: Iterable[float]) -> tuple[float, ...]:
    """Clip the five numbers of a solimp to MuJoCo's bounds.

    Order: dmin, dmax, width [m, rad], midpoint, power. The width is not clipped, because a negative
    width has the same effect as MuJoCo's lower bound, zero (`solimp_impedance`).
    """
    dmin, dmax, width, midpoint, power = (float(value) for value in solimp)
    dmin, dmax, midpoint = (
        min(max(value, mujoco.mjMINIMP), mujoco.mjMAXIMP) for value in (dmin, dmax, midpoint)
    )
    return dmin, dmax, width, midpoint, max(power, 1.0)


def effective_solref(solref: Iterable[float]) -> tuple[float, float]:
    """Return the solref that MuJoCo applies: the stated solref, or MuJoCo's default.

    MuJoCo applies its default if exactly one of the two values is positive. MuJoCo's lower bound of
    the time constant (``refsafe``) is not applied.

    Source: getsolparam in MuJoCo's ``engine_core_constraint.c``.

    Args:
        solref: Two numbers, as in the MJCF.

    Returns:
        Time constant [s] and damping ratio [1], if positive; otherwise -stiffness and -damping.
    """
    first, second = (float(value) for value in solref)
    return (first, second) if (first > 0) == (second > 0) else _DEFAULT_REFERENCE


def solimp_impedance(solimp: tuple[float, ...], violation: float) -> tuple[float, float]:
    """Return the impedance d of a soft constraint, and the derivative of d by abs(violation).

    d changes from dmin at zero violation to dmax at the violation ``width``. If ``width`` is at
    most 1e-15 (``mjMINVAL``), d is the mean of dmin and dmax.

    Source: MuJoCo documentation, "Computation: Solver parameters"; ``engine_core_constraint.c``.

    Args:
        solimp: Parameters from ``clip_solimp``.
        violation: Violation of the constraint [m, rad]; for a contact, penetration plus margin.

    Returns:
        Impedance d [1]; derivative [1/m, 1/rad].
    """
    dmin, dmax, width, midpoint, power = solimp
    if dmin == dmax or width <= mujoco.mjMINVAL:
        return (dmin + dmax) / 2, 0.0
    x, rise = min(abs(violation) / width, 1.0), dmax - dmin
    if x <= midpoint:
        fraction = x / midpoint
        y = midpoint * fraction**power
    else:
        fraction = (1 - x) / (1 - midpoint)
        y = 1 - (1 - midpoint) * fraction**power
    slope = power * fraction ** (power - 1) * rise / width if x < 1 else 0.0
    return dmin + y * rise, slope


class EqualityCompliance:
    """Compliance of a model's equality constraints at a configuration, for any violation.

    At rest, an equation with the violation x exerts the force k d^2 x / ((1 - d) A). The impedance
    d depends on abs(x), or for the equations of a ``connect`` or ``weld`` on the norm of all their
    violations. A (MuJoCo's ``diagApprox``) and k (stiffness from ``solref``) do not depend on x.

    Args:
        model: MuJoCo model.
        data: Data in which all constraint rows belong to equality constraints. The object keeps no
            reference to the data.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        impedance = data.efc_KBIP[:, 2]
        self._compliance: Array = 1 / (data.efc_D * data.efc_KBIP[:, 0] * impedance)
        self._base_compliance: Array = self._compliance * impedance**2 / (1 - impedance)
        self._row_groups: list[tuple[slice, tuple[float, ...]]] = []
        row = 0
        while row < data.nefc:
            constraint = int(data.efc_id[row])
            num_rows = _NUM_EQUATIONS.get(int(model.eq_type[constraint]), 1)
            self._row_groups.append(
                (slice(row, row + num_rows), clip_solimp(model.eq_solimp[constraint]))
            )
            row += num_rows

    def current_compliance(self) -> Array:
        """Return the present compliance of each of m scalar equations, shape (m,) [m/N, rad/(N m)].

        The compliance is violation / constraint force. It belongs to the violations in the data
        that the constructor was given.
        """
        return self._compliance.copy()

    def max_compliance(self) -> Array:
        """Return the largest compliance of each of m scalar equations, shape (m,) [m/N, rad/(N m)].

        The result is the maximum over all violations.
        """
        compliance = self._base_compliance.copy()
        for rows, solimp in self._row_groups:
            compliance[rows] *= max(
                _compute_compliance_factor(solimp, 0.0),
                _compute_compliance_factor(solimp, solimp[2]),
            )
        return compliance

    def solve_violations(self, forces: Array) -> Array:
        """Solve the violations of equality constraints under forces at rest, shape (m,) [m, rad].

        Args:
            forces: Force of each of m scalar equations, shape (m,) [N, N m].
        """
        openings = self._base_compliance * forces
        for rows, solimp in self._row_groups:
            openings[rows] *= _compute_compliance_factor(
                solimp, _solve_violation(solimp, float(np.linalg.norm(openings[rows])))
            )
        return openings


def _solve_violation(solimp: tuple[float, ...], force: float) -> float:
    """Return the smallest violation x [m, rad] that satisfies x = ``force`` (1 - d(x)) / d(x)^2.

    d is the impedance. ``force`` is the constraint force times the compliance for (1 - d) / d^2 =
    1, so that its unit is m or rad.
    """
    low, high = (
        force * _compute_compliance_factor(solimp, opening) for opening in (0.0, solimp[2])
    )
    if low < high:
        for _ in range(_MAX_ITERATIONS):
            previous, low = low, force * _compute_compliance_factor(solimp, low)
            if low - previous <= _VIOLATION_RTOL * low:
                break
        return low
    if high >= solimp[2]:
        return high
    low, high = high, low
    for _ in range(_NUM_BISECTIONS):
        middle = (low + high) / 2
        exceeds_solution = middle > force * _compute_compliance_factor(solimp, middle)
        low, high = (low, middle) if exceeds_solution else (middle, high)
    return (low + high) / 2


def _compute_compliance_factor(solimp: tuple[float, ...], violation: float) -> float:
    """Return the factor (1 - d) / d^2 of compliance; d is the impedance at a violation [m, rad]."""
    d, _ = solimp_impedance(solimp, violation)
    return (1 - d) / d**2
