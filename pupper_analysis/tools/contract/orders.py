"""Which joint each statement of a source is of: by name, by pattern, or by its place in a list."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.sides import mirror_pairs
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.robot.matching.pairs import without_affixes
from pupper_analysis.tools.contract.facts import (
    QUANTITIES,
    Role,
    Source,
    Statement,
    is_pattern,
    matches,
)


@dataclass(frozen=True)
class Placed:
    """A source whose statements are each of a joint of the robot.

    Attributes:
        source: What was read.
        facts: {(quantity, joint): what is stated of it}; the joint is "" of a setting.
        order: The robot's joints in the order in which a policy has them; empty if not known.
        how: How that is known: ``named``, ``motors``, ``policy``, ``assumed``, or "" if it is not.
        names: {the source's name: the joint}.
        unknown: Names that are of no joint of the robot.
        notes: What was assumed.
    """

    source: Source
    facts: Mapping[tuple[str, str], Statement]
    order: tuple[str, ...] = ()
    how: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()
    notes: tuple[Diagnostic, ...] = ()


def breadth_first(model: RobotModel) -> tuple[str, ...]:
    """Returns a model's joints by their depth in the tree, as Isaac Lab has them."""
    depth = {name: len(list(model.ancestors(one.child))) for name, one in model.joints.items()}
    return tuple(sorted(depth_first(model), key=depth.__getitem__))


def depth_first(model: RobotModel) -> tuple[str, ...]:
    """Returns a model's joints limb by limb, as MuJoCo and Isaac Gym have them."""
    roots = [link for link in model.links.values() if link.parent is None]
    links = [link for root in roots for link in (root, *model.descendants(root.name))]
    return tuple(joint.name for link in links for joint in link.joints if joint.moves)


def name_joints(
    names: Sequence[str], joints: Sequence[str], given: Mapping[str, str]
) -> dict[str, str]:
    """Returns {a source's name: the joint it means}: as given, the same, or but for affixes."""
    pairs = {name: given[name] for name in names if given.get(name) in joints}
    pairs |= {name: name for name in names if name in joints and name not in pairs}
    return {**pairs, **without_affixes(names, joints, pairs)}


def place_source(
    source: Source,
    model: RobotModel,
    joints: tuple[str, ...],
    others: Sequence[Source],
    given: Mapping[str, str],
) -> Placed:
    """Returns of which joint each statement is.

    Args:
        source: What was read.
        model: The robot.
        joints: Its joints, in the order of its file.
        others: All sources: what one leaves open another may say.
        given: {a source's name: joint}, as the user says.
    """
    asked = dict.fromkeys(one.joint for one in source.statements if one.joint)
    plain = [one for one in asked if _PLAIN.fullmatch(one) or not is_pattern(one)]
    names = list(dict.fromkeys((*source.order, *plain)))
    known = name_joints(names, joints, given)
    order, how, assumed = _order(source, model, joints, others, known, given)
    reverse = {joint: name for name, joint in known.items()}
    facts: dict[tuple[str, str], Statement] = {}
    unread: dict[str, int] = {}
    for name, scale, place in source.observations:
        if scale is not None:
            what = f"observation {_CALLED.get(name, name)}"
            facts[what, ""] = Statement(what, scale, place)
    for one in source.statements:
        if one.index is None:
            theirs = (
                [known.get(one.joint, "")]
                if one.joint in known or not one.joint
                else [
                    joint
                    for joint in joints
                    if matches(one.joint, joint) or matches(one.joint, reverse.get(joint, joint))
                ]
            )
        elif one.count == len(order):
            theirs = [order[one.index]] if order[one.index] else []
        else:  # whose they are nobody knows: of the first ones, or all?
            unread[one.quantity], theirs = one.count, []
        facts.update({(one.quantity, joint): one for joint in theirs})
    step, many = (facts.get((what, "")) for what in ("time step", "decimation"))
    if step and many and step.value and many.value:
        said = Statement("policy step", step.value * many.value, many.place)
        facts.setdefault(("policy step", ""), said)
    size = len(order) or len(joints)
    notes = [diagnose("contract-list-unread", file=source.name, what=Term(quantity), count=count,
                      joints=size) for quantity, count in unread.items()]  # fmt: skip
    unknown = tuple(name for name in names if name not in known)
    return Placed(source, facts, order, how, known, unknown, (*assumed, *notes))


_CALLED = {"generated_commands": "commands", "velocity_commands": "commands",
           "command": "commands", "joint_pos_rel": "joint_pos", "joint_vel_rel": "joint_vel",
           "last_action": "actions", "action": "actions", "last_actions": "actions",
           "imu_ang_vel": "base_ang_vel", "base_ang_vel_b": "base_ang_vel"}  # fmt: skip
"""{what one library calls a part of what a policy observes: what the others do}."""


def observed(source: Source) -> list[str]:
    """Returns what a policy observes, in order, by one library's names."""
    return [_CALLED.get(name, name) for name, _, _ in source.observations]


_PLAIN = re.compile(r"[\w/\- ]+")
"""A name, and no pattern."""


def _order(
    source: Source,
    model: RobotModel,
    joints: tuple[str, ...],
    others: Sequence[Source],
    known: Mapping[str, str],
    given: Mapping[str, str],
) -> tuple[tuple[str, ...], str, list[Diagnostic]]:
    """Returns the joints in the order of a source's lists, how that is known, and notes."""
    if source.order:
        return tuple(known.get(name, "") for name in source.order), "named", []
    lists = {one.count for one in source.statements if one.index is not None}
    sizes = {len(source.motors)} if source.motors else lists
    if not sizes:
        return (), "", []
    named = next(filter(None, map(_motor_names, others)), {})
    if source.motors and set(source.motors) <= set(named):
        motors = name_joints(list(named.values()), joints, given)
        return tuple(motors.get(named[one], "") for one in source.motors), "motors", []
    policies = [one for one in others if one.role is Role.POLICY and len(one.order) in sizes]
    if policies and source.role is Role.DEPLOYMENT:  # it runs that policy
        names = name_joints(policies[0].order, joints, given)
        return tuple(names.get(name, "") for name in policies[0].order), "policy", []
    if len(joints) not in sizes:
        return (), "", []
    trainers = [one for one in others if one.role is Role.TRAINER]
    kept = [joints, breadth_first(model)]
    if not (trainers and all(one.breadth_first for one in trainers)):
        kept.reverse()
    # That in which left and right are least unlike: a list in another order is like no mirror.
    wrong = {one: _unlike(one, source, model) for one in dict.fromkeys(kept[::-1])}
    order = min(wrong, key=wrong.__getitem__)
    if wrong[order] > MOST_UNLIKE:
        return (), "", []
    if order == joints:
        message = diagnose("contract-order-of-file", file=source.name, first=order[:3])
    else:
        message = diagnose("contract-order-by-depth", file=source.name, first=order[:3])
    return order, "assumed", [message]


MOST_UNLIKE = 1 / 3
"""Share of the pairs of left and right whose numbers may be unlike in an order that is assumed."""


def _unlike(order: tuple[str, ...], source: Source, model: RobotModel) -> float:
    """Returns the share of pairs of left and right that a source's lists contradict in an order."""
    said = {(one.quantity, order[one.index]): one.value for one in source.statements
            if one.index is not None and one.count == len(order)}  # fmt: skip
    pairs = mirror_pairs(order)
    signs = {pair: (1, mirrored_sign(model, *pair)) for pair in pairs}
    alike = [like_mirror(said[what, one], said[what, two], signs[one, two][kind.mirrored < 0])
             for what, kind in QUANTITIES.items() if kind.mirrored
             for one, two in pairs if (what, one) in said]  # fmt: skip
    return alike.count(False) / max(1, len(alike))


def like_mirror(one: float | None, two: float | None, sign: int) -> bool:
    """Whether two numbers are each other's mirror image, or nobody knows."""
    if one is None or two is None or not sign:
        return True
    return abs(one - sign * two) <= 1e-3 * abs(one) + 1e-9


def _motor_names(source: Source) -> dict[int, str]:
    """Returns {number of a motor: name of its joint}, as a source states them."""
    if source.order and source.motors:
        return dict(zip(source.motors, source.order, strict=False))
    return dict(enumerate(source.motor_names))


def mirrored_sign(model: RobotModel, one: str, two: str) -> int:
    """Returns 1 if mirrored postures have the same angle at two joints, -1 if the opposite one.

    A turn about an axis a is in a mirror (of the plane of x and z) one about (-a_x, a_y, -a_z).

    Returns:
        0 if the axes are no mirror images.
    """
    first, second = (model.joints[name] for name in (one, two))
    if first.kind != "hinge" or second.kind != "hinge":
        return 0
    along = first.axis[1] * second.axis[1] - first.axis[0] * second.axis[0]
    along -= first.axis[2] * second.axis[2]
    return 0 if abs(along) < _PARALLEL else 1 if along > 0 else -1


_PARALLEL = 0.95
"""Least |cosine| between an axis and the mirrored one of the other side."""
