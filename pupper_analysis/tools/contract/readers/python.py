"""Trainers in Python: mjlab, Isaac Lab, and the classes of settings of legged_gym and its kin."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pupper_analysis.tools.contract.facts import Node, Request, Role, Source, Statement, per_joint
from pupper_analysis.tools.contract.facts import stated as state
from pupper_analysis.tools.contract.python_values import (
    Class,
    Evaluator,
    Function,
    Instance,
    Lost,
    Unknown,
)
from pupper_analysis.tools.contract.readers.tables import (
    observed_in,
    of_table,
    settings_of,
    stated_of_all,
)

SUFFIXES = (".py",)

_OF_ACTUATORS = {
    "stiffness": "kp",
    "damping": "kd",
    "effort_limit_sim": "effort",
    "effort_limit": "effort",
    "velocity_limit_sim": "velocity",
    "velocity_limit": "velocity",
    "armature": "armature",
    "friction": "friction",
    "frictionloss": "friction",
}
"""{field of an actuator's configuration: quantity}; of two the later counts: what the motor's own
model cuts a torque by, not what a solver does."""

_NAMES = ("joint_names_expr", "target_names_expr", "joint_names", "actuator_names")
_MOTIONS = ("JointPositionAction", "JointPositionToLimitsAction", "RelativeJointPositionAction")


def read(request: Request) -> Iterator[Source]:
    """Yields the configurations of a Python file; a flat table that a function makes, if none."""
    evaluator = Evaluator(request.folders)
    module = evaluator.module(request.path)
    roots, tables = list[tuple[Node, Source]](), list[Source]()
    for name, node in module.items():
        if name in module.imported or request.name not in ("", name):
            continue
        root, shown = _made(evaluator, node), f"{request.path.name}:{name}"
        if isinstance(root.value, Instance):
            roots += [(root, one) for one in _of_root(shown, request.path, root)]
        elif isinstance(root.value, dict):
            tables += of_table(request, shown, root, Role.TRAINER)
    # What another one is made of is no configuration of its own.
    parts = {one.value.kind for root, _ in roots for one in _walk(root, set())
             if one.value.kind != root.value.kind}  # fmt: skip
    found = [source for root, source in roots
             if request.name or not root.value.of or root.value.kind not in parts]  # fmt: skip
    scales = [] if request.name else [
        one for name, node in module.items()
        if "action_scale" in name.lower() and name not in module.imported
        for one in per_joint("action scale", node)
    ]  # fmt: skip
    for source in found or tables:
        has = {one.quantity for one in source.statements}
        more = scales if "action scale" not in has and "kp" in has else []
        yield replace(source, statements=(*source.statements, *more))


def _made(evaluator: Evaluator, node: Node) -> Node:
    """Returns what a name of a module makes: itself, an instance, or what its function returns."""
    value = node.value
    try:
        if isinstance(value, Class):
            return Node(evaluator.make(value, [], {}), node.place)
        if isinstance(value, Function) and isinstance(value.node, ast.FunctionDef):
            arguments = value.node.args
            free = arguments.args[: len(arguments.args) - len(arguments.defaults)]
            given = [_made(evaluator, _class_of(evaluator, each, value)) for each in free]
            made = evaluator.call(value, given, {})
            # A function may fill in the settings that it is given.
            return given[0] if given and made.value is None else made
    except Lost:
        return Node(None, node.place)
    return node if isinstance(value, Instance) else Node(None, node.place)


def _class_of(evaluator: Evaluator, argument: ast.arg, function: Function) -> Node:
    """Returns the class that an argument is annotated with, or the first of several."""
    for one in [] if argument.annotation is None else ast.walk(argument.annotation):
        found = evaluator.value(one, function.around) if isinstance(one, ast.Name) else None
        if found is not None and isinstance(found.value, Class):
            return found
    raise Lost


# mjlab and Isaac Lab: dataclasses within dataclasses.


def _walk(node: Node, seen: set[int]) -> Iterator[Node]:
    """Yields the instances below a value."""
    value = node.value
    if id(value) in seen or not isinstance(value, Instance | dict | list):
        return
    seen.add(id(value))
    if isinstance(value, Instance):
        yield node
    held: Any = getattr(value, "fields", value)
    for part in held.values() if isinstance(held, dict) else held:
        yield from _walk(part, seen)


def _of_root(name: str, path: Path, root: Node) -> Iterator[Source]:
    settings = tuple(settings_of(root))
    if settings:
        yield Source(name, path, Role.TRAINER, settings)
        return
    instances = list(_walk(root, set()))
    robots = [one for one in instances if _actuators(one)]
    if len({id(one.value) for one in robots}) > 1:
        named = [root.get("scene", "robot"), root.get("scene", "entities", "robot")]
        robots = [one for one in named if one is not None and _actuators(one)] or robots[:1]
    statements: list[Statement] = []
    motors: tuple[str, ...] = ()
    for robot in robots:
        statements += _of_robot(robot)
        sdk = robot.get("joint_sdk_names")
        motors = () if sdk is None else sdk.texts
    angles = [one for one in statements if one.quantity == "default angle"]
    actions = [one for one in instances if one.value.kind.removesuffix("Cfg") in _MOTIONS]
    for action in actions:
        statements += _of_action(action, angles)
    statements += stated_of_all(root)
    group = root.get("observations", "policy") or root.get("observations", "actor")
    if not (robots or actions):
        return
    # Isaac Lab's articulations are in the order of depth, MuJoCo's as they are written.
    mjlab = any(one.value.kind == "EntityCfg" or "target_names_expr" in one.value.fields
                for one in instances)  # fmt: skip
    yield Source(
        name,
        path,
        Role.TRAINER,
        tuple(statements),
        motor_names=motors,
        breadth_first=not mjlab,
        observations=tuple(observed_in(group and (group.get("terms") or group))),
    )


def _actuators(node: Node) -> list[Node]:
    """Returns the actuators of an articulation or an entity; none of what is neither."""
    held = node.get("actuators") or node.get("articulation", "actuators")
    if held is None or node.get("init_state") is None:
        return []
    parts = list(held.value.values()) if isinstance(held.value, dict) else held.items
    return [one for one in parts if any(one.get(name) for name in _NAMES)
            or one.get("base_cfg")]  # fmt: skip


def _of_robot(robot: Node) -> Iterator[Statement]:
    start = robot.get("init_state")
    angles = None if start is None else start.get("joint_pos")
    first_wins = robot.value.kind == "EntityCfg"
    if angles is not None and isinstance(angles.value, dict):
        yield Statement("default angle", 0.0, angles.place, ".*", implied=True)
        entries = list(angles.value.items())
        for pattern, node in reversed(entries) if first_wins else entries:
            # mjlab takes the first pattern that begins a name, Isaac Lab the one that is all of it.
            whole = f"{pattern}.*" if first_wins and not pattern.endswith((".*", "$")) else pattern
            yield state("default angle", node, whole)
    for actuator in _actuators(robot):
        inner = actuator.get("base_cfg") or actuator
        names = next((found for word in _NAMES if (found := inner.get(word))), None)
        patterns = () if names is None else names.texts
        for word, quantity in _OF_ACTUATORS.items():
            node = inner.get(word)
            if quantity == "friction" and not first_wins and node is not None and node.number:
                quantity = "friction coefficient"
            if node is not None and not isinstance(node.value, Unknown | str | list):
                yield from per_joint(quantity, node, patterns)
            elif node is not None:
                yield from (state(quantity, node, pattern) for pattern in patterns or [".*"])


def _of_action(action: Node, angles: list[Statement]) -> Iterator[Statement]:
    names = next((found for word in _NAMES if (found := action.get(word))), None)
    patterns = () if names is None else names.texts
    yield from per_joint("action scale", action.get("scale"), patterns)
    offset, default = action.get("offset"), action.get("use_default_offset")
    if default is None or default.value is True:
        for one in angles:
            yield replace(one, quantity="action offset", implied=True)
    else:
        yield from per_joint("action offset", offset, patterns)
