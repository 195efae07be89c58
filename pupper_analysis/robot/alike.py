"""Limbs with the same structure: groups of corresponding joints, and limbs that lack a foot.

Limbs with the same joint types, and with similar masses or dimensions, probably have the same
function. If at least half of such limbs end in a foot, and one limb does not, the file probably
contains a wrong value for this limb, or lacks a shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.robot import Robot

_SIMILARITY_TOLERANCE = 0.05
"""Tolerance [1] with which two limbs count as similar (`Limb.is_similar_to`). The tolerance applies
to three quantities: masses, relative to the larger mass; distances between joints, relative to the
length of the limb; and |cos| between axes. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Limb:
    """Chain of moving bodies from the base to a limb end: joint types, masses and dimensions.

    Attributes:
        bodies: Ids of the moving bodies in MuJoCo's model, from the base outwards.
        kinds: Types of the joints (MuJoCo's ``jnt_type``).
        masses: Mass [kg] of each of the n bodies, with the bodies that are fixed to it, shape (n,).
        lengths: Distances [m] between successive joints; invariant under mirroring.
        turns: |cos| of the angles between successive joint axes; invariant under mirroring.
    """

    bodies: tuple[int, ...]
    kinds: tuple[int, ...]
    masses: Array
    lengths: Array
    turns: Array

    def is_similar_to(self, other: Limb) -> bool:
        """Return True if two limbs have equal joint types, and similar dimensions or masses.

        One of the two similarities is sufficient, because the file may contain a wrong mass or a
        wrong dimension. Dimensions are distances between joints, and angles between axes.

        Args:
            other: Limb of the same robot.
        """
        if self.kinds != other.kinds:
            return False
        total_length = np.maximum(self.lengths, other.lengths).sum()
        are_lengths_similar = (
            np.abs(self.lengths - other.lengths) <= _SIMILARITY_TOLERANCE * total_length
        )
        if (
            total_length
            and are_lengths_similar.all()
            and (np.abs(self.turns - other.turns) <= _SIMILARITY_TOLERANCE).all()
        ):
            return True
        if len(self.masses) != len(other.masses):
            return False
        larger_mass = np.maximum(self.masses, other.masses)
        return bool(
            (np.abs(self.masses - other.masses) <= _SIMILARITY_TOLERANCE * larger_mass).all()
        )


def list_limbs(robot: Robot) -> list[Limb]:
    """Return the limbs of a robot: the chains of moving bodies from the base to the limb ends.

    A limb end is a moving body without moving descendants.
    """
    model, data = robot.mj_model, robot.compute_kinematics()
    weld, base = model.body_weldid, int(model.body_weldid[model.body(robot.mj_base).id])
    limbs = []
    for end_body in limb_ends(model):
        bodies: list[int] = []
        body = int(end_body)
        while body not in (0, base):
            if int(weld[body]) == body:
                bodies.insert(0, body)
            body = int(model.body_parentid[body])
        if body != base or not bodies:
            continue
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, bodies))
        joints = joints[
            np.argsort(
                [bodies.index(body_of_joint) for body_of_joint in model.jnt_bodyid[joints]],
                kind="stable",
            )
        ]
        masses = [float(model.body_mass[weld == body].sum()) for body in bodies]
        kinds = tuple(model.jnt_type[joints].tolist())
        lengths = np.linalg.norm(np.diff(data.xanchor[joints], axis=0), axis=1)
        axes = data.xaxis[joints]
        turns = np.abs((axes[1:] * axes[:-1]).sum(axis=1))
        limbs.append(Limb(tuple(bodies), kinds, np.array(masses), lengths, turns))
    return limbs


