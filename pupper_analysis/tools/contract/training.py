"""Numbers in configurations of trainers: legged_gym, Isaac Lab and mjlab.

A configuration is an object of a Python file, or a table of the file ``params/env.yaml`` that Isaac
Lab and mjlab write beside a policy. Both are a `LocatedValue`: `LocatedValue.get` returns a field
of an object or an entry of a table.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.places import quote_short
from pupper_analysis.tools.contract.facts import (
    CLASS_KEY,
    KEY_ALIASES,
    OBSERVATION_ALIASES,
    JointSource,
    LocatedValue,
    ObservedTerm,
    Origin,
    Role,
    Statement,
)
from pupper_analysis.tools.contract.keys import load_key_rules

_LEGGED_GYM, _MJLAB, _ISAAC_LAB = "legged_gym 1.0", "mjlab 1.6", "Isaac Lab 2.0"
"""Names of frameworks, with the versions from which the assumed default values were read."""

TARGET_BOUNDS = ("lowest target", "highest target")
"""Quantities of the bounds of commanded joint positions."""

COMMAND_PARTS = ("x", "y", "turn")
"""Elements of a command, whose scales are a list ``cmd_scale`` in files of unitree_rl_gym."""

_PLAIN_NAME = re.compile(r"\w+")
"""Pattern of a joint name that is no regular expression."""


def get_class_name(node: LocatedValue) -> str:
    """Return the name of the class of an object or table; empty if the class is not stated.

    A table states its class as ``class_type``, for example
    ``isaaclab.actuators.actuator_pd:DCMotor``.
    """
    kind = getattr(node.value, "kind", None)
    return str(kind) if kind is not None else _get_last_name(node.get(CLASS_KEY))


def _get_last_name(node: LocatedValue) -> str:
    """Return the last part of a dotted name, such as ``f`` of ``module.f`` and ``module:f``."""
    return re.split(r"[.:]", node.value)[-1] if isinstance(node.value, str) else ""


def iterate_instances(node: LocatedValue, seen: set[int]) -> Iterator[LocatedValue]:
    """Yield the objects and tables with a class in a configuration, also nested ones, each once.

    ``seen`` contains the Python ids of the values that were visited before, and is extended.
    """
    value = node.value
    held: Any = getattr(value, "fields", value)
    if id(value) in seen or not isinstance(held, dict | list):
        return
    seen.add(id(value))
    if get_class_name(node):
        yield node
    for part in held.values() if isinstance(held, dict) else held:
        yield from iterate_instances(part, seen)


def list_observation_terms(group: LocatedValue) -> Iterator[ObservedTerm]:
    """Yield the observation terms of a configuration: name, scales, history, clip.

    The terms are entries of ``group``, or of its table ``terms``.
    """
    group_history = group.get("history_length").number
    terms = group.get("terms")
    for name, term in (terms if terms.table else group).table.items():
        func, scale = term.get("func"), term.get("scale")
        function_name = re.split(r"[.:]", str(func.value))[-1]
        if func.is_present or isinstance(term.value, dict):
            numbers = tuple(item.number for item in scale.items)
            known = tuple(number for number in numbers if number is not None)
            scales = known if numbers and len(known) == len(numbers) else None
            if not numbers and func.is_present:
                scales = (1.0,)
            bounds = [item.number for item in term.get("clip").items]
            clip = (
                (bounds[0], bounds[1])
                if len(bounds) == 2 and bounds[0] is not None and bounds[1] is not None
                else None
            )
            history = group_history or term.get("history_length").number or 0.0
            yield ObservedTerm(
                function_name if function_name in OBSERVATION_ALIASES else str(name),
                scales,
                term.place,
                int(history),
                clip,
            )


def describe_partial_terms(
    group: LocatedValue, action_joints: tuple[str, ...]
) -> dict[str, Diagnostic]:
    """Return {quantity: message} of observation terms with other joints than the action.

    In Isaac Lab and mjlab, ``asset_cfg`` of a term may select joints (``joint_names``, patterns).
    The pattern ``.*`` for all joints is not reported.

    Args:
        group: Observation terms, as for `list_observation_terms`.
        action_joints: Joint names or patterns of the action.
    """
    terms, unread = group.get("terms"), dict[str, Diagnostic]()
    for name, term in (terms if terms.table else group).table.items():
        joints = term.get("params", "asset_cfg", "joint_names")
        if joints.value is not None and joints.texts not in ((".*",), action_joints):
            unread[f"observation {name}"] = diagnose(
                "contract-term-unread",
                file=str(joints.place),
                term=str(name),
                operation="joint_names",
                sources=joints.place.source,
            )
    return unread


def is_trainer_config(root: LocatedValue) -> bool:
    """Return True if a table is the training configuration of a policy, as of legged_gym.

    Such a table contains the default joint angles as ``init_state/default_joint_angles``.
    """
    return bool(root.get("init_state", "default_joint_angles").table)


def read_settings(root: LocatedValue) -> Iterator[Statement]:
    """Yield the joint values, global settings and observation scales in a legged_gym configuration.

    ``root`` is the top of the configuration. Each default angle is also an action offset.

    Raises:
        ModelError: If an entry of the user's ``pupper-analysis.toml`` is not valid.
    """
    for rule in load_key_rules("trainer", root.place.file):
        node = root.get(*rule.path)
        for statement in rule.list_statements(node) if rule.accepts(node) else ():
            # legged_gym leaves the armature of the URDF if the configuration has 0.
            if statement.value or rule.quantity != "armature":
                yield statement
            if rule.quantity == "default angle":
                yield replace(statement, quantity="action offset", origin=Origin.DERIVED)
    scale, hips = (root.get("control", word) for word in ("action_scale", "hip_scale_reduction"))
    if hips.number is not None and scale.number:
        # Source: walk-these-ways, LeggedRobot._compute_torques: first joint of each leg.
        product = scale.number * hips.number
        yield Statement("action scale", product, hips.place, r".*hip.*", origin=Origin.DERIVED)
    scales = root.get("normalization", "obs_scales")
    for word, node in scales.table.items():
        yield from node.make_statements(f"observation {word}")
    # Source: legged_gym, LeggedRobot._init_buffers: commands_scale.
    for part, word in zip(COMMAND_PARTS, ("lin_vel", "lin_vel", "ang_vel"), strict=True):
        if (node := scales.get(word)).number is not None:
            quantity = f"observation commands {part}"
            yield node.make_statement(quantity, origin=Origin.DEFAULT, basis=_LEGGED_GYM)


def is_environment(root: LocatedValue) -> bool:
    """Return True if a configuration contains a robot with actuators, as in Isaac Lab and mjlab."""
    return bool(_list_actuators(root.find_first("robot")))


def read_configuration(name: str, path: Path, root: LocatedValue) -> Iterator[JointSource]:
    """Yield the source of a top-level configuration ``root``, with the role of a trainer.

    The source has the numbers of a robot's actuators and default angles, of the policy's actions,
    and settings. Except for legged_gym, nothing is yielded without a robot or actions.
    """
    settings = tuple(read_settings(root))
    if is_trainer_config(root):
        yield JointSource(name, path, Role.TRAINER, settings)
        return
    instances = list(iterate_instances(root, set()))
    robots = [instance for instance in instances if _list_actuators(instance)]
    if len(robots) != 1:
        named = root.find_first("robot")
        robots = [named] if _list_actuators(named) else robots[:1]
    statements = [statement for robot in robots for statement in _list_robot_statements(robot)]
    angles = [statement for statement in statements if statement.quantity == "default angle"]
    actions = [
        instance
        for instance in instances
        if get_class_name(instance).removesuffix("Cfg") in KEY_ALIASES["actions"]
    ]
    statements += [
        statement for action in actions for statement in _list_action_statements(action, angles)
    ]
    # An empty text is a motor that the robot lacks, as in unitree_rl_lab's G1 with 23 joints.
    sdk_names = [item.value for item in robots[0].get("joint_sdk_names").items] if robots else []
    motors = tuple(sdk_names) if all(isinstance(name, str) for name in sdk_names) else ()
    order = actions[0].find_first("patterns") if len(actions) == 1 else None
    is_kept = order is not None and actions[0].get("preserve_order").value is True
    names = order.texts if order is not None and is_kept else ()
    if not all(_PLAIN_NAME.fullmatch(joint) for joint in names):
        names = ()
    # Isaac Lab sorts joints by depth, MuJoCo keeps the order of the file.
    mjlab = any(
        get_class_name(instance) == "EntityCfg" or "target_names_expr" in instance.table
        for instance in instances
    )
    observed = root.find_first("observations")
    observations = tuple(list_observation_terms(observed))
    # A text of a Python file may be an expression; a text of a table is no number.
    unread = _describe_texts(statements) if isinstance(root.value, dict) else {}
    unread |= describe_partial_terms(observed, order.texts if order is not None else ())
    if robots or actions:
        yield JointSource(
            name,
            path,
            Role.TRAINER,
            (*statements, *settings),
            order=names,
            order_place=order.place if order is not None and names else None,
            motor_names=motors,
            breadth_first=not mjlab,
            observations=observations,
            unread=unread,
        )


def _describe_texts(statements: Iterable[Statement]) -> dict[str, Diagnostic]:
    """Return {quantity: message} of the statements whose value is no number, such as ``15 deg``."""
    return {
        statement.quantity: diagnose(
            "contract-value-unread",
            file=str(statement.place),
            what=Term(statement.quantity),
            value=quote_short(statement.expression),
            sources=statement.place.source,
        )
        for statement in statements
        if statement.value is None
    }


def _list_actuators(node: LocatedValue) -> list[LocatedValue]:
    """Return the actuators in a robot's configuration (Isaac Lab or mjlab); otherwise empty."""
    actuators = node.find_first("actuators")
    parts = list(actuators.value.values()) if isinstance(actuators.value, dict) else actuators.items
    return [
        part
        for part in parts
        if node.get("init_state").is_present
        and (part.find_first("patterns").is_present or part.get("base_cfg").is_present)
    ]


