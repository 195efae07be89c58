"""Explanation of the deviation between two models: their differences, with effects on the dynamics.

Input: a robot with two models. Output: an ``Explanation``. Method: the multibody trees are compared
value by value, and elements that only an MJCF can contain are listed. The effect of each difference
is evaluated alone. Finally, all values of the MJCF are written into the URDF's tree. This tree must
behave as the MJCF without the listed elements. The remaining deviation is the residual.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.units import DOWNWARD_GRAVITY, select_joint_units
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.sides import find_mirror_pairs, find_unlike_pairs
from pupper_analysis.robot.compare.behaviour import (
    Behaviour,
    MujocoBehaviour,
    count_affordable_states,
    random_states,
)
from pupper_analysis.robot.compare.differences import (
    Difference,
    Effect,
    Explanation,
    PropertyKey,
    RelativeError,
    apply_changes,
    changes_between,
    convention_changes,
)
from pupper_analysis.robot.compare.mjcf_only import (
    MjcfOnlyEffect,
    list_couplings,
    make_passive_model,
    mjcf_only_effects,
    split_mimics,
    without_effects,
)
from pupper_analysis.robot.matching.alignment import Alignment, align_frames
from pupper_analysis.robot.matching.conventions import Conventions
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Mimic, Mimics, Reference, kinematic_trees
from pupper_analysis.robot.robot import Robot

MAX_RESIDUAL = 1e-9
"""Largest accepted residual: deviation between the models after all found differences are removed,
relative to the scale of the quantity [1]. Two engines in double precision agree to about 1e-13. For
accelerations see `_compute_residual`."""

_NUM_STATES = 20
"""Maximum number of random states at which the effect of each difference between two files is
evaluated. With the default number of configurations of `crosscheck`, and the same seed, effects and
deviations belong to the same states."""


def explain_differences(
    robot: Robot,
    *,
    tolerances: Tolerances | None = None,
    reference: Reference | None = None,
    mimics: Mimics | None = None,
    alignment: Alignment | None = None,
    conventions: Conventions | None = None,
    unstated: Mapping[str, Collection[str]] | None = None,
) -> Explanation:
    """Find the differences between URDF and MJCF of a robot, and their effects on the dynamics.

    1. Values of both trees are compared body by body, with the tolerances. The effect of a
       difference on the dynamics is evaluated by applying this difference alone to the URDF's
       model.
    2. Elements that only the MJCF can contain are listed. The effect of an element is evaluated, if
       possible, by enabling it in a MuJoCo model without the other listed elements.
    3. All differences of values are applied to the URDF's model. It must behave as the MJCF without
       the listed elements. The deviation is the residual.

    Args:
        robot: The robot.
        tolerances: Tolerances of the comparison; by default for files with 5 to 6 digits.
        reference: Compiled model of the unmodified MJCF, with names; by default the MuJoCo model of
            the robot.
        mimics: Mimic joints of the URDF. Equivalent equalities of the MJCF are no differences.
        alignment: Joint tree of the MJCF, expressed in the link frames of the URDF; computed by
            default.
        conventions: Original base frame and joint zeros of the URDF, relative to the MJCF. Required
            if the robot's URDF was converted to the base frame and joint zeros of the MJCF.
        unstated: {"damping" or "friction": joints whose URDF has no value, so that the value of the
            MJCF was copied}.
    """
    tolerances = tolerances or Tolerances()
    reference = reference or Reference(
        robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base
    )
    alignment = alignment or align_robot(robot, tolerances)
    first, second = _make_compared_trees(robot, tolerances, alignment)
    mjcf_only = mjcf_only_effects(reference)
    coupled, uncoupled = split_mimics(mjcf_only, reference, mimics or {}, tolerances.limit)
    mjcf_only = [extra for extra in mjcf_only if extra not in coupled]
    mimic_differences, mjcf_only = _report_mimics(
        {name: (mimics or {})[name] for name in uncoupled}, mjcf_only, reference
    )
    states = random_states(robot, count_affordable_states(robot, _NUM_STATES), seed=0)
    behaviour = Behaviour(robot, states)
    urdf = behaviour(first)
    evaluate_mujoco = MujocoBehaviour(robot, reference, states, alignment.moved)
    mjcf = evaluate_mujoco(without_effects(reference.model, coupled))
    reduced_model = without_effects(reference.model, [*mjcf_only, *coupled])
    reduced = evaluate_mujoco(reduced_model)
    relative_error = RelativeError(urdf, mjcf)
    differences = []
    for convention, original in convention_changes(conventions or Conventions(), first):
        effects = relative_error.effects(urdf, behaviour(original))
        differences.append(replace(convention, effects=effects))
    for change in changes_between(first, second, tolerances):
        effects = {}
        if change.felt:
            effects = relative_error.effects(urdf, behaviour(change.apply(first, second)))
        differences.append(change.to_difference(effects))
    differences += armature_differences(first, behaviour, relative_error)
    full_model = make_passive_model(reference.model)
    for extra in mjcf_only:
        extra.switch(reduced_model, full_model)
        effects = (
            relative_error.effects(reduced, evaluate_mujoco(reduced_model)) if extra.slots else {}
        )
        extra.switch(reduced_model, None)
        differences.append(extra.to_difference(effects))
    differences += mimic_differences
    patched = behaviour(apply_changes(first, second))
    residual = _compute_residual(relative_error, patched, reduced)
    differences.sort(key=lambda difference: difference.rank)
    return Explanation(
        differences=tuple(differences),
        deviations={
            name: relative_error.relative_deviation(name, urdf[name], mjcf[name]) for name in urdf
        },
        residual=residual,
        complete=all(value <= MAX_RESIDUAL for value in residual.values()),
        notes=tuple(
            _report_copied_values({"armature": robot.joint_names, **(unstated or {})}, first)
        ),
    )


def _make_compared_trees(
    robot: Robot, tolerances: Tolerances, alignment: Alignment
) -> tuple[MultibodyTree, MultibodyTree]:
    """Return the trees of URDF and MJCF; the URDF has Earth's gravity if the MJCF has another."""
    first, raw = kinematic_trees(robot)
    if float(np.linalg.norm(raw.gravity - DOWNWARD_GRAVITY)) > tolerances.gravity:
        first = replace(first, gravity=np.array(DOWNWARD_GRAVITY))
    return first, replace(alignment.values, gravity=raw.gravity)


