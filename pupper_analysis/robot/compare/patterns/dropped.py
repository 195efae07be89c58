"""What one file has left out of all its inertials: products of inertia, coms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.changes import body_changes
from pupper_analysis.robot.compare.links import ComparedLink, fold_bodies
from pupper_analysis.robot.compare.patterns.case import (
    Found,
    Key,
    PatternCase,
    PatternFinding,
)

Array = NDArray[np.float64]

_LEAST_DROPPED = 4  # bodies that have their coms in their links' origins by no accident

_ORIGIN = 1e-9  # m: a com that is nearer to its link's origin is there


def dropped_products(case: PatternCase, lacking: str) -> Found:
    """Finds that one file has no products of inertia at all.

    They are dropped in the other file, in each link's own axes or, had they been folded before, in
    those of the body that carries it: then the two are alike.

    Args:
        case: The two trees.
        lacking: The file that is to have none, ``URDF`` or ``MJCF``.
    """
    if sum(kind == "inertia" for kind, _ in case.open) < 2:
        return
    bare, full = (case.urdf, case.mjcf) if lacking == "URDF" else (case.mjcf, case.urdf)
    tree, other = (case.second, case.first) if lacking == "URDF" else (case.first, case.second)
    if not all(_is_diagonal(_own(link)) for links in bare.values() for link in links):
        return
    in_links = {
        name: tuple(_without_products(link) for link in links) for name, links in full.items()
    }
    of_links = {
        name: fold_bodies(*(link.body for link in in_links.get(name, ()))) for name in tree.bodies
    }
    of_folds = {
        name: replace(body, inertia=_diagonal(body.inertia)) for name, body in tree.bodies.items()
    }
    for bodies, links in ((of_links, in_links), (of_folds, full)):
        left = {
            (change.kind, name)
            for name, body in bodies.items()
            for change in body_changes(name, body, other.bodies[name], case.tolerances)
            if change.kind == "inertia"
        }
        gone = {key for key in case.open if key[0] == "inertia"} - left
        if len(gone) > 1 and left <= set(case.keys):
            count = sum(not _is_diagonal(_own(link)) for group in full.values() for link in group)
            mended = replace(tree, bodies=bodies)
            undone = (
                replace(case, second=mended, mjcf=links)
                if lacking == "URDF"
                else replace(case, first=mended, urdf=links)
            )
            yield PatternFinding(
                "products",
                diagnose("products-of-inertia-dropped", file=lacking, count=count),
                gone,
                undone,
            )
            return


def _own(link: ComparedLink) -> Array:
    """Returns the inertia of a link in its own axes."""
    return link.axes.T @ link.body.inertia @ link.axes


def _without_products(link: ComparedLink) -> ComparedLink:
    bare = link.axes @ _diagonal(_own(link)) @ link.axes.T
    return replace(link, body=replace(link.body, inertia=bare))


def _diagonal(inertia: Array) -> Array:
    return np.diag(np.diag(inertia))


def _is_diagonal(inertia: Array) -> bool:
    off = inertia - _diagonal(inertia)
    return float(np.abs(off).max()) <= 1e-9 * max(float(np.abs(inertia).max()), 1e-300)


def dropped_coms(words: str, one: MultibodyTree, keys: Sequence[Key]) -> Found:
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
    if len(names) >= _LEAST_DROPPED:
        yield PatternFinding(
            "coms",
            diagnose("coms-dropped", file=words, count=len(names), bodies=names),
            {("com", name) for name in names},
        )


def find_dropped(case: PatternCase) -> Found:
    """Finds what one file has left out of its inertials."""
    trees_of = (("URDF", case.first), ("MJCF", case.raw))
    for words, own in trees_of:
        yield from dropped_products(case, words)
        yield from dropped_coms(words, own, case.keys)
