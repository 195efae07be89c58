"""Which joint each statement of a source is of: by name, by pattern, or by its place in a list."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.robot.matching.pairs import match_without_affixes
from pupper_analysis.tools.contract.facts import (
    OBSERVATION_ALIASES,
    QUANTITIES,
    Fact,
    Role,
    Source,
    Statement,
)


@dataclass(frozen=True, eq=False)
class PlacedSource:
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
    facts: Mapping[tuple[str, str], Fact]
    order: tuple[str, ...] = ()
    how: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()
    notes: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class RobotJoints:
    """The joints by which all is ordered.

    Attributes:
        model: The robot.
        order: Its joints, in the order of its file.
        user_names: {a source's name: joint}, as the user says.
    """

    model: RobotModel
    order: tuple[str, ...]
    user_names: Mapping[str, str]

    @property
    def by_depth(self) -> tuple[str, ...]:
        """The joints by their depth in the tree, as Isaac Lab has them."""
        above = {
            name: list(self.model.ancestors(one.child)) for name, one in self.model.joints.items()
        }
        return tuple(sorted(list_depth_first(self.model), key=lambda name: len(above[name])))

    def match_names(self, names: Sequence[str]) -> dict[str, str]:
        """Returns {a source's name: the joint it means}: as given, the same, or but for affixes."""
        pairs = {
            name: self.user_names[name] for name in names if self.user_names.get(name) in self.order
        }
        pairs |= {name: name for name in names if name in self.order and name not in pairs}
        return {**pairs, **match_without_affixes(names, self.order, pairs)}

    def mirrored_sign(self, one: str, two: str) -> int:
        """Returns 1 if mirrored postures have the same angle at two joints, -1 if the opposite one.

        A turn about an axis a is in a mirror (of the plane of x and z) one about (-a_x, a_y, -a_z).

        Returns:
            0 if the axes are no mirror images.
        """
        first, second = (self.model.joints[name] for name in (one, two))
        along = float(np.dot(np.multiply(first.axis, (-1, 1, -1)), second.axis))
        turn = first.kind == second.kind == "hinge" and abs(along) >= _PARALLEL
        return 0 if not turn else 1 if along > 0 else -1


_PARALLEL = 0.95
"""Least |cosine| between an axis and the mirrored one of the other side."""


def list_depth_first(model: RobotModel) -> tuple[str, ...]:
    """Returns a model's joints limb by limb, as MuJoCo and Isaac Gym have them."""
    roots = [link for link in model.links.values() if link.parent is None]
    links = [link for root in roots for link in (root, *model.descendants(root.name))]
    return tuple(joint.name for link in links for joint in link.joints if joint.moves)


def assign_joints(source: Source, model: RobotJoints, others: Sequence[Source]) -> PlacedSource:
    """Returns of which joint each statement is.

    Args:
        source: What was read.
        model: The robot's joints.
        others: All sources: what one leaves open another may say.
    """
    asked = dict.fromkeys(one.joint for one in source.statements if one.joint)
    plain = [one for one in asked if _PLAIN.fullmatch(one) or not is_pattern(one)]
    names = list(dict.fromkeys((*source.order, *plain)))
    known = model.match_names(names)
    order, how, assumed = _order(source, model, others, known)
    reverse = {joint: name for name, joint in known.items()}
    seen = {
        f"observation {OBSERVATION_ALIASES.get(name, name)}": (scale, place)
        for name, scale, place in source.observations
        if scale is not None
    }
    facts = {(what, ""): source.fact(Statement(what, *said)) for what, said in seen.items()}
    unread: dict[str, int] = {}
    for one in source.statements:
        if one.index is not None:
            # Of a list of another length nobody knows whose they are: of the first ones, or all?
            theirs = list(filter(None, order[one.index : one.index + 1]))
            if one.count != len(order):
                unread[one.quantity], theirs = one.count, []
        elif one.joint in known or not one.joint:
            theirs = [known.get(one.joint, "")]
        else:
            theirs = [
                joint
                for joint in model.order
                if matches_name(one.joint, joint)
                or matches_name(one.joint, reverse.get(joint, joint))
            ]
        facts |= {(one.quantity, joint): source.fact(one, joint) for joint in theirs}
    step, many = (facts.get((what, "")) for what in ("time step", "decimation"))
    if step and many and step.number * many.number:
        many = replace(
            many,
            quantity="policy step",
            unit=step.unit,
            decimals=None,
            value=step.number * many.number,
        )
        facts.setdefault(("policy step", ""), many)
    notes = [
        diagnose(
            "contract-list-unread",
            file=source.name,
            what=Term(quantity),
            count=count,
            joints=len(order) or len(model.order),
        )
        for quantity, count in unread.items()
    ]
    unknown = tuple(name for name in names if name not in known)
    return PlacedSource(source, facts, order, how, known, unknown, (*assumed, *notes))


def list_observations(source: Source) -> list[str]:
    """Returns what a policy observes, in order, by one library's names."""
    return [OBSERVATION_ALIASES.get(name, name) for name, _, _ in source.observations]


_PLAIN = re.compile(r"[\w/\- ]+")
"""A name, and no pattern."""


def _order(
    source: Source, model: RobotJoints, others: Sequence[Source], known: Mapping[str, str]
) -> tuple[tuple[str, ...], str, list[Diagnostic]]:
    """Returns the joints in the order of a source's lists, how that is known, and notes."""
    if source.order:
        return tuple(known.get(name, "") for name in source.order), "named", []
    lists = {one.count for one in source.statements if one.index is not None}
    sizes = {len(source.motors)} if source.motors else lists
    motors = next(filter(None, map(_motor_names, others)), {})
    if source.motors and set(source.motors) <= set(motors):
        names = model.match_names(list(motors.values()))
        return tuple(names.get(motors[one], "") for one in source.motors), "motors", []
    policies = [one for one in others if one.role is Role.POLICY and len(one.order) in sizes]
    if policies and source.role is Role.DEPLOYMENT:  # it runs that policy
        names = model.match_names(policies[0].order)
        return tuple(names.get(name, "") for name in policies[0].order), "policy", []
    if len(model.order) not in sizes:
        return (), "", []
    trainers = [one for one in others if one.role is Role.TRAINER]
    kept = [model.by_depth, model.order]
    if trainers and all(one.breadth_first for one in trainers):
        kept.reverse()
    # That in which left and right are least unlike: a list in another order is like no mirror.
    wrong = {one: _unlike(one, source, model) for one in dict.fromkeys(kept[::-1])}
    order = min(wrong, key=wrong.__getitem__)
    if wrong[order] > MAX_UNLIKE_FRACTION:
        return (), "", []
    of_file = diagnose("contract-order-of-file", file=source.name, first=order[:3])
    by_depth = diagnose("contract-order-by-depth", file=source.name, first=order[:3])
    return order, "assumed", [of_file if order == model.order else by_depth]


MAX_UNLIKE_FRACTION = 1 / 3
"""Share of the pairs of left and right whose numbers may be unlike in an order that is assumed."""


def _unlike(order: tuple[str, ...], source: Source, model: RobotJoints) -> float:
    """Returns the share of pairs of left and right that a source's lists contradict in an order."""
    said = {
        (one.quantity, order[one.index]): one.value
        for one in source.statements
        if one.index is not None and one.count == len(order)
    }
    signs = {pair: (1, model.mirrored_sign(*pair)) for pair in find_mirror_pairs(order)}
    alike = [
        is_mirror_image(said[what, one], said[what, two], sign[kind.mirrored < 0])
        for what, kind in QUANTITIES.items()
        if kind.mirrored
        for (one, two), sign in signs.items()
        if (what, one) in said
    ]
    return alike.count(False) / max(1, len(alike))


def is_mirror_image(one: float | None, two: float | None, sign: int) -> bool:
    """Whether two numbers are each other's mirror image, or nobody knows."""
    if one is None or two is None or not sign:
        return True
    return abs(one - sign * two) <= 1e-3 * abs(one) + 1e-9


def _motor_names(source: Source) -> dict[int, str]:
    """Returns {number of a motor: name of its joint}, as a source states them."""
    if source.order and source.motors:
        return dict(zip(source.motors, source.order, strict=False))
    return dict(enumerate(source.motor_names))


def matches_name(pattern: str, name: str) -> bool:
    """Whether a joint's name is a name, or matches all of a regular expression."""
    if pattern in (name, ".*"):
        return True
    return is_pattern(pattern) and re.fullmatch(pattern, name) is not None


@cache
def is_pattern(text: str) -> bool:
    """Whether a text is a regular expression, and none whose time may grow without bound."""
    often = len(_REPEATED.findall(text))
    try:
        return often <= _MOST_REPEATED and not _NESTED.search(text) and bool(re.compile(text))
    except (re.error, RecursionError, OverflowError):
        return False


_REPEATED = re.compile(r"[+*{?]")
_MOST_REPEATED = 5
"""A name of n letters is tried in some n^5 / 120 ways."""
_NESTED = re.compile(r"[+*}?)][+*{]")
"""A repetition of a repetition, or of a group, which may have some, or alternatives."""
