"""Trainers in Python: mjlab, Isaac Lab, and the classes of settings of legged_gym and its kin."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pupper_analysis.models.places import Place
from pupper_analysis.tools.contract.facts import Node, Request, Role, Source, Statement, per_joint
from pupper_analysis.tools.contract.facts import stated as state
from pupper_analysis.tools.contract.python_values import (
    Class,
    Evaluator,
    Function,
    Instance,
    Lost,
    Module,
    Unknown,
)
from pupper_analysis.tools.contract.readers.tables import settings_of, steps_of

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
    """Yields the configurations of a Python file, those with the most facts first."""
    evaluator = Evaluator(request.folders)
    module = evaluator.module(request.path)
    found: list[Source] = []
    roots: list[Node] = []
    for name, node in module.items():
        if name in module.imported or (request.name and name != request.name):
            continue
        root = _made(evaluator, node)
        if root is None:
            continue
        name = f"{request.path.name}:{name}"
        source = _of_class(name, request.path, root) or _of_graph(name, request.path, root)
        if source is not None:
            found.append(source)
            roots.append(root)
    # What another one is made of is no configuration of its own.
    parts = [{one.value.kind for one in _walk(root, set())} - {root.value.kind} for root in roots]
    if not request.name:
        whole = [not root.value.of or all(root.value.kind not in each for each in parts)
                 for root in roots]  # fmt: skip
        found = [one for one, alone in zip(found, whole, strict=True) if alone]
    scales = [] if request.name else list(_loose_scales(module))
    for source in found:
        has = {one.quantity for one in source.statements}
        more = scales if "action scale" not in has and "kp" in has else []
        yield replace(source, statements=(*source.statements, *more))


def _made(evaluator: Evaluator, node: Node) -> Node | None:
    """Returns what a name of a module makes: itself, an instance, or what its function returns."""
    value = node.value
    if isinstance(value, Instance):
        return node
    try:
        if isinstance(value, Class):
            return Node(evaluator.make(value, [], {}), node.place)
        if isinstance(value, Function) and isinstance(value.node.args.args, list):
            arguments = value.node.args
            free = arguments.args[: len(arguments.args) - len(arguments.defaults)]
            classes = [one for each in free if (one := _class_of(evaluator, each, value))]
            if len(classes) != len(free):
                return None
            given = [Node(evaluator.make(one.value, [], {}), one.place) for one in classes]
            made = evaluator.call(value, given, {})
            if given and made.value is None:
                made = given[0]  # a function that fills in the settings that it is given
            return made if isinstance(made.value, Instance) else None
    except Lost:
        pass
    return None


def _class_of(evaluator: Evaluator, argument: ast.arg, function: Function) -> Node | None:
    """Returns the class that an argument is annotated with, or the first of several."""
    names = [] if argument.annotation is None else ast.walk(argument.annotation)
    found = (evaluator.value(one, function.around) for one in names if isinstance(one, ast.Name))
    return next((one for one in found if isinstance(one.value, Class)), None)


def _loose_scales(module: Module) -> Iterator[Statement]:
    for name, node in module.items():
        if "action_scale" in name.lower() and name not in module.imported:
            yield from per_joint("action scale", node)


# mjlab and Isaac Lab: dataclasses within dataclasses.


def _walk(node: Node, seen: set[int]) -> Iterator[Node]:
    """Yields the instances below a value."""
    value = node.value
    if id(value) in seen or not isinstance(value, Instance | dict | list):
        return
    seen.add(id(value))
    if isinstance(value, Instance):
        yield node
    held = getattr(value, "fields", value)
    for part in held.values() if isinstance(held, dict) else held:
        yield from _walk(part, seen)


def _of_graph(name: str, path: Path, root: Node) -> Source | None:
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
    statements += steps_of(root)
    observations = tuple(_observed(root))
    if not (robots or actions):
        return None
    # Isaac Lab's articulations are in the order of depth, MuJoCo's as they are written.
    isaac = not any("target_names_expr" in one.value.fields for one in instances)
    mjlab = any(one.value.kind == "EntityCfg" for one in instances) or not isaac
    return Source(
        name,
        path,
        Role.TRAINER,
        tuple(statements),
        motor_names=motors,
        breadth_first=not mjlab,
        observations=observations,
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


def _observed(root: Node) -> Iterator[tuple[str, float | None, Place]]:
    for group in ("policy", "actor"):
        found = root.get("observations", group)
        if found is None:
            continue
        terms = found.get("terms") or found
        held = terms.value if isinstance(terms.value, dict) else terms.value.fields
        for name, term in held.items():
            if not isinstance(term.value, Instance) or term.get("func") is None:
                continue
            scale = term.get("scale")
            func = str(term.value.fields["func"].value).rpartition(".")[2]
            number = 1.0 if scale is None else scale.items[0].number
            yield (func if func.isidentifier() and func in _KNOWN else name), number, term.place
        return


_KNOWN = ("base_ang_vel", "projected_gravity", "generated_commands", "joint_pos_rel",
          "joint_vel_rel", "last_action", "velocity_commands", "base_lin_vel")  # fmt: skip


# legged_gym: classes within classes.


def _of_class(name: str, path: Path, root: Node) -> Source | None:
    statements = tuple(settings_of(root))
    return Source(name, path, Role.TRAINER, statements) if statements else None