def sibling_joints(robot: Robot) -> dict[str, tuple[str, ...]]:
    """Find the corresponding joints of similar limbs, for example the knees of a quadruped.

    Corresponding joints have the same index, counted from the base.

    Returns:
        {joint: corresponding joints of all similar limbs}. Joints without corresponding joints, and
        joints shared by similar limbs, are omitted.
    """
    model, limbs = robot.mj_model, list_limbs(robot)
    joints = [
        [int(joint) for body in limb.bodies for joint in np.flatnonzero(model.jnt_bodyid == body)]
        for limb in limbs
    ]
    found: dict[str, dict[str, None]] = {}
    for number, limb in enumerate(limbs):
        alike = [
            joints[index]
            for index, candidate in enumerate(limbs)
            if index != number and candidate.is_similar_to(limb)
        ]
        for place, joint in enumerate(joints[number]):
            names = tuple(model.joint(limb_joints[place]).name for limb_joints in alike)
            name = model.joint(joint).name
            found.setdefault(name, {}).update(dict.fromkeys(names))
    return {name: tuple(names) for name, names in found.items() if names and name not in names}


def report_limbs_without_feet(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report each limb without a foot, if at least half of the similar limbs have a foot.

    The similar limbs include the limb itself. The result is empty if this package did not detect
    the feet (no note ``feet-found``).
    """
    if not any(note.code == "feet-found" for note in robot.notes):
        return ()
    model, messages, limbs = robot.mj_model, [], list_limbs(robot)
    foot_bodies = (
        body for point, (body, _) in robot.contact_places.items() if point not in robot.hands
    )
    moving_foot_bodies = {int(model.body_weldid[body]) for body in foot_bodies}
    limbs_with_foot = [limb for limb in limbs if limb.bodies[-1] in moving_foot_bodies]
    for limb in limbs:
        similar_with_foot = [
            candidate for candidate in limbs_with_foot if candidate.is_similar_to(limb)
        ]
        if limb in limbs_with_foot or not similar_with_foot:
            continue
        similar = [candidate for candidate in limbs if candidate.is_similar_to(limb)]
        if len(similar_with_foot) * 2 < len(similar):
            continue
        messages.append(
            diagnose(
                "limb-without-foot",
                subject=("body", model.body(limb.bodies[-1]).name),
                feet=len(similar_with_foot),
                alike=len(similar),
            )
        )
    return tuple(messages)


def group_joints(robot: Robot, kp: Array, kd: Array) -> list[list[int]]:
    """Group corresponding joints of similar limbs that have equal gains and effort limits.

    Corresponding joints are, for example, all knees (`sibling_joints`). Joints without direct
    actuator are omitted.

    Args:
        robot: Robot.
        kp: Servo stiffness, shape (nu,) [N m/rad, N/m].
        kd: Servo damping, shape (nu,) [N m s/rad, N s/m].

    Returns:
        Joint indices (in actuator order) of each group, in the order of the first joints. A joint
        without corresponding joint is a group by itself.
    """
    siblings, names = sibling_joints(robot), robot.joint_names
    values = np.stack([kp, kd, robot.effort_limits])
    groups: list[list[int]] = []
    for index in np.flatnonzero(robot.mj_convention.actuator_index >= 0).tolist():
        for group in groups:
            if names[group[0]] in siblings.get(names[index], ()) and np.array_equal(
                values[:, group[0]], values[:, index]
            ):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def name_joints(names: Sequence[str]) -> str:
    """Return one short name for several joints, for example ``leg_*_1``.

    The common beginning and end of the names, cut at underscores, are joined by ``*``. Without
    common parts, the result consists of the first two names and the number of the others.
    """
    if len(names) <= 1:
        return "".join(names)
    begin = _common_beginning(names)
    begin = begin[: begin.rfind("_") + 1]
    end = _common_beginning([name[len(begin) :][::-1] for name in names])
    end = end[: end.rfind("_") + 1][::-1]
    if begin or end:
        return f"{begin}*{end}"
    return f"{names[0]}, {names[1]}" + (f" +{len(names) - 2}" if len(names) > 2 else "")


def _common_beginning(names: Sequence[str]) -> str:
    """Return the characters with which all names begin."""
    common = 0
    while all(len(name) > common and name[common] == names[0][common] for name in names):
        common += 1
    return names[0][:common]
