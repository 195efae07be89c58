"""Assignment of the statements of a source to joints: by name, pattern, or index in a list.

Inputs are a source (for example a trainer, a deployment or a driver) and the joints of the model.
Output is a `PlacedSource`: each number of the source with its joint, and the order of the policy's
arrays.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.places import Place
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.models.stated.model import BALL_JOINT, HINGE_JOINT, RobotModel
from pupper_analysis.robot.matching.pairs import match_without_affixes
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.contract.facts import (
    QUANTITIES,
    Fact,
    JointSource,
    Origin,
    Role,
    Statement,
)


@dataclass(frozen=True, eq=False)
class PlacedSource:
    """Source whose statements are assigned to joints of the robot.

    Attributes:
        source: Content of the source.
        facts: {(quantity, joint): fact}; the joint is "" for a setting.
        order: Joints of the robot in the order of the policy's arrays, "" for a name without match;
            empty if the order is not known.
        how: How the order is known: ``named``, ``motors``, ``policy`` or ``assumed``; "" if it is
            not.
        names: {name in the source: joint}.
        unknown: Names that match no joint of the robot.
        notes: Assumptions, and the reasons in ``unread``.
        unread: {quantity: reason} of values that are no numbers, and of lists that are not
            assigned to joints.
        unplaced: {quantity: keys that match no joint}.
    """

    source: JointSource
    facts: Mapping[tuple[str, str], Fact]
    order: tuple[str, ...] = ()
    how: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()
    notes: tuple[Diagnostic, ...] = ()
    unread: Mapping[str, Diagnostic] = field(default_factory=dict)
    unplaced: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class RobotJoints:
    """Joints of the robot, from the model that defines the joint order.

    Attributes:
        order: Names of the moving joints, limb by limb (`list_depth_first`).
        depths: {joint: depth of the driven link in the tree}.
        axes: {hinge: axis in the base frame at zero joint angles, shape (3,)}.
        user_names: {name in a source: joint}, passed by the user.
    """

    order: tuple[str, ...]
    depths: Mapping[str, int]
    axes: Mapping[str, NDArray[np.float64]]
    user_names: Mapping[str, str]

    @staticmethod
    def from_model(
        model: RobotModel, order: tuple[str, ...], user_names: Mapping[str, str]
    ) -> RobotJoints:
        """Create the joints of a robot's file.

        Args:
            model: Content of the file.
            order: Names of the moving joints, limb by limb.
            user_names: {name in a source: joint}, passed by the user.
        """
        joints = {name: model.joints[name] for name in list_depth_first(model)}
        depths = {name: len(list(model.ancestors(joint.child))) for name, joint in joints.items()}
        axes = {
            name: np.asarray(joint.axis, dtype=np.float64)
            for name, joint in joints.items()
            if joint.kind == HINGE_JOINT
        }
        return RobotJoints(order, depths, axes, user_names)

    @staticmethod
    def from_robot(robot: Robot, user_names: Mapping[str, str] | None = None) -> RobotJoints:
        """Create the joints of a loaded robot, in the order of its MJCF.

        Args:
            robot: Robot.
            user_names: {name in a source: joint}, passed by the user.
        """
        model, places = robot.mj_model, robot.mj_convention.qpos_index[-robot.nu :]
        data = robot.compute_kinematics(robot.make_qpos(np.zeros(robot.nu)))
        base = data.xmat[model.body(robot.mj_base).id].reshape(3, 3)
        ids = {int(model.jnt_qposadr[joint]): joint for joint in range(model.njnt)}
        depths, axes = dict[str, int](), dict[str, NDArray[np.float64]]()
        for name, place in zip(robot.joint_names, places, strict=True):
            joint, depth = ids[int(place)], 0
            body = int(model.jnt_bodyid[joint])
            while body:
                body, depth = int(model.body_parentid[body]), depth + 1
            depths[name] = depth
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE.value:
                axes[name] = base.T @ data.xaxis[joint]
        by_place = dict(zip(places.tolist(), robot.joint_names, strict=True))
        order = tuple(by_place[place] for place in sorted(by_place))
        return RobotJoints(order, depths, axes, user_names or {})

    @property
    def joints_by_depth(self) -> tuple[str, ...]:
        """Names of the moving joints, sorted by depth in the tree, as in Isaac Lab."""
        return tuple(sorted(self.order, key=self.depths.__getitem__))

    def match_names(self, names: Sequence[str]) -> dict[str, str]:
        """Match names in a source to the joints of the robot.

        Names may differ from the joint in prefixes, suffixes, case and separators, if the match is
        unique.

        Returns:
            {name in the source: joint}, without the names that match no joint.
        """
        pairs = {
            name: self.user_names[name] for name in names if self.user_names.get(name) in self.order
        }
        pairs |= {name: name for name in names if name in self.order and name not in pairs}
        return {**pairs, **match_without_affixes(names, self.order, pairs)}

    def mirrored_sign(self, first_name: str, second_name: str) -> int:
        """Return whether two joints have equal or opposite angles in mirrored postures: 1 or -1.

        A rotation about the axis a, mirrored at the xz plane of the base frame, is a rotation about
        (-a_x, a_y, -a_z), at zero joint angles.

        Args:
            first_name: Joint on one side.
            second_name: Joint on the other side.

        Returns:
            1 for equal angles, -1 for opposite angles, 0 if the axes are no mirror images or a
            joint is not a hinge.
        """
        first, second = self.axes.get(first_name), self.axes.get(second_name)
        if first is None or second is None:
            return 0
        cosine = float(np.dot(np.multiply(first, (-1, 1, -1)), second))
        return 0 if abs(cosine) < _MIN_MIRROR_COSINE else 1 if cosine > 0 else -1


_MIN_MIRROR_COSINE = 0.95
r"""Smallest absolute cosine between a joint axis, and the mirrored axis of the corresponding joint
on the other side, at which both are mirror images. Chosen, not tuned.
"""


def list_depth_first(model: RobotModel) -> tuple[str, ...]:
    """Return the names of the moving joints limb by limb: the order of MuJoCo and Isaac Gym.

    The joints of a base that has a ball joint are left out: with slides, the ball joint acts as a
    free joint.
    """
    roots = [link for link in model.links.values() if link.parent is None]
    links = [link for root in roots for link in (root, *model.descendants(root.name))]
    bases = [root.name for root in roots if any(joint.kind == BALL_JOINT for joint in root.joints)]
    return tuple(
        joint.name
        for link in links
        if link.name not in bases
        for joint in link.joints
        if joint.moves
    )


@dataclass(frozen=True, eq=False)
class _JointNames:
    """Names in a source, and the joints of the robot that the names and list indices denote.

    Attributes:
        model: Joints of the robot.
        matched: {name in the source: joint}.
        order: Joints in the order of the source's lists, "" for a name without match; empty if the
            order is not known.
        motor_order: {quantity: joints in the order of the motors}. Contains the quantities whose
            list has the order of the motors instead of ``order`` (`_find_motor_lists`).
    """

    model: RobotJoints
    matched: Mapping[str, str]
    order: tuple[str, ...]
    motor_order: Mapping[str, tuple[str, ...]]

    def find_joints(self, statement: Statement) -> list[str]:
        """Return the joints to which a statement applies; [""] for a setting of the whole robot.

        A statement selects joints by name, part of the name, pattern or list index. Empty if no
        joint matches.
        """
        if statement.index is not None:
            if statement.count != len(self.order):
                return []
            order = self.motor_order.get(statement.quantity, self.order)
            return list(filter(None, order[statement.index : statement.index + 1]))
        is_name = statement.joint in self.matched
        if statement.is_part and not (is_name and statement.quantity in _QUANTITIES_BY_NAME):
            return [
                joint
                for joint in self.model.order
                if statement.joint in joint
                or statement.joint in self.source_names.get(joint, joint)
            ]
        if is_name or not statement.joint:
            return [self.matched.get(statement.joint, "")]
        return [
            joint
            for joint in self.model.order
            if matches_name(statement.joint, joint)
            or matches_name(statement.joint, self.source_names.get(joint, joint))
        ]

    @cached_property
    def source_names(self) -> dict[str, str]:
        """{joint of the robot: name of the joint in the source}; the last of several names."""
        return {joint: name for name, joint in self.matched.items()}


def assign_joints(
    source: JointSource, model: RobotJoints, others: Sequence[JointSource]
) -> PlacedSource:
    """Assign the values that a source (for example a driver or a policy) states to robot joints.

    Args:
        source: Source.
        model: Joints of the robot.
        others: Other sources, which may define the order of the lists in this source.

    Returns:
        Facts about joints of the robot, the joint order with its origin, and unmatched names.
    """
    names = _list_joint_names(source)
    matched = model.match_names(names)
    order, how, order_notes = _determine_order(source, model, others, matched)
    motor_order = _find_motor_lists(source, model, order)
    joint_names = _JointNames(model, matched, order, motor_order)
    facts = _make_scale_facts(source)
    rest_facts = set[tuple[str, str]]()
    unread_lists: dict[str, Statement] = {}
    unplaced: dict[str, tuple[str, ...]] = {}
    for statement in source.statements:
        joints = joint_names.find_joints(statement)
        if statement.index is not None:
            if statement.count != len(order):
                unread_lists.setdefault(statement.quantity, statement)
            if how == "assumed" and statement.origin is Origin.STATED:
                statement = replace(statement, origin=Origin.ASSUMED)
        if statement.joint and not joints:
            keys = (*unplaced.get(statement.quantity, ()), statement.joint)
            unplaced[statement.quantity] = keys
        fact_keys = [(statement.quantity, joint) for joint in joints]
        if statement.is_rest:
            rest_facts.update(fact_keys)
        else:
            rest_facts.difference_update(fact_keys)
        facts |= {key: source.make_fact(statement, key[1]) for key in fact_keys}
    # A number of "all other joints" applies to the joints that the source controls.
    controlled = {joint for quantity, joint in facts if quantity == "kp"}
    facts = {
        key: fact for key, fact in facts.items() if key not in rest_facts or key[1] in controlled
    }
    _add_policy_step(facts)
    unread = {
        **source.unread,
        **_describe_unread_lists(source, unread_lists, order, model.order),
    }
    unknown = _list_unknown_names(source, model, names, matched)
    motor_notes = [
        diagnose("contract-order-of-motors", file=source.name, what=Term(quantity))
        for quantity in motor_order
    ]
    list_notes = _describe_number_lists(source, order, model.order)
    notes = (*order_notes, *motor_notes, *list_notes, *unread.values())
    return PlacedSource(source, facts, order, how, matched, unknown, notes, unread, unplaced)


def _describe_number_lists(
    source: JointSource, order: Sequence[str], model_joints: Sequence[str]
) -> Iterator[Diagnostic]:
    """Yield a note on lists under unknown keys with as many numbers as the robot has joints.

    ``order`` is the joint order of the source; empty if unknown. ``model_joints`` are the joints of
    the robot.
    """
    lengths = (len(model_joints), len(order))
    keys = [key for key, count in source.number_lists.items() if count in lengths]
    if keys:
        yield diagnose(
            "contract-lists-not-read",
            file=source.name,
            place=source.name,
            keys=keys,
            count=source.number_lists[keys[0]],
            named=bool(source.order),
            entry=f'quantity = "{_guess_quantity(keys[0])}", names = ["{keys[0]}"]',
            line=_format_names_line(Path(source.path).suffix, model_joints[0]),
        )


def _format_names_line(suffix: str, joint: str) -> str:
    """Return the start of a line with joint names, in the syntax of a file with a suffix."""
    if suffix.lower() == ".json":
        return f'"joint_names": ["{joint}", ...]'
    sign = " =" if suffix.lower() in (".py", ".toml") else ":"
    return f'joint_names{sign} ["{joint}", ...]'


_WORDS_OF_QUANTITIES = {"viscous": "damping", "damping": "damping", "friction": "friction"}
"""{part of a key: quantity of this key}, in addition to the names of the quantities themselves; the
first part that a key contains counts."""


def _guess_quantity(key: str) -> str:
    """Return the quantity that an unknown key probably states, for an example; else friction."""
    words = _WORDS_OF_QUANTITIES | {name: name for name in QUANTITIES}
    return next((words[part] for part in words if part in key.lower()), "friction")


def _describe_unread_lists(
    source: JointSource,
    lists: Mapping[str, Statement],
    order: Sequence[str],
    model_joints: Sequence[str],
) -> dict[str, Diagnostic]:
    """Explain why lists of a source cannot be assigned to joints: {quantity: message}.

    ``lists`` is {quantity: first number of the list}; ``order`` is the joint order of the source;
    ``model_joints`` are the joints of the robot.
    """
    order_place = source.order_place or Place(source.path)
    messages = dict[str, Diagnostic]()
    for quantity, first in lists.items():
        file = f"{source.name}:{first.place.line}" if first.place.line else source.name
        what = Term(quantity) if quantity in QUANTITIES else quantity
        if order:
            messages[quantity] = diagnose(
                "contract-list-length",
                file=file,
                what=what,
                count=first.count,
                joints=len(order),
                order=str(order_place),
                sources=(first.place.source, order_place.source),
            )
        else:
            messages[quantity] = diagnose(
                "contract-list-unread",
                file=file,
                what=what,
                count=first.count,
                joints=len(model_joints),
                line=_format_names_line(Path(source.path).suffix, model_joints[0]),
                sources=first.place.source,
            )
    return messages


def _list_unknown_names(
    source: JointSource, model: RobotJoints, names: Sequence[str], matched: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the ``names``, or parts of names, in a source that match no joint of the robot."""
    name_parts = {statement.joint for statement in source.statements if statement.is_part}
    return tuple(
        name
        for name in names
        if name not in matched
        and not (name in name_parts and any(name in joint for joint in model.order))
    )


