"""YAML and JSON of deployments: Unitree's, ROS 2's controllers, MoveIt's limits; RTNeural's."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.inputs import read_text
from pupper_analysis.models.places import Place
from pupper_analysis.tools.contract.facts import (
    FIELD_TABLE,
    FORMAT_KEYS,
    KEY_ALIASES,
    OBSERVATION_ALIASES,
    Node,
    Request,
    Role,
    Source,
    Statement,
    find_quantity_kind,
    read_yaml_nodes,
)

SUFFIXES = (".yaml", ".yml", ".json")

_KEYS = {
    **FORMAT_KEYS["table"],
    **{f"{name}_scale": f"observation {name}" for name in KEY_ALIASES["scales"]},
}


def read(request: Request) -> Iterator[Source]:
    """Yields what a YAML or a JSON holds: a configuration, or one for each controller or robot."""
    documents = read_yaml_nodes(request.path, read_text(request.path))
    for document in (one for one in documents if isinstance(one.value, dict)):
        layers = document.get("layers")
        if document.get("joint_limits").is_present:
            yield from _of_limits(request, document.get("joint_limits"))
        elif isinstance(layers.value, list):  # RTNeural's: a policy
            ends = {
                "actions": [one.get("shape") for one in layers.items[-1:]],
                "observed numbers": [document.get("in_shape")],
            }
            sizes = [
                size.make_statement(what)
                for what, shapes in ends.items()
                for shape in shapes
                for size in shape.items[-1:]
                if size.number
            ]
            yield from read_table(request, request.path.name, document, Role.POLICY, sizes)
        else:
            yield from _of_document(request, document)


def _of_document(request: Request, document: Node) -> Iterator[Source]:
    """Yields what a table states, and the tables in it: rl_sar's of a robot, ROS 2's of a node."""
    rate = document.get("controller_manager", "ros__parameters", "update_rate")
    # What a trainer's settings consist of is no configuration of its own.
    parts = {} if is_trainer_config(document) else document.value
    for key, node in {"": document, **parts}.items():
        own = node.get("ros__parameters")
        table, role = (own, Role.DRIVER) if own.is_present else (node, Role.DEPLOYMENT)
        if isinstance(table.value, dict) and request.name in ("", key):
            more = {"update_rate": rate} if own.is_present and rate.is_present else {}
            name = f"{request.path.name}:{key}" if key else request.path.name
            yield from read_table(request, name, Node({**table.value, **more}, table.place), role)


def read_table(
    request: Request, name: str, table: Node, role: Role, sizes: Sequence[Statement] = ()
) -> Iterator[Source]:
    """Yields what a flat table states of joints, and what else is known, if that is anything."""
    table = Node({str(key).lower(): node for key, node in table.value.items()}, table.place)
    named, motors = table.find_first("joints"), table.find_first("motors")
    indices = _numbers(motors)
    unread = (
        [diagnose("contract-motors-unread", file=name)] if motors.is_present and not indices else []
    )
    up = name.rpartition(":")[2].lower() in KEY_ALIASES["starting"]
    statements = [*sizes, *_listed(table, named.texts, indices, up)]
    for action in _below(table.get("actions")):
        statements += _flat("action scale", action.get("scale"))
        statements += _flat("action offset", action.get("offset"))
    statements += read_settings(table) if is_trainer_config(table) else ()
    if not (
        sizes
        or named.texts
        or any(not find_quantity_kind(one.quantity).is_setting for one in statements)
    ):
        return
    rate, often = table.get("update_rate"), table.get("repeat_action")
    if rate.number and often.number:
        statements.append(Statement("policy step", often.number / rate.number, often.place))
    seen = table.get("observation_names")
    names = ((one, None, seen.place) for one in seen.texts)
    role = Role.TRAINER if is_trainer_config(table) else role
    yield Source(
        name,
        request.path,
        role,
        tuple(statements),
        order=named.texts,
        order_place=named.place,
        motors=tuple(indices),
        observations=(*names, *list_observation_terms(table.get("observations"))),
        notes=tuple(unread),
    )


def _numbers(motors: Node) -> list[int]:
    """Returns the numbers of motors, each another one from 0 on; none if they are not."""
    numbers = [one.number for one in motors.items]
    whole = [int(one) for one in numbers if one is not None and one.is_integer() and one >= 0]
    return whole if len(set(whole)) == len(numbers) else []


def _listed(table: Node, order: Sequence[str], motors: list[int], up: bool) -> Iterator[Statement]:
    known = set(order) | {"", ".*"}
    # By motor, in the robot's own order: see unitree_rl_lab's articulation.h, "sdk order".
    whole = sorted(motors) == list(range(len(motors)))
    # Source: rl_sar, ReadYaml: a robot's table is for getting up, a policy's counts over it.
    to_start = up or (table.get("fixed_kp").is_present and not table.get("rl_kp").is_present)
    keys = {
        word: quantity
        for word, quantity in _KEYS.items()
        if not (to_start and quantity in ("effort", "default angle", "kp", "kd"))
    }
    for word, quantity in keys.items():
        for one in _flat(quantity, table.get(word)):
            if word in ("stiffness", "damping") and whole and one.index in motors:
                one = replace(one, index=motors.index(one.index or 0))
            # A text is a name of a parameter, not an expression: nothing is said of joints.
            if one.value is not None and (one.joint in known or not order):
                yield one


def _flat(quantity: str, node: Node) -> Iterable[Statement]:
    """Returns statements of a list, or of the list that a list of one list is."""
    inner = node.items[0] if len(node.items) == 1 else node
    return (inner if isinstance(inner.value, list) else node).make_statements(quantity)


def _below(node: Node) -> list[Node]:
    """Returns the tables in a table that are of joint positions."""
    return [
        one
        for key, one in node.table.items()
        if isinstance(one.value, dict) and "Velocity" not in key and "Effort" not in key
    ]


def list_observation_terms(terms: Node) -> Iterator[tuple[str, float | None, Place]]:
    """Yields the terms of an observation, in order, by their functions' names where these tell."""
    for name, term in terms.table.items():
        func, scale = term.get("func"), term.get("scale")
        called = str(func.value).rpartition(".")[2]
        if func.is_present or isinstance(term.value, dict):
            number = scale.items[0].number if scale.items else 1.0 if func.is_present else None
            yield called if called in OBSERVATION_ALIASES else name, number, term.place


