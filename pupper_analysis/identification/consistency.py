"""Estimates that a body can have: masses above zero, coms within links, inertias that exist."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import clarabel
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import sparse

from pupper_analysis.arrays import INERTIA_ENTRIES, inertia_entries, inertia_tensor
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import FitError
from pupper_analysis.identification.estimate import Posterior
from pupper_analysis.identification.hulls import hull_of
from pupper_analysis.identification.parameters import KINDS
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_LEAST = 0.01
"""Of a stated mass or stiffness: a link that weighs a hundredth of it is another link."""

_OUTSIDE = 0.005
"""m: shapes leave out covers, screws and cables, and are drawn by hand."""

_BINDING = 1e-6
"""Standard deviations: a multiplier above it holds an estimate; the others are rounding."""


_FLAT = 1e-6
"""Of the greatest stated moment: so thick is a body at least. Engines refuse what is flatter."""

_NONE = 1e-300
"""What no row is divided by."""


@dataclass(frozen=True, eq=False)
class _Bound:
    """Rows G x <= h of one constraint, or a matrix h - G x that has no negative eigenvalue.

    Attributes:
        matrix: (m, n).
        right: (m,).
        told: What is said where it holds an estimate.
        matrix_size: Of the matrix; 0 of rows.
    """

    matrix: Array
    right: Array
    told: Diagnostic
    matrix_size: int = 0


def make_consistent(robot: Robot, posterior: Posterior) -> tuple[Array, tuple[Diagnostic, ...]]:
    """Returns the parameters that a body can have and that are nearest to the estimate.

    Nearest in the metric of the posterior's covariance C: the least (x - mean)^T C^-1 (x - mean)
    with: masses and what else is positive above zero; coms within 5 mm of the hull of their link's
    shapes, or of where the file has them; and, where all inertia is estimated, a positive
    semidefinite pseudo-inertia (Wensing, Kim, Slotine, "Linear matrix inequalities for physically
    consistent inertial parameter identification", 2018): of a mass above zero that is
    tr(I) / 2 - I > 0, with I about the com. Where it is not, the density pattern of the file
    stays, which such an inertia has. By Clarabel.

    Args:
        robot: The robot, as its files have it.
        posterior: The estimate.

    Returns:
        (n,) the parameters, and which constraints hold them: none, and the estimate itself, if it
        is consistent.

    Raises:
        FitError: If nothing is.
    """
    mean = np.array(posterior.mean, dtype=float)
    bounds = list(_bounds(robot, posterior))
    if all(_holds(bound, mean) for bound in bounds):
        return mean, ()
    # x = mean + spread y, where y has the covariance 1: the least |y|.
    widths = np.array([one.width for one in posterior.parameters])
    scaled = posterior.covariance / np.outer(widths, widths)
    spread = widths[:, None] * np.linalg.cholesky(scaled)
    rows: list[Array] = []
    right: list[Array] = []
    cones: list[object] = []
    for bound in bounds:
        matrix, rest = bound.matrix @ spread, bound.right - bound.matrix @ mean
        sizes = np.maximum(np.linalg.norm(matrix, axis=1), _NONE)  # rows in standard deviations
        if bound.matrix_size:
            sizes[:] = sizes.max()
            cones.append(clarabel.PSDTriangleConeT(bound.matrix_size))
        else:
            cones.append(clarabel.NonnegativeConeT(len(rest)))
        rows.append(matrix / sizes[:, None])
        right.append(rest / sizes)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    n = len(mean)
    solution = clarabel.DefaultSolver(
        sparse.identity(n, format="csc"),
        np.zeros(n),
        sparse.csc_matrix(np.concatenate(rows)),
        np.concatenate(right),
        cones,
        settings,
    ).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise FitError(diagnose("no-consistent-estimate"))
    step, multipliers = np.array(solution.x), np.array(solution.z)
    found, at = [], 0
    for bound in bounds:
        if np.abs(multipliers[at : at + len(bound.right)]).max(initial=0.0) > _BINDING:
            found.append(bound.told)
        at += len(bound.right)
    off = float(np.linalg.norm(step))
    return mean + spread @ step, (*found, diagnose("estimate-moved", deviations=off))


def _holds(bound: _Bound, x: Array) -> bool:
    rest = bound.right - bound.matrix @ x
    if not bound.matrix_size:
        return bool((rest >= 0).all())
    return bool(np.linalg.eigvalsh(_unpacked(rest))[0] >= 0)


def _bounds(robot: Robot, posterior: Posterior) -> Iterator[_Bound]:
    parameters = posterior.parameters
    place = {(one.kind, one.subject, one.component): at for at, one in enumerate(parameters)}
    for at, one in enumerate(parameters):
        if KINDS[one.kind].positive:
            least = _LEAST * one.stated if one.kind in ("mass", "kp") else 0.0
            value = Quantity(least, one.unit)
            told = diagnose("held-above-zero", parameter=one.name, least=value)
            yield _Bound(-np.eye(1, len(parameters), at), np.array([-least]), told)
    for link in dict.fromkeys(one.subject for one in parameters if one.kind == "com"):
        yield from _within_hull(robot, posterior, place, link)
    for link in dict.fromkeys(one.subject for one in parameters if one.kind == "inertia"):
        yield _existing(robot, posterior, place, link)


def _within_hull(
    robot: Robot, posterior: Posterior, place: dict[tuple[str, str, str], int], link: str
) -> Iterator[_Bound]:
    normals, reach = hull_of(robot, link)
    if not len(reach):
        return
    stated = np.array(_inertia(robot, link).lever)
    matrix, known = np.zeros((3, len(posterior.parameters))), stated.copy()
    for axis, component in enumerate("xyz"):
        at = place.get(("com", link, component))
        if at is not None:
            matrix[axis, at], known[axis] = 1.0, 0.0
    # What the file says is not called impossible here: its audit does.
    reach = np.maximum(reach, normals @ stated) + _OUTSIDE
    told = diagnose("com-held-in-hull", link=link, margin=Quantity(_OUTSIDE, "m"))
    yield _Bound(normals @ matrix, reach - normals @ known, told)


def _existing(
    robot: Robot, posterior: Posterior, place: dict[tuple[str, str, str], int], link: str
) -> _Bound:
    """Returns that tr(I) / 2 - I has no negative eigenvalue; entries not estimated are stated."""
    stated = inertia_entries(np.array(_inertia(robot, link).inertia))
    matrix = np.zeros((6, len(posterior.parameters)))
    right = -_FLAT * float(stated[:3].max()) * _packed(np.eye(3))
    for entry, (name, value) in enumerate(zip(INERTIA_ENTRIES, stated, strict=True)):
        unit = np.zeros(6)
        unit[entry] = 1.0
        moments = _second_moments(unit)
        at = place.get(("inertia", link, name[1:]))
        if at is None:
            right += value * moments
        else:
            matrix[:, at] -= moments
    return _Bound(matrix, right, diagnose("inertia-held", link=link), 3)


def _second_moments(entries: Array) -> Array:
    """Returns tr(I) / 2 - I of an inertia's entries, as Clarabel's upper triangle (6,)."""
    tensor = inertia_tensor(entries)
    return _packed(np.trace(tensor) / 2 * np.eye(3) - tensor)


def _packed(matrix: Array) -> Array:
    """Returns the upper triangle by columns, off the diagonal times sqrt(2)."""
    rows = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    return np.array([matrix[i, j] * (1.0 if i == j else np.sqrt(2.0)) for i, j in rows])


def _unpacked(packed: Array) -> Array:
    a, b, c, d, e, f = packed / np.array([1, np.sqrt(2), 1, np.sqrt(2), np.sqrt(2), 1])
    return np.array([[a, b, d], [b, c, e], [d, e, f]])


def _inertia(robot: Robot, link: str) -> pin.Inertia:
    model = robot.pin_model
    at = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
    return model.inertias[at]