def _list_joint_names(source: JointSource) -> list[str]:
    """Return the texts in a source that may be joint names: listed names, then keys of numbers.

    Parts of joint names, by which legged_gym states gains, are omitted unless they are also keys of
    default angles.
    """
    keys = dict.fromkeys(statement.joint for statement in source.statements if statement.joint)
    parts = {statement.joint for statement in source.statements if statement.is_part}
    angle_keys = {
        statement.joint for statement in source.statements if statement.quantity == "default angle"
    }
    plain_names = [
        key
        for key in keys
        if (_PLAIN_NAME.fullmatch(key) or not is_pattern(key))
        and (key not in parts or key in angle_keys)
    ]
    return list(dict.fromkeys((*source.order, *plain_names)))


def _make_scale_facts(source: JointSource) -> dict[tuple[str, str], Fact]:
    """Return {("observation " + term, ""): scale of the first element} of the observation terms."""
    scales = {
        f"observation {term.common_name}": (term.scale, term.place)
        for term in source.observations
        if term.scale is not None
    }
    return {
        (quantity, ""): source.make_fact(Statement(quantity, scale, place))
        for quantity, (scale, place) in scales.items()
    }


def _add_policy_step(facts: dict[tuple[str, str], Fact]) -> None:
    """Add the policy step (time step x decimation) to facts, unless stated or unknown."""
    time_step, decimation = facts.get(("time step", "")), facts.get(("decimation", ""))
    if time_step and decimation and time_step.number * decimation.number:
        policy_step = replace(
            decimation,
            quantity="policy step",
            unit=time_step.unit,
            decimals=None,
            origin=str(Origin.DERIVED),
            value=time_step.number * decimation.number,
        )
        facts.setdefault(("policy step", ""), policy_step)


