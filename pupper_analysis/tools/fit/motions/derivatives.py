"""How predicted motions change with parameters: differences along what is known to be uncertain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.tools.fit.moments import Moments
from pupper_analysis.tools.fit.motions.rollouts import Run, Simulator

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_STEP = 0.1
"""Of a standard deviation: by that parameters are changed for a derivative. From 0.1 to 1 the
intervals of a v3 are the same to 1 %, and motions hardly bend in the least of these."""

_FIRST_STEP = 1e-2
"""Of a prior's width, while nothing else is known."""


def differentiate(
    simulator: Simulator,
    moments: Moments,
    run: Run,
    at: Array,
    known: Array | None = None,
) -> Mapping[int, tuple[IntArray, Array]]:
    """Returns how predicted positions change with parameters by moments.

    kp, friction, masses all larger by the same factor move nothing, but each alone moves much: by
    parameters one at a time, errors of large derivatives add up to what looks as if the factor were
    told, and intervals are a quarter too narrow. So steps are along principal directions of what is
    known, each as long as it is uncertain.

    Joints that move no body of each other's are changed together, as they do not feel it.

    Args:
        simulator: Predicts them.
        moments: Makes parameters of moments.
        run: The run.
        at: (n,) moments.
        known: (n, n) what is known of these, in the priors' widths: inverse of a covariance. None:
            the priors alone, and steps are one parameter at a time.

    Returns:
        {group of joints: (numbers of the parameters that act on it, (n, joints, parameters))}.
    """
    groups, shared = simulator.groups, simulator.bodies.shared(simulator.table)
    turns, width = max(len(columns) for _, columns in groups), simulator.table.width
    changes = np.zeros((turns + len(shared), len(at)))
    steps = []
    for columns in (*(own for _, own in groups), shared):
        steps.append(_steps(columns, known))
        rows = slice(len(columns)) if len(steps) <= len(groups) else slice(turns, None)
        changes[rows, columns] = steps[-1]
    changes *= width

    vectors = [moments.to_parameters(one) for one in (at, *(at + changes))]
    predicted = simulator.predict_all(run, np.array(vectors))
    moved = predicted[1:] - predicted[0]
    found: dict[int, tuple[IntArray, Array]] = {}
    for number, (joints, columns) in enumerate(groups):
        places = np.array([*columns, *shared], dtype=np.int64)
        by_step = np.moveaxis(moved[:, :, joints], 0, 2)
        slopes = np.concatenate(
            [
                by_step[..., : len(columns)] @ np.linalg.inv(steps[number]).T,
                by_step[..., turns:] @ np.linalg.inv(steps[-1]).T,
            ],
            axis=2,
        )
        found[number] = places, slopes / width[places]
    return found


def _steps(columns: list[int], known: Array | None) -> Array:
    """Returns steps (rows) of some parameters in their priors' widths."""
    if known is None:
        return _FIRST_STEP * np.eye(len(columns))
    values, directions = np.linalg.eigh(known[np.ix_(columns, columns)])
    steps: Array = _STEP * (directions / np.sqrt(values)).T
    return steps