def compute_joint_effects(
    robot: Robot,
    groups: Sequence[Collection[PropertyKey]],
    explanation: Explanation,
    *,
    tolerances: Tolerances,
    alignment: Alignment,
) -> list[dict[str, Effect]]:
    """Compute the effects of groups of differences, each group applied together to the URDF's tree.

    Args:
        robot: Robot.
        groups: Properties of each group.
        explanation: Explanation of all differences, whose deviations are the totals of the shares.
        tolerances: Tolerances of the comparison.
        alignment: Joint tree of the MJCF, expressed in the link frames of the URDF.

    Returns:
        {quantity: effect} for each group. Empty if a property of the group is not part of the
        trees, for example an equality constraint of the MJCF.
    """
    first, second = _make_compared_trees(robot, tolerances, alignment)
    changes = {
        (change.kind, change.element): change
        for change in changes_between(first, second, tolerances)
    }
    evaluable = [bool(group) and set(group) <= set(changes) for group in groups]
    if not any(evaluable):
        return [{} for _ in groups]
    states = random_states(robot, count_affordable_states(robot, _NUM_STATES), seed=0)
    behaviour = Behaviour(robot, states)
    urdf = behaviour(first)
    relative_error = RelativeError(urdf, urdf)
    found: list[dict[str, Effect]] = []
    for group, is_evaluable in zip(groups, evaluable, strict=True):
        if not is_evaluable:
            found.append({})
            continue
        tree = first
        for key in group:
            tree = changes[key].apply(tree, second)
        effects = relative_error.effects(urdf, behaviour(tree))
        for name, effect in effects.items():
            total = explanation.deviations[name]
            share = effect.relative / total if 1e-9 < total < math.inf else math.inf
            effects[name] = replace(effect, share=share)
        found.append(effects)
    return found


def _compute_residual(
    relative_error: RelativeError, patched: Mapping[str, Array], reduced: Mapping[str, Array]
) -> dict[str, float]:
    """Compute the residual: {quantity: relative deviation that no found difference explains}.

    ``patched`` are quantities of the URDF with all found values of the MJCF, ``reduced`` of the
    MJCF without the elements that a URDF cannot specify. The rounding error of accelerations grows
    with the condition number of the mass matrix (1e8 for a link of 1e-6 kg at the end of an arm).
    Therefore the deviation of the forces M (a1 - a2) replaces a larger deviation of the
    accelerations, if it is a rounding error (backward error of the linear solver).
    """
    residual = {
        name: relative_error.relative_deviation(name, patched[name], reduced[name])
        for name in patched
    }
    mass, name = patched["mass matrix"], "forward dynamics"
    accelerations = patched[name]
    force_deviation = np.abs(np.einsum("nij,nj->ni", mass, accelerations - reduced[name])).max()
    forces = np.abs(np.einsum("nij,nj->ni", mass, accelerations)).max()
    if force_deviation <= MAX_RESIDUAL * forces:
        residual[name] = min(residual[name], float(force_deviation / max(forces, 1e-300)))
    return residual


def align_robot(robot: Robot, tolerances: Tolerances) -> Alignment:
    """Align the link frames of the MJCF's multibody tree with the frames of the URDF's tree."""
    urdf, mjcf = kinematic_trees(robot)
    model = robot.mj_model
    joints = [model.joint(name).id for name in robot.joint_names]
    last_joint = model.body_jntadr + model.body_jntnum - 1
    # MuJoCo reports the axes of the body, which later joints of the body rotate.
    not_last_joints = [joint for joint in joints if last_joint[model.jnt_bodyid[joint]] != joint]
    return align_frames(
        mjcf, urdf, tolerances, {model.joint(joint).name for joint in not_last_joints}
    )