def list_observations(source: JointSource) -> list[str]:
    """Return the names of a policy's observation terms, in order.

    Names of a library are replaced by common names (`OBSERVATION_ALIASES`).
    """
    return [term.common_name for term in source.observations]


_QUANTITIES_BY_NAME = ("default angle", "action offset")
"""Quantities whose keys in a trainer's table are names of joints if joints with these names exist,
and parts of joint names otherwise. legged_gym writes names; booster_gym writes parts.
"""

_PLAIN_NAME = re.compile(r"[\w/\- ]+")
"""Pattern of a text that is the name of a joint, not a regular expression for several joints."""


def _determine_order(
    source: JointSource,
    model: RobotJoints,
    others: Sequence[JointSource],
    matched: Mapping[str, str],
) -> tuple[tuple[str, ...], str, list[Diagnostic]]:
    """Determine the joint order of the lists in a source, and how this order is known.

    ``matched`` is {joint name in ``source``: joint of the model}.

    Returns:
        Joints ("" for an unknown name), empty if the order is unknown; ``named``, ``motors``,
        ``policy``, ``assumed`` or ""; notes.
    """
    if source.order:
        return tuple(matched.get(name, "") for name in source.order), "named", []
    lists = {statement.count for statement in source.statements if statement.index is not None}
    found = _find_name_lists(source, model, lists)
    if len(set(found.values())) == 1:
        key, order = next(iter(found.items()))
        return order, "named", [diagnose("contract-order-of-key", file=source.name, key=key)]
    sizes = {len(source.motors)} if source.motors else lists
    motors = next(filter(None, map(_get_motor_names, others)), {})
    if source.motors and set(source.motors) <= set(motors):
        names = model.match_names(list(motors.values()))
        return tuple(names.get(motors[motor], "") for motor in source.motors), "motors", []
    policies = [
        other_source
        for other_source in others
        if other_source.role is Role.POLICY and len(other_source.order) in sizes
    ]
    if policies and source.role is Role.DEPLOYMENT:  # a deployment runs the policy
        names = model.match_names(policies[0].order)
        return tuple(names.get(name, "") for name in policies[0].order), "policy", []
    if len(model.order) not in sizes:
        return (), "", []
    trainers = [other_source for other_source in others if other_source.role is Role.TRAINER]
    candidates = [model.joints_by_depth, model.order]
    if trainers and all(trainer.breadth_first for trainer in trainers):
        candidates.reverse()
    # Select the order with the best left-right symmetry: a wrong order violates the symmetry.
    # Limits of motors may have another order if the source states the motor of each joint.
    quantities = QUANTITIES.keys() - (_MOTOR_QUANTITIES if source.motors else ())
    unlike_fractions = {
        candidate: _compute_unlike_fraction(candidate, source, model, quantities)
        for candidate in dict.fromkeys(candidates[::-1])
    }
    order = min(unlike_fractions, key=unlike_fractions.__getitem__)
    if unlike_fractions[order] > MAX_UNLIKE_FRACTION:
        return (), "", []
    of_file = diagnose("contract-order-of-file", file=source.name, first=order[:3])
    by_depth = diagnose("contract-order-by-depth", file=source.name, first=order[:3])
    return order, "assumed", [of_file if order == model.order else by_depth]


