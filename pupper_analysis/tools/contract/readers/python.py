"""Trainers in Python: mjlab, Isaac Lab, and the classes of settings of legged_gym and its kin."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pupper_analysis.tools.contract import python_values as py
from pupper_analysis.tools.contract.facts import (
    FORMAT_KEYS,
    KEY_ALIASES,
    Node,
    Request,
    Role,
    Source,
    Statement,
)
from pupper_analysis.tools.contract.readers import tables

SUFFIXES = (".py",)

_OF_ACTUATORS = FORMAT_KEYS["actuator"]


def read(request: Request) -> Iterator[Source]:
    """Yields the configurations of a Python file; a flat table that a function makes, if none."""
    evaluator = py.Evaluator(request.folders)
    module = evaluator.module(request.path)
    own = {
        name: node
        for name, node in module.items()
        if name not in module.imported and request.name in ("", name)
    }
    roots, flat = list[tuple[Node, Source]](), list[Source]()
    for name, node in own.items():
        root, shown = _made(evaluator, node), f"{request.path.name}:{name}"
        if isinstance(root.value, py.InstanceValue):
            roots += [(root, one) for one in _of_root(shown, request.path, root)]
        elif isinstance(root.value, dict):
            flat += tables.read_table(request, shown, root, Role.TRAINER)
    # What another one is made of is no configuration of its own.
    parts = {
        one.value.kind
        for root, _ in roots
        for one in _walk(root, set())
        if one.value.kind != root.value.kind
    }
    found = [
        source
        for root, source in roots
        if request.name or not root.value.of or root.value.kind not in parts
    ]
    scales = [
        one
        for name, node in own.items()
        if "action_scale" in name.lower()
        for one in node.make_statements("action scale")
        if not request.name
    ]
    for source in found or flat:
        has = {one.quantity for one in source.statements}
        more = scales if "action scale" not in has and "kp" in has else []
        yield replace(source, statements=(*source.statements, *more))


def _made(evaluator: py.Evaluator, node: Node) -> Node:
    """Returns what a name of a module makes: itself, an instance, or what its function returns."""
    value = node.value
    if not isinstance(value, py.FunctionValue | py.ClassValue):
        return node if isinstance(value, py.InstanceValue) else replace(node, value=None)
    given: list[Node] = []
    try:
        if isinstance(value, py.FunctionValue):
            free = value.node.args.args[: -len(value.node.args.defaults) or None]
            given = [_made(evaluator, _class_of(evaluator, each, value)) for each in free]
        made = replace(node, value=evaluator.call(value, given, {}).value)
    except py.NotConstantError:
        return replace(node, value=None)
    # A function may fill in the settings that it is given.
    return given[0] if given and made.value is None else made


def _class_of(evaluator: py.Evaluator, argument: ast.arg, function: py.FunctionValue) -> Node:
    """Returns the class that an argument is annotated with, or the first of several."""
    for one in [] if argument.annotation is None else ast.walk(argument.annotation):
        found = evaluator.value(one, function.around) if isinstance(one, ast.Name) else None
        if found is not None and isinstance(found.value, py.ClassValue):
            return found
    raise py.NotConstantError


# mjlab and Isaac Lab: dataclasses within dataclasses.


def _walk(node: Node, seen: set[int]) -> Iterator[Node]:
    """Yields the instances below a value."""
    value = node.value
    if id(value) in seen or not isinstance(value, py.InstanceValue | dict | list):
        return
    seen.add(id(value))
    if isinstance(value, py.InstanceValue):
        yield node
    held: Any = getattr(value, "fields", value)
    for part in held.values() if isinstance(held, dict) else held:
        yield from _walk(part, seen)


def _of_root(name: str, path: Path, root: Node) -> Iterator[Source]:
    settings = tuple(tables.read_settings(root))
    if tables.is_trainer_config(root):
        yield Source(name, path, Role.TRAINER, settings)
        return
    instances = list(_walk(root, set()))
    robots = [one for one in instances if _actuators(one)]
    if len(robots) > 1:
        named = root.find_first("robot")
        robots = [named] if _actuators(named) else robots[:1]
    statements = [one for robot in robots for one in _of_robot(robot)]
    angles = [one for one in statements if one.quantity == "default angle"]
    actions = [
        one for one in instances if one.value.kind.removesuffix("Cfg") in KEY_ALIASES["actions"]
    ]
    statements += [one for action in actions for one in _of_action(action, angles)]
    motors = robots[0].get("joint_sdk_names").texts if robots else ()
    # Isaac Lab's articulations are in the order of depth, MuJoCo's as they are written.
    mjlab = any(
        one.value.kind == "EntityCfg" or "target_names_expr" in one.value.fields
        for one in instances
    )
    seen = tuple(tables.list_observation_terms(root.find_first("observations")))
    if robots or actions:
        yield Source(
            name,
            path,
            Role.TRAINER,
            (*statements, *settings),
            motor_names=motors,
            breadth_first=not mjlab,
            observations=seen,
        )


def _actuators(node: Node) -> list[Node]:
    """Returns the actuators of an articulation or an entity; none of what is neither."""
    held = node.find_first("actuators")
    parts = list(held.value.values()) if isinstance(held.value, dict) else held.items
    return [
        one
        for one in parts
        if node.get("init_state").is_present
        and (one.find_first("patterns").is_present or one.get("base_cfg").is_present)
    ]


def _of_robot(robot: Node) -> Iterator[Statement]:
    angles = robot.get("init_state", "joint_pos")
    first_wins = robot.value.kind == "EntityCfg"
    if isinstance(angles.value, dict):
        yield Statement("default angle", 0.0, angles.place, ".*", implied=True)
        entries = list(angles.value.items())
        for pattern, node in reversed(entries) if first_wins else entries:
            # mjlab takes the first pattern that begins a name, Isaac Lab the one that is all of it.
            whole = f"{pattern}.*" if first_wins and not pattern.endswith((".*", "$")) else pattern
            yield node.make_statement("default angle", whole)
    for actuator in _actuators(robot):
        base = actuator.get("base_cfg")
        inner = base if base.is_present else actuator
        for word, quantity in _OF_ACTUATORS.items():
            node = inner.get(word)
            if quantity == "friction" and not first_wins and node.number:
                quantity = "friction coefficient"
            if isinstance(node.value, list):  # whose each is is not known
                node = replace(node, value=py.UnknownValue("[...]"))
            yield from node.make_statements(quantity, inner.find_first("patterns").texts)


def _of_action(action: Node, angles: list[Statement]) -> Iterator[Statement]:
    patterns = action.find_first("patterns").texts
    yield from action.get("scale").make_statements("action scale", patterns)
    if action.get("use_default_offset").value in (None, True):
        yield from (replace(one, quantity="action offset", implied=True) for one in angles)
    else:
        yield from action.get("offset").make_statements("action offset", patterns)