def _list_robot_statements(robot: LocatedValue) -> Iterator[Statement]:
    """Yield default angles, gains, limits and friction of a robot's configuration, in SI units.

    The statements select joints by regular expressions. A joint that is missing in a table of
    default angles has the angle 0, the default of the framework.
    """
    angles = robot.get("init_state", "joint_pos")
    first_wins = get_class_name(robot) == "EntityCfg"
    if isinstance(angles.value, dict):
        basis = _MJLAB if first_wins else _ISAAC_LAB
        yield Statement(
            "default angle", 0.0, angles.place, ".*", origin=Origin.DEFAULT, basis=basis
        )
        entries = [(str(pattern), node) for pattern, node in angles.value.items()]
        for pattern, node in reversed(entries) if first_wins else entries:
            whole = _extend_to_name_end(pattern) if first_wins else pattern
            yield node.make_statement("default angle", whole)
    for actuator in _list_actuators(robot):
        base = actuator.get("base_cfg")
        inner = base if base.is_present else actuator
        for rule in load_key_rules("actuator", robot.place.file):
            node, quantity = inner.get(*rule.path), rule.quantity
            if quantity == "friction" and not first_wins and node.number:
                quantity = "friction coefficient"
            if isinstance(node.value, list):  # the joint of each element is not known
                node = replace(node, value="[...]")
            yield from node.make_statements(quantity, inner.find_first("patterns").texts)


