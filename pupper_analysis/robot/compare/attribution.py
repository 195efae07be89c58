"""Which numbers make two models disagree: each difference, its effect, and that none is missing.

And the rotors' inertia, of which a URDF has none: what it does, and where it differs from that of
its mirror image.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.units import DOWN
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.sides import mirror_pairs, unlike_pairs
from pupper_analysis.robot.compare.behaviour import (
    Behaviour,
    MujocoBehaviour,
    affordable_states,
    random_states,
)
from pupper_analysis.robot.compare.differences import (
    Difference,
    Explanation,
    RelativeError,
    apply_changes,
    changes_between,
    convention_changes,
)
from pupper_analysis.robot.compare.mjcf_only import (
    as_it_is,
    mjcf_only_effects,
    split_mimics,
    without_effects,
)
from pupper_analysis.robot.matching.alignment import Alignment, align_frames
from pupper_analysis.robot.matching.conventions import Conventions
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Mimics, Reference, kinematic_trees
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

EXPLAINED = 1e-9
"""What may be left, relative to a quantity's scale, when all differences are taken away.

Two engines of double precision agree to some 1e-13; accelerations likewise, in the forces that make
them (see `_left`).
"""

_STATES = 10  # at which each difference is weighed


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
    """Finds every number in which a robot's URDF and MJCF differ, and proves that none is missing.

    The parameters of both models are compared body by body, and what the MJCF alone can state is
    found. Each difference is put into the URDF's model alone (or into a MuJoCo model that has
    nothing else that a URDF cannot state), to see its effect. Then all are put into the URDF's
    model, made of its numbers as Pinocchio reads them, and it must behave as MuJoCo's model of the
    MJCF, as it is but for what was found that a URDF cannot state.

    Args:
        robot: The robot.
        tolerances: What counts as a difference; for files of 5 to 6 digits by default.
        reference: The MJCF as it is; by default the robot's MuJoCo model.
        mimics: The joints that follow others in the URDF.
        alignment: The MJCF's tree in the URDF's link frames, if known.
        conventions: In what the URDF's coordinates were, before it was given the MJCF's.
        unstated: {damping or friction: joints for which the URDF does not state it, and was given
            the MJCF's}, as it is given the armature.
    """
    tolerances = tolerances or Tolerances()
    reference = reference or Reference(
        robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base
    )
    first, raw = kinematic_trees(robot)
    if float(np.linalg.norm(raw.gravity - DOWN)) > tolerances.gravity:
        first = replace(first, gravity=np.array(DOWN))
    alignment = alignment or align_robot(robot, tolerances)
    second = replace(alignment.values, gravity=raw.gravity)
    found = mjcf_only_effects(reference)
    coupled, uncoupled = split_mimics(found, reference, mimics or {}, tolerances.limit)
    found = [extra for extra in found if extra not in coupled]
    states = random_states(robot, affordable_states(robot, _STATES), seed=0)
    behaviour = Behaviour(robot, states)
    urdf = behaviour(first)
    mujoco_sees = MujocoBehaviour(robot, reference, states, alignment.moved)
    mjcf = mujoco_sees(without_effects(reference.model, coupled))
    bare = without_effects(reference.model, [*found, *coupled])
    stripped = mujoco_sees(bare)
    judge = RelativeError(urdf, mjcf)
    differences = []
    for convention, undone in convention_changes(conventions or Conventions(), first):
        effects = judge.effects(urdf, behaviour(undone))
        differences.append(replace(convention, effects=effects))
    for change in changes_between(first, second, tolerances):
        effects = {}
        if change.felt:
            effects = judge.effects(urdf, behaviour(change.apply(first, second)))
        differences.append(change.difference(effects))
    differences += armature_differences(first, behaviour, judge)
    whole = as_it_is(reference.model)
    for extra in found:
        extra.switch(bare, whole)
        effects = judge.effects(stripped, mujoco_sees(bare)) if extra.slots else {}
        extra.switch(bare, None)
        differences.append(extra.difference(effects))
    differences += [_mimic(name, (mimics or {})[name]) for name in uncoupled]
    patched = behaviour(apply_changes(first, second))
    left = _left(judge, patched, stripped)
    differences.sort(key=lambda difference: difference.rank)
    return Explanation(
        differences=tuple(differences),
        deviations={name: judge.relative(name, urdf[name], mjcf[name]) for name in urdf},
        residual=left,
        complete=all(value <= EXPLAINED for value in left.values()),
        notes=tuple(_given_notes({"armature": robot.joint_names, **(unstated or {})}, first)),
    )


def _left(
    judge: RelativeError, patched: Mapping[str, Array], stripped: Mapping[str, Array]
) -> dict[str, float]:
    """Returns {quantity: by how much two evaluations deviate, relative to its scale}.

    Accelerations are forces divided by inertias, and what rounding does to them grows with the mass
    matrix's condition number (a link of 1e-6 kg at the end of an arm: 1e8). A solver is as good as
    its backward error: where the forces that make them, M (a1 - a2), deviate by rounding, relative
    to the greatest of those, that is how far they do. A force that was overlooked is one in full.
    """
    left = {name: judge.relative(name, patched[name], stripped[name]) for name in patched}
    mass, name = patched["mass matrix"], "forward dynamics"
    accelerations = patched[name]
    between = np.abs(np.einsum("nij,nj->ni", mass, accelerations - stripped[name])).max()
    forces = np.abs(np.einsum("nij,nj->ni", mass, accelerations)).max()
    if between <= EXPLAINED * forces:
        left[name] = min(left[name], float(between / max(forces, 1e-300)))
    return left


def align_robot(robot: Robot, tolerances: Tolerances) -> Alignment:
    """Puts the MJCF's link frames to the URDF's."""
    urdf, mjcf = kinematic_trees(robot)
    model = robot.mj_model
    joints = [model.joint(name).id for name in robot.joint_names]
    last = model.body_jntadr + model.body_jntnum - 1
    # MuJoCo tells the axes of a body, which later joints turn.
    still = [j for j in joints if last[model.jnt_bodyid[j]] != j]
    return align_frames(mjcf, urdf, tolerances, {model.joint(joint).name for joint in still})


def _mimic(name: str, said: tuple[str, float, float]) -> Difference:
    leader, multiplier, offset = said
    message = diagnose(
        "mimic-without-equality",
        subject=("joint", name),
        leader=leader,
        multiplier=multiplier,
        offset=offset,
    )
    return Difference("mimic", name, said, None, "", message, {})


def armature_differences(
    values: MultibodyTree, behaviour: Behaviour, judge: RelativeError
) -> Iterator[Difference]:
    """Yields armatures of no rotor, and unlike those of mirror images: a URDF can state neither.

    Before a free joint there is no rotor: the armature of a default class has reached it, and adds
    to the base's mass in every direction what weighs nothing.
    """
    if values.base_armature:
        value = values.base_armature
        unit = "kg and kg m^2"
        message = diagnose(
            "free-joint-armature", subject=("body", values.base), armature=Quantity(value, unit)
        )
        effects = judge.effects(behaviour(replace(values, base_armature=0.0)), judge.one)
        yield Difference("armature", values.base, None, value, unit, message, effects)
    stated = {name: joint.armature for name, joint in values.joints.items()}
    often = Counter(stated.values())
    for pair in unlike_pairs(mirror_pairs(values.joints), stated):
        name, like = sorted(pair, key=lambda one: often[stated[one]])  # the rarer is the odd one
        joint = replace(values.joints[name], armature=stated[like])
        alone = behaviour(replace(values, joints={**values.joints, name: joint}))
        unit = "kg" if joint.slides else "kg m^2"
        message = diagnose(
            "armature-unlike-mirror-image",
            subject=("joint", name),
            armature=Quantity(stated[name], unit),
            like=like,
            usual=Quantity(stated[like], unit),
        )
        effects = judge.effects(judge.one, alone)
        yield Difference("armature", name, None, stated[name], unit, message, effects)


_GIVEN = {
    "armature": "armature-of-the-mjcf-alone",
    "damping": "damping-of-the-mjcf-alone",
    "friction": "friction-of-the-mjcf-alone",
}
_UNITS = {"armature": "kg m^2", "damping": "N m s/rad", "friction": "N m"}


def _given_notes(
    given: Mapping[str, Collection[str]], values: MultibodyTree
) -> Iterator[Diagnostic]:
    """Yields what the URDF was given of the MJCF's."""
    for kind in _GIVEN:
        own = [float(getattr(values.joints[name], kind)) for name in given.get(kind, ())]
        if any(own):
            least, greatest = (Quantity(f(own), _UNITS[kind]) for f in (min, max))
            more = greatest if greatest != least else None
            yield diagnose(_GIVEN[kind], least=least, greatest=more, count=len(own))