_MOTOR_QUANTITIES = ("effort", "velocity")
"""Quantities that limit motors. A deployment may list these in the order of the motors, but gains
and angles in the order of the policy (RoboMimic_Deploy, ``tau_limit`` beside
``joint2motor_idx``)."""


def _find_motor_lists(
    source: JointSource, model: RobotJoints, order: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """Find the lists of motor limits that have the order of the motors, not that of the policy.

    The mirror symmetry of the values decides. ``order`` are the joints in the order of the policy.

    Returns:
        {quantity: joints in the order of the motors}.
    """
    if sorted(source.motors) != list(range(len(order))):
        return {}
    joints_of_motors = dict(zip(source.motors, order, strict=True))
    motor_order = tuple(joints_of_motors[motor] for motor in range(len(order)))
    return {
        quantity: motor_order
        for quantity in _MOTOR_QUANTITIES
        if _compute_unlike_fraction(order, source, model, (quantity,)) > MAX_UNLIKE_FRACTION
        and _compute_unlike_fraction(motor_order, source, model, (quantity,)) == 0
    }


def _find_name_lists(
    source: JointSource, model: RobotJoints, sizes: Collection[int]
) -> dict[str, tuple[str, ...]]:
    """Return {key: joints of the robot} of lists of joint names under keys unknown to the rules.

    ``sizes`` are the lengths of the source's lists of numbers, which these lists must have.
    """
    found = dict[str, tuple[str, ...]]()
    for key, names in source.name_lists.items():
        matched = model.match_names(names)
        order = tuple(matched[name] for name in names if name in matched)
        if len(names) in sizes and len(set(order)) == len(names):
            found[key] = order
    return found


MAX_UNLIKE_FRACTION = 1 / 3
"""Largest fraction of the left-right pairs of values (such as gains) that may contradict mirror
symmetry in an assumed joint order. If the fraction is larger, the order is rejected.
`_find_motor_lists` applies the bound to lists of motor limits. Chosen, not tuned.
"""


def _compute_unlike_fraction(
    order: tuple[str, ...],
    source: JointSource,
    model: RobotJoints,
    quantities: Collection[str] = QUANTITIES,
) -> float:
    """Return the fraction of left-right pairs of values that are no mirror images; 0 without pairs.

    ``order`` is the joint of each value in the lists of the source.
    """
    values = {
        (statement.quantity, order[statement.index]): statement.value
        for statement in source.statements
        if statement.index is not None and statement.count == len(order)
    }
    signs = {pair: (1, model.mirrored_sign(*pair)) for pair in find_mirror_pairs(order)}
    agreements = [
        is_mirror_image(
            values[quantity, first], values.get((quantity, second)), sign[kind.mirrored < 0]
        )
        for quantity, kind in QUANTITIES.items()
        if kind.mirrored and quantity in quantities
        for (first, second), sign in signs.items()
        if (quantity, first) in values
    ]
    return agreements.count(False) / max(1, len(agreements))


def is_mirror_image(first: float | None, second: float | None, sign: int) -> bool:
    """Return True if first = sign x second within a relative difference of 1e-3.

    Also True if a number is None or the sign is 0, since nothing can be compared.

    Args:
        first: Number of the joint on one side.
        second: Number of the joint on the other side.
        sign: Sign between mirrored numbers: 1, -1, or 0 if unknown.
    """
    if first is None or second is None or not sign:
        return True
    return math.isclose(first, sign * second, rel_tol=1e-3, abs_tol=1e-9)


def _get_motor_names(source: JointSource) -> dict[int, str]:
    """Return {index of a motor: joint name}, as stated in a source."""
    if source.order and source.motors:
        return dict(zip(source.motors, source.order, strict=False))
    return dict(enumerate(source.motor_names))


@cache
def matches_name(pattern: str, name: str) -> bool:
    """Return True if a pattern equals a name, or is a regular expression of the whole name.

    A regular expression that `is_pattern` refuses for the length of the name matches no other name.
    """
    if pattern in (name, ".*"):
        return True
    return (
        is_pattern(pattern, max(len(name), _NAME_LENGTH))
        and re.fullmatch(pattern, name) is not None
    )


_NAME_LENGTH = 100
"""Length of a joint name [characters] for which the matching time of a pattern is bounded, at
least. Chosen above the names of public robots, which have at most 50."""


@cache
def is_pattern(text: str, length: int = _NAME_LENGTH) -> bool:
    """Return True if a text is a regular expression that is matched in a bounded time.

    The number of paths that a backtracking search may try is at most `_MAX_PATHS`.

    Args:
        text: Text.
        length: Length of the matched names [characters].
    """
    plain = _ATOM_PATTERN.sub("x", text)
    if _NESTED_REPEAT_PATTERN.search(plain) or _VERBOSE_PATTERN.search(plain):
        return False
    if _count_paths(plain, length) > _MAX_PATHS:
        return False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # nested sets, as in [[1,2]
            return bool(re.compile(text))
    except (re.error, RecursionError, OverflowError):
        return False


def _count_paths(plain: str, length: int) -> float:
    """Return an upper bound of the paths of a backtracking search, for names of a given length.

    k quantifiers ``*``, ``+`` or ``{`` divide a name of n characters in at most C(n + k, k) ways;
    each ``?`` doubles the number, and each group multiplies it by the sum over its alternatives.

    Args:
        plain: Regular expression without escapes, sets of characters and nested quantifiers.
        length: Length of the name [characters].
    """
    num_repeats = min(len(_REPEAT_PATTERN.findall(plain)), 10)  # 10 exceed the limit
    groups = [(0.0, 1.0)]  # (paths of the earlier alternatives, paths of the current one)
    for letter in _EXTENSION_PATTERN.sub(r"\1", plain):
        total, current = groups[-1]
        if letter == "(":
            groups.append((0.0, 1.0))
        elif letter == ")" and len(groups) > 1:
            groups.pop()
            groups[-1] = groups[-1][0], groups[-1][1] * (total + current)
        elif letter == "|":
            groups[-1] = total + current, 1.0
        elif letter == "?":
            groups[-1] = total, current * 2.0
    return math.prod(map(sum, groups)) * math.comb(length + num_repeats, num_repeats)


_MAX_PATHS = 5_000_000
"""Largest number of paths (`_count_paths`) of a regular expression that is matched. Chosen: four
quantifiers and a name of 100 characters have 4.6 million paths, which need 0.2 s."""

_ATOM_PATTERN = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]", re.DOTALL)
"""Pattern of an escaped character, or a set of characters, in a regular expression."""

_EXTENSION_PATTERN = re.compile(r"(\(|(?<=[+*}?]))\?")
"""Question marks of a regular expression that are no quantifier: of ``(?...)`` and ``*?``."""

_REPEAT_PATTERN = re.compile(r"[+*{]")
"""Pattern of a quantifier in a regular expression that may match any number of characters."""

_NESTED_REPEAT_PATTERN = re.compile(r"[+*}?)][+*{]")
"""Quantifier (other than ``?``) that follows a quantifier or a group. A regular expression with
such a pair is not evaluated, because its matching time may grow exponentially.
"""

_VERBOSE_PATTERN = re.compile(r"\(\?[a-zA-Z-]*x")
"""Flag ``x``, with which spaces may separate a quantifier from its group."""