def _extend_to_name_end(pattern: str) -> str:
    """Return a pattern that fully matches each name of which ``pattern`` matches the start.

    mjlab uses the first pattern that matches the start of a name (``resolve_expr``); Isaac Lab
    requires full matches. A suffix applies to all alternatives of ``pattern``; flags such as
    ``(?i)`` stay in front.
    """
    flags, rest = _FLAGS_PATTERN.fullmatch(pattern).groups()  # type: ignore[union-attr]
    if "|" in rest:
        return f"{flags}(?:{rest}).*"
    return pattern if rest.endswith((".*", "$")) else f"{pattern}.*"


_FLAGS_PATTERN = re.compile(r"((?:\(\?[aiLmsux]+\))?)(.*)", re.DOTALL)
"""Pattern of a regular expression, with two groups: global flags, and the remaining expression."""


def _list_action_statements(action: LocatedValue, angles: list[Statement]) -> Iterator[Statement]:
    """Yield the scales, offsets and bounds of a policy's action.

    The default joint angles ``angles`` are the offsets if ``use_default_offset`` is True or not
    stated.
    """
    patterns = action.find_first("patterns").texts
    scale = action.get("scale")
    yield from scale.make_statements("action scale", patterns)
    if not scale.is_present:
        is_mjlab = action.get("actuator_names").is_present
        basis = _MJLAB if is_mjlab else _ISAAC_LAB
        for pattern in patterns:
            yield Statement(
                "action scale", 1.0, action.place, pattern, origin=Origin.DEFAULT, basis=basis
            )
    if action.get("use_default_offset").value in (None, True):
        for angle in angles:
            origin = Origin.DERIVED if angle.origin is Origin.STATED else angle.origin
            yield replace(angle, quantity="action offset", origin=origin)
    else:
        yield from action.get("offset").make_statements("action offset", patterns)
    # The bounds of relative actions, and of actions relative to limits, are no positions.
    if get_class_name(action).removesuffix("Cfg") == "JointPositionAction":
        yield from list_target_bounds(action.get("clip"))


def list_target_bounds(clip: LocatedValue) -> Iterator[Statement]:
    """Yield the bounds of the commanded joint positions [rad] of a policy's action.

    ``clip`` is {joint pattern: [lower, upper]}, or a list of such pairs in the order of the policy.
    The bounds apply to the action after scale and offset (Isaac Lab, ``JointAction``).
    """
    pairs: list[tuple[LocatedValue, dict[str, Any]]]
    if isinstance(clip.value, dict):
        pairs = [(pair, {"joint": str(pattern)}) for pattern, pair in clip.table.items()]
    else:
        count = len(clip.items)
        pairs = [(pair, {"index": k, "count": count}) for k, pair in enumerate(clip.items)]
    for pair, where in pairs:
        if isinstance(pair.value, list) and len(pair.items) == 2:
            for quantity, bound in zip(TARGET_BOUNDS, pair.items, strict=True):
                yield bound.make_statement(quantity, **where)