def _report_mimics(
    mimics: Mimics, mjcf_only: Sequence[MjcfOnlyEffect], reference: Reference
) -> tuple[list[Difference], list[MjcfOnlyEffect]]:
    """Create the differences for mimics without an equivalent joint equality in the MJCF.

    If a linear equality couples the same two joints, the messages of both contain both couplings.

    Returns:
        Differences; the elements of ``mjcf_only``, with these messages.
    """
    others: dict[str, Mimic] = {}
    effects = []
    for effect in mjcf_only:
        for joint, other in list_couplings(effect, reference).items():
            mimic = mimics.get(joint)
            if mimic is not None and mimic[0] == other[0] and joint not in others:
                others[joint] = other
                message = diagnose(
                    "coupling-differs",
                    subject=("equality", effect.element),
                    follower=joint,
                    **_describe_couplings(mimic, other),
                )
                effect = replace(effect, diagnostic=message)
                break
        effects.append(effect)
    differences = []
    for name, mimic in mimics.items():
        message = diagnose(
            "mimic-without-equality",
            subject=("joint", name),
            **_describe_couplings(mimic, others.get(name)),
        )
        differences.append(Difference("mimic", name, mimic, others.get(name), "", message, {}))
    return differences, effects


def _describe_couplings(mimic: Mimic, other: Mimic | None) -> dict[str, Any]:
    """Return the values of a message on a mimic of the URDF, and on a coupling of the MJCF."""
    leader, multiplier, offset = mimic
    values: dict[str, Any] = {"leader": leader, "multiplier": multiplier, "offset": offset}
    if other is not None:
        values |= {"factor": other[1], "constant": other[2]}
    return values | {"coupled": other is not None}


def armature_differences(
    values: MultibodyTree, behaviour: Behaviour, relative_error: RelativeError
) -> Iterator[Difference]:
    """Yield suspicious armatures of an MJCF, as differences with their effects.

    - An armature of the free joint adds inertia without weight to the base.
    - Armatures of a joint and its mirror image should agree (`find_unlike_pairs`).

    Args:
        values: Multibody tree with the armatures of the MJCF.
        behaviour: Evaluation of the compared quantities for a tree.
        relative_error: Quantities of both models, which scale the effects.
    """
    if values.base_armature:
        value = values.base_armature
        unit = "kg and kg m^2"
        message = diagnose(
            "free-joint-armature", subject=("body", values.base), armature=Quantity(value, unit)
        )
        effects = relative_error.effects(
            behaviour(replace(values, base_armature=0.0)), relative_error.one
        )
        yield Difference("armature", values.base, None, value, unit, message, effects)
    stated = {name: joint.armature for name, joint in values.joints.items()}
    frequency = Counter(stated.values())
    for pair in find_unlike_pairs(find_mirror_pairs(values.joints), stated):
        # The rarer value is considered wrong.
        name, reference_joint = sorted(pair, key=lambda joint_name: frequency[stated[joint_name]])
        joint = replace(values.joints[name], armature=stated[reference_joint])
        symmetric = behaviour(replace(values, joints={**values.joints, name: joint}))
        unit = select_joint_units(slides=joint.slides).armature
        message = diagnose(
            "armature-unlike-mirror-image",
            subject=("joint", name),
            armature=Quantity(stated[name], unit),
            like=reference_joint,
            usual=Quantity(stated[reference_joint], unit),
        )
        effects = relative_error.effects(relative_error.one, symmetric)
        yield Difference("armature", name, None, stated[name], unit, message, effects)


_COPIED_CODES = {
    "armature": "armature-of-the-mjcf-alone",
    "damping": "damping-of-the-mjcf-alone",
    "friction": "friction-of-the-mjcf-alone",
}
"""{parameter copied from the MJCF to the URDF: code of the note}."""

_COPIED_UNITS = {"armature": "armature", "damping": "damping", "friction": "effort"}
"""{joint parameter copied from the MJCF to the URDF: field of `JointUnits` with its unit}."""


def _report_copied_values(
    copied: Mapping[str, Collection[str]], values: MultibodyTree
) -> Iterator[Diagnostic]:
    """Yield notes on the copied parameters, {parameter: joints}, of hinges and of slides."""
    for kind, slides in product(_COPIED_CODES, (False, True)):
        joints = [values.joints[name] for name in copied.get(kind, ())]
        values_of_joints = [
            float(getattr(joint, kind)) for joint in joints if joint.slides == slides
        ]
        if any(values_of_joints):
            unit = getattr(select_joint_units(slides=slides), _COPIED_UNITS[kind])
            minimum, maximum = (
                Quantity(function(values_of_joints), unit) for function in (min, max)
            )
            differing_maximum = maximum if maximum != minimum else None
            yield diagnose(
                _COPIED_CODES[kind],
                least=minimum,
                greatest=differing_maximum,
                count=len(values_of_joints),
            )
