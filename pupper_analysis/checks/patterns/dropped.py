"""What one file has left out of all its inertials: products of inertia, coms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.checks.patterns.case import Case, Found, Key
from pupper_analysis.checks.tolerances import Tolerances
from pupper_analysis.models.parameters import Parameters

Array = NDArray[np.float64]

_MANY = 4  # bodies that have their coms in their links' origins by no accident

_ORIGIN = 1e-9  # m: a com that is nearer to its link's origin is there


def dropped_products(
    words: str,
    one: Parameters,
    two: Parameters,
    keys: Sequence[Key],
    tolerances: Tolerances,
) -> Found:
    """Finds that one file has no products of inertia at all.

    Args:
        words: What the file is called.
        one: Its tree.
        two: That of the other file, in the same link frames.
        keys: The differences.
        tolerances: What counts as one.
    """
    names = [element for kind, element in keys if kind == "inertia"]
    if len(names) < 2:
        return
    alike = [
        name
        for name in names
        if _is_diagonal(one.bodies[name].inertia)
        and np.allclose(
            np.diag(one.bodies[name].inertia),
            np.diag(two.bodies[name].inertia),
            rtol=tolerances.inertia,
        )
    ]
    if len(alike) > 1 and all(_is_diagonal(body.inertia) for body in one.bodies.values()):
        yield (
            "products",
            f"all products of inertia are 0 in the {words}, of {len(alike)} bodies that have "
            "some in the other file: were they dropped, or is it diaginertia for fullinertia?",
            {("inertia", name) for name in alike},
        )


def _is_diagonal(inertia: Array) -> bool:
    off = inertia - np.diag(np.diag(inertia))
    return float(np.abs(off).max()) <= 1e-9 * max(float(np.abs(inertia).max()), 1e-300)


def dropped_coms(words: str, one: Parameters, keys: Sequence[Key]) -> Found:
    """Finds that one file has the coms of many bodies where their links' origins are.

    Args:
        words: What the file is called.
        one: Its tree, in its own link frames.
        keys: The differences.
    """
    names = [
        element
        for kind, element in keys
        if kind == "com" and float(np.linalg.norm(one.bodies[element].com)) < _ORIGIN
    ]
    if len(names) >= _MANY:
        yield (
            "coms",
            f"the coms of {len(names)} bodies are their links' origins in the {words}, and "
            f"elsewhere in the other file: {', '.join(names[:_MANY])}"
            f"{' …' if len(names) > _MANY else ''} (was the inertials' origin left out?)",
            {("com", name) for name in names},
        )


def dropped(case: Case) -> Found:
    """Finds what one file has left out of its inertials."""
    trees_of = (("URDF", case.first, case.first), ("MJCF", case.raw, case.second))
    for (words, own, one), (_, _, two) in (trees_of, trees_of[::-1]):
        yield from dropped_products(words, one, two, case.keys, case.tolerances)
        yield from dropped_coms(words, own, case.keys)