def _of_limits(request: Request, limits: Node) -> Iterator[Source]:
    """Yields MoveIt's limits, each with the switch that says whether it counts."""
    words = {
        name: row["limits"] for name, row in FIELD_TABLE["quantities"].items() if "limits" in row
    }
    found = [
        one.get(word).make_statement(quantity, joint)
        for joint, one in limits.table.items()
        for quantity, (word, switch) in words.items()
        if one.get(word).is_present and one.get(switch).value is not False
    ]
    if found:
        yield Source(request.path.name, request.path, Role.DRIVER, tuple(found))


def is_trainer_config(root: Node) -> bool:
    """Whether settings are legged_gym's, or those of its kin: classes, or tables."""
    return bool(root.get("init_state", "default_joint_angles").table)


def read_settings(root: Node) -> Iterator[Statement]:
    """Yields what a trainer's settings state."""
    for path, quantity in FORMAT_KEYS["settings"].items():
        parts = FIELD_TABLE["quantities"][quantity].get("parts", False)
        for one in root.get(*path.split(".")).make_statements(quantity):
            if parts and one.joint != ".*":
                # A gain is of all joints whose names have its key in them.
                yield replace(one, joint=f".*{re.escape(one.joint)}.*")
            elif one.value or quantity != "armature":
                yield one
            if quantity == "default angle":
                yield replace(one, quantity="action offset", implied=True)
    scale, hips = (root.get("control", word) for word in ("action_scale", "hip_scale_reduction"))
    if hips.number is not None and scale.number:
        # Source: walk-these-ways, LeggedRobot._compute_torques: of each leg's first joint.
        yield Statement("action scale", scale.number * hips.number, hips.place, r".*hip.*")
    for word, node in root.get("normalization", "obs_scales").table.items():
        yield from node.make_statements(f"observation {word}")
