"""Names that two joints have exchanged, left for right mostly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations, islice

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.patterns.case import (
    Found,
    Key,
    PatternCase,
    PatternFinding,
)


def find_exchanged(case: PatternCase) -> Found:
    """Finds limbs whose names are exchanged."""
    tops = case.first.children(case.first.base)
    limbs = {top: [top, *case.first.below(top)] for top in tops}
    concerned = {
        case.first.frames[element][0] if kind == "frame" else element for kind, element in case.keys
    }
    shaken = [top for top, names in limbs.items() if concerned & set(names)]
    pairs: list[tuple[str, str]] = []
    second, gone = case.raw, set[Key]()
    tries = ((a, b) for a, b in combinations(shaken, 2) if len(limbs[a]) == len(limbs[b]))
    for one, two in islice(tries, _EXCHANGES):
        if any({one, two} & set(pair) for pair in pairs):
            continue
        own = {*limbs[one], *limbs[two]}
        exchange = dict(zip(limbs[one], limbs[two], strict=True))
        carried = own | {frame for name in own for frame in case.first.carried_by(name)}
        before = {key for key in case.keys if key[1] in carried}
        if case.masses_apart(exchange) > _STAY * len(before):
            continue  # these alone are too many of those that would stay
        both = replace(second.part(own), frames=second.frames)
        left = case.left(_renamed(both, exchange), [*limbs[one], *limbs[two]])
        own = carried
        after = {key for key in left if key[1] in own}
        if len(before) > 1 and len(after) <= _STAY * len(before):
            pairs.append((one, two))
            second, gone = _renamed(second, exchange), gone | (before - after)
    if pairs:
        limbs_told = [diagnose("limbs-of-a-pair", one=one, two=two) for one, two in pairs]
        yield PatternFinding(
            "exchanged",
            diagnose("limbs-exchanged", pairs=limbs_told, count=len(gone), total=len(case.keys)),
            gone,
        )


_STAY = 0.2
"""Share of the differences of two limbs that may stay where they are exchanged."""

_EXCHANGES = 300
"""Pairs of limbs that are tried: all of 24 limbs and more than any robot of limbs has."""


def _renamed(values: MultibodyTree, names: Mapping[str, str]) -> MultibodyTree:
    """Exchanges joints of a tree, with all that they move."""
    new = {**names, **{two: one for one, two in names.items()}}
    joints = {
        new.get(name, name): replace(joint, parent=new.get(joint.parent, joint.parent))
        for name, joint in values.joints.items()
    }
    return replace(
        values,
        joints=joints,
        bodies={new.get(name, name): body for name, body in values.bodies.items()},
        frames={
            frame: (new.get(owner, owner), place) for frame, (owner, place) in values.frames.items()
        },
    )
