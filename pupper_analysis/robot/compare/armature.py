"""The rotors' inertia: what it does, and where it differs from leg to leg."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.behaviour import Behaviour
from pupper_analysis.robot.compare.differences import (
    Armature,
    Difference,
    Effect,
    Explanation,
    RelativeError,
)
from pupper_analysis.robot.matching.match import Match

_LEG_LOAD_RATIO = 1.25
"""Of two legs one carries no more than this of what the other does below a joint: front and hind
legs differ by percents."""

_AWAY = 0.01  # m: nor is the joint further from the one above it


def armature_differences(
    values: MultibodyTree, behaviour: Behaviour, judge: RelativeError
) -> list[Difference]:
    """Returns armatures of no rotor, and unlike those of the other legs.

    A URDF can state neither. Before a free joint there is no rotor: the armature of a default class
    has reached it, and adds to the base's mass in every direction what weighs nothing.
    """
    differences = []
    if values.base_armature:
        value = values.base_armature
        unit = "kg and kg m^2"
        told = diagnose(
            "free-joint-armature", subject=("body", values.base), armature=Quantity(value, unit)
        )
        effects = judge.effects(behaviour(replace(values, base_armature=0.0)), judge.one)
        differences.append(Difference("armature", values.base, None, value, unit, told, effects))
    for name, usual in _unusual_armatures(values).items():
        joint = replace(values.joints[name], armature=usual)
        alone = behaviour(replace(values, joints={**values.joints, name: joint}))
        value = values.joints[name].armature
        unit = "kg" if joint.slides else "kg m^2"
        told = diagnose(
            "armature-unlike-other-legs",
            subject=("joint", name),
            armature=Quantity(value, unit),
            usual=Quantity(usual, unit),
        )
        effects = judge.effects(judge.one, alone)
        differences.append(Difference("armature", name, None, value, unit, told, effects))
    return differences


def _unusual_armatures(values: MultibodyTree) -> dict[str, float]:
    """Returns the joints whose armature differs from that of most at the same place of a leg.

    Joints are at the same place if as many joints are above as below them, and they carry about as
    much: a neck is no leg, nor is an arm.

    Returns:
        {joint: the usual armature there}.
    """
    places: dict[tuple[int, int], list[str]] = {}
    depth = {values.base: 0}
    carried = {name: values.bodies[name].mass for name in values.joints}
    below = dict.fromkeys(values.joints, 0)
    for name, joint in values.joints.items():
        depth[name] = depth[joint.parent] + 1
        ancestor = joint.parent
        while ancestor != values.base:
            below[ancestor] += 1
            carried[ancestor] += values.bodies[name].mass
            ancestor = values.joints[ancestor].parent
    for name in values.joints:
        places.setdefault((depth[name], below[name]), []).append(name)
    unusual: dict[str, float] = {}
    for names in (group for place in places.values() for group in _alike(place, carried, values)):
        found = Counter(values.joints[name].armature for name in names)
        usual, count = found.most_common(1)[0]
        if 2 * count > len(names) >= 3:
            # A value that a mirror image has too is meant: thumbs among fingers.
            odd = {armature for armature, times in found.items() if times == 1}
            unusual |= {n: usual for n in names if values.joints[n].armature in odd}
    return unusual


def _alike(
    names: list[str], carried: Mapping[str, float], values: MultibodyTree
) -> Iterator[list[str]]:
    """Yields joints in groups of those that carry about as much, as far from the joint above."""
    left = sorted(names, key=carried.__getitem__)
    away = {name: float(np.linalg.norm(values.joints[name].position)) for name in names}
    while left:
        group = [left.pop(0)]
        for name in list(left):
            if carried[name] > _LEG_LOAD_RATIO * carried[group[-1]]:
                break
            if abs(away[name] - away[group[0]]) < _AWAY:
                group.append(name)
                left.remove(name)
        yield group


def armature_of(
    names: Iterable[str], values: MultibodyTree, behaviour: Behaviour, judge: RelativeError
) -> Armature:
    """Returns every joint's armature, and what leaving it out of the URDF's model does."""
    without_it = {name: replace(joint, armature=0.0) for name, joint in values.joints.items()}
    bare = behaviour(replace(values, joints=without_it))
    armature = {name: values.joints[name].armature for name in names}
    return Armature(armature, judge.effects(judge.one, bare))


_VALUES = 6
"""Different values that are listed; of more, the least and the greatest."""


_NAMED = 3
"""Joints that are named; more are counted."""


def unstated_notes(matched: Match, explanation: Explanation) -> Iterator[Diagnostic]:
    """Yields what the damping and the dry friction do that the URDF does not state."""
    model = matched.robot.pin_model

    def of_joints(values: Sequence[float], word: str) -> dict[str, float]:
        places = {n: model.joints[model.getJointId(n)].idx_v for n in matched.unstated[word]}
        return {name: float(values[place]) for name, place in places.items()}

    if matched.unstated.get("damping"):
        damping = _by_value(of_joints(model.damping, "damping"), "N m s/rad")
        forward = explanation.damping.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
        yield diagnose("damping-of-the-mjcf-alone", values_are=damping, forward=forward)
    if matched.unstated.get("friction"):
        friction = _by_value(of_joints(model.friction, "friction"), "N m")
        yield diagnose("friction-of-the-mjcf-alone", values_are=friction)


def armature_notes(explanation: Explanation) -> Iterator[Diagnostic]:
    """Yields what the armature does, which the URDF cannot state, for who builds models of it."""
    effects = explanation.armature
    if any(effects.values.values()):
        yield diagnose(
            "armature-of-the-mjcf-alone",
            values_are=_by_value(effects.values, "kg m^2"),
            mass_matrix=effects.effects.get("mass matrix", Effect(0.0, 0.0, 0.0)).relative,
            forward=effects.effects.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative,
        )


def _by_value(values: Mapping[str, float], unit: str) -> list[Diagnostic]:
    """Lists the joints of each value; of many values, the least and the greatest."""
    found: dict[str, list[str]] = {}
    for name, value in values.items():
        found.setdefault(f"{value:.6g}", []).append(name)
    if len(found) > _VALUES:
        least, greatest = (Quantity(f(values.values()), unit) for f in (min, max))
        return [diagnose("values-of-joints", least=least, greatest=greatest, count=len(values))]
    return [
        diagnose(
            "value-of-joints",
            value=Quantity(values[names[0]], unit),
            joints=names,
            count=len(names),
            few=len(names) <= _NAMED,
        )
        for names in found.values()
    ]
